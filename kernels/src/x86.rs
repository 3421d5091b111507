//! x86-64: AVX-512 with VNNI, AVX2 with AVX-VNNI, AVX2.

use crate::lanes::Lanes;
use std::arch::x86_64::*;

/// AVX-512 F, BW, VL, VNNI: 16 lanes, `vpdpbusd`.
#[derive(Clone, Copy)]
pub(crate) struct Avx512Vnni;

#[inline(always)]
fn mask16(n: usize) -> u16 {
    if n >= 16 { u16::MAX } else { (1 << n) - 1 }
}

impl Lanes for Avx512Vnni {
    const N: usize = 16;
    const WIDE: bool = true;
    type I = __m512i;
    type F = __m512;
    type B = __m512i;

    #[inline(always)]
    unsafe fn load_i(from: *const i32) -> Self::I {
        // SAFETY: guaranteed by the caller, here and below.
        unsafe { _mm512_loadu_epi32(from) }
    }
    #[inline(always)]
    unsafe fn load_b(from: *const u8) -> Self::B {
        // SAFETY: as above.
        unsafe { _mm512_loadu_si512(from.cast()) }
    }
    #[inline(always)]
    unsafe fn splat_b(from: *const u8) -> Self::B {
        // SAFETY: as above.
        unsafe { _mm512_set1_epi32(from.cast::<i32>().read_unaligned()) }
    }
    #[inline(always)]
    unsafe fn dot(sum: Self::I, unsigned: Self::B, signed: Self::B) -> Self::I {
        // SAFETY: as above.
        unsafe { _mm512_dpbusd_epi32(sum, unsigned, signed) }
    }
    #[inline(always)]
    unsafe fn to_f(value: Self::I) -> Self::F {
        // SAFETY: as above.
        unsafe { _mm512_cvtepi32_ps(value) }
    }
    #[inline(always)]
    unsafe fn splat(value: f32) -> Self::F {
        // SAFETY: as above.
        unsafe { _mm512_set1_ps(value) }
    }
    #[inline(always)]
    unsafe fn load_f(from: *const f32) -> Self::F {
        // SAFETY: as above.
        unsafe { _mm512_loadu_ps(from) }
    }
    #[inline(always)]
    unsafe fn add(a: Self::F, b: Self::F) -> Self::F {
        // SAFETY: as above.
        unsafe { _mm512_add_ps(a, b) }
    }
    #[inline(always)]
    unsafe fn mul(a: Self::F, b: Self::F) -> Self::F {
        // SAFETY: as above.
        unsafe { _mm512_mul_ps(a, b) }
    }
    #[inline(always)]
    unsafe fn min(a: Self::F, b: Self::F) -> Self::F {
        // SAFETY: as above.
        unsafe { _mm512_min_ps(a, b) }
    }
    #[inline(always)]
    unsafe fn max(a: Self::F, b: Self::F) -> Self::F {
        // SAFETY: as above.
        unsafe { _mm512_max_ps(a, b) }
    }
    #[inline(always)]
    unsafe fn mul_add(a: Self::F, b: Self::F, c: Self::F) -> Self::F {
        // SAFETY: as above.
        unsafe { _mm512_fmadd_ps(a, b, c) }
    }
    #[inline(always)]
    unsafe fn by_sign(of: Self::F, negative: Self::F, other: Self::F) -> Self::F {
        // SAFETY: as above.
        unsafe {
            let below = _mm512_cmp_ps_mask::<_CMP_LT_OQ>(of, _mm512_setzero_ps());
            _mm512_mask_blend_ps(below, other, negative)
        }
    }
    #[inline(always)]
    unsafe fn store_f(to: *mut f32, value: Self::F, n: usize) {
        // SAFETY: as above.
        unsafe { _mm512_mask_storeu_ps(to, mask16(n), value) }
    }
    #[inline(always)]
    unsafe fn store_u8(to: *mut u8, value: Self::F, n: usize) {
        // SAFETY: as above.
        unsafe {
            let bytes = _mm512_cvtepi32_epi8(_mm512_cvttps_epi32(value));
            if n >= 16 {
                _mm_storeu_si128(to.cast(), bytes);
            } else {
                _mm_mask_storeu_epi8(to.cast(), mask16(n), bytes);
            }
        }
    }
}

