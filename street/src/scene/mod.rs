//! A scene: everything about a recording but its seed, read from a small TOML file.
//!
//! Owns the keys and their defaults; every key's range is checked in `check.rs`, and unknown
//! keys are refused. Owns no behaviour: the road, the traffic, the picture each read their part.

mod check;
mod check_marks;
mod fleet;
mod lane;
mod marks;
mod roadside;

pub use fleet::FleetMix;
pub use lane::{LaneSpec, Marking, Signal, Slowdown};
pub use marks::{Ink, Overlay, OverlayKind, Painted, PaintedKind, Turn};
pub use roadside::{
    Barrier, Bridge, BuildingRow, Closure, ClosureKind, Ground, LampRow, Roadside, Shadow,
    ShadowKind, Strip, TreeRow,
};

use std::path::Path;

use jiff::{SignedDuration, Timestamp};
use nalgebra::Point3;
use serde::Deserialize;

use crate::camera::{Attitude, Camera};
use crate::error::{Error, Result};
use crate::road::{Piece, Road};

/// No recording is longer: a million frames, an hour apart.
const LONGEST: SignedDuration = SignedDuration::from_hours(1_000_000);

/// One camera over one street.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Scene {
    /// Name of the scene; becomes the camera's id.
    pub name: String,
    /// UTC time of the first frame, RFC 3339 with `Z`.
    pub start: String,
    /// Time between frames, s.
    pub interval_s: f64,
    /// Traffic runs so long before the first frame, s.
    #[serde(default = "default_warmup_s")]
    pub warmup_s: f64,
    /// The camera.
    pub camera: CameraSpec,
    /// Optics and sensor noise.
    #[serde(default)]
    pub imaging: Imaging,
    /// Light and weather.
    #[serde(default)]
    pub light: Light,
    /// The reference line.
    pub road: RoadSpec,
    /// The lanes, numbered from 1 in this order.
    #[serde(rename = "lane")]
    pub lanes: Vec<LaneSpec>,
    /// Painted lines along the road.
    #[serde(default, rename = "marking")]
    pub markings: Vec<Marking>,
    /// Words and symbols painted in lanes, later ones over earlier ones.
    #[serde(default)]
    pub painted: Vec<Painted>,
    /// What the camera burns into its picture, later ones over earlier ones.
    #[serde(default, rename = "overlay")]
    pub overlays: Vec<Overlay>,
    /// Ground and objects beside the lanes.
    #[serde(default)]
    pub roadside: Roadside,
    /// Shares of vehicle classes.
    #[serde(default)]
    pub fleet: FleetMix,
    /// The measured stretch.
    #[serde(default)]
    pub measure: Measure,
    /// Faults of the camera.
    #[serde(default)]
    pub faults: Faults,
}

fn default_warmup_s() -> f64 {
    300.0
}

/// Pose and optics. The camera stands at world (0, 0, `height_m`).
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CameraSpec {
    /// Picture width, px.
    pub width: u32,
    /// Picture height, px.
    pub height: u32,
    /// Focal length, px.
    pub focal_px: f64,
    /// Height over the road, m.
    pub height_m: f64,
    /// Angle below the horizon, degrees.
    pub tilt_deg: f64,
    /// Clockwise turn from +Y, degrees.
    #[serde(default)]
    pub pan_deg: f64,
    /// Clockwise turn of the picture's content, degrees.
    #[serde(default)]
    pub roll_deg: f64,
    /// Radial distortion k1.
    #[serde(default)]
    pub k1: f64,
}

/// The chain from lens to file of a cheap traffic camera.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Imaging {
    /// JPEG quality, 1 to 100.
    pub jpeg_quality: u8,
    /// Standard deviation of the luma noise, 8-bit levels.
    pub noise_levels: f64,
    /// Standard deviation of the lens blur, px.
    pub blur_px: f64,
    /// Strength of the sharpening halo: 0 none, 1 strong.
    pub sharpening: f64,
    /// Horizontal smear of colour as on an analogue line, px.
    pub chroma_smear_px: f64,
    /// Samples per pixel side of the drawing, 1 to 4; 0 chooses 3 up to 400 px width, else 2.
    pub supersampling: u32,
}

