//! verge's kernels as a back end of tract.
//!
//! tract reads a model, knows its shapes, plans and runs it; this crate is a
//! [`ModelTransform`](tract_core::transform::ModelTransform) that puts the subgraphs which the
//! kernels know (quantise, convolve, activate, join, and what a detector's head does with each
//! cell) into one operator each. What is not recognised stays with tract, node by node.
//!
//! Owns how tract's operators are recognised and how values cross between both. Knows nothing
//! of files.

mod constant;
mod graph;
mod lower;
mod op;
mod partition;
mod reshape;
mod tail;
mod transform;

pub use constant::keep_quantised;
pub use op::{Input, Subnet, SubnetState};
pub use reshape::{with_input_size, without_rounding};
pub use tail::{Gate, Part};
pub use transform::{KernelTransform, LeftToTract};
pub use verge_kernels::Isa;
