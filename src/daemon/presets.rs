//! The lane tables of the camera's presets: from boxes in a picture to counts by lane.
//!
//! Owns the tables of one camera and the count of its latest picture. Windows over these counts
//! are the core's [`crate::sensor`].

use super::exit::Failure;
use super::frame::{Detection, PixelBox};
use super::locate::{Anchor, LocateError, Located, Locator};
use crate::density::{AggregateError, Errors, FrameCounts, Start};
use crate::evidence::CarSize;
use crate::hidden::{Queues, Seen};
use crate::lane::{Description, Lane, Place};
use crate::picture::Light;
use crate::scene::Reference;
use crate::sensor;
use crate::track::{LaneMoves, Sighting, Tracker, rate};
use crate::units::{ImagePoint, ImageSize, LaneId, UtcMs};
use std::path::{Path, PathBuf};
use std::time::Duration;

/// The lane tables, and how they are looked up.
#[derive(Clone, Debug)]
pub struct TableSettings {
    /// One lane table for each preset of the camera, at least one.
    pub files: Vec<PathBuf>,
    /// The camera that they must belong to; `None`: whichever they belong to.
    pub camera: Option<String>,
    /// Point of a box that is looked up.
    pub anchor: Anchor,
}

impl TableSettings {
    /// One table, of whichever camera.
    pub fn of(file: &Path) -> Self {
        Self { files: vec![file.to_owned()], camera: None, anchor: Anchor::default() }
    }
}

/// The windows over which density is taken.
#[derive(Clone, Debug)]
pub struct WindowSettings {
    /// Their lengths.
    pub lengths: Vec<Duration>,
    /// Share of its frames that a window needs.
    pub min_completeness: f32,
    /// Treatment of a window that is running at the start.
    pub start: Start,
}

impl WindowSettings {
    /// For a recording: every frame counts.
    pub fn recorded(length: Duration) -> Self {
        Self { lengths: vec![length], min_completeness: 0.0, start: Start::WithFirstFrame }
    }
}

/// Whether vehicles are followed, which flow and speed need.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Following {
    /// Not asked for.
    #[default]
    Off,
    /// Vehicles are followed.
    On {
        /// Time between two pictures.
        interval: Duration,
        /// The longest with which they can be.
        longest: Duration,
    },
    /// Pictures come too seldom.
    TooSeldom {
        /// Time between two pictures.
        interval: Duration,
        /// The longest with which they could be.
        longest: Duration,
    },
    /// A lane is so short that no camera gives enough pictures of a fast vehicle.
    TooShort {
        /// Highest speed, km/h.
        top_kmh: f32,
    },
}

impl std::fmt::Display for Following {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        // Milliseconds tell 5 pictures a second from 4.9.
        let s = |time: &Duration| (time.as_secs_f64() * 1000.0).round() / 1000.0;
        match self {
            Self::Off => write!(f, "density alone, as configured (traffic.enabled)"),
            Self::On { interval, longest } => write!(
                f,
                "flow and speed too: a picture each {} s, these lanes need one each {} s",
                s(interval),
                s(longest)
            ),
            Self::TooSeldom { interval, longest } => write!(
                f,
                "density alone: a picture comes each {} s, flow and speed on these lanes need one \
                 each {} s (camera.interval_s, traffic.top_speed_kmh)",
                s(interval),
                s(longest)
            ),
            Self::TooShort { top_kmh } => write!(
                f,
                "density alone: a lane is too short to follow vehicles of {top_kmh} km/h; paint \
                 longer lanes, or lower traffic.top_speed_kmh"
            ),
        }
    }
}

/// Road before and behind a section that tells how steeply it is seen, m.
const ABOUT_SECTION_M: f32 = 8.0;

/// One lane table and the count of its latest picture.
#[derive(Debug)]
pub struct Preset {
    locator: Locator,
    located: Vec<Located>,
    none: FrameCounts,
    counts: FrameCounts,
    /// How far the scene of its latest picture stands off its place, px of the picture.
    shift: ImagePoint,
    /// Estimates what vehicles of a queue hide, where the size of cars is known.
    queues: Option<Queues>,
    seen: Vec<Seen>,
    /// Follows the vehicles on the lanes, where pictures come often enough.
    tracker: Option<Tracker>,
    moves: Option<LaneMoves>,
}

impl Preset {
    /// The lane table's metadata.
    pub fn table(&self) -> &Description {
        self.locator.description()
    }

    /// SHA-256 of its table's file.
    pub fn sha256(&self) -> [u8; 32] {
        self.locator.sha256()
    }

    /// The lane table's file.
    pub fn file(&self) -> &Path {
        self.locator.file()
    }

    /// Where a point of the table's picture lies on the road.
    pub fn place(&self, point: ImagePoint) -> Option<Place> {
        self.locator.place(point)
    }

