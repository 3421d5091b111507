//! Convolutions: 1x1 and dense ones as matrix products, depthwise ones row by row.
//!
//! Owns how weights are packed and the loops over pixels; written once over [`Lanes`] for
//! integers and floats. Pictures lie as rows of pixels, channels last.

use crate::lanes::{Lanes, round};

/// Pixels of a matrix product that are worked on while they lie in the first cache.
const BLOCK: usize = 96;

/// What happens to a sum before it is stored.
#[derive(Clone, Debug)]
pub(crate) struct Finish {
    /// Steps of the output that one of the sum is worth, by channel, filled up with 0.
    pub factors: Vec<f32>,
    /// Rounded before the activation: least and largest step, from the zero point.
    pub before: Option<(f32, f32)>,
    /// Factor below 0 and elsewhere.
    pub slopes: Option<(f32, f32)>,
    /// The output's zero point; `None`: 32-bit floats.
    pub zero: Option<f32>,
}

/// Integer weights, packed for one width of vectors.
#[derive(Clone, Debug)]
pub(crate) struct Packed {
    /// Vectors of channels that are worked on together: `(first channel, vectors)`.
    pub panels: Vec<(usize, usize)>,
    /// By panel, four inputs, channel: four bytes. Depthwise: by tap column, group of four
    /// rows, channel.
    pub weights: Vec<u8>,
    /// What sums start from, by channel.
    pub start: Vec<i32>,
    /// Channels of the output.
    pub channels: usize,
    /// Inputs of each output, in fours.
    pub fours: usize,
    pub finish: Finish,
}

/// Float weights, packed alike with one input in place of four.
#[derive(Clone, Debug)]
pub(crate) struct PackedF {
    pub panels: Vec<(usize, usize)>,
    pub weights: Vec<f32>,
    pub start: Vec<f32>,
    pub channels: usize,
    pub inputs: usize,
    /// Factor below 0.
    pub slope: Option<f32>,
}

/// Panels of at most four (or two) vectors, as even as can be.
pub(crate) fn panels(channels: usize, lanes: usize, wide: bool) -> Vec<(usize, usize)> {
    let vectors = channels.div_ceil(lanes);
    let count = vectors.div_ceil(if wide { 4 } else { 2 });
    let mut first = 0;
    (0..count)
        .map(|i| {
            let width = (vectors - first).div_ceil(count - i);
            first += width;
            ((first - width) * lanes, width)
        })
        .collect()
}

/// Pixels of `channels` bytes (or floats) each, `stride` apart.
#[derive(Clone, Copy)]
pub(crate) struct Pixels<T> {
    pub start: *mut T,
    pub stride: usize,
}

#[inline(always)]
unsafe fn finish<S: Lanes>(sum: S::I, packed: &Finish, channel: usize, out: *mut u8, n: usize) {
    // SAFETY: the caller's; `factors` is filled up to whole vectors.
    unsafe {
        let mut value = S::mul(S::to_f(sum), S::load_f(packed.factors.as_ptr().add(channel)));
        if let Some((least, most)) = packed.before {
            value = round::<S>(S::min(S::max(value, S::splat(least)), S::splat(most)));
        }
        if let Some((below, above)) = packed.slopes {
            let slope = S::by_sign(value, S::splat(below), S::splat(above));
            value = S::mul(value, slope);
        }
        match packed.zero {
            Some(zero) => {
                let value = S::min(S::max(value, S::splat(-zero)), S::splat(255.0 - zero));
                let steps = S::add(round::<S>(value), S::splat(zero));
                S::store_u8(out.add(channel), steps, n);
            }
            None => S::store_f(out.cast::<f32>().add(channel), value, n),
        }
    }
}

/// `M` pixels by `V` vectors of channels.
#[inline(always)]
unsafe fn tile<S: Lanes, const M: usize, const V: usize>(
    packed: &Packed,
    panel: *const u8,
    first: usize,
    from: Pixels<u8>,
    to: Pixels<u8>,
) {
    // SAFETY: the caller gives `M` whole pixels and the weights of this panel.
    unsafe {
        let mut sums = [[S::load_i(packed.start.as_ptr().add(first)); V]; M];
        for v in 1..V {
            let start = S::load_i(packed.start.as_ptr().add(first + v * S::N));
            for sums in &mut sums {
                sums[v] = start;
            }
        }
        let mut weights = panel;
        for four in 0..packed.fours {
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
                finish::<S>(sum, &packed.finish, channel, out, packed.channels - channel);
            }
        }
    }
}

