//! A picture to draw on: the camera's frame enlarged, with dots and lines in its pixels.
//!
//! Owns the few shapes that reports and overlays need. Does not own what they mean.

use crate::error::{Error, Result};
use crate::files::picture::upright;
use image::{ImageFormat, Rgb, RgbImage, imageops};
use nalgebra::Vector2;
use std::path::Path;

/// A colour, red green blue.
pub type Colour = [u8; 3];

/// A frame, enlarged by a whole factor; coordinates are those of the frame (px).
pub struct Canvas {
    image: RgbImage,
    factor: f64,
}

/// Pictures are enlarged to about this width, px.
const WIDTH: u32 = 1280;

impl Canvas {
    /// A frame from a file.
    ///
    /// # Errors
    /// When it cannot be decoded or does not have the calibration's size (px).
    pub fn open(path: &Path, expected: [u32; 2]) -> Result<Self> {
        let wrong =
            |e: image::ImageError| Error::Picture { path: path.to_owned(), detail: e.to_string() };
        let frame = upright(path).map_err(wrong)?.to_rgb8();
        let actual = [frame.width(), frame.height()];
        if actual != expected {
            let what = path.display().to_string();
            return Err(Error::ImageSize { what, actual, expected });
        }
        Ok(Self::enlarged(frame))
    }

    /// A grey frame of a size, where there is no picture.
    pub fn blank([width, height]: [u32; 2]) -> Self {
        Self::enlarged(RgbImage::from_pixel(width, height, Rgb([90, 90, 90])))
    }

    fn enlarged(frame: RgbImage) -> Self {
        let factor = (WIDTH / frame.width()).max(1);
        let (w, h) = (frame.width() * factor, frame.height() * factor);
        let image = imageops::resize(&frame, w, h, imageops::FilterType::CatmullRom);
        Canvas { image, factor: f64::from(factor) }
    }

    /// Mixes a colour into a pixel of the enlarged picture, by a part of 0 to 1.
    fn mix(&mut self, x: i64, y: i64, colour: Colour, part: f64) {
        let inside = x >= 0
            && y >= 0
            && x < i64::from(self.image.width())
            && y < i64::from(self.image.height());
        if inside {
            let pixel = self.image.get_pixel_mut(x as u32, y as u32);
            for (old, new) in pixel.0.iter_mut().zip(colour) {
                *old = (f64::from(*old) * (1.0 - part) + f64::from(new) * part).round() as u8;
            }
        }
    }

    /// A filled disc at a point of the frame, its radius in pixels of the enlarged picture.
    pub fn dot(&mut self, at: Vector2<f64>, radius: f64, colour: Colour) {
        let centre = at * self.factor;
        let reach = radius.ceil() as i64 + 1;
        let (cx, cy) = (centre.x.round() as i64, centre.y.round() as i64);
        for y in cy - reach..=cy + reach {
            for x in cx - reach..=cx + reach {
                let d = Vector2::new(x as f64 + 0.5, y as f64 + 0.5) - centre;
                self.mix(x, y, colour, (radius + 0.5 - d.norm()).clamp(0.0, 1.0));
            }
        }
    }

    /// A straight line between two points of the frame, its width in pixels of the enlarged
    /// picture.
    pub fn line(&mut self, from: Vector2<f64>, to: Vector2<f64>, width: f64, colour: Colour) {
        let (from, to) = (from * self.factor, to * self.factor);
        let edge = to - from;
        let reach = width / 2.0 + 1.0;
        let limit = |low: f64, high: f64, size: u32| {
            let low = (low - reach).max(0.0) as i64;
            (low, ((high + reach).min(f64::from(size))) as i64)
        };
        let (x0, x1) = limit(from.x.min(to.x), from.x.max(to.x), self.image.width());
        let (y0, y1) = limit(from.y.min(to.y), from.y.max(to.y), self.image.height());
        for y in y0..=y1 {
            for x in x0..=x1 {
                let p = Vector2::new(x as f64 + 0.5, y as f64 + 0.5);
                let t = (p - from).dot(&edge) / edge.norm_squared().max(f64::MIN_POSITIVE);
                let d = (p - from - edge * t.clamp(0.0, 1.0)).norm();
                self.mix(x, y, colour, (width / 2.0 + 0.5 - d).clamp(0.0, 1.0));
            }
        }
    }

    /// The outline of a polygon of the frame.
    pub fn outline(&mut self, polygon: &[Vector2<f64>], width: f64, colour: Colour) {
        for (k, corner) in polygon.iter().enumerate() {
            self.line(*corner, polygon[(k + 1) % polygon.len()], width, colour);
        }
    }

    /// A cross at a point of the frame.
    pub fn cross(&mut self, at: Vector2<f64>, size: f64, colour: Colour) {
        let d = size / self.factor;
        self.line(at + Vector2::new(-d, -d), at + Vector2::new(d, d), 2.0, colour);
        self.line(at + Vector2::new(-d, d), at + Vector2::new(d, -d), 2.0, colour);
    }

    /// The picture as PNG.
    pub fn png(&self) -> Result<Vec<u8>> {
        let mut bytes = std::io::Cursor::new(Vec::new());
        let failed = |e: image::ImageError| Error::Picture {
            path: "(drawing)".into(),
            detail: e.to_string(),
        };
        self.image.write_to(&mut bytes, ImageFormat::Png).map_err(failed)?;
        Ok(bytes.into_inner())
    }
}