    /// Counts the vehicles of a lane at that place, where they are followed.
    fn count_at(&mut self, lane: LaneId, section_m: f32) {
        let about_m = [section_m - ABOUT_SECTION_M, section_m + ABOUT_SECTION_M];
        let foreshortening = self.locator.foreshortening(lane, about_m);
        if let Some(tracker) = &mut self.tracker {
            // The caller knows that the lane has the place.
            let _ = tracker.set_section(lane, section_m, foreshortening);
        }
    }

    /// Whether the section of a lane, where its vehicles are followed, lies between these two places.
    pub fn is_section_between(&self, [a, b]: [Place; 2]) -> bool {
        let section = self.tracker.as_ref().and_then(|tracker| tracker.section_m(a.lane));
        a.lane == b.lane && section.is_some_and(|m| (a.s_m < m) != (b.s_m < m))
    }

    /// The point that stands for the vehicle in a box, px of the picture; `None` where it lies
    /// outside.
    pub fn contact(&self, bounds: &PixelBox, picture: ImageSize) -> Option<ImagePoint> {
        self.locator.contact(bounds, picture)
    }

    /// Where a point of its latest picture, of that size, lies on the road.
    pub fn place_at(&self, point: ImagePoint, picture: ImageSize) -> Option<Place> {
        self.locator.place_at(point, picture, self.shift)
    }

    /// How far the scene of its latest picture stands to the right of and below its place in the
    /// table, px of the picture.
    pub fn shift(&self) -> ImagePoint {
        self.shift
    }

    /// How many vehicles of its latest picture are in the lanes.
    pub fn located(&self) -> usize {
        self.located.len()
    }
}

/// The presets of a camera.
#[derive(Debug)]
pub struct Presets {
    presets: Vec<Preset>,
    /// The one at which the camera looked in the picture that was counted last.
    active: usize,
}

impl Presets {
    /// Loads the tables.
    ///
    /// # Errors
    /// [`LocateError`] names the file that is missing or wrong.
    pub fn load(settings: &TableSettings) -> Result<Self, LocateError> {
        let load = |file: &PathBuf| {
            let locator = Locator::load(file, settings.camera.as_deref(), settings.anchor)?;
            let table = locator.description();
            let none = FrameCounts::new(&table.lanes, table.cell_length_m);
            Ok(Preset {
                counts: none.clone(),
                none,
                locator,
                located: Vec::new(),
                shift: ImagePoint { u: 0.0, v: 0.0 },
                queues: None,
                seen: Vec::new(),
                tracker: None,
                moves: None,
            })
        };
        let presets = settings.files.iter().map(load).collect::<Result<_, _>>()?;
        Ok(Self { presets, active: 0 })
    }

    /// Windows over the lanes of each table, for a camera with this time between frames.
    ///
    /// # Errors
    /// [`Failure::Aggregate`] where they cannot be kept or never filled.
    pub fn windows(
        &self,
        settings: &WindowSettings,
        interval: Duration,
        errors: &Errors,
    ) -> Result<Vec<sensor::Preset>, Failure> {
        let WindowSettings { lengths, min_completeness, start } = settings;
        let of = |preset: &Preset| {
            let table = preset.table();
            let mut windows =
                sensor::Preset::new(table, lengths, interval, *min_completeness, *start)?;
            if let Some(tracker) = &preset.tracker {
                windows.follow(lengths, tracker.longest_interval(), *min_completeness);
            }
            windows.set_errors(preset.locator.length_rel_errs(), errors.clone());
            Ok::<_, AggregateError>(windows)
        };
        Ok(self.presets.iter().map(of).collect::<Result<_, _>>()?)
    }

    /// From now on the vehicles of each table are followed, with a picture each `interval`, where
    /// that suffices for all of them. To be called before [`Self::windows`].
    pub fn follow(&mut self, top_kmh: f32, interval: Duration) -> Following {
        let tracker = |preset: &Preset| Tracker::new(&preset.table().lanes, top_kmh);
        let trackers: Option<Vec<Tracker>> = self.presets.iter().map(tracker).collect();
        let Some(trackers) = trackers else { return Following::TooShort { top_kmh } };
        let longest = trackers.iter().map(Tracker::longest_interval).min().unwrap_or_default();
        if interval > longest {
            return Following::TooSeldom { interval, longest };
        }
        for (preset, tracker) in self.presets.iter_mut().zip(trackers) {
            preset.tracker = Some(tracker);
            for lane in preset.table().lanes.clone() {
                preset.count_at(lane.id, lane.length_m / 2.0);
            }
        }
        Following::On { interval, longest }
    }

    /// From now on vehicles that others hide in a queue are estimated; `cars` are the sizes of cars in
    /// each table's pictures.
    pub fn estimate_hidden(&mut self, cars: &[Option<CarSize>]) {
        for (preset, car) in self.presets.iter_mut().zip(cars) {
            let queues = |car| Queues::new(preset.table(), |point| preset.place(point), car);
            preset.queues = car.map(queues);
        }
    }

