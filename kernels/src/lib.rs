//! Small convolutional networks on one core: int8 and 32-bit floats, channels last, no heap
//! while they run.
//!
//! Owns the arithmetic and the memory of a network that was put together with [`Builder`];
//! knows nothing of model files. Each kernel is written once over a vector of lanes and
//! compiled for every instruction set; [`Isa::best`] picks one when the program runs. Integer
//! networks give the same bytes on all of them.
//!
//! Own code, because nothing that can be had runs these nets at this speed: tract and rten take 7
//! to 30 times as long as ONNX Runtime for quantised depthwise nets, and crates of matrix products
//! (rten-gemm, tract-linalg) leave the depthwise convolutions, the shuffles and the rounding between
//! them, which is where the time goes. `docs/measured/inference.md` has what is measured.
//!
//! The one place of the project, besides the clock and the microcontroller, with `unsafe`:
//! vector instructions and the pointers that they need.

mod builder;
#[cfg(any(debug_assertions, test))]
mod contract;
mod depthwise;
mod finish;
mod isa;
mod lanes;
mod layout;
mod moves;
mod net;
mod op;
mod pack;
mod pixels;
mod product;
mod step;

#[cfg(target_arch = "aarch64")]
mod arm;
#[cfg(target_arch = "x86_64")]
mod x86;

pub use builder::{Builder, PlanError, Tensor};
pub use isa::Isa;
pub use net::{Net, Plan, Shape};
pub use pack::{Conv, QuantParams, Weights};
