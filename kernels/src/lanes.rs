//! One vector of 32-bit lanes, as each instruction set has it.
//!
//! Owns the few operations that the kernels are written in, and their portable form. Every
//! other form gives the same bytes where integers are concerned: products are exact, rounding
//! is to nearest, ties to even.

/// Operations on `N` lanes of 32 bits.
///
/// # Safety
/// Pointers must be valid for what is named; the processor must have the instructions.
pub(crate) trait Lanes: Copy {
    /// Lanes of a vector.
    const N: usize;
    /// Whether there are 32 vector registers.
    const WIDE: bool;
    /// `dot` takes its first operand as 128 less than it is (an instruction that knows signed
    /// bytes only); biases make up for it.
    const SHIFTED: bool = false;
    type I: Copy;
    type F: Copy;
    type B: Copy;

    unsafe fn load_i(from: *const i32) -> Self::I;
    /// `4 N` bytes.
    unsafe fn load_b(from: *const u8) -> Self::B;
    /// Four bytes into every lane.
    unsafe fn splat_b(from: *const u8) -> Self::B;
    /// Adds in each lane the products of four unsigned with four signed bytes.
    unsafe fn dot(sum: Self::I, unsigned: Self::B, signed: Self::B) -> Self::I;
    unsafe fn to_f(value: Self::I) -> Self::F;
    unsafe fn splat(value: f32) -> Self::F;
    unsafe fn load_f(from: *const f32) -> Self::F;
    unsafe fn add(a: Self::F, b: Self::F) -> Self::F;
    unsafe fn mul(a: Self::F, b: Self::F) -> Self::F;
    unsafe fn min(a: Self::F, b: Self::F) -> Self::F;
    unsafe fn max(a: Self::F, b: Self::F) -> Self::F;
    /// `a * b + c`, rounded once where the processor can.
    unsafe fn mul_add(a: Self::F, b: Self::F, c: Self::F) -> Self::F;
    /// `negative` where `of` is below 0, else `other`.
    unsafe fn by_sign(of: Self::F, negative: Self::F, other: Self::F) -> Self::F;
    /// The first `n` lanes.
    unsafe fn store_f(to: *mut f32, value: Self::F, n: usize);
    /// The first `n` lanes, whole numbers of 0 to 255, as bytes.
    unsafe fn store_u8(to: *mut u8, value: Self::F, n: usize);
}

/// Adding and subtracting it rounds values below 2^22 to the nearest even.
pub(crate) const ROUND: f32 = 12_582_912.0;

/// Rounds lanes below 2^22 to the nearest, ties to even.
///
/// # Safety
/// As for [`Lanes`].
#[inline(always)]
pub(crate) unsafe fn round<S: Lanes>(value: S::F) -> S::F {
    // SAFETY: guaranteed by the caller.
    unsafe { S::add(S::add(value, S::splat(ROUND)), S::splat(-ROUND)) }
}

/// Lanes as arrays; what the compiler makes of them.
#[derive(Clone, Copy)]
pub(crate) struct Portable;

const P: usize = 8;

impl Lanes for Portable {
    const N: usize = P;
    const WIDE: bool = false;
    type I = [i32; P];
    type F = [f32; P];
    type B = [[u8; 4]; P];

    #[inline(always)]
    unsafe fn load_i(from: *const i32) -> Self::I {
        // SAFETY: guaranteed by the caller.
        unsafe { from.cast::<Self::I>().read_unaligned() }
    }
    #[inline(always)]
    unsafe fn load_b(from: *const u8) -> Self::B {
        // SAFETY: guaranteed by the caller.
        unsafe { from.cast::<Self::B>().read_unaligned() }
    }
    #[inline(always)]
    unsafe fn splat_b(from: *const u8) -> Self::B {
        // SAFETY: guaranteed by the caller.
        [unsafe { from.cast::<[u8; 4]>().read_unaligned() }; P]
    }
    #[inline(always)]
    unsafe fn dot(mut sum: Self::I, unsigned: Self::B, signed: Self::B) -> Self::I {
        for ((sum, a), b) in sum.iter_mut().zip(unsigned).zip(signed) {
            for (a, b) in a.into_iter().zip(b) {
                *sum += i32::from(a) * i32::from(b.cast_signed());
            }
        }
        sum
    }
    #[inline(always)]
    unsafe fn to_f(value: Self::I) -> Self::F {
        value.map(|v| v as f32)
    }
    #[inline(always)]
    unsafe fn splat(value: f32) -> Self::F {
        [value; P]
    }
    #[inline(always)]
    unsafe fn load_f(from: *const f32) -> Self::F {
        // SAFETY: guaranteed by the caller.
        unsafe { from.cast::<Self::F>().read_unaligned() }
    }
    #[inline(always)]
    unsafe fn add(a: Self::F, b: Self::F) -> Self::F {
        std::array::from_fn(|i| a[i] + b[i])
    }
    #[inline(always)]
    unsafe fn mul(a: Self::F, b: Self::F) -> Self::F {
        std::array::from_fn(|i| a[i] * b[i])
    }
    #[inline(always)]
    unsafe fn min(a: Self::F, b: Self::F) -> Self::F {
        std::array::from_fn(|i| if a[i] < b[i] { a[i] } else { b[i] })
    }
    #[inline(always)]
    unsafe fn max(a: Self::F, b: Self::F) -> Self::F {
        std::array::from_fn(|i| if a[i] > b[i] { a[i] } else { b[i] })
    }
    #[inline(always)]
    unsafe fn mul_add(a: Self::F, b: Self::F, c: Self::F) -> Self::F {
        std::array::from_fn(|i| a[i] * b[i] + c[i])
    }
    #[inline(always)]
    unsafe fn by_sign(of: Self::F, negative: Self::F, other: Self::F) -> Self::F {
        std::array::from_fn(|i| if of[i] < 0.0 { negative[i] } else { other[i] })
    }
    #[inline(always)]
    unsafe fn store_f(to: *mut f32, value: Self::F, n: usize) {
        for (i, value) in value.into_iter().enumerate().take(n) {
            // SAFETY: guaranteed by the caller.
            unsafe { to.add(i).write_unaligned(value) };
        }
    }
    #[inline(always)]
    unsafe fn store_u8(to: *mut u8, value: Self::F, n: usize) {
        for (i, value) in value.into_iter().enumerate().take(n) {
            // SAFETY: guaranteed by the caller.
            unsafe { *to.add(i) = value as i32 as u8 };
        }
    }
}
