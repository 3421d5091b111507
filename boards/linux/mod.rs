//! Adapters from Linux to the parts of `verge::hal`, for boards that run it.
//!
//! Owns devices and their names; each opens when it is first used and again after a fault,
//! so that a board may be described before its parts are there. The only files that name
//! `linux-embedded-hal`.
#![allow(dead_code, reason = "each board uses the parts that it has")]

pub mod gpio;
pub mod temperature;
pub mod watchdog;
