//! Whether labelled vehicles can be posed at all, told before any solver runs.
//!
//! Owns the geometric checks on key points of one vehicle: enough of them, spread over
//! the picture, left and right consistent. Does not own reading the files.

use crate::error::{Error, Result};
use crate::model::VehicleModel;
use crate::vehicle::Vehicle;
use nalgebra::{Matrix2, Vector2};

/// Fewest key points of a vehicle: EPnP's minimum.
pub const MIN_POINTS: usize = 4;

/// Fewest px that the points must spread across their best line (root mean square).
const MIN_SPREAD_PX: f64 = 0.5;

/// Pairs of labels (left, right seen from the front) that point the same way across the
/// vehicle in the model's frame: headlights, mirrors, back corners, tail lights. The
/// paper's back corners are labelled from the driver's seat, hence 8 before 7.
const ACROSS: [(u8, u8); 4] = [(1, 2), (5, 6), (8, 7), (10, 9)];

/// Checks one vehicle; the error names it and the points concerned.
pub fn check_vehicle(vehicle: &Vehicle, models: &[VehicleModel]) -> Result<()> {
    let too_few = |actual| Error::TooFewPoints {
        vehicle: vehicle.name.clone(),
        required: MIN_POINTS,
        actual,
    };
    if vehicle.points.len() < MIN_POINTS {
        return Err(too_few(vehicle.points.len()));
    }
    let models = vehicle.body.model().map_or(models, std::slice::from_ref);
    let best = models.iter().map(|m| m.pairs(vehicle).len()).max().unwrap_or(0);
    if best < MIN_POINTS {
        return Err(too_few(best));
    }
    check_spread(vehicle)?;
    check_sides(vehicle)?;
    check_mirror_image(vehicle)
}

fn check_spread(vehicle: &Vehicle) -> Result<()> {
    let n = vehicle.points.len() as f64;
    let mean = vehicle.points.iter().map(|p| p.uv).sum::<Vector2<f64>>() / n;
    let scatter = vehicle
        .points
        .iter()
        .map(|p| (p.uv - mean) * (p.uv - mean).transpose())
        .sum::<Matrix2<f64>>()
        / n;
    let spread_px = scatter.symmetric_eigenvalues().min().max(0.0).sqrt();
    if spread_px < MIN_SPREAD_PX {
        let points = vehicle.points.iter().map(|p| p.label.to_string()).collect::<Vec<_>>();
        let points = points.join(", ");
        return Err(Error::Collinear { vehicle: vehicle.name.clone(), points, spread_px });
    }
    Ok(())
}

/// The vectors across the vehicle that are labelled, with their two labels.
fn sides(vehicle: &Vehicle) -> Vec<((u8, u8), Vector2<f64>)> {
    let at = |label| vehicle.points.iter().find(|p| p.label == label).map(|p| p.uv);
    ACROSS.iter().filter_map(|&(a, b)| Some(((a, b), at(b)? - at(a)?))).collect()
}

/// Parallel edges of a car stay nearly parallel in the picture; one that points the
/// other way than the rest has its labels swapped.
fn check_sides(vehicle: &Vehicle) -> Result<()> {
    let sides = sides(vehicle);
    for (i, &((first, second), across)) in sides.iter().enumerate() {
        let against =
            sides.iter().enumerate().filter(|&(j, (_, o))| j != i && o.dot(&across) < 0.0);
        if sides.len() > 1 && 2 * against.count() > sides.len() - 1 {
            let reason = "the other left-right pairs of this vehicle point the other way".into();
            return Err(Error::SwappedLabels {
                vehicle: vehicle.name.clone(),
                first,
                second,
                reason,
            });
        }
    }
    Ok(())
}

/// A car on the road seen from above is never a mirror image: from left to right and from
/// the headlights to the mirrors turn one way only.
fn check_mirror_image(vehicle: &Vehicle) -> Result<()> {
    let at = |label| vehicle.points.iter().find(|p| p.label == label).map(|p| p.uv);
    let (Some(l), Some(r), Some(ml), Some(mr)) = (at(1), at(2), at(5), at(6)) else {
        return Ok(());
    };
    let across = (r - l) + (mr - ml);
    let backwards = (ml + mr) - (l + r);
    // Image v points down, so a right-handed turn has a negative cross product.
    if across.perp(&backwards) > 0.0 {
        let reason = "the vehicle is a mirror image of a car on the road; so are 5 and 6".into();
        return Err(Error::SwappedLabels {
            vehicle: vehicle.name.clone(),
            first: 1,
            second: 2,
            reason,
        });
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::parse_models;
    use crate::vehicle::KeyPoint;

    fn models() -> Vec<VehicleModel> {
        parse_models(include_str!("../data/vehicles.json")).unwrap()
    }

    /// vehicle_07 of camera K109F.
    fn good() -> Vehicle {
        let points = [
            (1, 167.3, 204.0),
            (2, 184.0, 205.6),
            (3, 175.0, 209.4),
            (4, 178.4, 195.4),
            (5, 169.4, 191.7),
            (6, 189.0, 194.8),
            (7, 193.3, 181.6),
        ];
        let points = points.map(|(label, u, v)| KeyPoint { label, uv: Vector2::new(u, v) });
        Vehicle { name: "vehicle_07".into(), body: Default::default(), points: points.to_vec() }
    }

    fn swap(vehicle: &mut Vehicle, a: usize, b: usize) {
        let uv = vehicle.points[a].uv;
        vehicle.points[a].uv = vehicle.points[b].uv;
        vehicle.points[b].uv = uv;
    }

    #[test]
    fn a_real_vehicle_passes() {
        check_vehicle(&good(), &models()).unwrap();
    }

    #[test]
    fn three_points_are_too_few() {
        let mut v = good();
        v.points.truncate(3);
        let error = check_vehicle(&v, &models()).unwrap_err();
        assert!(matches!(error, Error::TooFewPoints { required: 4, actual: 3, .. }));
    }

    #[test]
    fn points_on_a_line_are_named() {
        let mut v = good();
        for (i, p) in v.points.iter_mut().enumerate() {
            p.uv = Vector2::new(100.0 + 3.0 * i as f64, 50.0 + 2.0 * i as f64);
        }
        let error = check_vehicle(&v, &models()).unwrap_err().to_string();
        assert!(error.contains("vehicle_07") && error.contains("1, 2, 3"), "{error}");
    }

    #[test]
    fn swapped_headlights_and_mirrored_cars_are_named() {
        let mut v = good();
        swap(&mut v, 4, 5);
        swap(&mut v, 0, 1);
        assert!(matches!(
            check_vehicle(&v, &models()),
            Err(Error::SwappedLabels { first: 1, second: 2, .. })
        ));
        let mut v = good();
        v.points.push(KeyPoint { label: 8, uv: Vector2::new(175.0, 179.0) });
        check_vehicle(&v, &models()).unwrap();
        swap(&mut v, 4, 5);
        assert!(matches!(
            check_vehicle(&v, &models()),
            Err(Error::SwappedLabels { first: 5, second: 6, .. })
        ));
    }
}
