//! The keys of a scene for what lies and stands beside the carriageway.
//!
//! Owns strips, barriers, trees, buildings, bridges, lamps, closures and shadows as data; ranges are `check.rs`.

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
    /// Rows of barrier elements or cones on a stretch. They hide what is behind them.
    #[serde(rename = "closure")]
    pub closures: Vec<Closure>,
    /// Shadows of things that the camera does not see.
    #[serde(rename = "shadow")]
    pub shadows: Vec<Shadow>,
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

/// What a closure is made of.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum ClosureKind {
    /// Plastic elements filled with water, red and white in turn.
    Water,
    /// Concrete elements.
    Concrete,
    /// Cones.
    Cone,
}

impl ClosureKind {
    /// Length of an element, m.
    pub fn length_m(self) -> f64 {
        match self {
            ClosureKind::Water => 1.5,
            ClosureKind::Concrete => 3.0,
            ClosureKind::Cone => 0.36,
        }
    }

    /// Width of an element at its foot, m.
    pub fn width_m(self) -> f64 {
        match self {
            ClosureKind::Water => 0.45,
            ClosureKind::Concrete => 0.5,
            ClosureKind::Cone => 0.36,
        }
    }

    /// Height of an element, m.
    pub fn height_m(self) -> f64 {
        match self {
            ClosureKind::Water => 0.9,
            ClosureKind::Concrete => 0.8,
            ClosureKind::Cone => 0.75,
        }
    }

    /// The usual gap between elements, m.
    pub fn gap_m(self) -> f64 {
        match self {
            ClosureKind::Water => 0.15,
            ClosureKind::Concrete => 0.05,
            ClosureKind::Cone => 4.0,
        }
    }
}

/// A row of elements on a stretch, at the edge of the carriageway or in a lane without traffic.
#[derive(Debug, Clone, Copy, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Closure {
    /// What it is made of.
    pub kind: ClosureKind,
    /// Start along the road, m.
    pub from_m: f64,
    /// Behind this no element with its gap begins, along the road, m.
    pub to_m: f64,
    /// Centre at the start, right of the reference line, m.
    pub offset_m: f64,
    /// Centre at the end, m; absent is as at the start.
    pub to_offset_m: Option<f64>,
    /// Gap between elements, m; absent is the usual one.
    pub gap_m: Option<f64>,
}

/// What casts a shadow.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum ShadowKind {
    /// An upright mast.
    Mast,
    /// Two masts and the beam between them.
    Gantry,
    /// The leaves of a tree: patches of shade and of sun.
    Leaves,
}

/// The shadow under the sun of a thing that is not drawn itself: it stands beside the picture.
#[derive(Debug, Clone, Copy, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Shadow {
    /// What casts it.
    pub kind: ShadowKind,
    /// Foot along the road, m; may lie before its start.
    pub at_m: f64,
    /// Foot right of the reference line, m.
    pub offset_m: f64,
    /// The other foot of a gantry, m.
    pub to_offset_m: Option<f64>,
    /// Height, m.
    pub height_m: f64,
    /// Thickness of mast and beam, of leaves the crown's width, m; absent is the usual one.
    pub width_m: Option<f64>,
}
