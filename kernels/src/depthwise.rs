//! Depthwise convolutions, row by row: each channel with its own window.

use crate::finish::{activate, finish};
use crate::lanes::Lanes;
use crate::pack::{Packed, PackedF};
use crate::pixels::{Pixels, Window};

/// A depthwise convolution of bytes.
///
/// The rows under the window are first woven together, four bytes of a column for each
/// channel; a column then serves every window that covers it.
///
/// # Safety
/// `from` and `to` hold whole activations; `scratch` holds
/// `(from[1] + 2 pad) * groups * 4 * padded` bytes.
#[inline(always)]
pub(crate) unsafe fn depthwise<S: Lanes>(
    packed: &Packed,
    window: &Window,
    from: Pixels<u8>,
    to: Pixels<u8>,
    outside: u8,
    scratch: *mut u8,
) {
    let padded = packed.channels.next_multiple_of(S::N);
    let groups = window.kernel.div_ceil(4);
    let column_len = groups * 4 * padded;
    for y in 0..window.to[0] {
        // SAFETY: guaranteed by the caller, as far as the end of this function.
        unsafe {
            for column in 0..window.from[1] + 2 * window.pad {
                let inside = column.checked_sub(window.pad).filter(|&x| x < window.from[1]);
                for group in 0..groups {
                    let out = scratch.add(column * column_len + group * 4 * padded);
                    let mut rows = [std::ptr::null::<u8>(); 4];
                    let mut any = false;
                    for (i, place) in rows.iter_mut().enumerate() {
                        let k = group * 4 + i;
                        let row = if k < window.kernel { window.row(y, k) } else { None };
                        if let (Some(row), Some(x)) = (row, inside) {
                            let pixel = row * window.from[1] + x;
                            *place = from.start.add(pixel * from.stride);
                            any = true;
                        }
                    }
                    weave(rows, any, outside, out, packed.channels);
                }
            }
            let to = to.skip(y * window.to[1]);
            match window.kernel {
                3 => across::<S, 3, 1>(packed, window, scratch, to, padded),
                _ => across::<S, 5, 2>(packed, window, scratch, to, padded),
            }
        }
    }
}

/// Four rows of one column into groups of four bytes.
#[inline(always)]
unsafe fn weave(rows: [*const u8; 4], any: bool, outside: u8, out: *mut u8, channels: usize) {
    // SAFETY: rows that are not null have `channels` bytes, `out` four times as many.
    unsafe {
        let out = out.cast::<u32>();
        let blank = u32::from_ne_bytes([outside; 4]);
        if !any {
            for c in 0..channels {
                out.add(c).write_unaligned(blank);
            }
            return;
        }
        if rows.iter().all(|row| !row.is_null()) {
            for c in 0..channels {
                let at = |i: usize| u32::from(*rows[i].add(c)) << (8 * i);
                out.add(c).write_unaligned((at(0) | at(1) | at(2) | at(3)).to_le());
            }
        } else if !rows[0].is_null() && !rows[1].is_null() && !rows[2].is_null() {
            let last = u32::from(outside) << 24;
            for c in 0..channels {
                let at = |i: usize| u32::from(*rows[i].add(c)) << (8 * i);
                out.add(c).write_unaligned((at(0) | at(1) | at(2) | last).to_le());
            }
        } else {
            for c in 0..channels {
                let mut four = [outside; 4];
                for (four, row) in four.iter_mut().zip(rows) {
                    if !row.is_null() {
                        *four = *row.add(c);
                    }
                }
                out.add(c).write_unaligned(u32::from_ne_bytes(four));
            }
        }
    }
}

