//! Where the activations of a network lie in the memory that they share.

/// An activation as memory sees it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Block {
    /// Its length.
    pub bytes: usize,
    /// The first and the last moment at which it is needed, counted in steps.
    pub life: (usize, usize),
}

/// Where each block begins, and how many bytes there are: blocks that are not needed at the
/// same time share memory. Largest first, each as low as it fits.
pub(crate) fn lay_out(blocks: &[Block]) -> (Vec<usize>, usize) {
    let mut order: Vec<_> = (0..blocks.len()).collect();
    order.sort_by_key(|&i| (std::cmp::Reverse(blocks[i].bytes), i));
    let mut offsets = vec![0; blocks.len()];
    let mut placed: Vec<usize> = Vec::new();
    let mut end = 0;
    for i in order {
        let Block { bytes, life } = blocks[i];
        let at_once = |other: (usize, usize)| other.0 <= life.1 && life.0 <= other.1;
        let mut taken: Vec<_> = placed
            .iter()
            .filter(|&&j| at_once(blocks[j].life))
            .map(|&j| (offsets[j], offsets[j] + blocks[j].bytes))
            .collect();
        taken.sort_unstable();
        let mut at = 0;
        for (from, to) in taken {
            if from >= at + bytes {
                break;
            }
            at = at.max(to);
        }
        offsets[i] = at;
        end = end.max(at + bytes);
        placed.push(i);
    }
    (offsets, end)
}
