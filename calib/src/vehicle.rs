//! Vehicles as the solvers see them: labelled key points and the models they may fit.
//!
//! Owns key points, observed vehicles and their pairs with a model's points. Does not own
//! the models (see `model`), reading labels (see `labelme`) nor judging them (see `validation`).

use crate::bodies::Body;
use crate::model::VehicleModel;
use nalgebra::{Vector2, Vector3};

/// One labelled point of a vehicle in the picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct KeyPoint {
    /// The label, 1 to [`crate::model::KEY_POINT_COUNT`].
    pub label: u8,
    /// Where it is in the picture, px.
    pub uv: Vector2<f64>,
}

/// One vehicle as labelled in one picture.
#[derive(Clone, Debug, PartialEq)]
pub struct Vehicle {
    /// Name for messages: the file's stem, with `#group` when a file holds several.
    pub name: String,
    /// What kind of vehicle it is.
    pub body: Body,
    /// The key points that are visible, by rising label.
    pub points: Vec<KeyPoint>,
}

/// A key point known in the model (m) and in the picture (px).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pair {
    /// In the vehicle's frame, m.
    pub world: Vector3<f64>,
    /// In the picture, px.
    pub image: Vector2<f64>,
}

impl VehicleModel {
    /// The pairs of a vehicle's labelled points with this model's points. Labels that
    /// the model lacks are left out.
    pub fn pairs(&self, vehicle: &Vehicle) -> Vec<Pair> {
        vehicle
            .points
            .iter()
            .filter_map(|k| Some(Pair { world: self.point(k.label)?, image: k.uv }))
            .collect()
    }
}
