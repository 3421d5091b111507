//! The calibration file: what a calibration gave, how it was made, how far to trust it.
//!
//! Owns the JSON format `verge-calibration`, versions 1 and 2; 2 where the road has a crest,
//! which programs that know version 1 alone would silently leave out. Does not own the verdict's
//! rules (see `trust`) nor any solver.
//!
//! | field | unit | meaning |
//! |---|---|---|
//! | `format`, `version` | | `verge-calibration`, 1 or 2 |
//! | `method` | | `joint`, `mvcalib`, ... |
//! | `camera_id` | | the camera, or null |
//! | `image_size` | px | width and height |
//! | `f`, `principal_point`, `k1` | px, px, 1 | the lens, see [`crate::camera`] |
//! | `rvec`, `tvec` | rad, m | `cam_from_world`, as OpenCV writes it |
//! | `crest_per_m` | 1/m | curvature of the road's profile (optional), see [`Camera`] |
//! | `loss` | | the method's own objective at the result |
//! | `rel_err` | 1 | standard error of a length on the road, as a part of it, or null |
//! | `vehicles` | | name and matched model of each vehicle |
//! | `seed`, `evaluations`, `wall_time_s` | , , s | how it was computed |
//! | `stages` | | what each stage gave (optional) |
//! | `uncertainty` | | covariance of the camera (joint, road) |
//! | `errors` | 1 | standard error of a length near, in the middle and far (road) |
//! | `trust` | | `ok`, or why not to trust it |
//! | `warnings` | | lengths that everything else contradicts, standards that nothing checks (road, optional) |
//!
//! Only `f`, `rvec`, `tvec` and `image_size` are needed to read one, so the authors' own
//! result files are readable too.

use super::stated::{StatedErrors, Uncertainty};
use crate::camera::{Camera, Lens, Pose};
use crate::error::{Error, Result};
use crate::length_error::{CameraCovariance, UncertainCamera};
use crate::plain;
use crate::trust::Trust;
use nalgebra::{Vector2, Vector3};
use serde::{Deserialize, Serialize};
use sha2::Digest;
use std::fmt;
use std::path::Path;

/// The SHA-256 of a file, by which a lane table names its calibration.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Sha256(pub [u8; 32]);

impl Sha256 {
    /// Of these bytes.
    pub fn of(bytes: &[u8]) -> Self {
        Sha256(sha2::Sha256::digest(bytes).into())
    }
}

/// Eight hexadecimal digits, for people.
impl fmt::Display for Sha256 {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0[..4].iter().try_for_each(|byte| write!(f, "{byte:02x}"))
    }
}

/// Value of the field `format`.
pub const FORMAT: &str = "verge-calibration";
/// The newest version that this program reads; it writes the lowest that holds a calibration.
pub const VERSION: u32 = 2;

/// One calibration file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Calibration {
    /// [`FORMAT`].
    #[serde(default = "format_name")]
    pub format: String,
    /// [`VERSION`].
    #[serde(default = "version")]
    pub version: u32,
    /// The method that made it.
    #[serde(default)]
    pub method: String,
    /// The camera it belongs to.
    #[serde(default)]
    pub camera_id: Option<String>,
    /// Width and height of the pictures, px.
    #[serde(default)]
    pub image_size: Option<[u32; 2]>,
    /// Focal length, px.
    pub f: f64,
    /// Principal point, px; the middle of the picture when absent.
    #[serde(default)]
    pub principal_point: Option<[f64; 2]>,
    /// Radial distortion, see [`Lens::k1`].
    #[serde(default)]
    pub k1: f64,
    /// Rotation vector of `cam_from_world`, rad.
    #[serde(deserialize_with = "flat_or_column")]
    pub rvec: [f64; 3],
    /// Translation of `cam_from_world`, m.
    #[serde(deserialize_with = "flat_or_column")]
    pub tvec: [f64; 3],
    /// Curvature of the road's profile, see [`Camera::crest_per_m`].
    #[serde(default, skip_serializing_if = "is_level")]
    pub crest_per_m: f64,
    /// The method's objective at the result; its unit is the method's.
    #[serde(default)]
    pub loss: Option<f64>,
    /// Standard error (1 sigma) of a length on the road as a part of that length.
    #[serde(default)]
    pub rel_err: Option<f64>,
    /// The vehicles and the models they matched.
    #[serde(default)]
    pub vehicles: Vec<VehicleMatch>,
    /// Seed of the random numbers.
    #[serde(default)]
    pub seed: u64,
    /// Evaluations of the losses.
    #[serde(default)]
    pub evaluations: usize,
    /// Time the calibration took, s.
    #[serde(default)]
    pub wall_time_s: f64,
    /// What the stages of MVCalib gave.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub stages: Option<StageLosses>,
    /// What the method says of its own error.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub uncertainty: Option<Uncertainty>,
    /// Error of lengths near, in the middle and far.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub errors: Option<StatedErrors>,
    /// Whether it may be used.
    #[serde(default)]
    pub trust: Trust,
    /// What a person should look at although it may be used.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub warnings: Vec<String>,
}

