//! Speed and flow over density: points, fit and its 95 % band, as in the paper's figures of
//! fundamental diagrams.
//!
//! Owns the picture: dots, or hexagons where there are many points; parameters with their intervals
//! and capacity on it. Units may be those of the mile.

use super::estimate::Fit;
use super::hexagons::{corners, hexagons};
use super::least_squares::Point;
use super::report::quantities;
use crate::chart::{Anchor, Axes, Colour, Drawing, INK, Shape, shade};

const SIZE: [u32; 2] = [560, 440];
/// Lines of parameters below the frames, px.
const LINE: f64 = 17.0;
const STEPS: usize = 240;
/// With more points than these dots hide each other.
const MOST_DOTS: usize = 2000;
/// Of a hexagon, px.
const RADIUS: f64 = 4.5;
const DOT: Colour = Colour(50, 95, 160, 0.35);
const CURVE: Colour = Colour(200, 30, 30, 1.0);
const BAND: Colour = Colour(200, 30, 30, 0.22);
/// Kilometres of a mile.
const MILE_KM: f64 = 1.609_344;

/// Units of a picture.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum)]
pub enum Units {
    /// km/h and veh/km/lane.
    #[default]
    Metric,
    /// mph and veh/mi/lane.
    Imperial,
}

impl Units {
    /// A length in this unit, of one in kilometres.
    fn length(self, km: f64) -> f64 {
        match self {
            Self::Metric => km,
            Self::Imperial => km / MILE_KM,
        }
    }

    const fn speed_name(self) -> &'static str {
        match self {
            Self::Metric => "km/h",
            Self::Imperial => "mph",
        }
    }

    const fn density_name(self) -> &'static str {
        match self {
            Self::Metric => "veh/km/lane",
            Self::Imperial => "veh/mi/lane",
        }
    }

    /// A quantity with its unit, in this one.
    fn of(self, unit: &'static str) -> (f64, &'static str) {
        match unit {
            "km/h" => (self.length(1.0), self.speed_name()),
            "veh/km/lane" => (1.0 / self.length(1.0), self.density_name()),
            other => (1.0, other),
        }
    }
}

/// Title, units and texts of a picture.
#[derive(Clone, Debug, Default)]
pub struct Look {
    /// Its title; the model's name without one.
    pub title: Option<String>,
    /// Its units.
    pub units: Units,
}

