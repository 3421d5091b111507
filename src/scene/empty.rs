//! The empty road: what the picture's edges are like where no vehicle stands, by light.
//!
//! Owns the memory, how it is learned, and the comparison. A painted arrow, a letter, an arrow
//! burnt into the picture or a barrier has its edges here; a vehicle has edges of its own and
//! covers these. The memory is the mean orientation field (see `field.rs`): as an edge counts by its
//! direction and hardly by its contrast, sun, street lamps and rain change it little, and what
//! they do change is learned within the hour.
//!
//! A standing queue is never learned: cells under a box that might be a vehicle are left out,
//! whether the box counts or not, pictures count at most one each [`LEARN_SPACING`], and the mean
//! moves by 1/[`MEMORY`] a picture, so that a vehicle that the net misses must stand for hours.
//! Nothing is learned of where boxes lie: boxes that come back at one place are a queue as well.

use super::field::{Cell, Field, Grid};
use super::reference::Reference;
use crate::evidence::PixelBox;
use crate::picture::Light;
use core::time::Duration;

/// Least time between two pictures that are learned from.
pub const LEARN_SPACING: Duration = Duration::from_secs(10);
/// Pictures over which the memory is a mean; from then on it forgets.
pub const MEMORY: u32 = 256;
/// Pictures with which half of what can be known is known.
const HALF_KNOWN: f32 = 12.0;
/// Weight of a lane table's reference, pictures: its points are taken from several.
const REFERENCE_WORTH: u32 = 4;
/// Steps of the memory for one of a field.
const FINE: i32 = 128;
/// Kinds of light that are kept apart.
const LIGHTS: usize = 2;
/// How far beyond a box cells count as covered by it, as a part of its side: shadows, headlights.
const MARGIN: f32 = 0.15;
/// Length (127 for 1) below which a cell of either field is noise rather than an edge.
const NOISE: f32 = 6.0;

/// One cell of the memory: a field's, times `FINE`.
pub type MeanCell = [i16; 2];

/// State of the memory for one light.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Known {
    /// Pictures it was learned from, up to [`MEMORY`]; a lane table's reference counts as some.
    pub seen: u32,
    /// Time since it was last learned; `None`: never.
    pub age: Option<Duration>,
}

/// When it last learned: how old that was already at a time of this run.
#[derive(Clone, Copy, Debug)]
struct Learned {
    at: Duration,
    age_then: Duration,
}

/// The appearance of the road without vehicles. `M` is the memory's buffer.
#[derive(Debug)]
pub struct EmptyRoad<M> {
    grid: Grid,
    cells: M,
    seen: [u32; LIGHTS],
    /// When it last learned, whatever the light.
    latest: Option<Duration>,
    /// When it last learned in each light.
    learned: [Option<Learned>; LIGHTS],
}

impl<M: AsRef<[MeanCell]> + AsMut<[MeanCell]>> EmptyRoad<M> {
    /// Cells that the buffer needs for pictures of that grid: 614 kB for 320x240.
    pub const fn buffer_len(grid: Grid) -> usize {
        LIGHTS * grid.cells()
    }

    /// A road that nothing is known of; `None` where the buffer is shorter than
    /// [`Self::buffer_len`].
    pub fn new(grid: Grid, mut cells: M) -> Option<Self> {
        cells.as_mut().get_mut(..Self::buffer_len(grid))?.fill([0; 2]);
        Some(Self { grid, cells, seen: [0; LIGHTS], latest: None, learned: [None; LIGHTS] })
    }

    /// Begins with the static edges of a lane table.
    pub fn begin_with(&mut self, reference: &Reference) {
        if !reference.fits(self.grid) {
            return;
        }
        let (width, cells) = (self.grid.width, self.grid.cells());
        for half in self.cells.as_mut().chunks_exact_mut(cells.max(1)).take(LIGHTS) {
            for point in &reference.fine {
                let at = usize::from(point.y) * width + usize::from(point.x);
                if let Some(cell) = half.get_mut(at) {
                    *cell = point.edge.map(|v| (i32::from(v) * FINE) as i16);
                }
            }
        }
        self.seen = self.seen.map(|seen| seen.max(REFERENCE_WORTH));
    }

    /// Learns from the field of a picture whose scene is shifted by `shift` cells against the
    /// table; `boxes` may be vehicles, in cells of the grid. Says whether it did.
    pub fn learn(
        &mut self,
        field: &Field<'_>,
        shift: (f32, f32),
        light: Light,
        now: Duration,
        boxes: &[PixelBox],
    ) -> bool {
        let is_soon = self.latest.is_some_and(|at| now.saturating_sub(at) < LEARN_SPACING);
        if is_soon || field.width != self.grid.width || field.height != self.grid.height {
            return false;
        }
        let half = light as usize;
        let Some(seen) = self.seen.get_mut(half) else { return false };
        *seen = (*seen + 1).min(MEMORY);
        let weight = *seen as i32;
        let Grid { width, height, .. } = self.grid;
        let (dx, dy) = (rounded(shift.0), rounded(shift.1));
        let memory = self.cells.as_mut().get_mut(half * width * height..).unwrap_or(&mut []);
        for (y, row) in memory.chunks_exact_mut(width.max(1)).take(height).enumerate() {
            let v = y as i32 + dy;
            let mut free = 0;
            while free < width {
                let (covered, end) = covered(boxes, (free as i32 + dx) as f32, v as f32);
                if covered {
                    let next = (end as i32).saturating_sub(dx).max(free as i32 + 1);
                    free = (next as usize).min(width);
                    continue;
                }
                let until =
                    ((end as i32).saturating_sub(dx).max(free as i32 + 1) as usize).min(width);
                let cells = row.get_mut(free..until).unwrap_or(&mut []);
                for (x, mean) in (free..).zip(cells) {
                    let [c, s] = field.at(x as i32 + dx, v);
                    for (mean, new) in mean.iter_mut().zip([c, s]) {
                        let step = i32::from(new) * FINE - i32::from(*mean);
                        *mean = (i32::from(*mean) + step / weight) as i16;
                    }
                }
                free = until;
            }
        }
        self.latest = Some(now);
        if let Some(learned) = self.learned.get_mut(half) {
            *learned = Some(Learned { at: now, age_then: Duration::ZERO });
        }
        true
    }

