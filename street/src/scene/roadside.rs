//! The keys of a scene for what lies and stands beside the carriageway.
//!
//! Owns strips, barriers, trees, buildings, bridges and lamps as data; ranges are `check.rs`.

use serde::Deserialize;

/// Ground and objects beside the carriageway.
#[derive(Debug, Clone, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Roadside {
    /// Strips of ground, later ones over earlier ones; elsewhere grass.
    #[serde(rename = "strip")]
    pub strips: Vec<Strip>,
    /// Walls and rails along the road. They hide what is behind them.
    #[serde(rename = "barrier")]
    pub barriers: Vec<Barrier>,
    /// Rows of trees. Scenery: must not stand between the camera and a lane.
    #[serde(rename = "trees")]
    pub trees: Vec<TreeRow>,
    /// Rows of buildings. Scenery, as trees.
    #[serde(rename = "buildings")]
    pub buildings: Vec<BuildingRow>,
    /// Footbridges across the road. Scenery, as trees: put them beyond the measured lanes.
    #[serde(rename = "bridge")]
    pub bridges: Vec<Bridge>,
    /// Rows of street lamps.
    #[serde(rename = "lamps")]
    pub lamps: Vec<LampRow>,
}

/// Surface of a strip of ground.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Ground {
    /// Mown grass.
    Grass,
    /// Paving stones.
    Pavement,
    /// Concrete.
    Concrete,
    /// Low shrubs.
    Planting,
}

/// A strip of ground along the road.
#[derive(Debug, Clone, Copy, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Strip {
    /// Left edge right of the reference line, m.
    pub from_m: f64,
    /// Right edge, m.
    pub to_m: f64,
    /// Surface.
    pub ground: Ground,
}

/// A wall along the road.
#[derive(Debug, Clone, Copy, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Barrier {
    /// Centre right of the reference line, m.
    pub offset_m: f64,
    /// Height, m.
    pub height_m: f64,
    /// Thickness, m.
    pub width_m: f64,
    /// A hedge and not concrete.
    #[serde(default)]
    pub hedge: bool,
}

/// A row of trees.
#[derive(Debug, Clone, Copy, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TreeRow {
    /// Centre right of the reference line, m.
    pub offset_m: f64,
    /// First tree along the road, m.
    pub from_m: f64,
    /// Last tree along the road, m.
    pub to_m: f64,
    /// Distance between trees, m.
    pub spacing_m: f64,
    /// Mean height, m.
    pub height_m: f64,
}

/// A row of buildings.
#[derive(Debug, Clone, Copy, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BuildingRow {
    /// Front right of the reference line, m (negative is left).
    pub offset_m: f64,
    /// Start along the road, m.
    pub from_m: f64,
    /// End along the road, m.
    pub to_m: f64,
    /// Mean height, m.
    pub height_m: f64,
}

/// A bridge across the road.
#[derive(Debug, Clone, Copy, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Bridge {
    /// Place along the road, m.
    pub at_m: f64,
    /// Underside over the road, m.
    pub clearance_m: f64,
    /// Height of deck and railing, m.
    pub depth_m: f64,
    /// Half its span, m.
    pub half_span_m: f64,
}

/// A row of street lamps.
#[derive(Debug, Clone, Copy, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LampRow {
    /// Post right of the reference line, m.
    pub offset_m: f64,
    /// First lamp along the road, m.
    pub from_m: f64,
    /// Last lamp along the road, m.
    pub to_m: f64,
    /// Distance between lamps, m.
    pub spacing_m: f64,
    /// Height, m.
    pub height_m: f64,
}
