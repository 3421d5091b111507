//! Matrix products over pixels: 1x1 convolutions, and dense ones whose windows were copied
//! into rows.
//!
//! Owns the tiles that stay in registers and the blocks that stay in the first cache.

use crate::finish::{activate, finish};
use crate::lanes::Lanes;
use crate::pack::{Packed, PackedF};
use crate::pixels::Pixels;

/// Pixels of a matrix product that are worked on while they lie in the first cache.
const BLOCK: usize = 96;

/// Packed weights that pixels are multiplied by, on the lanes `S`.
pub(crate) trait Matrix<S: Lanes> {
    /// Type of inputs and weights in memory.
    type Stored: Copy;
    /// Type of outputs.
    type Out: Copy;
    /// Whether narrow registers take tiles of twice the pixels: no sums of four to be held.
    const LONG: bool;

    fn panels(&self) -> &[(usize, usize)];

    /// Weights of one output channel.
    fn inputs(&self) -> usize;

    fn weights(&self) -> *const Self::Stored;

    /// `M` pixels by `V` vectors of channels, from channel `first` on.
    ///
    /// # Safety
    /// `from` and `to` hold `M` whole pixels; `panel` the weights of these channels.
    unsafe fn tile<const M: usize, const V: usize>(
        &self,
        panel: *const Self::Stored,
        first: usize,
        from: Pixels<Self::Stored>,
        to: Pixels<Self::Out>,
    );
}

impl<S: Lanes> Matrix<S> for Packed {
    type Stored = u8;
    type Out = u8;
    const LONG: bool = false;

    fn panels(&self) -> &[(usize, usize)] {
        &self.panels
    }

    fn inputs(&self) -> usize {
        4 * self.fours
    }

    fn weights(&self) -> *const u8 {
        self.weights.as_ptr()
    }

    #[inline(always)]
    unsafe fn tile<const M: usize, const V: usize>(
        &self,
        panel: *const u8,
        first: usize,
        from: Pixels<u8>,
        to: Pixels<u8>,
    ) {
        // SAFETY: the caller gives `M` whole pixels and the weights of this panel.
        unsafe {
            let mut sums = [[S::load_i(self.start.as_ptr().add(first)); V]; M];
            for v in 1..V {
                let start = S::load_i(self.start.as_ptr().add(first + v * S::N));
                for sums in &mut sums {
                    sums[v] = start;
                }
            }
            let mut weights = panel;
            for four in 0..self.fours {
                let mut column = [S::load_b(weights); V];
                for (v, column) in column.iter_mut().enumerate().skip(1) {
                    *column = S::load_b(weights.add(v * 4 * S::N));
                }
                weights = weights.add(V * 4 * S::N);
                for (m, sums) in sums.iter_mut().enumerate() {
                    let input = S::splat_b(from.start.add(m * from.stride + four * 4));
                    for (sum, weights) in sums.iter_mut().zip(column) {
                        *sum = S::dot(*sum, input, weights);
                    }
                }
            }
            for (m, sums) in sums.into_iter().enumerate() {
                for (v, sum) in sums.into_iter().enumerate() {
                    let channel = first + v * S::N;
                    let out = to.start.add(m * to.stride);
                    finish::<S>(sum, &self.finish, channel, out, self.channels - channel);
                }
            }
        }
    }
}

impl<S: Lanes> Matrix<S> for PackedF {
    type Stored = f32;
    type Out = f32;
    const LONG: bool = true;

    fn panels(&self) -> &[(usize, usize)] {
        &self.panels
    }

    fn inputs(&self) -> usize {
        self.inputs
    }

    fn weights(&self) -> *const f32 {
        self.weights.as_ptr()
    }

    #[inline(always)]
    unsafe fn tile<const M: usize, const V: usize>(
        &self,
        panel: *const f32,
        first: usize,
        from: Pixels<f32>,
        to: Pixels<f32>,
    ) {
        // SAFETY: the caller gives `M` whole pixels and the weights of this panel.
        unsafe {
            let mut sums = [[S::splat(0.0); V]; M];
            for v in 0..V {
                let start = S::load_f(self.start.as_ptr().add(first + v * S::N));
                for sums in &mut sums {
                    sums[v] = start;
                }
            }
            let mut weights = panel;
            for input in 0..self.inputs {
                let mut column = [S::load_f(weights); V];
                for (v, column) in column.iter_mut().enumerate().skip(1) {
                    *column = S::load_f(weights.add(v * S::N));
                }
                weights = weights.add(V * S::N);
                for (m, sums) in sums.iter_mut().enumerate() {
                    let input = S::splat(*from.start.add(m * from.stride + input));
                    for (sum, weights) in sums.iter_mut().zip(column) {
                        *sum = S::mul_add(input, weights, *sum);
                    }
                }
            }
            for (m, sums) in sums.into_iter().enumerate() {
                for (v, sum) in sums.into_iter().enumerate() {
                    let channel = first + v * S::N;
                    let out = to.start.add(m * to.stride + channel);
                    let value = activate::<S>(sum, self.slope);
                    S::store_f(out, value, self.channels - channel);
                }
            }
        }
    }
}

#[inline(always)]
unsafe fn tiles<S: Lanes, W: Matrix<S>, const M: usize, const V: usize>(
    matrix: &W,
    panel: *const W::Stored,
    first: usize,
    from: Pixels<W::Stored>,
    to: Pixels<W::Out>,
    count: usize,
) {
    let mut m = 0;
    while m < count {
        // SAFETY: the caller's pixels reach as far.
        unsafe {
            let (from, to) = (from.skip(m), to.skip(m));
            if m + M <= count {
                matrix.tile::<M, V>(panel, first, from, to);
                m += M;
            } else {
                matrix.tile::<1, V>(panel, first, from, to);
                m += 1;
            }
        }
    }
}

/// Each of `count` pixels times the matrix.
///
/// # Safety
/// `from` holds as many readable values from each pixel's start as the matrix has inputs, `to`
/// the output.
#[inline(always)]
pub(crate) unsafe fn product<S: Lanes, W: Matrix<S>>(
    matrix: &W,
    from: Pixels<W::Stored>,
    to: Pixels<W::Out>,
    count: usize,
) {
    let mut done = 0;
    while done < count {
        let block = BLOCK.min(count - done);
        // SAFETY: guaranteed by the caller; panels lie one behind the other.
        unsafe {
            let (from, to) = (from.skip(done), to.skip(done));
            for &(first, vectors) in matrix.panels() {
                let panel = matrix.weights().add(first * matrix.inputs());
                match (S::WIDE, vectors, W::LONG) {
                    (true, 4, _) => tiles::<S, W, 6, 4>(matrix, panel, first, from, to, block),
                    (true, 3, _) => tiles::<S, W, 8, 3>(matrix, panel, first, from, to, block),
                    (true, 2, _) => tiles::<S, W, 8, 2>(matrix, panel, first, from, to, block),
                    (false, 2, false) => tiles::<S, W, 4, 2>(matrix, panel, first, from, to, block),
                    (false, 2, true) => tiles::<S, W, 6, 2>(matrix, panel, first, from, to, block),
                    (_, _, false) => tiles::<S, W, 4, 1>(matrix, panel, first, from, to, block),
                    (_, _, true) => tiles::<S, W, 8, 1>(matrix, panel, first, from, to, block),
                }
            }
        }
        done += block;
    }
}
