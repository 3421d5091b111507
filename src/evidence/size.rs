//! The size that a car has in the picture at the place where it stands.
//!
//! Owns the plane and its fit. On a flat road the side in pixels of anything of a given size is a
//! linear function of where it meets the road, and 0 at the horizon (Hartley and Zisserman,
//! "Multiple View Geometry", section 8.6, single view metrology). Three numbers therefore hold for
//! the whole picture, and are fitted to the widths of lanes, or to boxes of cars where there is no
//! lane table. The side of a box is the root of its area: width and height change with the angle
//! at which a car is seen, their product less.

use crate::units::ImagePoint;

/// Fewest samples to which a plane is fitted.
pub const LEAST_SAMPLES: usize = 10;
/// No car is smaller in a picture, px: neither would be seen.
const LEAST_PX: f32 = 4.0;
/// Logarithm of a size from which a sample counts half: lorries and motorcycles among cars.
const ODD: f32 = 0.25;
/// Rounds of the fit; 40 change the last ones by less than 1 %.
const ROUNDS: usize = 40;

/// Side of a car by place, as a part of the picture's width: so that it holds for the same
/// stream in another size.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CarSize {
    /// In the middle of the uppermost row.
    origin: f32,
    /// More for each width to the right, and for each width down.
    right: f32,
    down: f32,
}

impl CarSize {
    /// Side of a car that meets the road at `point` of a picture of that width, px.
    pub fn at(&self, point: ImagePoint, width: f32) -> f32 {
        (self.part(point, width) * width).max(LEAST_PX)
    }

    fn part(&self, point: ImagePoint, width: f32) -> f32 {
        self.origin + self.right * (point.u / width - 0.5) + self.down * (point.v / width)
    }

    /// The plane through samples of a place and the side of a car there, px of a picture of that
    /// width; those that differ most weigh least (a Cauchy weight on the logarithm). `None` for
    /// fewer than [`LEAST_SAMPLES`], or for places that give no plane.
    pub fn fit(
        samples: impl Iterator<Item = (ImagePoint, f32)> + Clone,
        width: f32,
    ) -> Option<Self> {
        let count = samples.clone().count();
        if count < LEAST_SAMPLES {
            return None;
        }
        let n = count as f32;
        let mut plane: Option<Self> = None;
        for _ in 0..ROUNDS {
            // Normal equations. The slope to the right is drawn to 0: a camera hangs level.
            let mut a = [[1e-3, 0.0, 0.0], [0.0, 0.015 * n, 0.0], [0.0, 0.0, 1e-3]];
            let mut b = [0.0; 3];
            for (point, side) in samples.clone() {
                let side = (side / width).max(1e-4);
                let weight = match plane {
                    None => 1.0 / side,
                    Some(plane) => {
                        let expected = plane.part(point, width).max(LEAST_PX / width);
                        let odd = libm::logf(side / expected) / ODD;
                        1.0 / (expected * libm::sqrtf(1.0 + odd * odd))
                    }
                };
                let row = [1.0, point.u / width - 0.5, point.v / width].map(|x| x * weight);
                for (line, &x) in a.iter_mut().zip(&row) {
                    for (cell, &y) in line.iter_mut().zip(&row) {
                        *cell += x * y;
                    }
                }
                for (sum, &x) in b.iter_mut().zip(&row) {
                    *sum += x * side * weight;
                }
            }
            let [origin, right, down] = solve(a, b)?;
            plane = Some(Self { origin, right, down });
        }
        plane
    }
}

/// The solution of three equations by Cramer's rule; `None` where there is none.
fn solve(a: [[f32; 3]; 3], b: [f32; 3]) -> Option<[f32; 3]> {
    let a = a.map(|row| row.map(f64::from));
    let [b0, b1, b2] = b.map(f64::from);
    let det = |[[a, b, c], [d, e, f], [g, h, i]]: [[f64; 3]; 3]| {
        a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g)
    };
    let whole = det(a);
    let [[x0, y0, z0], [x1, y1, z1], [x2, y2, z2]] = a;
    let of = |m| (det(m) / whole) as f32;
    let solution = [
        of([[b0, y0, z0], [b1, y1, z1], [b2, y2, z2]]),
        of([[x0, b0, z0], [x1, b1, z1], [x2, b2, z2]]),
        of([[x0, y0, b0], [x1, y1, b1], [x2, y2, b2]]),
    ];
    solution.iter().all(|x| x.is_finite()).then_some(solution)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec::Vec;

    /// Places all over a picture of 640 px, with the side of a car under a level camera.
    fn road() -> Vec<(ImagePoint, f32)> {
        let place =
            |i: usize| ImagePoint { u: (i * 97 % 640) as f32, v: 120.0 + (i * 53 % 240) as f32 };
        (0..60).map(place).map(|p| (p, 0.2 * (p.v - 60.0))).collect()
    }

    #[test]
    fn the_plane_of_a_level_camera_is_found() {
        let size = CarSize::fit(road().iter().copied(), 640.0).expect("enough samples");
        for (point, side) in road() {
            let at = size.at(point, 640.0);
            assert!((at / side - 1.0).abs() < 0.02, "{point:?}: {at} for {side}");
            let half = ImagePoint { u: point.u / 2.0, v: point.v / 2.0 };
            assert!((size.at(half, 320.0) - at / 2.0).abs() < 0.01, "the same stream, scaled");
        }
    }

    #[test]
    fn lorries_and_motorcycles_among_cars_do_not_turn_it() {
        let mut samples = road();
        for (i, (_, side)) in samples.iter_mut().enumerate() {
            *side *= [1.0, 1.0, 1.05, 2.2, 0.95, 1.0, 0.4][i % 7];
        }
        let size = CarSize::fit(samples.iter().copied(), 640.0).expect("enough samples");
        for (point, side) in road() {
            let at = size.at(point, 640.0);
            assert!((at / side - 1.0).abs() < 0.15, "{point:?}: {at} for {side}");
        }
    }

    #[test]
    fn too_few_samples_give_none_and_no_car_is_smaller_than_any() {
        assert_eq!(CarSize::fit(road().iter().copied().take(LEAST_SAMPLES - 1), 640.0), None);
        let size = CarSize::fit(road().iter().copied(), 640.0).expect("enough samples");
        assert_eq!(size.at(ImagePoint { u: 320.0, v: 0.0 }, 640.0), LEAST_PX, "in the sky");
    }
}
