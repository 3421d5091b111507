//! What a car may look like: a mean shape and independent ways to differ from it.
//!
//! Owns the shape prior of the joint method: mean of the known models, their principal
//! components, an overall scale, one scale for each axis, and the scatter of single key
//! points. Does not own poses or pictures.
//!
//! A discrete choice among the known models is overconfident: real cars are none of them.
//! The widths of the scale priors are assumptions about a fleet of passenger cars, stated
//! here once; the principal components come from the models given.

use crate::model::{KEY_POINT_COUNT, VehicleModel};
use crate::vehicle::Vehicle;
use nalgebra::{DMatrix, Vector3};

/// Principal components kept: five models span four.
pub const COMPONENTS: usize = 4;
/// Ways to differ: components, overall scale, scale along x, y, z.
pub const MODES: usize = COMPONENTS + FLEET;
/// The last modes, scale and axes, are also what a whole fleet may differ in.
pub const FLEET: usize = 4;

/// How far cars of a fleet are from what the known models span.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Spread {
    /// Standard deviation of a car's overall size (log scale).
    pub scale: f64,
    /// Standard deviation of each axis' size against the overall size (log scale).
    pub axis: f64,
    /// Standard deviation of a single key point against the shape, m: what one labeller
    /// takes for a headlight's centre, and what the modes cannot express.
    pub point_m: f64,
}

/// Passenger cars that are none of the known models.
pub const UNKNOWN_CARS: Spread = Spread { scale: 0.045, axis: 0.03, point_m: 0.05 };

/// Vehicles of another body than a car: about one published size that stands for several
/// makes, with key points that nobody measured.
pub const OTHER_BODIES: Spread = Spread { scale: 0.08, axis: 0.05, point_m: 0.10 };

impl Spread {
    /// The same fleet, this many times as diverse.
    pub fn times(self, factor: f64) -> Self {
        Spread {
            scale: self.scale * factor,
            axis: self.axis * factor,
            point_m: self.point_m * factor,
        }
    }
}

/// A distribution over cars. Points are relative to the middle of the footprint, so that a
/// vehicle's position is the middle of its patch of road.
#[derive(Clone, Debug)]
pub struct ShapePrior {
    /// Mean position by label - 1, m.
    mean: [Option<Vector3<f64>>; KEY_POINT_COUNT],
    /// Displacement by label - 1 for one standard deviation of each mode, m.
    modes: [[Vector3<f64>; MODES]; KEY_POINT_COUNT],
    /// Scatter of a single key point, m.
    pub point_sd_m: f64,
    /// Whether it is one of the fleet of cars, which may differ from the models as a whole.
    pub in_fleet: bool,
}

/// Coefficients of the modes in standard deviations.
pub type Coefficients = nalgebra::SVector<f64, MODES>;

impl ShapePrior {
    /// The distribution over cars that a set of models suggests.
    pub fn of_models(models: &[VehicleModel], spread: Spread) -> Self {
        let centred: Vec<Vec<Option<Vector3<f64>>>> = models.iter().map(centre).collect();
        let mut mean = [None; KEY_POINT_COUNT];
        for (label, slot) in mean.iter_mut().enumerate() {
            let known: Vec<Vector3<f64>> = centred.iter().filter_map(|m| m[label]).collect();
            if !known.is_empty() {
                *slot = Some(known.iter().sum::<Vector3<f64>>() / known.len() as f64);
            }
        }
        let mut modes = [[Vector3::zeros(); MODES]; KEY_POINT_COUNT];
        add_components(&centred, &mean, &mut modes);
        for (label, point) in mean.iter().enumerate() {
            let Some(point) = point else { continue };
            modes[label][COMPONENTS] = point * spread.scale;
            for axis in 0..3 {
                modes[label][COMPONENTS + 1 + axis][axis] = point[axis] * spread.axis;
            }
        }
        ShapePrior { mean, modes, point_sd_m: spread.point_m, in_fleet: true }
    }

    /// What a vehicle may look like: as the cars given, or as its own body.
    pub fn of_vehicle(vehicle: &Vehicle, cars: &ShapePrior) -> Self {
        vehicle.body.model().map_or_else(
            || cars.clone(),
            |model| {
                let own = Self::of_models(std::slice::from_ref(model), OTHER_BODIES);
                ShapePrior { in_fleet: false, ..own }
            },
        )
    }

