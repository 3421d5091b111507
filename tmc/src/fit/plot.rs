//! Speed and flow over density: points, fit and its 95 % band, as in the paper's figures of
//! fundamental diagrams.

use super::estimate::Fit;
use super::least_squares::Point;
use crate::chart::{Axes, Colour, Drawing};

const SIZE: [u32; 2] = [560, 440];
const STEPS: usize = 240;
/// Points beyond this number are thinned evenly: more cannot be told apart.
const MOST_DOTS: usize = 6000;
const DOT: Colour = Colour(50, 95, 160, 0.35);
const CURVE: Colour = Colour(200, 30, 30, 1.0);
const BAND: Colour = Colour(200, 30, 30, 0.22);

/// Two frames side by side.
pub(super) fn drawing(fit: &Fit, points: &[Point]) -> Drawing {
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
    let every = points.len().div_ceil(MOST_DOTS);
    let dots: Vec<Point> = points.iter().copied().step_by(every).collect();
    let mut whole = Drawing::new(SIZE[0] * 2, SIZE[1]);
    for (column, flow) in [false, true].into_iter().enumerate() {
        let of = |k: f64, v: f64| if flow { k * v } else { v };
        let highest = points.iter().map(|&(k, v)| of(k, v)).fold(0.0, f64::max);
        let top = curve.iter().map(|&[k, v, _]| of(k, v)).fold(highest, f64::max) * 1.05;
        let mut axes = Axes::new(SIZE, [0.0, end], [0.0, top]);
        let (title, name) = if flow {
            let capacity = fit.capacity.value;
            let known = format!("capacity {capacity:.0} veh/h/lane");
            let title = if capacity.is_nan() { "capacity not determined".into() } else { known };
            (title, "flow, veh/h/lane")
        } else {
            (format!("{}, {} points", fit.model.name(), fit.points), "speed, km/h")
        };
        axes.labels(&title, ["density, veh/km/lane", name]);
        for &(k, v) in &dots {
            axes.dot(k, of(k, v), 1.8, DOT);
        }
        let band: Vec<[f64; 3]> = curve
            .iter()
            .map(|&[k, v, half]| [k, of(k, (v - half).max(0.0)), of(k, v + half).min(top)])
            .collect();
        axes.band(&band, BAND);
        let line: Vec<[f64; 2]> = curve.iter().map(|&[k, v, _]| [k, of(k, v)]).collect();
        axes.curve(&line, 2.0, CURVE);
        axes.key(0, "fit with 95 % band", CURVE);
        whole.place(axes.finish(), [f64::from(SIZE[0]) * column as f64, 0.0]);
    }
    whole
}
