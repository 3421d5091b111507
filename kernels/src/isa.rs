//! Choice of the instruction set for the kernels, at run time.

use crate::lanes::{Lanes, Portable};

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