#[inline(always)]
unsafe fn tiles<S: Lanes, const M: usize, const V: usize>(
    packed: &Packed,
    panel: *const u8,
    first: usize,
    from: Pixels<u8>,
    to: Pixels<u8>,
    count: usize,
) {
    let at = |pixels: Pixels<u8>, m: usize| Pixels {
        // SAFETY: the caller's pixels reach as far.
        start: unsafe { pixels.start.add(m * pixels.stride) },
        ..pixels
    };
    let mut m = 0;
    while m + M <= count {
        // SAFETY: the caller's.
        unsafe { tile::<S, M, V>(packed, panel, first, at(from, m), at(to, m)) };
        m += M;
    }
    while m < count {
        // SAFETY: the caller's.
        unsafe { tile::<S, 1, V>(packed, panel, first, at(from, m), at(to, m)) };
        m += 1;
    }
}

/// Each of `count` pixels times the matrix. `to.stride` is in bytes.
///
/// # Safety
/// `from` holds `4 * fours` readable bytes from each pixel's start, `to` the output.
#[inline(always)]
pub(crate) unsafe fn product<S: Lanes>(
    packed: &Packed,
    from: Pixels<u8>,
    to: Pixels<u8>,
    count: usize,
) {
    let mut done = 0;
    while done < count {
        let block = BLOCK.min(count - done);
        // SAFETY: the caller's; panels lie one behind the other.
        unsafe {
            let from = Pixels { start: from.start.add(done * from.stride), ..from };
            let to = Pixels { start: to.start.add(done * to.stride), ..to };
            for &(first, vectors) in &packed.panels {
                let panel = packed.weights.as_ptr().add(first * 4 * packed.fours);
                match (S::WIDE, vectors) {
                    (true, 4) => tiles::<S, 6, 4>(packed, panel, first, from, to, block),
                    (true, 3) => tiles::<S, 8, 3>(packed, panel, first, from, to, block),
                    (true, 2) => tiles::<S, 8, 2>(packed, panel, first, from, to, block),
                    (false, 2) => tiles::<S, 4, 2>(packed, panel, first, from, to, block),
                    _ => tiles::<S, 4, 1>(packed, panel, first, from, to, block),
                }
            }
        }
        done += block;
    }
}

/// `M` pixels by `V` vectors of channels, in floats.
#[inline(always)]
unsafe fn tile_f<S: Lanes, const M: usize, const V: usize>(
    packed: &PackedF,
    panel: *const f32,
    first: usize,
    from: Pixels<f32>,
    to: Pixels<f32>,
) {
    // SAFETY: the caller gives `M` whole pixels and the weights of this panel.
    unsafe {
        let mut sums = [[S::splat(0.0); V]; M];
        for v in 0..V {
            let start = S::load_f(packed.start.as_ptr().add(first + v * S::N));
            for sums in &mut sums {
                sums[v] = start;
            }
        }
        let mut weights = panel;
        for input in 0..packed.inputs {
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
                let value = activate::<S>(sum, packed.slope);
                S::store_f(out, value, packed.channels - channel);
            }
        }
    }
}

#[inline(always)]
unsafe fn activate<S: Lanes>(value: S::F, slope: Option<f32>) -> S::F {
    // SAFETY: the caller's.
    unsafe {
        match slope {
            Some(slope) => S::by_sign(value, S::mul(value, S::splat(slope)), value),
            None => value,
        }
    }
}

#[inline(always)]
unsafe fn tiles_f<S: Lanes, const M: usize, const V: usize>(
    packed: &PackedF,
    panel: *const f32,
    first: usize,
    from: Pixels<f32>,
    to: Pixels<f32>,
    count: usize,
) {
    let at = |pixels: Pixels<f32>, m: usize| Pixels {
        // SAFETY: the caller's pixels reach as far.
        start: unsafe { pixels.start.add(m * pixels.stride) },
        ..pixels
    };
    let mut m = 0;
    while m + M <= count {
        // SAFETY: the caller's.
        unsafe { tile_f::<S, M, V>(packed, panel, first, at(from, m), at(to, m)) };
        m += M;
    }
    while m < count {
        // SAFETY: the caller's.
        unsafe { tile_f::<S, 1, V>(packed, panel, first, at(from, m), at(to, m)) };
        m += 1;
    }
}

