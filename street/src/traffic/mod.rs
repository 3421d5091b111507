//! Traffic on each lane by a car-following model, from inflow to outflow.
//!
//! Owns vehicles and their motion along lanes. `idm.rs` is the model, `fleet.rs` draws drivers
//! and vehicles, `lane.rs` moves one lane. Owns no geometry in the plane and no picture.

mod fleet;
mod idm;
mod lane;

pub use fleet::{Driver, Fleet, Vehicle};
pub use idm::IdmParameters;
pub use lane::LaneTraffic;
