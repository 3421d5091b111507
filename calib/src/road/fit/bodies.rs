//! The bodies that a box of traffic may show.
//!
//! Owns seven outlines, their mean sizes and scatter, and how a detector names them. Sizes
//! are means of fleets as published for Europe (cars) and of common makes (others), with a
//! scatter that covers other markets; what a camera's own fleet differs in is an unknown of
//! the fit (see `traffic`). Does not own the key points of labelled vehicles (`crate::bodies`).

use super::cues::Class;

/// One kind of vehicle: points of its hull and its size.
#[derive(Debug)]
pub struct Body {
    /// Its name.
    pub name: &'static str,
    /// Points of one flank: along (front 0, rear 1), half width as a part of half the width,
    /// height as a part of the height.
    pub points: &'static [[f64; 3]],
    /// Mean width, length, height, m.
    pub size_m: [f64; 3],
    /// Standard deviation of one vehicle's logarithms of the same.
    pub scatter: [f64; 3],
    /// Share of traffic before any box is seen.
    pub share: f64,
    /// Whether it is a car: cars share the fleet's unknowns.
    pub car: bool,
    /// Weight: a fleet of lorries is not known as a fleet of cars is.
    pub trust: f64,
    /// Probability of each class that a detector may give, in the order of [`class_index`].
    pub seen_as: [f64; 5],
}

/// Place of a class in [`Body::seen_as`].
pub fn class_index(class: Class) -> usize {
    match class {
        Class::Car => 0,
        Class::Van => 1,
        Class::Bus => 2,
        Class::Truck => 3,
        Class::Motorcycle => 4,
    }
}

/// How many bodies there are.
pub const BODIES: usize = 7;

const CAR_CLASSES: [f64; 5] = [0.90, 0.07, 0.003, 0.02, 0.007];

/// All of them.
pub static ALL: [Body; BODIES] = [
    Body {
        name: "saloon",
        points: &SALOON,
        size_m: [1.80, 4.65, 1.45],
        scatter: [0.035, 0.045, 0.025],
        share: 0.31,
        car: true,
        trust: 1.0,
        seen_as: CAR_CLASSES,
    },
    Body {
        name: "hatchback",
        points: &HATCHBACK,
        size_m: [1.76, 4.15, 1.49],
        scatter: [0.035, 0.055, 0.03],
        share: 0.21,
        car: true,
        trust: 1.0,
        seen_as: CAR_CLASSES,
    },
    Body {
        name: "SUV",
        points: &SUV,
        size_m: [1.84, 4.50, 1.66],
        scatter: [0.04, 0.055, 0.045],
        share: 0.24,
        car: true,
        trust: 1.0,
        seen_as: [0.85, 0.12, 0.003, 0.02, 0.007],
    },
    Body {
        name: "van",
        points: &VAN,
        size_m: [1.97, 5.15, 2.10],
        scatter: [0.045, 0.10, 0.11],
        share: 0.11,
        car: false,
        trust: 0.5,
        seen_as: [0.25, 0.55, 0.05, 0.14, 0.01],
    },
    Body {
        name: "lorry",
        points: &LORRY,
        size_m: [2.35, 7.8, 3.1],
        scatter: [0.08, 0.30, 0.18],
        share: 0.07,
        car: false,
        trust: 0.1,
        seen_as: [0.04, 0.14, 0.12, 0.69, 0.01],
    },
    Body {
        name: "bus",
        points: &BUS,
        size_m: [2.52, 11.5, 3.3],
        scatter: [0.03, 0.15, 0.20],
        share: 0.03,
        car: false,
        trust: 0.1,
        seen_as: [0.02, 0.06, 0.75, 0.16, 0.01],
    },
    Body {
        name: "motorcycle",
        points: &MOTORCYCLE,
        size_m: [0.78, 2.05, 1.62],
        scatter: [0.15, 0.08, 0.07],
        share: 0.03,
        car: false,
        trust: 0.1,
        seen_as: [0.12, 0.03, 0.01, 0.02, 0.82],
    },
];

