//! The methods that the paper compares with: a camera from one vehicle.
//!
//! Owns EPnP, UPnP and GPnP with their refinement, and the choice among single vehicles.
//! `paper` and `joint` start from EPnP too.

pub mod epnp;
pub mod gpnp;
pub mod pose_refinement;
pub mod single_vehicle;
pub mod upnp;