impl Default for Imaging {
    fn default() -> Self {
        Imaging {
            jpeg_quality: 75,
            noise_levels: 2.0,
            blur_px: 0.5,
            sharpening: 0.5,
            chroma_smear_px: 1.0,
            supersampling: 0,
        }
    }
}

/// Time of day.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Daylight {
    /// Sun or overcast sky.
    Day,
    /// After sunset, vehicles' lights on.
    Dusk,
    /// Street lamps and headlights only.
    Night,
}

/// Light and weather.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Light {
    /// Time of day.
    pub daylight: Daylight,
    /// Cloud: 0 clear sun with hard shadows, 1 overcast.
    pub cloud: f64,
    /// Sun azimuth, degrees clockwise from +Y.
    pub sun_azimuth_deg: f64,
    /// Sun height over the horizon, degrees.
    pub sun_elevation_deg: f64,
    /// Rain: 0 dry, 1 heavy.
    pub rain: f64,
}

impl Default for Light {
    fn default() -> Self {
        Light {
            daylight: Daylight::Day,
            cloud: 0.3,
            sun_azimuth_deg: 215.0,
            sun_elevation_deg: 48.0,
            rain: 0.0,
        }
    }
}

/// The reference line: from a point near the camera, away from it.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RoadSpec {
    /// World X of the start, m.
    pub start_x_m: f64,
    /// World Y of the start, m.
    pub start_y_m: f64,
    /// Heading at the start, degrees clockwise from +Y.
    #[serde(default)]
    pub heading_deg: f64,
    /// Left edge of the carriageway from the reference line, m (negative is left).
    pub left_edge_m: f64,
    /// Right edge of the carriageway, m.
    pub right_edge_m: f64,
    /// Brightness of the asphalt, 0 black to 1 white.
    #[serde(default = "default_asphalt")]
    pub asphalt: f64,
    /// The pieces, end to end.
    #[serde(rename = "piece")]
    pub pieces: Vec<Piece>,
}

fn default_asphalt() -> f64 {
    0.17
}

/// The measured stretch of a lane.
#[derive(Debug, Clone, Copy, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Measure {
    /// The far end is where a 1.45 m high car is this high in the picture, px.
    pub min_car_height_px: f64,
    /// The far end is at most this far along the lane from the road's start, m.
    pub far_m: f64,
    /// Vehicles are whole within this distance of the picture's edge, px.
    pub edge_margin_px: f64,
}

impl Default for Measure {
    fn default() -> Self {
        Measure { min_car_height_px: 8.0, far_m: 1000.0, edge_margin_px: 2.0 }
    }
}

/// Faults of the camera. Times are seconds after the first frame.
#[derive(Debug, Clone, Copy, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Faults {
    /// Amplitude of the sway of the pole, px at the picture's centre.
    pub shake_px: f64,
    /// The operator turns the camera.
    pub ptz: Option<Ptz>,
    /// From here on the same picture is sent again and again.
    pub frozen_from_s: Option<f64>,
    /// From here on pictures are black.
    pub black_from_s: Option<f64>,
    /// Frozen or black pictures end here; absent means never.
    pub until_s: Option<f64>,
}

/// A move of the camera to another view, for good or for a while.
#[derive(Debug, Clone, Copy, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Ptz {
    /// When, s after the first frame.
    pub at_s: f64,
    /// Change of pan, degrees clockwise.
    #[serde(default)]
    pub pan_deg: f64,
    /// Change of tilt, degrees downwards.
    #[serde(default)]
    pub tilt_deg: f64,
    /// Change of roll, degrees clockwise.
    #[serde(default)]
    pub roll_deg: f64,
    /// The camera is back from here on; absent means never.
    pub until_s: Option<f64>,
    /// Factor on the focal length.
    #[serde(default = "default_zoom")]
    pub zoom: f64,
}

fn default_zoom() -> f64 {
    1.0
}