static SALOON: [[f64; 3]; 18] = [
    [0.0, 0.78, 0.15],
    [0.0, 0.8, 0.4],
    [0.03, 0.93, 0.5],
    [0.1, 0.98, 0.16],
    [0.19, 0.98, 0.0],
    [0.26, 0.98, 0.68],
    [0.36, 1.09, 0.68],
    [0.36, 0.92, 0.68],
    [0.41, 0.74, 0.955],
    [0.53, 0.75, 1.0],
    [0.71, 0.73, 0.96],
    [0.87, 0.88, 0.74],
    [0.985, 0.88, 0.66],
    [0.97, 0.94, 0.48],
    [1.0, 0.86, 0.42],
    [1.0, 0.8, 0.18],
    [0.79, 0.98, 0.0],
    [0.5, 1.0, 0.42],
];
static HATCHBACK: [[f64; 3]; 17] = [
    [0.0, 0.78, 0.15],
    [0.0, 0.8, 0.42],
    [0.035, 0.93, 0.52],
    [0.1, 0.98, 0.16],
    [0.2, 0.98, 0.0],
    [0.26, 0.98, 0.68],
    [0.36, 1.09, 0.68],
    [0.36, 0.92, 0.68],
    [0.43, 0.74, 0.96],
    [0.57, 0.75, 1.0],
    [0.87, 0.73, 0.955],
    [0.96, 0.86, 0.66],
    [0.97, 0.94, 0.48],
    [1.0, 0.86, 0.42],
    [1.0, 0.8, 0.18],
    [0.81, 0.98, 0.0],
    [0.5, 1.0, 0.42],
];
static SUV: [[f64; 3]; 17] = [
    [0.0, 0.8, 0.17],
    [0.0, 0.82, 0.44],
    [0.03, 0.94, 0.56],
    [0.09, 0.98, 0.18],
    [0.19, 0.98, 0.0],
    [0.24, 0.98, 0.7],
    [0.35, 1.11, 0.7],
    [0.35, 0.94, 0.7],
    [0.4, 0.76, 0.96],
    [0.55, 0.78, 1.0],
    [0.9, 0.76, 0.965],
    [0.985, 0.88, 0.62],
    [0.97, 0.95, 0.5],
    [1.0, 0.87, 0.42],
    [1.0, 0.82, 0.2],
    [0.81, 0.98, 0.0],
    [0.5, 1.0, 0.42],
];
static VAN: [[f64; 3]; 15] = [
    [0.0, 0.82, 0.12],
    [0.0, 0.85, 0.36],
    [0.03, 0.95, 0.42],
    [0.12, 0.98, 0.1],
    [0.18, 0.97, 0.0],
    [0.14, 0.97, 0.56],
    [0.22, 1.12, 0.6],
    [0.24, 0.86, 0.94],
    [0.38, 0.87, 1.0],
    [0.98, 0.87, 1.0],
    [1.0, 0.9, 0.93],
    [1.0, 0.96, 0.45],
    [1.0, 0.9, 0.14],
    [0.82, 0.97, 0.0],
    [0.5, 1.0, 0.45],
];
static LORRY: [[f64; 3]; 11] = [
    [0.0, 0.95, 0.12],
    [0.0, 0.95, 0.45],
    [0.05, 1.0, 0.7],
    [0.12, 0.96, 0.0],
    [0.06, 1.1, 0.55],
    [0.25, 1.0, 1.0],
    [1.0, 1.0, 1.0],
    [1.0, 1.0, 0.35],
    [0.8, 0.96, 0.0],
    [1.0, 0.9, 0.2],
    [0.5, 1.0, 0.5],
];
static BUS: [[f64; 3]; 10] = [
    [0.0, 0.93, 0.09],
    [0.0, 0.97, 0.5],
    [0.0, 0.95, 0.96],
    [0.02, 1.0, 0.98],
    [0.01, 1.08, 0.5],
    [0.22, 0.97, 0.0],
    [1.0, 0.97, 0.97],
    [1.0, 0.97, 0.1],
    [0.73, 0.97, 0.0],
    [0.5, 1.0, 0.5],
];
static MOTORCYCLE: [[f64; 3]; 8] = [
    [0.0, 0.1, 0.3],
    [0.1, 0.15, 0.0],
    [0.28, 1.0, 0.69],
    [0.45, 0.65, 0.88],
    [0.45, 0.4, 1.0],
    [0.9, 0.2, 0.0],
    [1.0, 0.4, 0.5],
    [1.0, 0.1, 0.3],
];