/// Two frames side by side, the parameters below them.
pub(super) fn drawing(fit: &Fit, points: &[Point], look: &Look) -> Drawing {
    let units = look.units;
    let (per_km, per_h) = (1.0 / units.length(1.0), units.length(1.0));
    let most = |f: fn(&Point) -> f64| points.iter().map(f).fold(0.0, f64::max);
    let densest = most(|p| p.0);
    // Where the jam density is far away the picture ends with the points.
    let end = fit.values()[1].min(densest * 1.5).max(densest) * 1.02;
    let curve: Vec<[f64; 3]> = (1..=STEPS)
        .map(|i| {
            let k = end * i as f64 / STEPS as f64;
            [k, fit.model.speed(fit.values(), k), fit.band(k).unwrap_or(0.0)]
        })
        .filter(|&[_, v, _]| v >= 0.0)
        .collect();
    let lines = parameters(fit, units);
    let foot = LINE * lines.len() as f64 + 14.0;
    let mut whole = Drawing::new(SIZE[0] * 2, SIZE[1] + foot as u32);
    for (column, flow) in [false, true].into_iter().enumerate() {
        // In the units of the picture; flow has the same in both.
        let of = |k: f64, v: f64| if flow { k * v } else { v * per_h };
        let highest = points.iter().map(|&(k, v)| of(k, v)).fold(0.0, f64::max);
        let top = curve.iter().map(|&[k, v, _]| of(k, v)).fold(highest, f64::max) * 1.05;
        let mut axes = Axes::new(SIZE, [0.0, end * per_km], [0.0, top]);
        let (title, name) = if flow {
            let capacity = fit.capacity.value;
            let known = format!("capacity {capacity:.0} veh/h/lane");
            let title = if capacity.is_nan() { "capacity not determined".into() } else { known };
            (title, "flow, veh/h/lane".to_owned())
        } else {
            let named = look.title.clone();
            let title =
                named.unwrap_or_else(|| format!("{}, {} points", fit.model.name(), fit.points));
            (title, format!("speed, {}", units.speed_name()))
        };
        axes.labels(&title, [&format!("density, {}", units.density_name()), &name]);
        if points.len() > MOST_DOTS {
            let pixels = points.iter().map(|&(k, v)| axes.at(k * per_km, of(k, v)));
            let all = hexagons(pixels, RADIUS);
            let fullest = all.iter().map(|hexagon| hexagon.count).max().unwrap_or(1);
            for hexagon in all {
                // By the logarithm: a hundred points beside one are told apart from ten.
                let share = (hexagon.count as f64).ln_1p() / (fullest as f64).ln_1p();
                axes.shape(Shape::Area(corners(hexagon.centre, RADIUS + 0.3), shade(1.0 - share)));
            }
            axes.note(0, &format!("hexagons: 1 to {fullest} points"));
        } else {
            for &(k, v) in points {
                axes.dot(k * per_km, of(k, v), 1.8, DOT);
            }
        }
        let band: Vec<[f64; 3]> = curve
            .iter()
            .map(|&[k, v, half]| [k * per_km, of(k, (v - half).max(0.0)), of(k, v + half).min(top)])
            .collect();
        axes.band(&band, BAND);
        let line: Vec<[f64; 2]> = curve.iter().map(|&[k, v, _]| [k * per_km, of(k, v)]).collect();
        axes.curve(&line, 2.0, CURVE);
        axes.key(0, &format!("{} with 95 % band", fit.model.name()), CURVE);
        if flow && fit.capacity_density.is_finite() {
            let (k, q) = (fit.capacity_density * per_km, fit.capacity.value);
            axes.dot(k, q, 4.5, CURVE);
            if let Some([low, high]) = fit.capacity.interval {
                axes.curve(&[[k, low], [k, high]], 3.0, CURVE);
            }
        }
        whole.place(axes.finish(), [f64::from(SIZE[0]) * column as f64, 0.0]);
    }
    for (row, text) in lines.into_iter().enumerate() {
        let y = f64::from(SIZE[1]) + 12.0 + LINE * row as f64;
        whole.text(text, [62.0, y], 12.0, Anchor::Start);
    }
    let edge = f64::from(SIZE[1]) - 4.0;
    whole.shapes.push(Shape::Line(
        vec![[62.0, edge], [f64::from(SIZE[0] * 2) - 24.0, edge]],
        0.5,
        INK,
    ));
    whole
}

/// A line a parameter with its interval, and how good the fit is.
fn parameters(fit: &Fit, units: Units) -> Vec<String> {
    let mut lines: Vec<String> = quantities(fit)
        .into_iter()
        .map(|quantity| {
            let (factor, unit) = units.of(quantity.unit);
            let interval = quantity.estimate.interval.map_or_else(
                || "no interval: the points do not determine it".to_owned(),
                |[low, high]| format!("95 %: {:.1} to {:.1}", low * factor, high * factor),
            );
            let value = quantity.estimate.value * factor;
            let value = if value.is_nan() { "-".to_owned() } else { format!("{value:.1}") };
            format!("{} {value} {unit} ({interval})", quantity.words)
        })
        .collect();
    lines.push(format!(
        "{} points, {} of them beyond capacity; rmse {:.2} {}, r squared {:.3}, AICc {:.1}",
        fit.points,
        fit.beyond_capacity,
        fit.rmse * units.length(1.0),
        units.speed_name(),
        fit.r_squared,
        fit.aicc
    ));
    lines
}
