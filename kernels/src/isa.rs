//! Which instruction set the kernels use, found when the program runs.

/// An instruction set that the kernels exist for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Isa {
    /// Whatever the program was compiled for. The reference for all others.
    Portable,
    /// x86-64 with AVX2 and FMA.
    Avx2,
    /// x86-64 with AVX2, FMA and AVX-VNNI.
    AvxVnni,
    /// x86-64 with AVX-512 F, BW, VL and VNNI.
    Avx512Vnni,
    /// 64-bit Arm.
    Neon,
    /// 64-bit Arm with dot products.
    NeonDot,
}

impl Isa {
    /// Those that this processor has, slowest first.
    pub fn available() -> Vec<Self> {
        let all = [
            Self::Portable,
            Self::Avx2,
            Self::AvxVnni,
            Self::Avx512Vnni,
            Self::Neon,
            Self::NeonDot,
        ];
        all.into_iter().filter(|isa| isa.is_here()).collect()
    }

    /// The fastest that this processor has.
    pub fn best() -> Self {
        Self::available().pop().unwrap_or(Self::Portable)
    }

    /// Whether this processor has it.
    pub fn is_here(self) -> bool {
        match self {
            Self::Portable => true,
            #[cfg(target_arch = "x86_64")]
            Self::Avx2 => is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma"),
            #[cfg(target_arch = "x86_64")]
            Self::AvxVnni => Self::Avx2.is_here() && is_x86_feature_detected!("avxvnni"),
            #[cfg(target_arch = "x86_64")]
            Self::Avx512Vnni => {
                Self::Avx2.is_here()
                    && is_x86_feature_detected!("avx512f")
                    && is_x86_feature_detected!("avx512bw")
                    && is_x86_feature_detected!("avx512vl")
                    && is_x86_feature_detected!("avx512vnni")
            }
            #[cfg(target_arch = "aarch64")]
            Self::Neon => std::arch::is_aarch64_feature_detected!("neon"),
            #[cfg(target_arch = "aarch64")]
            Self::NeonDot => {
                Self::Neon.is_here() && std::arch::is_aarch64_feature_detected!("dotprod")
            }
            _ => false,
        }
    }

    /// As it is written in reports.
    pub fn name(self) -> &'static str {
        match self {
            Self::Portable => "portable",
            Self::Avx2 => "avx2",
            Self::AvxVnni => "avx-vnni",
            Self::Avx512Vnni => "avx512-vnni",
            Self::Neon => "neon",
            Self::NeonDot => "neon-dotprod",
        }
    }
}

/// Calls `$body` with `$lanes` standing for the lanes of `$isa`, compiled for it.
macro_rules! with_lanes {
    ($isa:expr, $generic:ident($($arg:expr),*)) => {{
        use $crate::isa::Isa;
        match $isa {
            #[cfg(target_arch = "x86_64")]
            Isa::Avx2 => $crate::isa::x86::avx2($($arg),*),
            #[cfg(target_arch = "x86_64")]
            Isa::AvxVnni => $crate::isa::x86::avx_vnni($($arg),*),
            #[cfg(target_arch = "x86_64")]
            Isa::Avx512Vnni => $crate::isa::x86::avx512_vnni($($arg),*),
            #[cfg(target_arch = "aarch64")]
            Isa::Neon => $crate::isa::arm::neon($($arg),*),
            #[cfg(target_arch = "aarch64")]
            Isa::NeonDot => $crate::isa::arm::neon_dot($($arg),*),
            _ => $generic::<$crate::lanes::Portable>($($arg),*),
        }
    }};
}
pub(crate) use with_lanes;

use crate::lanes::{Lanes, Portable};

/// Width, many registers, shifted: what packing must know of `isa`.
pub(crate) fn traits(isa: Isa) -> (usize, bool, bool) {
    fn of<S: Lanes>() -> (usize, bool, bool) {
        (S::N, S::WIDE, S::SHIFTED)
    }
    match isa {
        #[cfg(target_arch = "x86_64")]
        Isa::Avx2 | Isa::AvxVnni => of::<crate::x86::Avx2>(),
        #[cfg(target_arch = "x86_64")]
        Isa::Avx512Vnni => of::<crate::x86::Avx512Vnni>(),
        #[cfg(target_arch = "aarch64")]
        Isa::Neon => of::<crate::arm::Neon>(),
        #[cfg(target_arch = "aarch64")]
        Isa::NeonDot => of::<crate::arm::NeonDot>(),
        _ => of::<Portable>(),
    }
}

/// The step compiled for each x86-64 instruction set.
#[cfg(target_arch = "x86_64")]
pub(crate) mod x86 {
    use crate::step::{Arena, Step, run};
    use crate::x86::{Avx2, Avx512Vnni, AvxVnni};

    #[target_feature(enable = "avx2,fma")]
    pub(crate) unsafe fn avx2(step: &Step, arena: &mut Arena) {
        // SAFETY: the caller's.
        unsafe { run::<Avx2>(step, arena) }
    }

    #[target_feature(enable = "avx2,fma,avxvnni")]
    pub(crate) unsafe fn avx_vnni(step: &Step, arena: &mut Arena) {
        // SAFETY: the caller's.
        unsafe { run::<AvxVnni>(step, arena) }
    }

    #[target_feature(enable = "avx2,fma,avx512f,avx512bw,avx512vl,avx512vnni")]
    pub(crate) unsafe fn avx512_vnni(step: &Step, arena: &mut Arena) {
        // SAFETY: the caller's.
        unsafe { run::<Avx512Vnni>(step, arena) }
    }
}

/// The step compiled for each Arm instruction set.
#[cfg(target_arch = "aarch64")]
pub(crate) mod arm {
    use crate::arm::{Neon, NeonDot};
    use crate::step::{Arena, Step, run};

    #[target_feature(enable = "neon")]
    pub(crate) unsafe fn neon(step: &Step, arena: &mut Arena) {
        // SAFETY: the caller's.
        unsafe { run::<Neon>(step, arena) }
    }

    #[target_feature(enable = "neon,dotprod")]
    pub(crate) unsafe fn neon_dot(step: &Step, arena: &mut Arena) {
        // SAFETY: the caller's.
        unsafe { run::<NeonDot>(step, arena) }
    }
}
