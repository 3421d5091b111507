//! Colours of vehicles: paint drawn from what is on the road, and fixed materials.
//!
//! Owns linear RGB reflectances in 0..1. Shares of car paint: rounded from the yearly colour
//! reports of Axalta and PPG (white, black and grey make up about three quarters). Light and
//! shading are `render/`.

use super::Class;
use super::mesh::Material;
use crate::random::Stream;

/// Linear reflectance, red, green, blue.
pub type Rgb = [f32; 3];

/// The colours of one vehicle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Livery {
    /// Body paint.
    pub paint: Rgb,
    /// Roof or load.
    pub roof: Rgb,
    /// Clothes of a rider.
    pub cloth: Rgb,
    /// A number plate is yellow and not white.
    pub yellow_plate: bool,
}

const CAR_PAINTS: [(f64, Rgb); 10] = [
    (0.31, [0.80, 0.80, 0.78]),
    (0.19, [0.015, 0.015, 0.018]),
    (0.13, [0.14, 0.145, 0.15]),
    (0.12, [0.48, 0.49, 0.50]),
    (0.08, [0.03, 0.07, 0.22]),
    (0.08, [0.42, 0.02, 0.025]),
    (0.03, [0.30, 0.24, 0.16]),
    (0.02, [0.04, 0.14, 0.07]),
    (0.02, [0.55, 0.22, 0.03]),
    (0.02, [0.12, 0.25, 0.45]),
];

const VAN_PAINTS: [(f64, Rgb); 4] = [
    (0.7, [0.78, 0.78, 0.77]),
    (0.15, [0.4, 0.41, 0.42]),
    (0.1, [0.04, 0.1, 0.3]),
    (0.05, [0.6, 0.4, 0.04]),
];

const BUS_PAINTS: [(f64, Rgb); 4] = [
    (0.35, [0.62, 0.06, 0.04]),
    (0.25, [0.70, 0.55, 0.30]),
    (0.25, [0.16, 0.42, 0.58]),
    (0.15, [0.72, 0.72, 0.70]),
];

const LOADS: [(f64, Rgb); 5] = [
    (0.55, [0.78, 0.78, 0.76]),
    (0.15, [0.45, 0.2, 0.3]),
    (0.12, [0.08, 0.25, 0.12]),
    (0.1, [0.6, 0.42, 0.08]),
    (0.08, [0.1, 0.2, 0.45]),
];

fn pick(paints: &[(f64, Rgb)], rng: &mut Stream) -> Rgb {
    let weights: Vec<f64> = paints.iter().map(|(weight, _)| *weight).collect();
    let tone = rng.normal(1.0, 0.08) as f32;
    paints[rng.weighted(&weights)].1.map(|c| (c * tone).clamp(0.01, 0.9))
}

impl Livery {
    /// Draws the colours of a vehicle.
    pub fn draw(class: Class, taxi_share: f64, rng: &mut Stream) -> Self {
        let taxi = class == Class::Car && rng.unit() < taxi_share;
        let paint = match class {
            Class::Car if taxi => [0.52, 0.03, 0.02],
            Class::Car | Class::Motorcycle => pick(&CAR_PAINTS, rng),
            Class::Van => pick(&VAN_PAINTS, rng),
            Class::Bus => pick(&BUS_PAINTS, rng),
            Class::Truck => pick(&VAN_PAINTS, rng),
        };
        let roof = match class {
            Class::Car if taxi => [0.6, 0.6, 0.6],
            Class::Truck => pick(&LOADS, rng),
            Class::Bus => [0.7, 0.7, 0.68],
            _ => paint,
        };
        let cloth = pick(&CAR_PAINTS, rng).map(|c| c.min(0.35));
        Livery { paint, roof, cloth, yellow_plate: rng.unit() < 0.5 }
    }

    /// The reflectance of a material on this vehicle, without gloss and own light.
    pub fn reflectance(&self, material: Material) -> Rgb {
        match material {
            Material::Paint => self.paint,
            Material::Roof => self.roof,
            Material::Glass => [0.012, 0.015, 0.017],
            Material::Trim => [0.025, 0.025, 0.027],
            Material::Shade => [0.008, 0.008, 0.009],
            Material::Tyre => [0.018, 0.018, 0.018],
            Material::Rim => [0.32, 0.33, 0.34],
            Material::Headlight => [0.62, 0.64, 0.66],
            Material::Taillight => [0.30, 0.015, 0.012],
            Material::Plate if self.yellow_plate => [0.62, 0.5, 0.05],
            Material::Plate => [0.66, 0.66, 0.64],
            Material::Sign => [0.45, 0.28, 0.03],
            Material::Cloth => self.cloth,
            Material::Helmet => [0.55, 0.55, 0.55],
        }
    }
}