/// One output row from woven columns.
#[inline(always)]
unsafe fn across<S: Lanes, const K: usize, const G: usize>(
    packed: &Packed,
    window: &Window,
    woven: *const u8,
    to: Pixels<u8>,
    padded: usize,
) {
    let mut channel = 0;
    while channel < packed.channels {
        // SAFETY: weights, columns and starts are filled up to whole vectors.
        unsafe {
            let start = S::load_i(packed.start.as_ptr().add(channel));
            let weights: [[S::B; G]; K] = std::array::from_fn(|k| {
                std::array::from_fn(|g| {
                    let place = ((k * G + g) * padded + channel) * 4;
                    S::load_b(packed.weights.as_ptr().add(place))
                })
            });
            for x in 0..window.to[1] {
                let mut sum = start;
                for (k, weights) in weights.iter().enumerate() {
                    for (g, &weights) in weights.iter().enumerate() {
                        let column = x * window.stride + k;
                        let place = ((column * G + g) * padded + channel) * 4;
                        sum = S::dot(sum, S::load_b(woven.add(place)), weights);
                    }
                }
                let out = to.start.add(x * to.stride);
                finish::<S>(sum, &packed.finish, channel, out, packed.channels - channel);
            }
        }
        channel += S::N;
    }
}

/// A depthwise convolution of floats; outside the activation is 0.
///
/// # Safety
/// `from` and `to` hold whole activations, and a vector may be read behind `from`.
#[inline(always)]
pub(crate) unsafe fn depthwise_f<S: Lanes>(
    packed: &PackedF,
    window: &Window,
    from: Pixels<f32>,
    to: Pixels<f32>,
) {
    let padded = packed.channels.next_multiple_of(S::N);
    for y in 0..window.to[0] {
        // SAFETY: guaranteed by the caller.
        unsafe {
            let out = to.skip(y * window.to[1]);
            match window.kernel {
                3 => across_f::<S, 3>(packed, window, from, out, y, padded),
                _ => across_f::<S, 5>(packed, window, from, out, y, padded),
            }
        }
    }
}

/// Outputs of a row that are summed up together.
const TOGETHER: usize = 4;

#[inline(always)]
unsafe fn across_f<S: Lanes, const K: usize>(
    packed: &PackedF,
    window: &Window,
    from: Pixels<f32>,
    to: Pixels<f32>,
    y: usize,
    padded: usize,
) {
    let Window { stride, pad, from: [_, width], to: [_, outputs], .. } = *window;
    // Outputs whose windows lie inside from left to right.
    let first = pad.div_ceil(stride).min(outputs);
    let last = ((width + pad).saturating_sub(K) / stride + 1).clamp(first, outputs);
    let mut channel = 0;
    while channel < packed.channels {
        // SAFETY: guaranteed by the caller; weights are filled up to whole vectors.
        unsafe {
            let start = S::load_f(packed.start.as_ptr().add(channel));
            let weights = packed.weights.as_ptr().add(channel);
            let store = |x: usize, sum: S::F| {
                let out = to.start.add(x * to.stride + channel);
                S::store_f(out, activate::<S>(sum, packed.slope), packed.channels - channel);
            };
            let edge = |x: usize| {
                let mut sum = start;
                for k in 0..K {
                    let Some(row) = window.row(y, k) else { continue };
                    for i in 0..K {
                        let column = (x * stride + i).wrapping_sub(pad);
                        if column < width {
                            let pixel = row * width + column;
                            let value = S::load_f(from.start.add(pixel * from.stride + channel));
                            sum = S::mul_add(
                                value,
                                S::load_f(weights.add((k * K + i) * padded)),
                                sum,
                            );
                        }
                    }
                }
                store(x, sum);
            };
            (0..first).for_each(edge);
            let mut x = first;
            while x + TOGETHER <= last {
                let mut sums = [start; TOGETHER];
                for k in 0..K {
                    let Some(row) = window.row(y, k) else { continue };
                    let pixel = row * width + x * stride - pad;
                    let inputs = from.start.add(pixel * from.stride + channel);
                    for i in 0..K {
                        let weight = S::load_f(weights.add((k * K + i) * padded));
                        for (j, sum) in sums.iter_mut().enumerate() {
                            let value = S::load_f(inputs.add((j * stride + i) * from.stride));
                            *sum = S::mul_add(value, weight, *sum);
                        }
                    }
                }
                for (j, sum) in sums.into_iter().enumerate() {
                    store(x + j, sum);
                }
                x += TOGETHER;
            }
            (x..outputs).for_each(edge);
        }
        channel += S::N;
    }
}
