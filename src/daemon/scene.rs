//! Look: the stage between capture and detect. Is the picture fit to be measured, and does
//! the camera look where it was calibrated?
//!
//! Owns the buffers and the order of the questions; the answers are the core's
//! ([`crate::picture`], [`crate::scene`]). After the first picture nothing is allocated.

use super::frame::{Detection, Picture, PixelBox};
use super::offset::Offset;
use super::road_file::Road;
use crate::alarm::Alarm;
use crate::picture::{Before, Light, Look};
use crate::scene::{
    Aim, Cell, EmptyRoad, Eye, Grid, Guard, Judgement, MeanCell, Reference, search_wide,
};
use crate::units::{ImagePoint, UtcMs};
use std::time::Duration;

/// The verdict on a picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum View {
    /// It is measured with the table of this preset, shifted by so many of its pixels.
    Fit {
        /// Number of the preset.
        preset: usize,
        /// Shift of the scene against the table, px of the picture.
        shift: ImagePoint,
    },
    /// It shows nothing new but a clock.
    Unchanged,
    /// It is not measured, for this reason.
    Withheld(Alarm),
    /// It is not measured: the scene stands elsewhere in this one, which is not yet a move.
    PassedOver,
}

impl View {
    /// The first preset, not shifted.
    pub const NOWHERE: (usize, ImagePoint) = (0, ImagePoint { u: 0.0, v: 0.0 });
    /// A picture that nobody judges.
    pub const UNJUDGED: Self = Self::Fit { preset: Self::NOWHERE.0, shift: Self::NOWHERE.1 };
}

/// The camera's aim, as far as it is known.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Aiming {
    /// No table has a reference: it is not checked.
    Unchecked,
    /// Not seen yet: taken on trust.
    Unverified,
    /// At the active preset.
    InPlace,
    /// Moved.
    Moved,
}

impl Aiming {
    /// Its name in messages.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Unchecked => "unchecked",
            Self::Unverified => "unverified",
            Self::InPlace => "in_place",
            Self::Moved => "moved",
        }
    }
}

/// Buffers for pictures of one size.
#[derive(Debug)]
struct Buffers {
    size: (usize, usize),
    eye: Eye<Vec<u8>, Vec<Cell>>,
    before: Before<Vec<u8>>,
    /// The road of a preset without vehicles.
    road: EmptyRoad<Vec<MeanCell>>,
    road_of: Option<usize>,
    /// Vehicles that stand on it, in cells of the grid.
    standing: Vec<PixelBox>,
}

impl Buffers {
    fn new(width: usize, height: usize) -> Self {
        let grid = Grid::of(width, height);
        let len = grid.buffer_len();
        let eye = Eye::new(grid, vec![0; len], vec![[0; 2]; len]);
        Self {
            size: (width, height),
            eye: eye.expect("buffers of the length that the grid asks for"),
            before: Before::new(vec![0; grid.cells()]),
            road: empty_road(grid),
            road_of: None,
            standing: Vec::with_capacity(MAX_STANDING),
        }
    }
}

fn empty_road(grid: Grid) -> EmptyRoad<Vec<MeanCell>> {
    let len = EmptyRoad::<Vec<MeanCell>>::buffer_len(grid);
    let road = EmptyRoad::new(grid, vec![[0; 2]; len]);
    road.expect("a buffer of the length that the grid asks for")
}

/// A picture's box in cells of the grid.
fn in_cells(bounds: &PixelBox, grid: Grid) -> PixelBox {
    let cell = grid.cell_px();
    let PixelBox { x0, y0, x1, y1 } = *bounds;
    PixelBox { x0: x0 / cell, y0: y0 / cell, x1: x1 / cell, y1: y1 / cell }
}

/// Vehicles of a picture under which the road is not learned, at most; no camera shows more.
const MAX_STANDING: usize = 256;
/// Probability from which a vehicle covers the road. A mark that is taken for one now and then is
/// less sure, and is learned.
const COVERS: f32 = 0.7;

/// Shortest time between two pictures that are compared, to tell one that has not changed.
const COMPARED: Duration = Duration::from_secs(1);

/// Judges pictures.
#[derive(Debug)]
pub struct Scene {
    /// One a preset, or none where the camera's aim is not checked.
    references: Vec<Reference>,
    guard: Box<Guard>,
    buffers: Option<Buffers>,
    begun: Option<UtcMs>,
    clock: Duration,
    latest: Option<Look>,
    shift: Option<ImagePoint>,
    /// The road of a preset as an earlier run has learned it, until that preset is seen.
    earlier: Option<(usize, Road)>,
    /// When a picture was last compared with one before it, and whether it repeated it.
    compared: Option<Duration>,
    repeats: bool,
}

