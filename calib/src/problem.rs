//! The calibration problem: labelled vehicles, the models they may be, the picture size.
//!
//! Owns the checked input that every method starts from, and the prior on the focal
//! length, stated openly because a single car does not determine it. Does not own files.

use crate::camera::Lens;
use crate::error::{Error, Result};
use crate::model::VehicleModel;
use crate::validation::check_vehicle;
use crate::vehicle::{Pair, Vehicle};

/// Checked input of a calibration.
#[derive(Clone, Debug)]
pub struct Problem {
    /// Width and height of the pictures, px.
    pub image_size: [u32; 2],
    /// The labelled vehicles, all seen by the one camera in the one pose.
    pub vehicles: Vec<Vehicle>,
    /// The models that a vehicle may be.
    pub models: Vec<VehicleModel>,
}

impl Problem {
    /// Checks every vehicle, see [`check_vehicle`].
    pub fn new(
        image_size: [u32; 2],
        vehicles: Vec<Vehicle>,
        models: Vec<VehicleModel>,
    ) -> Result<Self> {
        if image_size.contains(&0) {
            return Err(Error::Usage(format!("picture size {image_size:?} is empty")));
        }
        for vehicle in &vehicles {
            check_vehicle(vehicle, &models)?;
        }
        Ok(Problem { image_size, vehicles, models })
    }

    /// A lens of focal length `f` (px) centred in the picture.
    pub fn lens(&self, f: f64) -> Lens {
        Lens::centred(f, self.image_size)
    }

    /// Width of the pictures, px.
    pub fn width_px(&self) -> f64 {
        f64::from(self.image_size[0])
    }

    /// The labelled points of a vehicle with those of a model.
    pub fn pairs(&self, vehicle: usize, model: usize) -> Vec<Pair> {
        self.models[model].pairs(&self.vehicles[vehicle])
    }
}

/// What MVCalib assumes about the focal length before it sees a vehicle.
///
/// The paper starts at 350 (it says millimetres; its code means px, of 320) and its code
/// keeps the second stage within 30 % of that. This is a prior and a strong one: the
/// key points of one distant car fit nearly any focal length.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FocalPrior {
    /// Focal length of the first stage, px.
    pub start: f64,
    /// Bounds of the second stage, px.
    pub matching: [f64; 2],
    /// Bounds of the third stage, px.
    pub tuning: [f64; 2],
}

impl FocalPrior {
    /// The paper's start and bounds, scaled to a picture of this width (px); in the third
    /// stage anything from a 143 degree wide-angle to a 14 degree tele lens.
    pub fn of_width(width_px: f64) -> Self {
        Self::around(350.0 / 320.0 * width_px, width_px)
    }

    /// The same with another start, px.
    pub fn around(start: f64, width_px: f64) -> Self {
        FocalPrior {
            start,
            matching: [0.7 * start, 1.3 * start],
            tuning: [width_px / 6.0, 4.0 * width_px],
        }
    }
}