    /// Where the key point with this label is on a car with these coefficients, m.
    pub fn point(&self, label: u8, coefficients: &Coefficients) -> Option<Vector3<f64>> {
        let index = usize::from(label).checked_sub(1)?;
        let mean = (*self.mean.get(index)?)?;
        let modes = &self.modes[index];
        Some(modes.iter().zip(coefficients.iter()).fold(mean, |p, (mode, c)| p + mode * *c))
    }

    /// Displacements of the key point for one standard deviation of each mode, m.
    pub fn modes(&self, label: u8) -> &[Vector3<f64>; MODES] {
        &self.modes[usize::from(label) - 1]
    }
}

/// A model's points relative to the middle of its footprint. The heights stay: the road
/// is Z = 0 for every car.
fn centre(model: &VehicleModel) -> Vec<Option<Vector3<f64>>> {
    let (mut low, mut high) = (Vector3::repeat(f64::INFINITY), Vector3::repeat(f64::NEG_INFINITY));
    for p in model.points.iter().flatten() {
        low = low.inf(p);
        high = high.sup(p);
    }
    let middle = (low + high) * 0.5;
    let shift = Vector3::new(middle.x, middle.y, 0.0);
    (0..KEY_POINT_COUNT)
        .map(|k| model.points.get(k).copied().flatten().map(|p| p - shift))
        .collect()
}

/// Principal components over the labels that all models have, each scaled to one standard
/// deviation of the set.
fn add_components(
    centred: &[Vec<Option<Vector3<f64>>>],
    mean: &[Option<Vector3<f64>>; KEY_POINT_COUNT],
    modes: &mut [[Vector3<f64>; MODES]; KEY_POINT_COUNT],
) {
    if centred.len() < 2 {
        return;
    }
    let common: Vec<usize> =
        (0..KEY_POINT_COUNT).filter(|&k| centred.iter().all(|m| m[k].is_some())).collect();
    let mut deviations = DMatrix::zeros(3 * common.len(), centred.len());
    for (column, model) in centred.iter().enumerate() {
        for (row, &label) in common.iter().enumerate() {
            let (Some(p), Some(m)) = (model[label], mean[label]) else { continue };
            deviations.fixed_view_mut::<3, 1>(3 * row, column).copy_from(&(p - m));
        }
    }
    let scale = ((centred.len() - 1) as f64).sqrt();
    let svd = deviations.svd(true, false);
    let Some(u) = svd.u else { return };
    for (row, &label) in common.iter().enumerate() {
        for (component, mode) in modes[label][..COMPONENTS].iter_mut().enumerate() {
            let Some(value) = svd.singular_values.get(component) else { continue };
            *mode = u.fixed_view::<3, 1>(3 * row, component) * (value / scale);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::parse_models;

    #[test]
    fn every_known_model_is_a_likely_shape() {
        let models = parse_models(include_str!("../../data/vehicles.json")).unwrap();
        let prior = ShapePrior::of_models(&models, UNKNOWN_CARS);
        for model in &models {
            // Least squares of the model on the modes; scales also explain a part.
            let centred = centre(model);
            let mut a = DMatrix::zeros(24 + MODES, MODES);
            let mut b = nalgebra::DVector::zeros(24 + MODES);
            for label in 1..=8u8 {
                let row = 3 * usize::from(label - 1);
                let p = centred[usize::from(label - 1)].unwrap();
                let d = p - prior.point(label, &Coefficients::zeros()).unwrap();
                for axis in 0..3 {
                    b[row + axis] = d[axis] / 1e-3;
                    for mode in 0..MODES {
                        a[(row + axis, mode)] = prior.modes(label)[mode][axis] / 1e-3;
                    }
                }
            }
            for mode in 0..MODES {
                a[(24 + mode, mode)] = 1.0;
            }
            let c = a.svd(true, true).solve(&b, 1e-12).unwrap();
            assert!(c.norm() < 3.0, "{}: {c}", model.name);
            let fitted = Coefficients::from_column_slice(c.as_slice());
            for label in 1..=8u8 {
                let p = prior.point(label, &fitted).unwrap();
                assert!((p - centred[usize::from(label - 1)].unwrap()).norm() < 1e-3);
            }
        }
    }
}