/// The lanes that AVX2 with and without AVX-VNNI share.
macro_rules! avx2_lanes {
    () => {
        const N: usize = 8;
        const WIDE: bool = false;
        type I = __m256i;
        type F = __m256;
        type B = __m256i;

        #[inline(always)]
        unsafe fn load_i(from: *const i32) -> Self::I {
            // SAFETY: guaranteed by the caller, here and below.
            unsafe { _mm256_loadu_si256(from.cast()) }
        }
        #[inline(always)]
        unsafe fn load_b(from: *const u8) -> Self::B {
            // SAFETY: as above.
            unsafe { _mm256_loadu_si256(from.cast()) }
        }
        #[inline(always)]
        unsafe fn splat_b(from: *const u8) -> Self::B {
            // SAFETY: as above.
            unsafe { _mm256_set1_epi32(from.cast::<i32>().read_unaligned()) }
        }
        #[inline(always)]
        unsafe fn to_f(value: Self::I) -> Self::F {
            // SAFETY: as above.
            unsafe { _mm256_cvtepi32_ps(value) }
        }
        #[inline(always)]
        unsafe fn splat(value: f32) -> Self::F {
            // SAFETY: as above.
            unsafe { _mm256_set1_ps(value) }
        }
        #[inline(always)]
        unsafe fn load_f(from: *const f32) -> Self::F {
            // SAFETY: as above.
            unsafe { _mm256_loadu_ps(from) }
        }
        #[inline(always)]
        unsafe fn add(a: Self::F, b: Self::F) -> Self::F {
            // SAFETY: as above.
            unsafe { _mm256_add_ps(a, b) }
        }
        #[inline(always)]
        unsafe fn mul(a: Self::F, b: Self::F) -> Self::F {
            // SAFETY: as above.
            unsafe { _mm256_mul_ps(a, b) }
        }
        #[inline(always)]
        unsafe fn min(a: Self::F, b: Self::F) -> Self::F {
            // SAFETY: as above.
            unsafe { _mm256_min_ps(a, b) }
        }
        #[inline(always)]
        unsafe fn max(a: Self::F, b: Self::F) -> Self::F {
            // SAFETY: as above.
            unsafe { _mm256_max_ps(a, b) }
        }
        #[inline(always)]
        unsafe fn mul_add(a: Self::F, b: Self::F, c: Self::F) -> Self::F {
            // SAFETY: as above.
            unsafe { _mm256_fmadd_ps(a, b, c) }
        }
        #[inline(always)]
        unsafe fn by_sign(of: Self::F, negative: Self::F, other: Self::F) -> Self::F {
            // SAFETY: as above.
            unsafe {
                let below = _mm256_cmp_ps::<_CMP_LT_OQ>(of, _mm256_setzero_ps());
                _mm256_blendv_ps(other, negative, below)
            }
        }
        #[inline(always)]
        unsafe fn store_f(to: *mut f32, value: Self::F, n: usize) {
            // SAFETY: as above; `part` holds the eight lanes.
            unsafe {
                if n >= 8 {
                    return _mm256_storeu_ps(to, value);
                }
                let mut part = [0f32; 8];
                _mm256_storeu_ps(part.as_mut_ptr(), value);
                for (i, value) in part.into_iter().enumerate().take(n) {
                    to.add(i).write_unaligned(value);
                }
            }
        }
        #[inline(always)]
        unsafe fn store_u8(to: *mut u8, value: Self::F, n: usize) {
            // SAFETY: as above.
            unsafe {
                let whole = _mm256_cvttps_epi32(value);
                let (low, high) =
                    (_mm256_castsi256_si128(whole), _mm256_extracti128_si256::<1>(whole));
                let words = _mm_packus_epi32(low, high);
                let bytes = _mm_cvtsi128_si64(_mm_packus_epi16(words, words)).to_le_bytes();
                if n >= 8 {
                    to.cast::<[u8; 8]>().write_unaligned(bytes);
                } else {
                    std::ptr::copy_nonoverlapping(bytes.as_ptr(), to, n);
                }
            }
        }
    };
}

/// AVX2 and FMA: 8 lanes; bytes are widened, since `vpmaddubsw` saturates.
#[derive(Clone, Copy)]
pub(crate) struct Avx2;

impl Lanes for Avx2 {
    avx2_lanes!();

    #[inline(always)]
    unsafe fn dot(sum: Self::I, unsigned: Self::B, signed: Self::B) -> Self::I {
        // SAFETY: as above. Even and odd bytes as 16-bit numbers.
        unsafe {
            let even = _mm256_and_si256(unsigned, _mm256_set1_epi16(255));
            let odd = _mm256_srli_epi16::<8>(unsigned);
            let even_signed = _mm256_srai_epi16::<8>(_mm256_slli_epi16::<8>(signed));
            let odd_signed = _mm256_srai_epi16::<8>(signed);
            let sum = _mm256_add_epi32(sum, _mm256_madd_epi16(even, even_signed));
            _mm256_add_epi32(sum, _mm256_madd_epi16(odd, odd_signed))
        }
    }
}

/// AVX2, FMA and AVX-VNNI: 8 lanes, `vpdpbusd`.
#[derive(Clone, Copy)]
pub(crate) struct AvxVnni;

impl Lanes for AvxVnni {
    avx2_lanes!();

    #[inline(always)]
    unsafe fn dot(sum: Self::I, unsigned: Self::B, signed: Self::B) -> Self::I {
        // SAFETY: as above.
        unsafe { _mm256_dpbusd_avx_epi32(sum, unsigned, signed) }
    }
}