impl Scene {
    /// Reads and checks a scene file, with some keys set to other values: each change is
    /// `table.key=value`, the value as in TOML, quotes around plain words may be left out.
    ///
    /// # Errors
    /// [`Error::Desk`], [`Error::SceneSyntax`], [`Error::SceneValue`].
    pub fn read(path: &Path, changes: &[String]) -> Result<Self> {
        let text = verge_desk::read_text(path)?;
        Self::parse(&text, &path.display().to_string(), changes)
    }

    /// Reads and checks a scene's text, with changes as [`Scene::read`]; `origin` names it in
    /// errors.
    ///
    /// # Errors
    /// [`Error::SceneSyntax`], [`Error::SceneValue`].
    pub fn parse(text: &str, origin: &str, changes: &[String]) -> Result<Self> {
        let broken = |message: String| Error::SceneSyntax { origin: origin.to_owned(), message };
        let say = |fault: toml::de::Error| broken(fault.to_string().trim_end().to_owned());
        let scene: Scene = if changes.is_empty() {
            toml::from_str(text).map_err(say)?
        } else {
            let mut table: toml::Table = text.parse().map_err(say)?;
            for change in changes {
                apply(&mut table, change).map_err(broken)?;
            }
            table.try_into().map_err(say)?
        };
        scene.check(origin)?;
        Ok(scene)
    }

    /// The camera as installed, without faults.
    pub fn camera(&self) -> Camera {
        let spec = &self.camera;
        let attitude = Attitude {
            pan: spec.pan_deg.to_radians(),
            tilt: spec.tilt_deg.to_radians(),
            roll: spec.roll_deg.to_radians(),
        };
        let eye = Point3::new(0.0, 0.0, spec.height_m);
        Camera::new((spec.width, spec.height), spec.focal_px, spec.k1, eye, attitude)
    }

    /// The reference line.
    pub fn reference_line(&self) -> Road {
        let spec = &self.road;
        let start = [spec.start_x_m, spec.start_y_m];
        Road::new(start, spec.heading_deg.to_radians(), &spec.pieces)
    }

    /// The instant of a frame, counted from 0.
    ///
    /// To the nearest millisecond.
    pub fn frame_time(&self, frame: usize) -> Timestamp {
        let start = self.start_time().expect("check() has parsed the start time");
        let after_ms = (frame as f64 * self.interval_s * 1000.0).round() as i64;
        start.checked_add(SignedDuration::from_millis(after_ms)).expect("check() leaves room")
    }

    /// The instant of the first frame; none where it is not a time in whole milliseconds, or so
    /// late that no recording would end within the calendar.
    fn start_time(&self) -> Option<Timestamp> {
        let start: Timestamp = self.start.parse().ok()?;
        start.checked_add(LONGEST).ok()?;
        (start.subsec_nanosecond() % 1_000_000 == 0).then_some(start)
    }
}

/// Sets one key of a scene's table.
fn apply(table: &mut toml::Table, change: &str) -> std::result::Result<(), String> {
    let (path, value) =
        change.split_once('=').ok_or_else(|| format!("--set {change}: write table.key=value"))?;
    let value = value.trim();
    let value = format!("v = {value}")
        .parse::<toml::Table>()
        .ok()
        .and_then(|mut parsed| parsed.remove("v"))
        .unwrap_or_else(|| toml::Value::String(value.to_owned()));
    let mut at = table;
    let mut keys = path.trim().split('.').peekable();
    while let Some(key) = keys.next() {
        if keys.peek().is_none() {
            at.insert(key.to_owned(), value);
            return Ok(());
        }
        let mut inner = at.entry(key).or_insert_with(|| toml::Value::Table(toml::Table::new()));
        if let toml::Value::Array(list) = inner {
            let (number, most) = (keys.next().unwrap_or_default(), list.len());
            let entry = number.parse::<usize>().ok().and_then(|n| list.get_mut(n.checked_sub(1)?));
            inner = entry.ok_or_else(|| {
                format!("--set {change}: {key} is a list of {most}: write {key}.1.key=value to {key}.{most}.key=value")
            })?;
        }
        at = inner.as_table_mut().ok_or_else(|| format!("--set {change}: {key} is not a table"))?;
    }
    Err(format!("--set {change}: write table.key=value"))
}