/// Each of `count` pixels times the matrix, in floats.
///
/// # Safety
/// `from` and `to` hold whole pixels.
#[inline(always)]
pub(crate) unsafe fn product_f<S: Lanes>(
    packed: &PackedF,
    from: Pixels<f32>,
    to: Pixels<f32>,
    count: usize,
) {
    let mut done = 0;
    while done < count {
        let block = BLOCK.min(count - done);
        // SAFETY: the caller's; panels lie one behind the other.
        unsafe {
            let from = Pixels { start: from.start.add(done * from.stride), ..from };
            let to = Pixels { start: to.start.add(done * to.stride), ..to };
            for &(first, vectors) in &packed.panels {
                let panel = packed.weights.as_ptr().add(first * packed.inputs);
                match (S::WIDE, vectors) {
                    (true, 4) => tiles_f::<S, 6, 4>(packed, panel, first, from, to, block),
                    (true, 3) => tiles_f::<S, 8, 3>(packed, panel, first, from, to, block),
                    (true, 2) => tiles_f::<S, 8, 2>(packed, panel, first, from, to, block),
                    (false, 2) => tiles_f::<S, 6, 2>(packed, panel, first, from, to, block),
                    _ => tiles_f::<S, 8, 1>(packed, panel, first, from, to, block),
                }
            }
        }
        done += block;
    }
}

/// Shape of a convolution's window and of what it moves over.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Window {
    pub kernel: usize,
    pub stride: usize,
    pub pad: usize,
    /// Height and width of the input.
    pub from: [usize; 2],
    /// Height and width of the output.
    pub to: [usize; 2],
}

impl Window {
    /// The input row under row `k` of the window for output row `y`, if it is inside.
    #[inline(always)]
    pub(crate) fn row(&self, y: usize, k: usize) -> Option<usize> {
        (y * self.stride + k).checked_sub(self.pad).filter(|&row| row < self.from[0])
    }
}

/// Copies the windows of output row `y` into rows of `scratch`, `width` values each; places
/// outside hold `outside`.
///
/// # Safety
/// `from` holds the input; `scratch` holds `to[1] * width` values.
#[inline(always)]
pub(crate) unsafe fn windows<T: Copy>(
    window: &Window,
    from: Pixels<T>,
    channels: usize,
    y: usize,
    scratch: *mut T,
    width: usize,
    outside: T,
) {
    let run = window.kernel * channels;
    for k in 0..window.kernel {
        let row = window.row(y, k);
        for x in 0..window.to[1] {
            // SAFETY: a window's row has `run` values, all rows together at most `width`.
            unsafe {
                let place = scratch.add(x * width + k * run);
                let left = (x * window.stride).cast_signed() - window.pad.cast_signed();
                let first = left.cast_unsigned();
                let whole = left >= 0 && first + window.kernel <= window.from[1];
                if let (Some(row), true) = (row, whole && from.stride == channels) {
                    let pixel = row * window.from[1] + first;
                    std::ptr::copy_nonoverlapping(from.start.add(pixel * channels), place, run);
                    continue;
                }
                for i in 0..window.kernel {
                    let column = left + i.cast_signed();
                    let inside = column >= 0 && column.cast_unsigned() < window.from[1];
                    for c in 0..channels {
                        let value = match row {
                            Some(row) if inside => {
                                let pixel = row * window.from[1] + column.cast_unsigned();
                                *from.start.add(pixel * from.stride + c)
                            }
                            _ => outside,
                        };
                        *place.add(i * channels + c) = value;
                    }
                }
            }
        }
    }
}

/// A depthwise convolution of bytes.
///
/// The rows under the window are first woven together, four bytes of a column for each
/// channel; a column then serves every window that covers it.
///
/// # Safety
/// `from` and `to` hold whole pictures; `scratch` holds
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
        // SAFETY: the caller's, as far as the end of this function.
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
            let out = to.start.add(y * window.to[1] * to.stride);
            let to = Pixels { start: out, ..to };
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

/// A depthwise convolution of floats; outside the picture is 0.
///
/// # Safety
/// `from` and `to` hold whole pictures, and a vector may be read behind `from`.
#[inline(always)]
pub(crate) unsafe fn depthwise_f<S: Lanes>(
    packed: &PackedF,
    window: &Window,
    from: Pixels<f32>,
    to: Pixels<f32>,
) {
    let padded = packed.channels.next_multiple_of(S::N);
    for y in 0..window.to[0] {
        // SAFETY: the caller's.
        unsafe {
            let out = Pixels { start: to.start.add(y * window.to[1] * to.stride), ..to };
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
        // SAFETY: the caller's; weights are filled up to whole vectors.
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
