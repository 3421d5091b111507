//! Day or night, from the picture itself.
//!
//! Street cameras expose for the road, so the mean of a night picture is nearly that of a day
//! picture; the upper third, where the sky or the far dark lies, tells them apart. The rule:
//! night when the mean Rec. 601 luminance of the upper third is below `NIGHT_BELOW_LUMA`.

use std::path::Path;
use verge_desk::Failure;

/// Mean luminance of the upper third (0..255) below which a picture is a night picture.
///
/// The value that best parts the training cameras of sg_lta by their clock (night from 19:45,
/// day 07:20 to 18:40); `detector/README.md` states how often it errs.
pub const NIGHT_BELOW_LUMA: f64 = 98.0;

/// The light of a picture.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Light {
    /// Daylight.
    Day,
    /// Street light or headlights.
    Night,
}

impl Light {
    /// `day` or `night`.
    pub fn name(self) -> &'static str {
        match self {
            Self::Day => "day",
            Self::Night => "night",
        }
    }
}

/// Light of RGB pixels, row by row.
pub fn of_pixels(rgb: &[u8], width: usize, height: usize) -> Light {
    let rows = (height / 3).max(1);
    let part = &rgb[..rgb.len().min(rows * width * 3)];
    let weights = [0.299, 0.587, 0.114];
    let sum: f64 = part
        .as_chunks::<3>()
        .0
        .iter()
        .map(|pixel| pixel.iter().zip(weights).map(|(&v, w)| f64::from(v) * w).sum::<f64>())
        .sum();
    let mean = sum / (part.len() / 3).max(1) as f64;
    if mean < NIGHT_BELOW_LUMA { Light::Night } else { Light::Day }
}

/// Light of a picture file.
pub fn of_file(path: &Path) -> Result<Light, Failure> {
    let bytes = std::fs::read(path).map_err(|source| Failure::reading(path, source))?;
    let picture = image::load_from_memory(&bytes)
        .map_err(|error| Failure::content(path, 0, format!("is not a JPEG or PNG: {error}")))?
        .to_rgb8();
    let (width, height) = picture.dimensions();
    Ok(of_pixels(picture.as_raw(), width as usize, height as usize))
}

/// Whether the name says JPEG or PNG.
pub fn is_picture(path: &Path) -> bool {
    let ending = path.extension().map(|ending| ending.to_string_lossy().to_lowercase());
    ending.is_some_and(|ending| ["jpg", "jpeg", "png"].contains(&ending.as_str()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_upper_third_decides() {
        let picture = |top: u8, rest: u8| -> Vec<u8> {
            (0..30 * 10 * 3).map(|i| if i < 10 * 10 * 3 { top } else { rest }).collect()
        };
        assert_eq!(of_pixels(&picture(160, 10), 10, 30), Light::Day);
        assert_eq!(of_pixels(&picture(20, 200), 10, 30), Light::Night);
        assert_eq!(of_pixels(&picture(98, 0), 10, 30), Light::Day);
        assert_eq!(of_pixels(&picture(97, 255), 10, 30), Light::Night);
    }

    #[test]
    fn green_weighs_most() {
        assert_eq!(of_pixels(&[0, 255, 0], 1, 1), Light::Day);
        assert_eq!(of_pixels(&[255, 0, 255], 1, 1), Light::Day);
        assert_eq!(of_pixels(&[0, 0, 255], 1, 1), Light::Night);
    }
}
