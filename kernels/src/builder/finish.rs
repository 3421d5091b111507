//! From operators to a network: where each activation lies in the memory.

use super::{Builder, PlanError, Tensor, refuse};
use crate::layout::{Block, lay_out};
use crate::net::{Plan, Port, Program};
use crate::op::{BEHIND, Place, Step};

impl Builder {
    /// Lays out the memory.
    ///
    /// # Errors
    /// [`PlanError`] where there is no output.
    pub fn finish(mut self, outputs: &[Tensor]) -> Result<Plan, PlanError> {
        if outputs.is_empty() {
            return refuse("a network without an output");
        }
        let (offsets, bytes) = lay_out(&self.blocks(outputs));
        // Moved, not copied: the weights are in there.
        let ops = std::mem::take(&mut self.ops);
        let place = |tensor: Tensor| {
            let (at, first) = self.whole(tensor);
            let whole = &self.activations[at.0];
            Place {
                offset: offsets[at.0] + first * whole.width(),
                stride: whole.shape.channels * whole.width(),
            }
        };
        let steps =
            ops.into_iter().map(|(op, from, to)| Step { op, from: from.map(place), to: place(to) });
        let port = |&tensor: &Tensor| Port {
            place: place(tensor),
            shape: self.shape(tensor),
            quant: self.quant_params(tensor),
        };
        Ok(Plan::new(Program {
            isa: self.isa,
            steps: steps.collect(),
            inputs: self.inputs.iter().map(port).collect(),
            outputs: outputs.iter().map(port).collect(),
            activations: bytes,
            scratch: self.scratch,
        }))
    }

    /// The activation that `tensor` is a part of, and its first channel there.
    fn whole(&self, tensor: Tensor) -> (Tensor, usize) {
        let (mut at, mut first) = (tensor, 0);
        while let Some((whole, from)) = self.activations[at.0].part_of {
            (at, first) = (whole, first + from);
        }
        (at, first)
    }

    /// Memory that each activation takes; parts of others take none.
    fn blocks(&self, outputs: &[Tensor]) -> Vec<Block> {
        let mut blocks = vec![Block { bytes: 0, life: (usize::MAX, 0) }; self.activations.len()];
        let mut touch = |tensor: Tensor, at: usize| {
            let (Tensor(i), _) = self.whole(tensor);
            let activation = &self.activations[i];
            let values = activation.shape.pixels() * activation.shape.channels;
            let bytes = (values * activation.width() + BEHIND).next_multiple_of(64);
            let (first, last) = blocks[i].life;
            blocks[i] = Block { bytes, life: (first.min(at), last.max(at)) };
        };
        for &input in &self.inputs {
            touch(input, 0);
        }
        for (i, (_, from, to)) in self.ops.iter().enumerate() {
            for &tensor in from.iter().chain([to]) {
                touch(tensor, i + 1);
            }
        }
        for &output in outputs {
            touch(output, self.ops.len() + 1);
        }
        blocks
    }
}