/// A vehicle and the model that it matched.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct VehicleMatch {
    /// The vehicle, by file name or group.
    pub name: String,
    /// The model; null where the method has a continuous shape instead.
    #[serde(default)]
    pub model: Option<String>,
    /// Root mean square distance of its key points to the fit, px.
    #[serde(default)]
    pub rms_px: Option<f64>,
}

/// Fine-tuning losses after each stage, as in the paper's figure of the three stages.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct StageLosses {
    /// Loss of every candidate of stage 1.
    pub candidates: Vec<StageLoss>,
    /// Loss of every refined candidate of stage 2.
    pub refined: Vec<StageLoss>,
    /// Loss from every anchor of stage 3.
    pub tuned: Vec<StageLoss>,
}

/// The fine-tuning loss of one camera of one stage.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct StageLoss {
    /// The vehicle that the camera came from.
    pub vehicle: String,
    /// Its model.
    pub model: String,
    /// Focal length, px.
    pub f: f64,
    /// Eq. obj_func; null when a key point is above this camera's horizon.
    pub loss: Option<f64>,
    /// Why the search stopped, for the stages that search.
    #[serde(default)]
    pub stopped: Option<String>,
}

impl Calibration {
    /// A calibration with only a camera and a method; the caller fills in the rest.
    pub fn of_camera(camera: &Camera, method: &str) -> Self {
        Calibration {
            format: format_name(),
            version: if camera.crest_per_m == 0.0 { version() } else { VERSION },
            method: method.to_owned(),
            camera_id: None,
            image_size: Some(camera.image_size),
            f: camera.lens.f,
            principal_point: Some(camera.lens.centre.into()),
            k1: camera.lens.k1,
            rvec: camera.pose.rvec().into(),
            tvec: camera.pose.translation.into(),
            crest_per_m: camera.crest_per_m,
            loss: None,
            rel_err: None,
            vehicles: Vec::new(),
            seed: 0,
            evaluations: 0,
            wall_time_s: 0.0,
            stages: None,
            uncertainty: None,
            errors: None,
            trust: Trust::Ok,
            warnings: Vec::new(),
        }
    }

    /// Reads a calibration file. `image_size` (px) is used where the file has none.
    pub fn read(path: &Path, image_size: Option<[u32; 2]>) -> Result<Self> {
        let text = verge_desk::read_text(path)?;
        let wrong = |detail: String| Error::Json { path: path.to_owned(), detail };
        let mut calibration: Calibration =
            serde_json::from_str(&text).map_err(|e| wrong(plain::words(&e)))?;
        if calibration.format != FORMAT || calibration.version > VERSION {
            let Calibration { format, version, .. } = calibration;
            return Err(wrong(format!(
                "{format} {version}, this program reads {FORMAT} {VERSION}"
            )));
        }
        if let (Some(actual), Some(expected)) = (calibration.image_size, image_size)
            && actual != expected
        {
            return Err(Error::ImageSize { what: path.display().to_string(), actual, expected });
        }
        calibration.image_size = calibration.image_size.or(image_size);
        if calibration.image_size.is_none() {
            return Err(wrong("no image_size; pass --image-size WIDTHxHEIGHT".into()));
        }
        if let Some(problem) = calibration.problem() {
            return Err(wrong(problem));
        }
        Ok(calibration)
    }

