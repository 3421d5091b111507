//! Camera calibration from vehicles on the road (MVCalib), and the lane tables made from it.
//!
//! Implements the calibration of Hu et al., "Turning Traffic Monitoring Cameras into
//! Intelligent Sensors for Traffic Density Estimation", its baselines, and a joint method
//! that goes past it:
//!
//! ```text
//! labelled vehicles -> candidates -> model_matching -> fine_tuning      (the paper)
//!                 \--> joint (one camera, one road, all vehicles at once)
//! calibration file -> lane_table, verify, report
//! ```
//!
//! The crate owns everything offline, between labels and the lane table file. It does not
//! own the table's format (the core crate's `lane` module does) nor anything that runs
//! beside the camera.

pub mod bodies;
pub mod calibration;
pub mod camera;
pub mod candidates;
pub mod canvas;
pub mod cmaes;
pub mod compare;
pub mod epnp;
pub mod error;
pub mod fine_tuning;
pub mod gpnp;
pub mod joint;
pub mod labelme;
pub mod lane_axis;
pub mod lane_table;
pub mod loss;
pub mod made_scene;
pub mod marks;
pub mod methods;
pub mod model_matching;
pub mod output;
pub mod pose_refinement;
pub mod problem;
pub mod registration;
pub mod report;
pub mod scene_reference;
pub mod single_vehicle;
pub mod stages;
pub mod trust;
pub mod upnp;
pub mod validation;
pub mod vehicle;

pub use error::{Error, Result};
