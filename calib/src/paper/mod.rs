//! The paper's method (MVCalib): candidates, model matching, fine tuning.
//!
//! Owns the three stages, their losses and the evolution strategy that searches them. Does
//! not own the baselines that the paper compares with, nor what goes past it (`joint`,
//! `road`).

pub mod candidates;
pub mod cmaes;
pub mod fine_tuning;
pub mod loss;
pub mod model_matching;
pub mod stages;