    fn problem(&self) -> Option<String> {
        let finite = self.rvec.iter().chain(&self.tvec).all(|x| x.is_finite());
        if !finite
            || self.f <= 0.0
            || !self.f.is_finite()
            || !self.k1.is_finite()
            || !self.crest_per_m.is_finite()
        {
            return Some("f, rvec, tvec, k1 or crest_per_m is not a usable number".into());
        }
        if self.image_size.is_some_and(|s| s.contains(&0)) {
            return Some("image_size is empty".into());
        }
        None
    }

    /// The camera.
    pub fn camera(&self) -> Camera {
        let image_size = self.image_size.unwrap_or([1, 1]);
        let lens = Lens::centred(self.f, image_size);
        let centre = self.principal_point.map_or(lens.centre, Vector2::from);
        Camera {
            image_size,
            lens: Lens { centre, k1: self.k1, ..lens },
            pose: Pose::from_vectors(Vector3::from(self.rvec), Vector3::from(self.tvec)),
            crest_per_m: self.crest_per_m,
        }
    }

    /// The camera with its covariance; `None` where the method states none.
    pub fn known(&self) -> Option<UncertainCamera> {
        let stated = self.uncertainty.as_ref()?;
        let covariance = CameraCovariance::from_fn(|a, b| stated.covariance[a][b]);
        Some(UncertainCamera { camera: self.camera(), covariance })
    }

    /// An error when the calibration says of itself that it cannot be trusted.
    pub fn require_trust(&self) -> Result<()> {
        match &self.trust {
            Trust::Ok => Ok(()),
            Trust::Refused(reason) => Err(Error::NotTrusted(reason.clone())),
        }
    }

    /// The file's text.
    pub fn to_json(&self) -> String {
        let mut text = serde_json::to_string_pretty(self)
            .expect("a struct of strings and finite numbers is always JSON");
        text.push('\n');
        text
    }
}

fn format_name() -> String {
    FORMAT.to_owned()
}

fn is_level(crest_per_m: &f64) -> bool {
    *crest_per_m == 0.0
}

fn version() -> u32 {
    1
}

fn flat_or_column<'de, D: serde::Deserializer<'de>>(
    d: D,
) -> std::result::Result<[f64; 3], D::Error> {
    #[derive(Deserialize)]
    #[serde(untagged)]
    enum Either {
        Flat([f64; 3]),
        Column([[f64; 1]; 3]),
    }
    Ok(match Either::deserialize(d)? {
        Either::Flat(v) => v,
        Either::Column(v) => v.map(|[x]| x),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::trust::Reason;
    use verge_desk::Exit;

    fn parse(json: &str) -> serde_json::Result<Calibration> {
        serde_json::from_str(json)
    }

    #[test]
    fn the_authors_columns_and_our_rows_are_both_read() {
        let column = parse(r#"{"f":400,"rvec":[[1],[2],[3]],"tvec":[[4],[5],[6]],"x":1}"#).unwrap();
        let row = parse(r#"{"f":400,"rvec":[1,2,3],"tvec":[4,5,6]}"#).unwrap();
        assert_eq!((column.rvec, column.tvec), (row.rvec, row.tvec));
        assert!(parse(r#"{"f":400,"rvec":[1,2],"tvec":[4,5,6]}"#).is_err());
    }

    #[test]
    fn a_written_calibration_reads_back_the_same_camera() {
        let camera = Camera {
            image_size: [320, 240],
            lens: Lens { k1: -0.03, ..Lens::centred(401.864, [320, 240]) },
            pose: Pose::from_vectors(
                Vector3::new(1.8936, 0.1869, -0.1925),
                Vector3::new(-3.901, 6.036, 44.410),
            ),
            crest_per_m: 1e-4,
        };
        let written = Calibration::of_camera(&camera, "joint");
        let read = parse(&written.to_json()).unwrap();
        assert_eq!(read, written);
        assert!((read.camera().pose.rvec() - camera.pose.rvec()).norm() < 1e-12);
        read.require_trust().unwrap();
    }

    #[test]
    fn an_untrusted_calibration_is_refused_with_its_reason() {
        let mut c = parse(r#"{"f":400,"rvec":[1,2,3],"tvec":[4,5,6]}"#).unwrap();
        c.trust = Trust::Refused(Reason::FewVehicles { actual: 1 });
        let error = c.require_trust().unwrap_err();
        assert!(error.to_string().contains("1 vehicle(s)"));
        assert_eq!(error.exit_code(), 65);
    }
}
