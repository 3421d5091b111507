//! The operations of a network, and the memory that all share.
//!
//! Owns the operations and their operands; `step` executes them.

use crate::moves::Rescale;
use crate::pack::{Packed, PackedF};
use crate::pixels::Window;

/// Where an activation lies: first byte, and bytes from pixel to pixel.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Place {
    pub offset: usize,
    pub stride: usize,
}

/// The operation of a step.
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