    /// From now on the vehicles of that lane are counted so far from its upstream end, m, in every
    /// table that has the lane, where they are followed.
    ///
    /// # Errors
    /// Says that no table has it, or how long it is where the place is not on it.
    pub fn set_section(&mut self, id: LaneId, section_m: f32) -> Result<(), String> {
        let mut is_known = false;
        for preset in &mut self.presets {
            let lane = preset.table().lanes.iter().find(|lane| lane.id == id).cloned();
            let Some(Lane { length_m, .. }) = lane else { continue };
            if !(section_m > 0.0 && section_m < length_m) {
                return Err(format!(
                    "lane {} has {length_m:.0} m from its upstream end, and no place {section_m} m from it",
                    id.get()
                ));
            }
            is_known = true;
            preset.count_at(id, section_m);
        }
        let none = || format!("no lane table has a lane {}", id.get());
        is_known.then_some(()).ok_or_else(none)
    }

    /// The longest time between two pictures with which vehicles of up to `top_kmh` are followed on
    /// each lane, in words.
    pub fn needs(&self, top_kmh: f32) -> String {
        let lanes = self.presets.iter().flat_map(|preset| &preset.table().lanes);
        let need = |lane: &Lane| {
            let longest = rate::longest_interval(std::slice::from_ref(lane), top_kmh);
            let longest = longest.map_or("more than any camera gives".to_owned(), |longest| {
                format!("one each {:.2} s", longest.as_secs_f32())
            });
            format!("lane {} of {:.0} m {longest}", lane.id.get(), lane.length_m)
        };
        lanes.map(need).collect::<Vec<_>>().join(", ")
    }

    /// The reference of each preset's table.
    ///
    /// # Errors
    /// [`LocateError`] for a wrong one, and for a missing one where there are several presets:
    /// they could not be told apart.
    pub fn references(&self) -> Result<Vec<Option<Reference>>, LocateError> {
        let several = self.presets.len() > 1;
        self.presets.iter().map(|preset| preset.locator.scene(several)).collect()
    }

    /// Each of them.
    pub fn iter(&self) -> impl Iterator<Item = &Preset> {
        self.presets.iter()
    }

    /// The one at which the camera looks.
    pub fn active(&self) -> &Preset {
        &self.presets[self.active]
    }

    /// Checks that a picture of this size belongs to the active table.
    ///
    /// # Errors
    /// [`LocateError::Shape`].
    pub fn check_size(&self, (width, height): (usize, usize)) -> Result<(), LocateError> {
        self.active().locator.check_size(width, height).map(|_| ())
    }

    /// Counts the vehicles of a picture of that preset, taken at `time`, and follows them. The scene stands `shift` (px of the
    /// picture) to the right of and below its place in the table.
    ///
    /// # Errors
    /// [`LocateError::Shape`] for a picture that does not belong to the table.
    pub fn count(
        &mut self,
        preset: usize,
        detections: &[Detection],
        (time, (width, height)): (UtcMs, (usize, usize)),
        shift: ImagePoint,
        light: Light,
    ) -> Result<(&FrameCounts, Option<&LaneMoves>), LocateError> {
        let size = self.presets[preset].locator.check_size(width, height)?;
        self.active = preset;
        let Preset { locator, located, none, counts, shift: latest, queues, seen, tracker, moves } =
            &mut self.presets[preset];
        *latest = shift;
        locator.locate(detections, size, shift, located);
        counts.clone_from(none);
        counts.set_light(light);
        for vehicle in located {
            let Place { lane, s_m, span_m } = vehicle.place;
            counts.add(lane, s_m, vehicle.class);
            if let Some(tracker) = tracker {
                tracker.see(lane, Sighting { s_m, span_m, class: vehicle.class });
            }
        }
        if let Some(queues) = queues {
            locator.see(detections, size, shift, seen);
            queues.estimate(seen, |lane, s_m| counts.add_hidden(lane, s_m));
        }
        *moves = tracker.as_mut().and_then(|tracker| tracker.observe(time));
        Ok((counts, moves.as_ref()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_section_learns_from_its_table_how_steeply_it_is_seen() {
        let table = TableSettings::of(Path::new("tests/data/curve.lut"));
        let mut presets = Presets::load(&table).expect("it ships");
        let is_on = presets.follow(100.0, Duration::from_millis(80));
        assert!(matches!(is_on, Following::On { .. }), "{is_on}");
        let Lane { id, length_m, .. } = presets.presets[0].table().lanes[0];
        let mut overhang_m = |part: f32| {
            presets.set_section(id, part * length_m).expect("on the lane");
            presets.presets[0].tracker.as_ref().and_then(|t| t.overhang_m(id)).expect("on")
        };
        let [first, last] = [overhang_m(0.15), overhang_m(0.85)];
        // 0.6 m where nothing is known.
        assert!(first < 0.5 && last < 0.5 && (first - last).abs() > 0.03, "{first} m, {last} m");
    }
}
