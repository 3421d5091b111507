//! The keys of a scene for what is painted in its lanes and burnt into its picture.
//!
//! Owns words, arrows and symbols on the road, and overlays, as data; ranges are
//! `check_marks.rs`. Lines along the road are `lane.rs`.

use serde::Deserialize;

/// What is painted in a lane.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum PaintedKind {
    /// A word; a second word lies before the first, nearer to its reader.
    Word,
    /// An arrow of the lane.
    Arrow,
    /// A bicycle.
    Cycle,
    /// The crossed lines of a box junction, in their frame.
    Hatching,
    /// A bar across.
    StopLine,
    /// A row of triangles that point at their reader.
    GiveWay,
    /// Bars along the road, side by side.
    Zebra,
}

/// The way an arrow points.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Turn {
    /// Straight on.
    #[default]
    Ahead,
    /// To the left.
    Left,
    /// To the right.
    Right,
    /// Straight on and to the left.
    AheadLeft,
    /// Straight on and to the right.
    AheadRight,
}

/// A word or symbol on the road. Its reader drives in its lane.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Painted {
    /// What it is.
    pub kind: PaintedKind,
    /// Middle along the road, m.
    pub at_m: f64,
    /// The lane in whose middle it lies, from 1; or `offset_m`.
    pub lane: Option<usize>,
    /// Middle right of the reference line, m; its reader then drives away from the camera.
    pub offset_m: Option<f64>,
    /// The word.
    #[serde(default)]
    pub text: String,
    /// The way an arrow points.
    #[serde(default)]
    pub turn: Turn,
    /// Length along the road, of a word that of one line, m; absent is the usual one.
    pub length_m: Option<f64>,
    /// Width across, m; absent is the usual one.
    pub width_m: Option<f64>,
    /// Yellow and not white.
    #[serde(default)]
    pub yellow: bool,
    /// Paint that traffic has worn off, 0 none to 1 nearly all.
    #[serde(default)]
    pub worn: f64,
}

/// What is burnt into the picture.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum OverlayKind {
    /// A line of text.
    Text,
    /// An arrow.
    Arrow,
    /// A band.
    Bar,
    /// A box with a ring and a bar in it, as an operator's sign.
    Logo,
}

/// Colour of an overlay.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Ink {
    /// White.
    #[default]
    White,
    /// Black.
    Black,
    /// Yellow.
    Yellow,
    /// Red.
    Red,
    /// Green.
    Green,
    /// Blue.
    Blue,
}

/// A mark that the camera burns into its picture, over everything.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Overlay {
    /// What it is.
    pub kind: OverlayKind,
    /// Left end, share of the picture's width.
    pub x: f64,
    /// Upper end, share of the picture's height.
    pub y: f64,
    /// Height, px.
    pub size_px: f64,
    /// The text; `{time}` becomes the frame's UTC time.
    #[serde(default)]
    pub text: String,
    /// Width of a bar, share of the picture's width.
    #[serde(default = "whole")]
    pub width: f64,
    /// The way an arrow points, degrees clockwise from upwards.
    #[serde(default)]
    pub turn_deg: f64,
    /// Colour.
    #[serde(default)]
    pub colour: Ink,
    /// Colour of a box behind it; absent is none.
    pub behind: Option<Ink>,
    /// How much it covers, 0 to 1.
    #[serde(default = "whole")]
    pub opacity: f64,
}

fn whole() -> f64 {
    1.0
}
