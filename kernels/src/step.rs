//! One step of a network on the memory that all steps share.
//!
//! Owns what a step names and the only place where offsets become pointers.

use crate::depthwise::{depthwise, depthwise_f};
use crate::isa::Isa;
use crate::lanes::{Lanes, Portable};
use crate::moves::{self, Rescale};
use crate::pack::{Packed, PackedF};
use crate::pixels::{Pixels, Window, windows};
use crate::product::product;

/// Where an activation lies: first byte, and bytes from pixel to pixel.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Place {
    pub offset: usize,
    pub stride: usize,
}

/// What a step does.
#[derive(Clone, Debug)]
pub(crate) enum Op {
    Product {
        packed: Packed,
        count: usize,
    },
    ProductF {
        packed: PackedF,
        count: usize,
    },
    Dense {
        packed: Packed,
        window: Window,
        channels: usize,
        outside: u8,
    },
    DenseF {
        packed: PackedF,
        window: Window,
        channels: usize,
    },
    Depthwise {
        packed: Packed,
        window: Window,
        outside: u8,
    },
    DepthwiseF {
        packed: PackedF,
        window: Window,
    },
    Pool {
        window: Window,
        channels: usize,
    },
    PoolF {
        window: Window,
        channels: usize,
    },
    Interleave {
        channels: usize,
        count: usize,
    },
    InterleaveF {
        channels: usize,
        count: usize,
    },
    /// Bytes of a pixel.
    Copy {
        bytes: usize,
        count: usize,
    },
    Rescale {
        scale: Rescale,
        channels: usize,
        count: usize,
    },
    Add {
        scales: [Rescale; 2],
        channels: usize,
        count: usize,
    },
    AddF {
        channels: usize,
        count: usize,
    },
    Double {
        size: [usize; 2],
        channels: usize,
    },
    DoubleF {
        size: [usize; 2],
        channels: usize,
    },
}

impl Op {
    /// For reports.
    pub(crate) fn name(&self) -> &'static str {
        match self {
            Self::Product { .. } | Self::ProductF { .. } => "conv 1x1",
            Self::Dense { .. } | Self::DenseF { .. } => "conv dense",
            Self::Depthwise { window, .. } | Self::DepthwiseF { window, .. } => {
                match (window.kernel, window.stride) {
                    (3, 1) => "depthwise 3x3",
                    (3, _) => "depthwise 3x3, stride 2",
                    (_, 1) => "depthwise 5x5",
                    _ => "depthwise 5x5, stride 2",
                }
            }
            Self::Pool { .. } | Self::PoolF { .. } => "max pool",
            Self::Interleave { .. } | Self::InterleaveF { .. } => "shuffle",
            Self::Copy { .. } | Self::Rescale { .. } => "concatenate",
            Self::Add { .. } | Self::AddF { .. } => "add",
            Self::Double { .. } | Self::DoubleF { .. } => "enlarge",
        }
    }
}

/// A step with its places. A step of one input names it twice.
#[derive(Clone, Debug)]
pub(crate) struct Step {
    pub op: Op,
    pub from: [Place; 2],
    pub to: Place,
}

/// All activations of a network, and what a step needs for itself.
#[derive(Clone, Debug)]
pub(crate) struct Arena {
    /// 64 bytes each, so that vectors lie in one line of the cache.
    pub activations: Vec<Line>,
    pub scratch: Vec<Line>,
}

/// A line of the cache.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(64))]
pub(crate) struct Line(pub [u8; 64]);

/// Bytes that must be readable behind the last activation: a vector.
pub(crate) const BEHIND: usize = 64;

impl Arena {
    /// Of as many bytes.
    pub(crate) fn new(activations: usize, scratch: usize) -> Self {
        let lines = |bytes: usize| vec![Line([0; 64]); (bytes + BEHIND).div_ceil(64) + 1];
        Self { activations: lines(activations), scratch: lines(scratch) }
    }
}

/// Does `step` with the instructions of `isa`.
///
/// # Safety
/// The processor has them; `step` was planned for this arena and for `isa`.
pub(crate) unsafe fn run_on(isa: Isa, step: &Step, arena: &mut Arena) {
    debug_assert!(isa.is_here(), "{} on a processor without it", isa.name());
    // SAFETY: the caller's.
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
            // SAFETY: the caller's.
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
