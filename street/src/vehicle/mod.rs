//! The vehicles: which models there are, their sizes and their eight key points.
//!
//! Owns the facts about each model. Meshes to draw are `mesh.rs`, colours `paint.rs`.
//!
//! Model frame, as the paper's data: metres, X to the right of a viewer who stands in front of
//! the vehicle, Y from the front towards the rear (the front is negative, the rear near 0), Z up
//! from the road. "Left" and "right" key points are the viewer's.

mod bodies;
mod loft;
pub mod mesh;
pub mod paint;

use serde::Serialize;

/// The key points' names, in the order of their numbers 1 to 8 (paper, section on calibration).
pub const KEY_POINT_NAMES: [&str; 8] = [
    "left headlight",
    "right headlight",
    "front plate centre",
    "front wiper centre",
    "left wing mirror",
    "right wing mirror",
    "back left corner",
    "back right corner",
];

/// Vehicle classes of the truth.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Class {
    /// Passenger car.
    Car,
    /// Delivery van or minibus.
    Van,
    /// City bus.
    Bus,
    /// Box truck, or lorry with a semi-trailer.
    Truck,
    /// Motorcycle with its rider.
    Motorcycle,
}

/// One vehicle model.
#[derive(Debug, Clone, PartialEq)]
pub struct Model {
    /// Name as the paper's data has it, or our own for the other classes.
    pub name: &'static str,
    /// Class.
    pub class: Class,
    /// Key points 1 to 8, m.
    pub key_points: [[f64; 3]; 8],
    /// Left and right side of the footprint without mirrors: X, m.
    pub sides_m: [f64; 2],
    /// Front and rear of the footprint: Y, m.
    pub ends_m: [f64; 2],
    /// Height, m.
    pub height_m: f64,
}

impl Model {
    /// Length of the footprint, m.
    pub fn length_m(&self) -> f64 {
        self.ends_m[1] - self.ends_m[0]
    }

    /// Width of the footprint, m.
    pub fn width_m(&self) -> f64 {
        self.sides_m[1] - self.sides_m[0]
    }

    /// Centre of the footprint in the model frame, m.
    pub fn centre_m(&self) -> [f64; 2] {
        [(self.sides_m[0] + self.sides_m[1]) / 2.0, (self.ends_m[0] + self.ends_m[1]) / 2.0]
    }
}

/// The number of the paper's car models, which come first in [`MODELS`].
pub const CAR_MODELS: usize = 5;

/// The lorry with a semi-trailer, in [`MODELS`].
pub const ARTICULATED: usize = 9;

