//! The methods that the paper compares with: a camera from one vehicle.
//!
//! Owns EPnP, UPnP and GPnP with their refinement. Does not own the choice among single vehicles
//! (see `methods`). `paper` and `joint` start from EPnP too.

pub mod epnp;
pub mod gpnp;
pub mod pose_refinement;
pub mod upnp;
