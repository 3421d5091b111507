//! The reference of the static scene, made from frames of the calibrated camera.
//!
//! Owns reading the frames, bringing them into the pose of the calibration, and their mean:
//! edges that stand still in all of them stay, traffic averages out. Does not own the
//! reference's bytes nor the search (the core crate's `scene` module does).

use crate::error::{Error, Result};
use crate::files::picture::upright;
use crate::road::outline::contains;
use nalgebra::Vector2;
use std::path::{Path, PathBuf};
use verge::scene::{Cell, Eye, Field, Grid, Pose, Reference, search};

/// Least mean displacement of the frames, cells, at which what is burnt into the picture
/// tells itself from the scene: it does not move with it.
const LEAST_SWAY: f64 = 0.35;
/// Burnt in is where the fields agree so much better without the frames' shifts than with.
const BURNT_IN: f64 = 1.1;
/// The comparison is made over cells so near, cells: a letter.
const BURNT_IN_REACH: usize = 4;

/// The eye that the tools use: buffers on the heap.
pub type HeapEye = Eye<Vec<u8>, Vec<Cell>>;

/// An eye for pictures of this size.
pub fn eye(width: u32, height: u32) -> HeapEye {
    let grid = Grid::of(width as usize, height as usize);
    let len = grid.buffer_len();
    Eye::new(grid, vec![0; len], vec![[0; 2]; len]).expect("buffers of the length it asks for")
}

/// The mean of the fields of several frames, in the pose of the first.
#[derive(Clone, Debug)]
pub struct Mean {
    grid: Grid,
    fine: Vec<[i32; 2]>,
    coarse: Vec<[i32; 2]>,
    /// The same as `fine`, with no frame moved.
    unmoved: Vec<[i32; 2]>,
    sway: f64,
    ignored: Vec<bool>,
    frames: u32,
}

impl Mean {
    /// Nothing yet, for pictures of this grid.
    pub fn new(grid: Grid) -> Self {
        let coarse = (grid.width / 2) * (grid.height / 2);
        Self {
            grid,
            fine: vec![[0; 2]; grid.cells()],
            coarse: vec![[0; 2]; coarse],
            unmoved: vec![[0; 2]; grid.cells()],
            sway: 0.0,
            ignored: vec![false; grid.cells()],
            frames: 0,
        }
    }

    /// Adds a frame that lies so against the pose of the calibration.
    pub fn add(&mut self, eye: &HeapEye, pose: Pose) {
        shift(&mut self.fine, &eye.fine(), pose.dx, pose.dy);
        shift(&mut self.coarse, &eye.coarse(), pose.dx / 2.0, pose.dy / 2.0);
        shift(&mut self.unmoved, &eye.fine(), 0.0, 0.0);
        self.sway += f64::from(pose.dx.hypot(pose.dy));
        self.frames += 1;
    }

    /// Leaves cells out of the reference, by column and row.
    pub fn ignore(&mut self, inside: impl Fn(usize, usize) -> bool) {
        for (at, ignored) in self.ignored.iter_mut().enumerate() {
            *ignored |= inside(at % self.grid.width, at / self.grid.width);
        }
    }

    /// Number of frames.
    pub fn frames(&self) -> u32 {
        self.frames
    }

    /// Which cells are burnt into the picture (clock, name, logo): there the frames agree
    /// better as they are than moved by their shifts. `None` where the camera swayed too
    /// little to tell.
    pub fn burnt_in(&self) -> Option<Vec<bool>> {
        if self.sway / f64::from(self.frames.max(1)) < LEAST_SWAY {
            return None;
        }
        let Grid { width, height, .. } = self.grid;
        let length = |[c, s]: [i32; 2]| f64::from(c).hypot(f64::from(s));
        let around = |cells: &[[i32; 2]], at: usize| {
            let (x, y, reach) = (at % width, at / width, BURNT_IN_REACH);
            let rows = y.saturating_sub(reach)..(y + reach + 1).min(height);
            let columns = x.saturating_sub(reach)..(x + reach + 1).min(width);
            let near = rows.flat_map(|y| columns.clone().map(move |x| y * width + x));
            near.map(|cell| length(cells[cell])).sum::<f64>()
        };
        let fixed = |at| around(&self.unmoved, at) > BURNT_IN * around(&self.fine, at);
        Some((0..self.grid.cells()).map(fixed).collect())
    }

    /// The reference of the mean.
    ///
    /// # Errors
    /// Where the scene has too few edges.
    pub fn reference(&self) -> Result<Reference> {
        let mean = |cells: &[[i32; 2]]| -> Vec<Cell> {
            cells.iter().map(|c| c.map(|v| (v / (16 * self.frames.max(1) as i32)) as i8)).collect()
        };
        let (fine, coarse) = (mean(&self.fine), mean(&self.coarse));
        let Grid { width, height, .. } = self.grid;
        let burnt_in = self.burnt_in();
        let out = |x: usize, y: usize| {
            let at = y * width + x;
            self.ignored[at] || burnt_in.as_ref().is_some_and(|cells| cells[at])
        };
        let fine = Field { cells: &fine, width, height };
        let coarse = Field { cells: &coarse, width: width / 2, height: height / 2 };
        Reference::of(&fine, &coarse, out).map_err(|e| Error::Usage(e.to_string()))
    }
}