/// All models. The five cars' key points are the paper's (measured by its authors from
/// dimensions.com, published with their code as `vehicle_3dkeypoints_head.json`); note that
/// their two back corners differ by 0.34 to 0.4 m along Y. A footprint ends where the key
/// points end. The others' dimensions and key points are ours, after common vehicles of their
/// class (a 5.3 m panel van, a 12 m double-decker of 4.4 m, an 8 m box truck, a 125 cc machine,
/// a 16.5 m lorry with a semi-trailer, the longest that Directive 96/53/EC allows).
pub const MODELS: [Model; 10] = [
    Model {
        name: "Toyota_Corolla",
        class: Class::Car,
        key_points: [
            [0.27, -4.28, 0.74],
            [1.51, -4.28, 0.74],
            [0.89, -4.65, 0.45],
            [0.89, -3.53, 1.02],
            [-0.05, -3.06, 1.04],
            [1.83, -3.06, 1.04],
            [1.78, -0.2, 0.87],
            [0.0, 0.2, 0.87],
        ],
        sides_m: [0.0, 1.78],
        ends_m: [-4.65, 0.2],
        height_m: 1.46,
    },
    Model {
        name: "Toyota_Prius",
        class: Class::Car,
        key_points: [
            [0.27, -4.28, 0.62],
            [1.48, -4.28, 0.62],
            [0.875, -4.55, 0.4],
            [0.875, -3.46, 0.65],
            [0.03, -2.91, 0.85],
            [1.78, -2.91, 0.85],
            [1.78, -0.18, 0.81],
            [0.0, 0.18, 0.81],
        ],
        sides_m: [0.0, 1.78],
        ends_m: [-4.55, 0.18],
        height_m: 1.47,
    },
    Model {
        name: "Honda_Civic",
        class: Class::Car,
        key_points: [
            [0.19, -4.23, 0.68],
            [1.56, -4.23, 0.68],
            [0.875, -4.55, 0.43],
            [0.875, -3.46, 1.04],
            [0.0, -2.73, 1.04],
            [1.75, -2.73, 1.04],
            [1.75, -0.17, 0.88],
            [0.0, 0.17, 0.88],
        ],
        sides_m: [0.0, 1.75],
        ends_m: [-4.55, 0.17],
        height_m: 1.43,
    },
    Model {
        name: "BMW_Series4",
        class: Class::Car,
        key_points: [
            [0.28, -4.37, 0.6],
            [1.56, -4.37, 0.6],
            [0.915, -4.65, 0.41],
            [0.915, -3.26, 0.97],
            [0.0, -2.88, 0.97],
            [1.83, -2.88, 0.97],
            [1.83, -0.17, 0.82],
            [0.0, 0.17, 0.82],
        ],
        sides_m: [0.0, 1.83],
        ends_m: [-4.65, 0.17],
        height_m: 1.39,
    },
    Model {
        name: "Tesla_ModelS",
        class: Class::Car,
        key_points: [
            [0.27, -4.37, 0.77],
            [1.82, -4.37, 0.77],
            [1.045, -4.7, 0.51],
            [1.045, -3.67, 0.96],
            [0.0, -3.0, 0.96],
            [2.09, -3.0, 0.96],
            [2.09, -0.19, 0.92],
            [0.0, 0.19, 0.92],
        ],
        sides_m: [0.0, 2.09],
        ends_m: [-4.7, 0.19],
        height_m: 1.45,
    },
    Model {
        name: "Panel_Van",
        class: Class::Van,
        key_points: [
            [0.24, -5.22, 0.82],
            [1.72, -5.22, 0.82],
            [0.98, -5.3, 0.5],
            [0.98, -4.55, 1.28],
            [-0.14, -4.05, 1.35],
            [2.1, -4.05, 1.35],
            [1.96, 0.0, 1.1],
            [0.0, 0.0, 1.1],
        ],
        sides_m: [0.0, 1.96],
        ends_m: [-5.3, 0.0],
        height_m: 2.25,
    },
    Model {
        name: "Double_Decker",
        class: Class::Bus,
        key_points: [
            [0.3, -11.96, 0.75],
            [2.25, -11.96, 0.75],
            [1.275, -12.0, 0.45],
            [1.275, -11.98, 1.1],
            [-0.2, -11.9, 1.9],
            [2.75, -11.9, 1.9],
            [2.55, 0.0, 1.2],
            [0.0, 0.0, 1.2],
        ],
        sides_m: [0.0, 2.55],
        ends_m: [-12.0, 0.0],
        height_m: 4.4,
    },
    Model {
        name: "Box_Truck",
        class: Class::Truck,
        key_points: [
            [0.25, -7.96, 0.8],
            [2.15, -7.96, 0.8],
            [1.2, -8.0, 0.55],
            [1.2, -7.9, 1.45],
            [-0.15, -7.5, 1.75],
            [2.55, -7.5, 1.75],
            [2.4, 0.0, 1.1],
            [0.0, 0.0, 1.1],
        ],
        sides_m: [0.0, 2.4],
        ends_m: [-8.0, 0.0],
        height_m: 3.4,
    },
    Model {
        name: "Motorcycle",
        class: Class::Motorcycle,
        key_points: [
            [0.33, -1.75, 0.85],
            [0.45, -1.75, 0.85],
            [0.39, -2.0, 0.35],
            [0.39, -1.65, 1.05],
            [0.0, -1.5, 1.15],
            [0.78, -1.5, 1.15],
            [0.52, -0.05, 0.75],
            [0.26, -0.05, 0.75],
        ],
        sides_m: [0.1, 0.68],
        ends_m: [-2.05, 0.0],
        height_m: 1.65,
    },
    Model {
        name: "Articulated_Lorry",
        class: Class::Truck,
        key_points: [
            [0.27, -16.46, 0.85],
            [2.28, -16.46, 0.85],
            [1.275, -16.5, 0.55],
            [1.275, -16.35, 1.75],
            [-0.18, -15.9, 2.1],
            [2.73, -15.9, 2.1],
            [2.55, 0.0, 1.1],
            [0.0, 0.0, 1.1],
        ],
        sides_m: [0.0, 2.55],
        ends_m: [-16.5, 0.0],
        height_m: 4.0,
    },
];

#[cfg(test)]
mod tests {
    use super::{CAR_MODELS, Class, MODELS};

    #[test]
    fn key_points_lie_in_the_stated_box() {
        for model in &MODELS {
            for [x, y, z] in model.key_points {
                assert!(
                    x >= model.sides_m[0] - 0.21 && x <= model.sides_m[1] + 0.21,
                    "{}",
                    model.name
                );
                assert!(
                    y >= model.ends_m[0] - 1e-9 && y <= model.ends_m[1] + 1e-9,
                    "{}",
                    model.name
                );
                assert!(z > 0.0 && z < model.height_m, "{}", model.name);
            }
        }
        assert!(MODELS[..CAR_MODELS].iter().all(|model| model.class == Class::Car));
        assert!(MODELS[CAR_MODELS..].iter().all(|model| model.class != Class::Car));
    }
}
