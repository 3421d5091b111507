//! The plain values that pass from one stage of the line to the next.
//!
//! Owns their shape and nothing else; stages know these types and never each other.

use crate::units::UtcMs;

pub use crate::evidence::{Detection, PixelBox};

/// One picture as the camera gave it. Its buffers are kept from frame to frame.
#[derive(Debug, Default)]
pub struct Frame {
    /// Time at which it was taken.
    pub time: UtcMs,
    /// Its source, for messages: a file name or `snapshot`.
    pub name: String,
    /// Its pixels.
    pub picture: Picture,
}

/// Pixels in RGB, 8 bits a channel, row by row.
#[derive(Clone, Debug, Default)]
pub struct Picture {
    /// Columns, px.
    pub width: usize,
    /// Rows, px.
    pub height: usize,
    /// `width * height * 3` bytes.
    pub rgb: Vec<u8>,
}

/// The shape of a picture: its columns and rows, at any scale.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Shape {
    /// Columns, px.
    pub width: u32,
    /// Rows, px.
    pub height: u32,
}

impl Shape {
    /// How far columns over rows may differ: scaled pictures are rounded to whole pixels.
    const MAX_ASPECT_ERROR: f64 = 0.01;

    /// Whether a picture of this size is one of this shape, scaled.
    pub fn admits(self, width: u32, height: u32) -> bool {
        let aspect = |width: u32, height: u32| f64::from(width) / f64::from(height);
        let expected = aspect(self.width, self.height);
        (aspect(width, height) / expected - 1.0).abs() < Self::MAX_ASPECT_ERROR
    }
}

impl std::fmt::Display for Shape {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}x{} px", self.width, self.height)
    }
}

/// A rectangle of whole pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Region {
    /// First column.
    pub x: usize,
    /// First row.
    pub y: usize,
    /// Columns, px.
    pub width: usize,
    /// Rows, px.
    pub height: usize,
}

impl Region {
    /// All of `picture`.
    pub fn whole(picture: &Picture) -> Self {
        Self { x: 0, y: 0, width: picture.width, height: picture.height }
    }

    /// Its part inside `picture`; all of the picture where they do not overlap.
    pub fn within(self, picture: &Picture) -> Self {
        let width = picture.width.saturating_sub(self.x).min(self.width);
        let height = picture.height.saturating_sub(self.y).min(self.height);
        if width > 0 && height > 0 { Self { width, height, ..self } } else { Self::whole(picture) }
    }
}