    /// Goes on with what an earlier run has learned of this camera's road: what it knew of each
    /// light by day and by night, and all [`Self::cells`]. False, and nothing is changed, where there
    /// are too few or too many.
    pub fn resume(&mut self, known: [Known; LIGHTS], cells: &[MeanCell], now: Duration) -> bool {
        let len = Self::buffer_len(self.grid);
        let Some(memory) = self.cells.as_mut().get_mut(..len).filter(|_| cells.len() == len) else {
            return false;
        };
        memory.copy_from_slice(cells);
        self.seen = known.map(|of| of.seen.min(MEMORY));
        self.learned = known.map(|of| of.age.map(|age_then| Learned { at: now, age_then }));
        true
    }
}

impl<M: AsRef<[MeanCell]>> EmptyRoad<M> {
    /// How much a box of a picture, in cells of the grid, looks like the empty road in that
    /// light: 0 for nothing in common or nothing known, 1 for the road itself.
    pub fn likeness(
        &self,
        field: &Field<'_>,
        shift: (f32, f32),
        light: Light,
        bounds: &PixelBox,
    ) -> f32 {
        let half = light as usize;
        let seen = self.seen.get(half).copied().unwrap_or(0) as f32;
        let Grid { width, height, .. } = self.grid;
        let memory = self.cells.as_ref().get(half * width * height..).unwrap_or(&[]);
        let (dx, dy) = (rounded(shift.0), rounded(shift.1));
        let mean = |x: i32, y: i32| -> [f32; 2] {
            let inside = (x as u32) < width as u32 && (y as u32) < height as u32;
            let at = if inside { y as usize * width + x as usize } else { usize::MAX };
            memory.get(at).map_or([0.0; 2], |cell| cell.map(|v| f32::from(v) / FINE as f32))
        };
        let (x0, y0) = (bounds.x0.max(0.0) as i32, bounds.y0.max(0.0) as i32);
        let (x1, y1) = (
            libm::ceilf(bounds.x1.min(width as f32)) as i32,
            libm::ceilf(bounds.y1.min(height as f32)) as i32,
        );
        let (mut both, mut here, mut there, mut count) = (0.0f32, 0.0f32, 0.0f32, 0.0f32);
        for y in y0..y1 {
            for x in x0..x1 {
                let [c, s]: Cell = field.at(x, y);
                let (c, s) = (f32::from(c), f32::from(s));
                let [mc, ms] = mean(x - dx, y - dy);
                both += c * mc + s * ms;
                here += c * c + s * s;
                there += mc * mc + ms * ms;
                count += 1.0;
            }
        }
        let noise = NOISE * NOISE * count;
        let likeness = both / libm::sqrtf((here + noise) * (there + noise)).max(1.0);
        likeness.clamp(0.0, 1.0) * seen / (seen + HALF_KNOWN)
    }

    /// Time since it last learned in that light; `None`: never.
    pub fn age(&self, light: Light, now: Duration) -> Option<Duration> {
        let Learned { at, age_then } = self.learned.get(light as usize).copied().flatten()?;
        Some(age_then.saturating_add(now.saturating_sub(at)))
    }

    /// The memory's state by day and by night, for [`Self::resume`].
    pub fn known(&self, now: Duration) -> [Known; LIGHTS] {
        [Light::Day, Light::Night]
            .map(|light| Known { seen: self.seen(light), age: self.age(light, now) })
    }

    /// The grid of its pictures.
    pub const fn grid(&self) -> Grid {
        self.grid
    }

    /// The memory, by day and then by night.
    pub fn cells(&self) -> &[MeanCell] {
        self.cells.as_ref().get(..LIGHTS * self.grid.cells()).unwrap_or(&[])
    }

    /// Pictures it has learned from in that light, up to [`MEMORY`].
    pub fn seen(&self, light: Light) -> u32 {
        self.seen.get(light as usize).copied().unwrap_or(0)
    }
}

/// Whether a cell is covered by a box, and the column up to which that stays so.
fn covered(boxes: &[PixelBox], u: f32, v: f32) -> (bool, f32) {
    let mut free_until = f32::from(u16::MAX);
    let mut end: Option<f32> = None;
    for bounds in boxes {
        let (beside, above) =
            (MARGIN * (bounds.x1 - bounds.x0) + 1.0, MARGIN * (bounds.y1 - bounds.y0) + 1.0);
        if v < bounds.y0 - above || v > bounds.y1 + above || u > bounds.x1 + beside {
            continue;
        }
        if u >= bounds.x0 - beside {
            let to = bounds.x1 + beside + 1.0;
            end = Some(end.map_or(to, |end| end.max(to)));
        } else {
            free_until = free_until.min(libm::ceilf(bounds.x0 - beside));
        }
    }
    end.map_or((false, free_until), |end| (true, end))
}

fn rounded(x: f32) -> i32 {
    libm::roundf(x) as i32
}

#[cfg(test)]
mod tests;
