//! Doing one step of a network on the memory that all steps share.
//!
//! Owns the only place where offsets become pointers.

use crate::depthwise::{depthwise, depthwise_f};
use crate::isa::Isa;
use crate::lanes::{Lanes, Portable};
use crate::moves;
use crate::op::{Arena, Op, Place, Step};
use crate::pixels::{Pixels, windows};
use crate::product::product;

/// Does `step` with the instructions of `isa`.
///
/// # Safety
/// The processor has them; `step` was planned for this arena and for `isa`.
pub(crate) unsafe fn run_on(isa: Isa, step: &Step, arena: &mut Arena) {
    debug_assert!(isa.is_here(), "{} on a processor without it", isa.name());
    // SAFETY: guaranteed by the caller.
    unsafe {
        match isa {
            #[cfg(target_arch = "x86_64")]
            Isa::Avx2 => avx2(step, arena),
            #[cfg(target_arch = "x86_64")]
            Isa::AvxVnni => avx_vnni(step, arena),
            #[cfg(target_arch = "x86_64")]
            Isa::Avx512Vnni => avx512_vnni(step, arena),
            #[cfg(target_arch = "aarch64")]
            Isa::Neon => neon(step, arena),
            #[cfg(target_arch = "aarch64")]
            Isa::NeonDot => neon_dot(step, arena),
            _ => run::<Portable>(step, arena),
        }
    }
}

/// A step compiled for one instruction set.
macro_rules! compiled {
    ($name:ident, $lanes:ty, $features:literal, $arch:literal) => {
        #[cfg(target_arch = $arch)]
        #[target_feature(enable = $features)]
        unsafe fn $name(step: &Step, arena: &mut Arena) {
            // SAFETY: guaranteed by the caller.
            unsafe { run::<$lanes>(step, arena) }
        }
    };
}

compiled!(avx2, crate::x86::Avx2, "avx2,fma", "x86_64");
compiled!(avx_vnni, crate::x86::AvxVnni, "avx2,fma,avxvnni", "x86_64");
compiled!(
    avx512_vnni,
    crate::x86::Avx512Vnni,
    "avx2,fma,avx512f,avx512bw,avx512vl,avx512vnni",
    "x86_64"
);
compiled!(neon, crate::arm::Neon, "neon", "aarch64");
compiled!(neon_dot, crate::arm::NeonDot, "neon,dotprod", "aarch64");

/// Does `step`.
///
/// # Safety
/// The processor has the instructions of `S`; `step` was planned for this arena and `S`.
#[inline(always)]
unsafe fn run<S: Lanes>(step: &Step, arena: &mut Arena) {
    #[cfg(debug_assertions)]
    crate::contract::check(step, arena, S::N);
    let activations = arena.activations.as_mut_ptr().cast::<u8>();
    let scratch = arena.scratch.as_mut_ptr().cast::<u8>();
    // SAFETY: the plan laid the places inside the arena, and outputs apart from inputs.
    unsafe {
        let bytes =
            |place: Place| Pixels { start: activations.add(place.offset), stride: place.stride };
        let floats = |place: Place| Pixels {
            start: activations.add(place.offset).cast::<f32>(),
            stride: place.stride / 4,
        };
        let (a, b) = (step.from[0], step.from[1]);
        match &step.op {
            Op::Product { packed, count } => {
                product::<S, _>(packed, bytes(a), bytes(step.to), *count);
            }
            Op::ProductF { packed, count } => {
                product::<S, _>(packed, floats(a), floats(step.to), *count);
            }
            Op::Dense { packed, window, channels, outside } => {
                let width = 4 * packed.fours;
                let rows = Pixels { start: scratch, stride: width };
                for y in 0..window.to[0] {
                    windows(window, bytes(a), *channels, y, scratch, width, *outside);
                    let to = bytes(step.to).skip(y * window.to[1]);
                    product::<S, _>(packed, rows, to, window.to[1]);
                }
            }
            Op::DenseF { packed, window, channels } => {
                let width = packed.inputs;
                let scratch = scratch.cast::<f32>();
                let rows = Pixels { start: scratch, stride: width };
                for y in 0..window.to[0] {
                    windows(window, floats(a), *channels, y, scratch, width, 0.0);
                    let to = floats(step.to).skip(y * window.to[1]);
                    product::<S, _>(packed, rows, to, window.to[1]);
                }
            }
            Op::Depthwise { packed, window, outside } => {
                depthwise::<S>(packed, window, bytes(a), bytes(step.to), *outside, scratch);
            }
            Op::DepthwiseF { packed, window } => {
                depthwise_f::<S>(packed, window, floats(a), floats(step.to));
            }
            Op::Pool { window, channels } => {
                moves::pool(window, *channels, 0u8, bytes(a), bytes(step.to));
            }
            Op::PoolF { window, channels } => {
                let least = f32::NEG_INFINITY;
                moves::pool(window, *channels, least, floats(a), floats(step.to));
            }
            Op::Interleave { channels, count } => {
                moves::interleave(bytes(a), bytes(b), bytes(step.to), *channels, *count);
            }
            Op::InterleaveF { channels, count } => {
                moves::interleave(floats(a), floats(b), floats(step.to), *channels, *count);
            }
            Op::Copy { bytes: width, count } => {
                moves::copy(bytes(a), bytes(step.to), *width, *count);
            }
            Op::Rescale { scale, channels, count } => {
                moves::rescale(*scale, bytes(a), bytes(step.to), *channels, *count);
            }
            Op::Add { scales, channels, count } => {
                moves::add(*scales, [bytes(a), bytes(b)], bytes(step.to), *channels, *count);
            }
            Op::AddF { channels, count } => {
                moves::add_f([floats(a), floats(b)], floats(step.to), *channels, *count);
            }
            Op::Double { size, channels } => {
                moves::double(*size, *channels, bytes(a), bytes(step.to));
            }
            Op::DoubleF { size, channels } => {
                moves::double(*size, *channels, floats(a), floats(step.to));
            }
        }
    }
}