impl Scene {
    /// A judge for a camera with these presets, each with the reference of its table.
    pub fn new(references: Vec<Option<Reference>>) -> Self {
        let references: Option<Vec<_>> = references.into_iter().collect();
        let references = references.unwrap_or_default();
        Self {
            guard: Box::new(Guard::new(references.len())),
            references,
            buffers: None,
            begun: None,
            clock: Duration::ZERO,
            latest: None,
            shift: None,
            earlier: None,
            compared: None,
            repeats: false,
        }
    }

    /// Judges a picture taken at `time`.
    pub fn judge(&mut self, picture: &Picture, time: UtcMs) -> View {
        let size = (picture.width, picture.height);
        let mut buffers = match self.buffers.take() {
            Some(buffers) if buffers.size == size => buffers,
            _ => Buffers::new(picture.width, picture.height),
        };
        let view = self.judge_with(&mut buffers, picture, time);
        self.buffers = Some(buffers);
        view
    }

    fn judge_with(&mut self, buffers: &mut Buffers, picture: &Picture, time: UtcMs) -> View {
        let Buffers { eye, before, .. } = buffers;
        eye.look(&picture.rgb);
        let now = self.since_start(time);
        let grid = eye.grid();
        let look = Look::at(eye.luma(), grid.width);
        self.latest = Some(look);
        self.shift = None;
        if let Some(flaw) = look.flaw() {
            return View::Withheld(flaw.into());
        }
        // In a fifth of a second a quiet street changes less than a frozen picture's noise.
        let is_due = |at: Duration| now.saturating_sub(at) >= COMPARED;
        if self.repeats || self.compared.is_none_or(is_due) {
            self.compared = Some(now);
            self.repeats = before.repeats(eye.luma(), grid.width);
            if self.repeats {
                return View::Unchanged;
            }
        }
        if !self.is_checked(grid) {
            return View::UNJUDGED;
        }
        let was = self.guard.aim();
        let Judgement { aim, shift } = self.guard.judge(&self.references, eye, now);
        if was != aim {
            say(was, aim, offset(&self.references, eye));
        }
        let px = grid.cell_px();
        self.shift = shift.map(|(dx, dy)| ImagePoint { u: dx * px, v: dy * px });
        match (aim, self.shift) {
            (Aim::Preset(preset), Some(shift)) => View::Fit { preset, shift },
            (Aim::Unknown, Some(shift)) => View::Fit { preset: 0, shift },
            (Aim::Moved, _) => View::Withheld(Alarm::CameraMoved),
            _ => View::PassedOver,
        }
    }

    /// The light of the latest picture.
    pub fn light(&self) -> Light {
        self.latest.map_or(Light::Day, |look| Light::of_mean(look.mean))
    }

    /// How much a box of the latest picture looks like the empty road, 0 to 1.
    pub fn likeness(&self, bounds: &PixelBox) -> f32 {
        let Some(buffers) = &self.buffers else { return 0.0 };
        let grid = buffers.eye.grid();
        let bounds = in_cells(bounds, grid);
        buffers.road.likeness(&buffers.eye.fine(), self.cells(grid), self.light(), &bounds)
    }

    /// When the camera looks at `preset`, its road is what an earlier run has learned.
    pub fn remember(&mut self, preset: usize, road: Road) {
        self.earlier = Some((preset, road));
    }

    /// The latest picture is one of `preset`: takes up what an earlier run has learned of its road.
    pub fn recall(&mut self, preset: usize) {
        let (Some(buffers), Some((of, _))) = (&mut self.buffers, &self.earlier) else { return };
        if *of != preset || buffers.road_of.is_some() {
            return;
        }
        let Some((_, Road { grid, known, cells, .. })) = self.earlier.take() else { return };
        let is = buffers.road.grid();
        if grid == [is.width, is.height] && buffers.road.resume(known, &cells, self.clock) {
            buffers.road_of = Some(preset);
        } else {
            log::info!("the empty road is learned again: pictures have another shape than before");
        }
    }

    /// The learned road, its preset, and the time for [`EmptyRoad::known`]; `None` before any was
    /// learned.
    pub fn road(&self) -> Option<(usize, &EmptyRoad<Vec<MeanCell>>, Duration)> {
        let buffers = self.buffers.as_ref()?;
        Some((buffers.road_of?, &buffers.road, self.clock))
    }

