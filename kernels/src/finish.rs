//! From a sum to a stored value: activation and rounding, before a sum leaves its register.

use crate::lanes::{Lanes, round};
use crate::pack::Finish;

/// Stores `n` channels of a sum of bytes, from `channel` on.
///
/// # Safety
/// `out` has room for them.
#[inline(always)]
pub(crate) unsafe fn finish<S: Lanes>(
    sum: S::I,
    packed: &Finish,
    channel: usize,
    out: *mut u8,
    n: usize,
) {
    // SAFETY: guaranteed by the caller; `factors` is filled up to whole vectors.
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

/// The leaky rectifier, where there is one.
#[inline(always)]
pub(crate) unsafe fn activate<S: Lanes>(value: S::F, slope: Option<f32>) -> S::F {
    // SAFETY: guaranteed by the caller.
    unsafe {
        match slope {
            Some(slope) => S::by_sign(value, S::mul(value, S::splat(slope)), value),
            None => value,
        }
    }
}
