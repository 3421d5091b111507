//! Vehicle models: where the key points of a known vehicle are.
//!
//! Owns the labels of key points, the models and their file. Does not own the vehicles of a
//! picture (see `vehicle`).

use crate::error::{Error, Result};
use crate::plain;
use nalgebra::Vector3;
use std::collections::BTreeMap;
use std::path::Path;

/// How many different key points a vehicle can have; labels run from 1 to this.
/// 1 to 8 are the paper's (section Experimental Settings), 9 to 13 are seen from behind.
pub const KEY_POINT_COUNT: usize = 13;

/// What each key point is, in the order of its label.
pub const KEY_POINT_NAMES: [&str; KEY_POINT_COUNT] = [
    "left headlight",
    "right headlight",
    "front plate centre",
    "front wiper centre",
    "left wing mirror",
    "right wing mirror",
    "back left corner",
    "back right corner",
    "left tail light",
    "right tail light",
    "rear plate centre",
    "rear window top centre",
    "rear bumper centre",
];

/// Key points of one vehicle model in the vehicle's own frame: origin near the back
/// right corner on the road, x across, y negative towards the front, z up; metres.
#[derive(Clone, Debug, PartialEq)]
pub struct VehicleModel {
    /// The model's name.
    pub name: String,
    /// Position of each key point by label - 1; `None` where the model has none.
    pub points: Vec<Option<Vector3<f64>>>,
}

impl VehicleModel {
    /// The model's point with this label, m.
    pub fn point(&self, label: u8) -> Option<Vector3<f64>> {
        self.points.get(usize::from(label).checked_sub(1)?).copied().flatten()
    }
}

/// Reads vehicle models: the paper's JSON, an object from name to a list of [x, y, z] in
/// label order, metres. A `null` in the list is a key point the model does not have.
pub fn read_models(path: &Path) -> Result<Vec<VehicleModel>> {
    let text = verge_desk::read_text(path)?;
    parse_models(&text).map_err(|error| match error {
        Error::Json { detail, .. } => Error::Json { path: path.to_owned(), detail },
        other => other,
    })
}

/// Parses vehicle models, see [`read_models`]. Models come in the order of their names.
pub fn parse_models(json: &str) -> Result<Vec<VehicleModel>> {
    let raw: BTreeMap<String, Vec<Option<[f64; 3]>>> = serde_json::from_str(json)
        .map_err(|e| Error::Json { path: "vehicle models".into(), detail: plain::words(&e) })?;
    let models: Vec<_> = raw
        .into_iter()
        .map(|(name, points)| {
            let points = points.into_iter().map(|p| p.map(Vector3::from)).collect();
            check_model(VehicleModel { name, points })
        })
        .collect::<Result<_>>()?;
    if models.is_empty() {
        return Err(Error::Model { model: "(none)".into(), problem: "the file is empty".into() });
    }
    Ok(models)
}

fn check_model(model: VehicleModel) -> Result<VehicleModel> {
    let problem = if model.points.len() > KEY_POINT_COUNT {
        Some(format!("{} points, at most {KEY_POINT_COUNT} are known", model.points.len()))
    } else if model.points.iter().flatten().count() < 4 {
        Some("fewer than 4 points".to_owned())
    } else {
        model.points.iter().zip(1..).find_map(|(p, label)| {
            let p = (*p)?;
            let sane = p.iter().all(|c| c.is_finite() && c.abs() < 30.0) && p.z >= 0.0;
            (!sane).then(|| {
                format!("point {label} at {:?} is not a place on a vehicle (m)", p.data.0[0])
            })
        })
    };
    match problem {
        Some(problem) => Err(Error::Model { model: model.name, problem }),
        None => Ok(model),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_shipped_models_are_readable() {
        let models = parse_models(include_str!("../data/vehicles.json")).unwrap();
        assert_eq!(models.len(), 5);
        let bmw = models.iter().find(|m| m.name == "BMW_Series4").unwrap();
        assert_eq!(bmw.point(1), Some(Vector3::new(0.28, -4.37, 0.6)));
        assert_eq!(bmw.point(0), None);
        assert_eq!(bmw.point(99), None);
    }

    #[test]
    fn a_model_with_a_wrong_number_is_named() {
        let error = parse_models(r#"{"T": [[0,0,0],[1,0,0],[0,1,0],[0,0,440]]}"#).unwrap_err();
        assert!(error.to_string().contains("'T'") && error.to_string().contains("point 4"));
    }
}