    /// Shows the road of `preset` in the latest picture, in which these vehicles stand.
    pub fn learn(&mut self, preset: usize, vehicles: &[Detection]) {
        let Some(mut buffers) = self.buffers.take() else { return };
        let grid = buffers.eye.grid();
        if buffers.road_of != Some(preset) {
            if buffers.road_of.is_some() {
                buffers.road = empty_road(grid);
            }
            buffers.road_of = Some(preset);
            if let Some(reference) = self.references.get(preset) {
                buffers.road.begin_with(reference);
            }
        }
        let sure = vehicles.iter().filter(|vehicle| vehicle.score >= COVERS).take(MAX_STANDING);
        buffers.standing.clear();
        buffers.standing.extend(sure.map(|vehicle| in_cells(&vehicle.bounds, grid)));
        let (shift, light, now) = (self.cells(grid), self.light(), self.clock);
        buffers.road.learn(&buffers.eye.fine(), shift, light, now, &buffers.standing);
        self.buffers = Some(buffers);
    }

    /// Time since the road was last learned in the light of the latest picture; `None` before.
    pub fn road_age(&self) -> Option<Duration> {
        let road = &self.buffers.as_ref()?.road;
        road.age(self.light(), self.clock)
    }

    /// The latest picture's shift in cells.
    fn cells(&self, grid: Grid) -> (f32, f32) {
        let px = grid.cell_px();
        self.shift.map_or((0.0, 0.0), |shift| (shift.u / px, shift.v / px))
    }

    /// Whether a table has a reference by which the aim is checked.
    pub fn is_aimed(&self) -> bool {
        self.aiming() != Aiming::Unchecked
    }

    /// The camera's aim, as far as it is known.
    pub fn aiming(&self) -> Aiming {
        let grid = self.buffers.as_ref().map(|buffers| buffers.eye.grid());
        if !grid.map_or(!self.references.is_empty(), |grid| self.is_checked(grid)) {
            return Aiming::Unchecked;
        }
        match self.guard.aim() {
            Aim::Unknown => Aiming::Unverified,
            Aim::Preset(_) => Aiming::InPlace,
            Aim::Moved => Aiming::Moved,
        }
    }

    /// Features of the latest picture.
    pub fn latest(&self) -> Option<Look> {
        self.latest
    }

    /// By how much the latest picture is shifted, px; `None` where it was not measured.
    pub fn shift(&self) -> Option<ImagePoint> {
        self.shift
    }

    /// How far the latest picture stands off the place where the camera was calibrated, searched
    /// for within half of the picture; `None` where the calibrated scene is not in it.
    pub fn offset(&self) -> Option<Offset> {
        let eye = &self.buffers.as_ref()?.eye;
        if self.is_checked(eye.grid()) { offset(&self.references, eye) } else { None }
    }

    /// Whether every preset can be looked for in pictures of this grid.
    fn is_checked(&self, grid: Grid) -> bool {
        !self.references.is_empty() && self.references.iter().all(|r| r.fits(grid))
    }

    /// Time since the first picture; a clock that is set back stands still.
    fn since_start(&mut self, time: UtcMs) -> Duration {
        let begun = *self.begun.get_or_insert(time);
        let since = time.saturating_since(begun);
        if since < self.clock {
            // Set back: time goes on from here.
            self.begun = Some(UtcMs(time.0.saturating_sub(self.clock.as_millis() as i64)));
            return self.clock;
        }
        self.clock = since;
        since
    }
}

/// How far the reference that fits best stands off its place; `None` where none is found.
fn offset(references: &[Reference], eye: &Eye<Vec<u8>, Vec<Cell>>) -> Option<Offset> {
    let sightings = references.iter().map(|reference| search_wide(reference, eye));
    let best = sightings.max_by(|a, b| a.significance.total_cmp(&b.significance))?;
    best.is_sure().then(|| Offset::of(best.pose, eye.grid()))
}

fn say(was: Aim, is: Aim, offset: Option<Offset>) {
    match is {
        Aim::Preset(preset) if was != Aim::Unknown => {
            log::info!("the camera looks at preset {} again", preset + 1);
        }
        Aim::Preset(preset) => log::info!("the camera looks at preset {}", preset + 1),
        Aim::Moved => log::warn!(
            "the camera has moved: no density until it is back. {}",
            Offset::words(offset.as_ref())
        ),
        Aim::Unknown => {}
    }
}
