//! The picture without traffic, and how each frame lies against it.
//!
//! Owns choosing frames of one scene, bringing them over each other by whole pixels, and their
//! median. Frames of another scene are left out and named. Does not own the search for a
//! scene (the core crate's `scene` module does).

use crate::error::{Error, Result};
use crate::road::scene_reference::{HeapEye, Mean, eye, picture};
use image::{ImageFormat, RgbImage};
use rayon::prelude::*;
use sha2::{Digest, Sha256};
use std::path::{Path, PathBuf};
use verge::scene::{Pose, Reference, Sighting, search};

/// Most frames in the median: of 25, a vehicle must hide a place in 13 to stay.
pub const MOST_FRAMES: usize = 25;

/// The picture that is drawn on.
#[derive(Debug)]
pub struct Backdrop {
    /// Width and height, px.
    pub image_size: [u32; 2],
    /// Its pixels, RGB.
    pub rgb: Vec<u8>,
    /// The same as a PNG file.
    pub png: Vec<u8>,
    /// SHA-256 of the pixels, in hexadecimal digits.
    pub sha256: String,
    /// The frames that it is made of.
    pub frames: Vec<PathBuf>,
    /// Frames that were left out, by name, and why.
    pub left_out: Vec<(String, String)>,
    /// By which other frames are found; `None` where the scene has too few edges.
    reference: Option<Reference>,
}

/// How a frame lies against another picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Shift {
    /// Where the other picture's middle lies in the frame, against its own middle, px.
    pub by: [f64; 2],
    /// Clockwise turn, rad.
    pub turn: f64,
    /// Zoom, a factor.
    pub zoom: f64,
    /// Root mean square displacement, px.
    pub displacement_px: f64,
    /// Whether the scene was found at all.
    pub sure: bool,
}

impl Shift {
    /// None, of a frame that nothing is known of.
    pub const NONE: Self =
        Shift { by: [0.0; 2], turn: 0.0, zoom: 1.0, displacement_px: 0.0, sure: false };

    fn of(seen: &Sighting, eye: &HeapEye) -> Self {
        let (grid, pose) = (eye.grid(), seen.pose);
        let px = f64::from(grid.cell_px());
        Shift {
            by: [pose.dx, pose.dy].map(|cells| f64::from(cells) * px),
            turn: f64::from(pose.turn),
            zoom: f64::from(pose.zoom),
            displacement_px: f64::from(pose.displacement(grid.width, grid.height)) * px,
            sure: seen.is_sure(),
        }
    }

    /// Where a point of the other picture lies in the frame, px.
    pub fn apply(&self, [u, v]: [f64; 2], image_size: [u32; 2]) -> [f64; 2] {
        let [x, y] = image_size.map(|px| 0.5 * f64::from(px));
        let (sine, cosine) = self.turn.sin_cos();
        let (u, v) = (self.zoom * (u - x), self.zoom * (v - y));
        [x + self.by[0] + cosine * u - sine * v, y + self.by[1] + sine * u + cosine * v]
    }
}

impl Backdrop {
    /// The backdrop of frames, in the pose of the first, or of the middle or last one where the
    /// first shows another scene than most.
    ///
    /// # Errors
    /// Where no frame can be read.
    pub fn of(frames: &[PathBuf]) -> Result<Self> {
        let chosen = spread(frames, MOST_FRAMES);
        let anchors = [0, chosen.len() / 2, chosen.len().saturating_sub(1)];
        let mut best: Option<Aligned> = None;
        for anchor in anchors {
            let Some(path) = chosen.get(anchor) else { continue };
            let aligned = match Aligned::to(path, &chosen) {
                Ok(aligned) => aligned,
                Err(_) if anchor != anchors[2] || best.is_some() => continue,
                Err(error) => return Err(error),
            };
            let most = aligned.kept.len() * 2 > chosen.len();
            if best.as_ref().is_none_or(|b| aligned.kept.len() > b.kept.len()) {
                best = Some(aligned);
            }
            if most {
                break;
            }
        }
        best.ok_or_else(|| Error::Usage("no picture can be read".into()))?.median()
    }

    /// How a frame lies against it.
    ///
    /// # Errors
    /// Where the frame cannot be read or has another size.
    pub fn shift(&self, path: &Path) -> Result<Shift> {
        let (rgb, width, height) = picture(path)?;
        if [width, height] != self.image_size {
            let what = path.display().to_string();
            let expected = self.image_size;
            return Err(Error::ImageSize { what, actual: [width, height], expected });
        }
        Ok(self.shift_of(&rgb))
    }

    /// The same of pixels of the same size.
    pub fn shift_of(&self, rgb: &[u8]) -> Shift {
        let [width, height] = self.image_size;
        let mut eye = eye(width, height);
        eye.look(rgb);
        self.reference.as_ref().map_or(Shift::NONE, |r| Shift::of(&search(r, &eye), &eye))
    }

    /// How this backdrop lies against an older picture of the same size, on which was drawn.
    ///
    /// # Errors
    /// Where the old picture has too few edges to be found again.
    pub fn against(&self, old: &[u8]) -> Result<Shift> {
        let [width, height] = self.image_size;
        let mut eye = eye(width, height);
        let reference = reference_of(&mut eye, old)?;
        eye.look(&self.rgb);
        Ok(Shift::of(&search(&reference, &eye), &eye))
    }
}

fn reference_of(eye: &mut HeapEye, rgb: &[u8]) -> Result<Reference> {
    eye.look(rgb);
    let mut mean = Mean::new(eye.grid());
    mean.add(eye, Pose::SAME);
    mean.reference()
}

