//! The detector, offline: data mix, evaluation, training, quantisation.
//!
//! `mix` chooses training pictures by the paper's linear program, `eval` scores boxes against
//! labels as pycocotools does, `check` says what the box makes of a model file. Training itself is Python (`detector/train/`).

pub mod check;
pub mod eval;
pub mod failure;
pub mod light;
pub mod mix;
