//! The picture without traffic, and how each frame lies against it.
//!
//! Owns choosing frames of one scene, bringing them over each other by whole pixels, and their
//! median. Frames of another scene are left out and named. Does not own the search for a
//! scene (the core crate's `scene` module does).

pub mod alike;

use crate::error::{Error, Result};
use crate::road::scene_reference::{HeapEye, Mean, eye, picture};
use alike::{alike, unreadable};
use image::{ImageFormat, RgbImage};
use rayon::prelude::*;
use sha2::{Digest, Sha256};
use std::path::{Path, PathBuf};
use verge::scene::{Pose, Reference, Sighting, search};

/// Most frames in the median: of 25, a vehicle must hide a place in 13 to stay.
pub const MOST_FRAMES: usize = 25;
/// Displacement from which a camera has moved, px of a picture 320 px wide.
const MOVED_OF_320_PX: f64 = 0.5;

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

    /// Whether it is too small to matter: the camera has not moved.
    pub fn is_none(&self, image_size: [u32; 2]) -> bool {
        self.displacement_px < MOVED_OF_320_PX * f64::from(image_size[0]) / 320.0
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
    /// first shows another scene than most. Frames of another size than most are left out.
    ///
    /// # Errors
    /// Where no frame can be read.
    pub fn of(frames: &[PathBuf]) -> Result<Self> {
        let found = alike(frames);
        let mut left_out = found.left_out;
        let chosen = read(&spread(&found.pictures, MOST_FRAMES), &mut left_out);
        let anchors = [0, chosen.len() / 2, chosen.len().saturating_sub(1)];
        let mut best: Option<Aligned> = None;
        for anchor in anchors.into_iter().filter_map(|k| chosen.get(k)) {
            let aligned = Aligned::to(anchor, &chosen);
            let most = aligned.kept.len() * 2 > chosen.len();
            if best.as_ref().is_none_or(|b| aligned.kept.len() > b.kept.len()) {
                best = Some(aligned);
            }
            if most {
                break;
            }
        }
        let mut backdrop = best.ok_or_else(|| none_read(frames, &left_out))?.median()?;
        backdrop.left_out.append(&mut left_out);
        backdrop.left_out.sort();
        Ok(backdrop)
    }

    /// How a frame lies against it.
    ///
    /// # Errors
    /// Where the frame cannot be read or has another size.
    pub fn shift(&self, path: &Path) -> Result<Shift> {
        let wrong = |why: String| Error::Usage(format!("{}: {why}", path.display()));
        let (rgb, w, h) = picture(path).map_err(|_| wrong(unreadable(path)))?;
        let [width, height] = self.image_size;
        if [w, h] != self.image_size {
            return Err(wrong(format!("it has {w} x {h} px, the others {width} x {height}")));
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

/// A decoded frame.
struct Frame {
    path: PathBuf,
    image: RgbImage,
}

/// Decodes frames; those that cannot be are left out.
fn read(paths: &[PathBuf], left_out: &mut Vec<(String, String)>) -> Vec<Frame> {
    let decode = |path: &PathBuf| -> Option<Frame> {
        let (rgb, width, height) = picture(path).ok()?;
        Some(Frame { path: path.clone(), image: RgbImage::from_raw(width, height, rgb)? })
    };
    let decoded: Vec<_> = paths.par_iter().map(decode).collect();
    for (path, _) in paths.iter().zip(&decoded).filter(|(_, frame)| frame.is_none()) {
        left_out.push((name_of(path), unreadable(path)));
    }
    decoded.into_iter().flatten().collect()
}

fn none_read(frames: &[PathBuf], left_out: &[(String, String)]) -> Error {
    let folder = frames.first().and_then(|path| path.parent()).unwrap_or(Path::new("."));
    let (tried, all) = (left_out.len(), frames.len());
    let (first, why) = left_out.first().map_or(("", ""), |(first, why)| (first, why));
    Error::Usage(format!(
        "no picture in {} can be read: {tried} of {all} were tried; {first}: {why}",
        folder.display()
    ))
}

/// Frames brought over one of them.
struct Aligned<'a> {
    size: [u32; 2],
    kept: Vec<(&'a Frame, [i64; 2])>,
    left_out: Vec<(String, String)>,
}

impl<'a> Aligned<'a> {
    /// The frames have the anchor's size.
    fn to(anchor: &Frame, frames: &'a [Frame]) -> Self {
        let (width, height) = anchor.image.dimensions();
        // A scene without edges is taken as it comes.
        let reference = reference_of(&mut eye(width, height), anchor.image.as_raw()).ok();
        let judge = |frame: &Frame| -> Option<[i64; 2]> {
            let Some(reference) = &reference else { return Some([0; 2]) };
            let mut eye = eye(width, height);
            eye.look(frame.image.as_raw());
            let shift = Shift::of(&search(reference, &eye), &eye);
            shift.sure.then(|| shift.by.map(|px| px.round() as i64))
        };
        let judged: Vec<_> = frames.par_iter().map(|frame| (frame, judge(frame))).collect();
        let (mut kept, mut left_out) = (Vec::new(), Vec::new());
        for (frame, judged) in judged {
            match judged {
                Some(by) => kept.push((frame, by)),
                None => {
                    let why = "it does not show the scene of the others";
                    left_out.push((name_of(&frame.path), why.into()));
                }
            }
        }
        Aligned { size: [width, height], kept, left_out }
    }

    fn median(self) -> Result<Backdrop> {
        let [width, height] = self.size;
        let row = |v: u32| -> Vec<u8> {
            let mut row = vec![0; 3 * width as usize];
            let mut values = [const { Vec::new() }; 3];
            for u in 0..width {
                values.iter_mut().for_each(Vec::clear);
                for (frame, [du, dv]) in &self.kept {
                    let (u, v) = (i64::from(u) + du, i64::from(v) + dv);
                    let inside =
                        (0..i64::from(width)).contains(&u) && (0..i64::from(height)).contains(&v);
                    if inside {
                        let pixel = frame.image.get_pixel(u as u32, v as u32);
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
        let frames = self.kept.iter().map(|(frame, _)| frame.path.clone()).collect();
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

/// SHA-256 in hexadecimal digits.
pub(super) fn hexadecimal(bytes: &[u8]) -> String {
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
