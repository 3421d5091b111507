//! Pooling, weaving, adding, enlarging, copying: the operations without products of many inputs.
//!
//! Plain loops over pixels, compiled once for each instruction set.

use crate::lanes::ROUND;
use crate::pixels::{Pixels, Window};

/// The largest value under each window; places outside do not count.
///
/// # Safety
/// `from` and `to` hold whole activations of `channels`.
#[inline(always)]
pub(crate) unsafe fn pool<T: Copy + PartialOrd>(
    window: &Window,
    channels: usize,
    least: T,
    from: Pixels<T>,
    to: Pixels<T>,
) {
    for y in 0..window.to[0] {
        for x in 0..window.to[1] {
            // SAFETY: guaranteed by the caller.
            unsafe {
                let out = to.start.add((y * window.to[1] + x) * to.stride);
                let out = std::slice::from_raw_parts_mut(out, channels);
                out.fill(least);
                for k in 0..window.kernel {
                    let Some(row) = window.row(y, k) else { continue };
                    for i in 0..window.kernel {
                        let column = (x * window.stride + i).wrapping_sub(window.pad);
                        if column >= window.from[1] {
                            continue;
                        }
                        let pixel = row * window.from[1] + column;
                        let input = from.start.add(pixel * from.stride);
                        let input = std::slice::from_raw_parts(input, channels);
                        for (out, &value) in out.iter_mut().zip(input) {
                            *out = if value > *out { value } else { *out };
                        }
                    }
                }
            }
        }
    }
}

/// Channels of two activations in turn: the shuffle of two halves.
///
/// # Safety
/// `a` and `b` hold `count` pixels of `channels`, `to` twice as many channels.
#[inline(always)]
pub(crate) unsafe fn interleave<T: Copy>(
    a: Pixels<T>,
    b: Pixels<T>,
    to: Pixels<T>,
    channels: usize,
    count: usize,
) {
    for i in 0..count {
        // SAFETY: guaranteed by the caller.
        unsafe {
            let a = std::slice::from_raw_parts(a.start.add(i * a.stride), channels);
            let b = std::slice::from_raw_parts(b.start.add(i * b.stride), channels);
            let out = to.start.add(i * to.stride).cast::<[T; 2]>();
            let out = std::slice::from_raw_parts_mut(out, channels);
            for ((out, &a), &b) in out.iter_mut().zip(a).zip(b) {
                *out = [a, b];
            }
        }
    }
}

/// Steps of one scale to steps of another: `value * factor + shift`, rounded.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Rescale {
    pub factor: f32,
    pub zero_from: f32,
    pub zero_to: f32,
}

#[inline(always)]
fn to_steps(value: f32, zero: f32) -> u8 {
    let (least, most) = (-zero, 255.0 - zero);
    let value = if value > least { value } else { least };
    let value = if value < most { value } else { most };
    // SAFETY: between 0 and 255; a scale is a normal number, so that nothing is NaN.
    unsafe { (((value + ROUND) - ROUND) + zero).to_int_unchecked::<i32>() as u8 }
}

/// Copies pixels, rescaled where that is asked.
///
/// # Safety
/// Both hold `count` pixels of `channels`.
#[inline(always)]
pub(crate) unsafe fn copy<T: Copy>(from: Pixels<T>, to: Pixels<T>, channels: usize, count: usize) {
    for i in 0..count {
        // SAFETY: guaranteed by the caller.
        unsafe {
            let source = from.start.add(i * from.stride);
            std::ptr::copy_nonoverlapping(source, to.start.add(i * to.stride), channels);
        }
    }
}

/// As [`copy`], to another scale.
///
/// # Safety
/// Both hold `count` pixels of `channels`.
#[inline(always)]
pub(crate) unsafe fn rescale(
    scale: Rescale,
    from: Pixels<u8>,
    to: Pixels<u8>,
    channels: usize,
    count: usize,
) {
    for i in 0..count {
        // SAFETY: guaranteed by the caller.
        unsafe {
            let source = std::slice::from_raw_parts(from.start.add(i * from.stride), channels);
            let out = std::slice::from_raw_parts_mut(to.start.add(i * to.stride), channels);
            for (out, &value) in out.iter_mut().zip(source) {
                let value = (f32::from(value) - scale.zero_from) * scale.factor;
                *out = to_steps(value, scale.zero_to);
            }
        }
    }
}