/// Adds sixteen times a field, moved back by a shift, to sums.
fn shift(sums: &mut [[i32; 2]], field: &Field<'_>, dx: f32, dy: f32) {
    let (x0, y0) = (dx.floor(), dy.floor());
    let (fx, fy) = (dx - x0, dy - y0);
    let weights = [(1.0 - fx) * (1.0 - fy), fx * (1.0 - fy), (1.0 - fx) * fy, fx * fy];
    for (at, sum) in sums.iter_mut().enumerate() {
        let x = (at % field.width) as i32 + x0 as i32;
        let y = (at / field.width) as i32 + y0 as i32;
        let four = [field.at(x, y), field.at(x + 1, y), field.at(x, y + 1), field.at(x + 1, y + 1)];
        for (k, total) in sum.iter_mut().enumerate() {
            let value: f32 = four.iter().zip(weights).map(|(c, w)| f32::from(c[k]) * w).sum();
            *total += (16.0 * value) as i32;
        }
    }
}

/// The pictures of a folder, by name.
///
/// # Errors
/// Where the folder cannot be listed or holds none.
pub fn pictures(folder: &Path) -> Result<Vec<PathBuf>> {
    let read = |source| verge_desk::Failure::reading(folder, source);
    let mut found = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(read)? {
        let path = entry.map_err(read)?.path();
        let extension = path.extension().and_then(|e| e.to_str()).unwrap_or_default();
        if ["jpg", "jpeg", "png"].iter().any(|known| extension.eq_ignore_ascii_case(known)) {
            found.push(path);
        }
    }
    found.sort();
    if found.is_empty() {
        return Err(Error::Usage(format!("no .jpg, .jpeg or .png file in {}", folder.display())));
    }
    Ok(found)
}

/// Reads a picture as RGB with its size.
///
/// # Errors
/// Where it cannot be read or decoded.
pub fn picture(path: &Path) -> Result<(Vec<u8>, u32, u32)> {
    let wrong = |detail: String| Error::Usage(format!("{}: {detail}", path.display()));
    let image = upright(path).map_err(|e| wrong(e.to_string()))?.into_rgb8();
    let (width, height) = image.dimensions();
    Ok((image.into_raw(), width, height))
}

/// The reference of frames in the pose of the first, each brought there by its own shift.
///
/// # Errors
/// Where a frame cannot be read, has another size, or does not show the first one's scene.
pub fn reference(frames: &[PathBuf], ignored: &[Vec<Vector2<f64>>]) -> Result<(Grid, Reference)> {
    let Some((first, others)) = frames.split_first() else {
        return Err(Error::Usage("no frame to make a reference of".into()));
    };
    reference_of(&first.display().to_string(), picture(first)?, others, ignored)
}

/// The same in the pose of a picture at hand, RGB with its size, called `name` in messages.
///
/// # Errors
/// As [`reference()`].
pub fn reference_of(
    name: &str,
    (rgb, width, height): (Vec<u8>, u32, u32),
    others: &[PathBuf],
    ignored: &[Vec<Vector2<f64>>],
) -> Result<(Grid, Reference)> {
    let mut eye = eye(width, height);
    eye.look(&rgb);
    let empty = {
        let mut mean = Mean::new(eye.grid());
        let px = f64::from(eye.grid().cell_px());
        mean.ignore(|x, y| {
            let centre = Vector2::new(x as f64 + 0.5, y as f64 + 0.5) * px;
            ignored.iter().any(|polygon| contains(polygon, centre))
        });
        mean
    };
    let mut mean = empty.clone();
    mean.add(&eye, Pose::SAME);
    let mut known = mean.reference()?;
    // Once to find what is burnt in, and once more without its pull.
    for round in 0..2 {
        let mut next = empty.clone();
        eye.look(&rgb);
        // What the others pulled the mean away from the first frame is taken back.
        let drift = search(&known, &eye).pose;
        next.add(&eye, Pose::SAME);
        for path in others {
            let (rgb, w, h) = picture(path)?;
            if (w, h) != (width, height) {
                return Err(Error::ImageSize {
                    what: path.display().to_string(),
                    actual: [w, h],
                    expected: [width, height],
                });
            }
            eye.look(&rgb);
            let seen = search(&known, &eye);
            if !seen.is_sure() {
                return Err(Error::Usage(format!(
                    "{} does not show the scene of {name} (significance {:.1}): leave it out, or \
                     give frames of one preset",
                    path.display(),
                    seen.significance
                )));
            }
            let (dx, dy) = (seen.pose.dx - drift.dx, seen.pose.dy - drift.dy);
            next.add(&eye, Pose { dx, dy, ..seen.pose });
            if round == 0 {
                // Each frame makes the next ones easier to find.
                mean.add(&eye, seen.pose);
                known = mean.reference()?;
            }
        }
        mean = next;
        known = mean.reference()?;
    }
    Ok((eye.grid(), known))
}
