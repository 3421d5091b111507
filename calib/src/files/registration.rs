//! Pictures of a camera that sways, brought into one frame.
//!
//! Owns the shifts file and moving labels by it. Does not own finding the shifts.
//!
//! `{"shifts": {"vehicle_01.jpg": [du, dv], ...}}`: the road of that picture stands at
//! u = u_reference + du, v = v_reference + dv, px.

use crate::error::{Error, Result};
use crate::plain;
use crate::vehicle::Vehicle;
use nalgebra::Vector2;
use serde::Deserialize;
use std::collections::BTreeMap;
use std::path::Path;

/// How far each picture is shifted against the reference, px, by the picture's name.
#[derive(Clone, Debug, Deserialize)]
pub struct FrameShifts {
    shifts: BTreeMap<String, [f64; 2]>,
}

impl FrameShifts {
    /// Reads a shifts file.
    pub fn read(path: &Path) -> Result<Self> {
        let wrong = |detail: String| Error::Json { path: path.to_owned(), detail };
        let text = verge_desk::read_text(path)?;
        let shifts: FrameShifts =
            serde_json::from_str(&text).map_err(|e| wrong(plain::words(&e)))?;
        match shifts.shifts.iter().find(|(_, s)| !s.iter().all(|x| x.is_finite())) {
            Some((name, _)) => Err(wrong(format!("{name}: shift is not a finite number"))),
            None => Ok(shifts),
        }
    }

    /// Moves the labels of every vehicle into the reference frame.
    ///
    /// # Errors
    /// When a vehicle's picture has no shift: a mixture of frames would be worse than none.
    pub fn register(&self, vehicles: &mut [Vehicle]) -> Result<()> {
        for vehicle in vehicles {
            let stem = vehicle.name.split('#').next().unwrap_or_default();
            let found = self.shifts.iter().find(|(name, _)| {
                Path::new(name).file_stem().is_some_and(|s| s.to_string_lossy() == stem)
            });
            let Some((_, &shift)) = found else {
                return Err(Error::KeyPoint {
                    vehicle: vehicle.name.clone(),
                    label: "(all)".into(),
                    problem: "its picture has no shift; add it to the shifts file".into(),
                });
            };
            vehicle.points.iter_mut().for_each(|p| p.uv -= Vector2::from(shift));
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::vehicle::KeyPoint;

    #[test]
    fn labels_move_against_the_shift_and_none_is_forgotten() {
        let shifts: FrameShifts =
            serde_json::from_str(r#"{"shifts":{"a.jpg":[1.0,-2.0]}}"#).unwrap();
        let vehicle = |name: &str| Vehicle {
            body: Default::default(),
            name: name.into(),
            points: vec![KeyPoint { label: 1, uv: Vector2::new(10.0, 20.0) }],
        };
        let mut one = [vehicle("a#3")];
        shifts.register(&mut one).unwrap();
        assert_eq!(one[0].points[0].uv, Vector2::new(9.0, 22.0));
        assert!(shifts.register(&mut [vehicle("b")]).unwrap_err().to_string().contains("b,"));
    }
}