/// Frames brought over one of them.
struct Aligned {
    size: [u32; 2],
    kept: Vec<(PathBuf, RgbImage, [i64; 2])>,
    left_out: Vec<(String, String)>,
}

impl Aligned {
    fn to(anchor: &Path, frames: &[PathBuf]) -> Result<Self> {
        let (rgb, width, height) = picture(anchor)?;
        let mut own = eye(width, height);
        // A scene without edges is taken as it comes.
        let reference = reference_of(&mut own, &rgb).ok();
        let judge = |path: &PathBuf| -> std::result::Result<(RgbImage, [i64; 2]), String> {
            let (rgb, w, h) = picture(path).map_err(|e| e.to_string())?;
            if (w, h) != (width, height) {
                return Err(format!("it has {w} x {h} px, the others {width} x {height}"));
            }
            let mut eye = eye(w, h);
            eye.look(&rgb);
            let by = match &reference {
                None => [0.0; 2],
                Some(reference) => {
                    let shift = Shift::of(&search(reference, &eye), &eye);
                    if !shift.sure {
                        return Err("it does not show the scene of the others".into());
                    }
                    shift.by
                }
            };
            let image = RgbImage::from_raw(w, h, rgb).ok_or("it is cut off")?;
            Ok((image, by.map(|px| px.round() as i64)))
        };
        let judged: Vec<_> = frames.par_iter().map(|path| (path, judge(path))).collect();
        let (mut kept, mut left_out) = (Vec::new(), Vec::new());
        for (path, judged) in judged {
            match judged {
                Ok((image, by)) => kept.push((path.clone(), image, by)),
                Err(why) => left_out.push((name_of(path), why)),
            }
        }
        Ok(Aligned { size: [width, height], kept, left_out })
    }

    fn median(self) -> Result<Backdrop> {
        let [width, height] = self.size;
        let row = |v: u32| -> Vec<u8> {
            let mut row = vec![0; 3 * width as usize];
            let mut values = [const { Vec::new() }; 3];
            for u in 0..width {
                values.iter_mut().for_each(Vec::clear);
                for (_, image, [du, dv]) in &self.kept {
                    let (u, v) = (i64::from(u) + du, i64::from(v) + dv);
                    let inside =
                        (0..i64::from(width)).contains(&u) && (0..i64::from(height)).contains(&v);
                    if inside {
                        let pixel = image.get_pixel(u as u32, v as u32);
                        values.iter_mut().zip(pixel.0).for_each(|(v, p)| v.push(p));
                    }
                }
                for (channel, values) in values.iter_mut().enumerate() {
                    let middle = values.len() / 2;
                    if !values.is_empty() {
                        let (_, median, _) = values.select_nth_unstable(middle);
                        row[3 * u as usize + channel] = *median;
                    }
                }
            }
            row
        };
        let rgb: Vec<u8> = (0..height).into_par_iter().flat_map_iter(row).collect();
        let frames = self.kept.into_iter().map(|(path, ..)| path).collect();
        let mut own = eye(width, height);
        let reference = reference_of(&mut own, &rgb).ok();
        let png = png(&rgb, self.size)?;
        let sha256 = hexadecimal(&rgb);
        let (image_size, left_out) = (self.size, self.left_out);
        Ok(Backdrop { image_size, rgb, png, sha256, frames, left_out, reference })
    }
}

fn png(rgb: &[u8], [width, height]: [u32; 2]) -> Result<Vec<u8>> {
    let mut bytes = Vec::new();
    let image = RgbImage::from_raw(width, height, rgb.to_vec()).expect("three bytes a pixel");
    image.write_to(&mut std::io::Cursor::new(&mut bytes), ImageFormat::Png).map_err(|e| {
        Error::Picture { path: "the picture without traffic".into(), detail: e.to_string() }
    })?;
    Ok(bytes)
}

fn hexadecimal(bytes: &[u8]) -> String {
    Sha256::digest(bytes).iter().map(|b| format!("{b:02x}")).collect()
}

/// A file's name.
pub fn name_of(path: &Path) -> String {
    path.file_name().unwrap_or_default().to_string_lossy().into_owned()
}

/// So many of a list, evenly over it, the first among them.
pub fn spread<T: Clone>(all: &[T], most: usize) -> Vec<T> {
    let n = all.len();
    let chosen = n.min(most);
    (0..chosen).map(|k| all[k * n / chosen].clone()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_list_is_thinned_evenly() {
        assert_eq!(spread(&[1, 2, 3], 5), [1, 2, 3]);
        assert_eq!(spread(&(0..100).collect::<Vec<_>>(), 4), [0, 25, 50, 75]);
        assert!(spread::<u8>(&[], 4).is_empty());
    }

    #[test]
    fn a_point_moves_with_the_scene() {
        let shift = Shift { by: [3.0, -2.0], ..Shift::NONE };
        assert_eq!(shift.apply([10.0, 20.0], [320, 240]), [13.0, 18.0]);
        let zoomed = Shift { zoom: 2.0, ..Shift::NONE };
        assert_eq!(zoomed.apply([170.0, 120.0], [320, 240]), [180.0, 120.0]);
        let turned = Shift { turn: std::f64::consts::FRAC_PI_2, ..Shift::NONE };
        let [u, v] = turned.apply([170.0, 120.0], [320, 240]);
        assert!((u - 160.0).abs() < 1e-9 && (v - 130.0).abs() < 1e-9);
    }
}