/// The sum of two activations, each with its scale.
///
/// # Safety
/// All hold `count` pixels of `channels`.
#[inline(always)]
pub(crate) unsafe fn add(
    scales: [Rescale; 2],
    from: [Pixels<u8>; 2],
    to: Pixels<u8>,
    channels: usize,
    count: usize,
) {
    for i in 0..count {
        // SAFETY: guaranteed by the caller.
        unsafe {
            let [a, b] =
                from.map(|p| std::slice::from_raw_parts(p.start.add(i * p.stride), channels));
            let out = std::slice::from_raw_parts_mut(to.start.add(i * to.stride), channels);
            for ((out, &a), &b) in out.iter_mut().zip(a).zip(b) {
                let a = (f32::from(a) - scales[0].zero_from) * scales[0].factor;
                let b = (f32::from(b) - scales[1].zero_from) * scales[1].factor;
                *out = to_steps(a + b, scales[0].zero_to);
            }
        }
    }
}

/// The sum of two activations in floats.
///
/// # Safety
/// All hold `count` pixels of `channels`.
#[inline(always)]
pub(crate) unsafe fn add_f(from: [Pixels<f32>; 2], to: Pixels<f32>, channels: usize, count: usize) {
    for i in 0..count {
        // SAFETY: guaranteed by the caller.
        unsafe {
            let [a, b] =
                from.map(|p| std::slice::from_raw_parts(p.start.add(i * p.stride), channels));
            let out = std::slice::from_raw_parts_mut(to.start.add(i * to.stride), channels);
            for ((out, &a), &b) in out.iter_mut().zip(a).zip(b) {
                *out = a + b;
            }
        }
    }
}

/// A value that an activation can be enlarged in.
pub(crate) trait Mix: Copy {
    /// Nine parts of `a`, three each of `b` and `c`, one of `d`, by 16.
    fn mix(a: Self, b: Self, c: Self, d: Self) -> Self;
}

impl Mix for u8 {
    #[inline(always)]
    fn mix(a: u8, b: u8, c: u8, d: u8) -> u8 {
        let [a, b, c, d] = [a, b, c, d].map(u16::from);
        let sum = 9 * a + 3 * (b + c) + d;
        // To the nearest, a half to the even one, as a model's QuantizeLinear does.
        ((sum + 7 + ((sum >> 4) & 1)) >> 4) as u8
    }
}

impl Mix for f32 {
    #[inline(always)]
    fn mix(a: f32, b: f32, c: f32, d: f32) -> f32 {
        (a * 9.0 + (b + c) * 3.0 + d) * (1.0 / 16.0)
    }
}

/// Twice as wide and high, linear between aligned pixel centres.
///
/// # Safety
/// `from` holds `size` (height, width) pixels of `channels`, `to` four times as many.
#[inline(always)]
pub(crate) unsafe fn double<T: Mix>(
    size: [usize; 2],
    channels: usize,
    from: Pixels<T>,
    to: Pixels<T>,
) {
    let [height, width] = size;
    for y in 0..2 * height {
        for x in 0..2 * width {
            // The nearest pixel and its neighbour on the other side, at the border itself.
            let near = |at: usize, len: usize| {
                let next =
                    if at.is_multiple_of(2) { (at / 2).saturating_sub(1) } else { at / 2 + 1 };
                (at / 2, next.min(len - 1))
            };
            let ((row, other_row), (column, other)) = (near(y, height), near(x, width));
            // SAFETY: guaranteed by the caller.
            unsafe {
                let pixel = |row: usize, column: usize| {
                    let start = from.start.add((row * width + column) * from.stride);
                    std::slice::from_raw_parts(start, channels)
                };
                let out = to.start.add((y * 2 * width + x) * to.stride);
                let out = std::slice::from_raw_parts_mut(out, channels);
                let (a, b) = (pixel(row, column), pixel(row, other));
                let (c, d) = (pixel(other_row, column), pixel(other_row, other));
                for ((((out, &a), &b), &c), &d) in out.iter_mut().zip(a).zip(b).zip(c).zip(d) {
                    *out = T::mix(a, b, c, d);
                }
            }
        }
    }
}
