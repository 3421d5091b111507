//! 64-bit Arm: NEON, and NEON with dot products.

use crate::lanes::Lanes;
use std::arch::aarch64::*;

/// The lanes that NEON with and without dot products share.
macro_rules! neon_lanes {
    () => {
        const N: usize = 4;
        const WIDE: bool = true;
        type I = int32x4_t;
        type F = float32x4_t;
        type B = uint8x16_t;

        #[inline(always)]
        unsafe fn load_i(from: *const i32) -> Self::I {
            // SAFETY: guaranteed by the caller, here and below.
            unsafe { vld1q_s32(from) }
        }
        #[inline(always)]
        unsafe fn load_b(from: *const u8) -> Self::B {
            // SAFETY: as above.
            unsafe { vld1q_u8(from) }
        }
        #[inline(always)]
        unsafe fn splat_b(from: *const u8) -> Self::B {
            // SAFETY: as above.
            unsafe { vreinterpretq_u8_u32(vdupq_n_u32(from.cast::<u32>().read_unaligned())) }
        }
        #[inline(always)]
        unsafe fn to_f(value: Self::I) -> Self::F {
            // SAFETY: as above.
            unsafe { vcvtq_f32_s32(value) }
        }
        #[inline(always)]
        unsafe fn splat(value: f32) -> Self::F {
            // SAFETY: as above.
            unsafe { vdupq_n_f32(value) }
        }
        #[inline(always)]
        unsafe fn load_f(from: *const f32) -> Self::F {
            // SAFETY: as above.
            unsafe { vld1q_f32(from) }
        }
        #[inline(always)]
        unsafe fn add(a: Self::F, b: Self::F) -> Self::F {
            // SAFETY: as above.
            unsafe { vaddq_f32(a, b) }
        }
        #[inline(always)]
        unsafe fn mul(a: Self::F, b: Self::F) -> Self::F {
            // SAFETY: as above.
            unsafe { vmulq_f32(a, b) }
        }
        #[inline(always)]
        unsafe fn min(a: Self::F, b: Self::F) -> Self::F {
            // SAFETY: as above.
            unsafe { vminq_f32(a, b) }
        }
        #[inline(always)]
        unsafe fn max(a: Self::F, b: Self::F) -> Self::F {
            // SAFETY: as above.
            unsafe { vmaxq_f32(a, b) }
        }
        #[inline(always)]
        unsafe fn mul_add(a: Self::F, b: Self::F, c: Self::F) -> Self::F {
            // SAFETY: as above.
            unsafe { vfmaq_f32(c, a, b) }
        }
        #[inline(always)]
        unsafe fn by_sign(of: Self::F, negative: Self::F, other: Self::F) -> Self::F {
            // SAFETY: as above.
            unsafe { vbslq_f32(vcltq_f32(of, vdupq_n_f32(0.0)), negative, other) }
        }
        #[inline(always)]
        unsafe fn store_f(to: *mut f32, value: Self::F, n: usize) {
            // SAFETY: as above; `part` holds the four lanes.
            unsafe {
                if n >= 4 {
                    return vst1q_f32(to, value);
                }
                let mut part = [0f32; 4];
                vst1q_f32(part.as_mut_ptr(), value);
                std::ptr::copy_nonoverlapping(part.as_ptr(), to, n);
            }
        }
        #[inline(always)]
        unsafe fn store_u8(to: *mut u8, value: Self::F, n: usize) {
            // SAFETY: as above.
            unsafe {
                let words = vmovn_u32(vcvtq_u32_f32(value));
                let bytes = vmovn_u16(vcombine_u16(words, words));
                let four = vget_lane_u32::<0>(vreinterpret_u32_u8(bytes)).to_le_bytes();
                std::ptr::copy_nonoverlapping(four.as_ptr(), to, n.min(4));
            }
        }
    };
}

/// NEON: 4 lanes; products of bytes are widened and added in pairs.
#[derive(Clone, Copy)]
pub(crate) struct Neon;

impl Lanes for Neon {
    neon_lanes!();

    #[inline(always)]
    unsafe fn dot(sum: Self::I, unsigned: Self::B, signed: Self::B) -> Self::I {
        // SAFETY: as above.
        unsafe {
            let signed = vreinterpretq_s8_u8(signed);
            let a = vreinterpretq_s16_u16(vmovl_u8(vget_low_u8(unsigned)));
            let b = vreinterpretq_s16_u16(vmovl_u8(vget_high_u8(unsigned)));
            let (w, x) = (vmovl_s8(vget_low_s8(signed)), vmovl_s8(vget_high_s8(signed)));
            let low = vpaddq_s32(
                vmull_s16(vget_low_s16(a), vget_low_s16(w)),
                vmull_s16(vget_high_s16(a), vget_high_s16(w)),
            );
            let high = vpaddq_s32(
                vmull_s16(vget_low_s16(b), vget_low_s16(x)),
                vmull_s16(vget_high_s16(b), vget_high_s16(x)),
            );
            vaddq_s32(sum, vpaddq_s32(low, high))
        }
    }
}

/// NEON with `sdot`: 4 lanes; it knows signed bytes only, so inputs are taken 128 lower.
#[derive(Clone, Copy)]
pub(crate) struct NeonDot;

impl Lanes for NeonDot {
    const SHIFTED: bool = true;
    neon_lanes!();

    #[inline(always)]
    unsafe fn dot(sum: Self::I, unsigned: Self::B, signed: Self::B) -> Self::I {
        // SAFETY: as above. `sdot` reads and writes registers only; the caller checked that
        // the processor has it.
        unsafe {
            let lower = veorq_u8(unsigned, vdupq_n_u8(128));
            let mut sum = sum;
            std::arch::asm!(
                "sdot {sum:v}.4s, {a:v}.16b, {b:v}.16b",
                sum = inout(vreg) sum, a = in(vreg) lower, b = in(vreg) signed,
                options(pure, nomem, nostack, preserves_flags)
            );
            sum
        }
    }
}
