//! A measured picture as the page shows it: boxes in their lanes, counts, and how the camera is.
//!
//! Owns the values that are sent to the page and their names. Counts as the line does: what it
//! shows is what the line has found and where the lane table puts it.

use crate::daemon::line::Line;
use crate::daemon::presets::Preset;
use crate::lane::Place;
use crate::picture::Light;
use crate::units::{Direction, ImagePoint, ImageSize};
use serde::Serialize;

/// The view now.
#[derive(Clone, Debug, Serialize)]
pub struct Seen {
    /// Columns and rows of the picture, px.
    size: [u16; 2],
    /// Its boxes.
    boxes: Vec<Boxed>,
    /// Lane by lane.
    lanes: Vec<InLane>,
    /// Whether the camera stands where the lanes were drawn.
    aim: &'static str,
    /// How far the scene stands off its place, px.
    shift_px: [f32; 2],
    /// `day` or `night`; nothing where pictures are not judged.
    light: Option<&'static str>,
    /// Time since the empty road was last learned, s.
    road_age_s: Option<u64>,
}

/// A vehicle.
#[derive(Clone, Debug, Serialize)]
struct Boxed {
    /// x0, y0, x1, y1, px.
    corners: [f32; 4],
    score: f32,
    class: &'static str,
    /// Number of its lane; nothing beside all lanes.
    lane: Option<u8>,
    /// Distance along its lane, m.
    s_m: Option<f32>,
    /// Where it meets the road, px.
    contact: Option<[f32; 2]>,
}

/// A lane.
#[derive(Clone, Debug, Serialize)]
struct InLane {
    lane: u8,
    direction: &'static str,
    length_m: f32,
    /// Vehicles in it now.
    vehicles: u32,
    /// The mean of all pictures since the view was opened.
    mean: f32,
}

/// Counts since the view was opened.
#[derive(Clone, Debug, Default)]
pub struct Totals {
    pictures: u32,
    by_lane: Vec<u32>,
}

impl Seen {
    /// The view of `line`'s latest picture, of this size.
    pub fn of(line: &Line, (width, height): (usize, usize), totals: &mut Totals) -> Self {
        let side = |px: usize| u16::try_from(px).unwrap_or(u16::MAX);
        let size = ImageSize { width: side(width), height: side(height) };
        let preset = line.preset();
        let boxes: Vec<Boxed> = line
            .found()
            .iter()
            .map(|found| {
                let contact = preset.contact(&found.bounds, size);
                let place = contact.and_then(|at| preset.place_at(at, size));
                let bounds = &found.bounds;
                Boxed {
                    corners: [bounds.x0, bounds.y0, bounds.x1, bounds.y1],
                    score: found.score,
                    class: found.class.name(),
                    lane: place.map(|place| place.lane.get()),
                    s_m: place.map(|place| place.s_m),
                    contact: contact.map(|at| [at.u, at.v]),
                }
            })
            .collect();
        let lanes = &preset.table().lanes;
        totals.pictures += 1;
        totals.by_lane.resize(lanes.len(), 0);
        let lanes = lanes.iter().zip(&mut totals.by_lane).map(|(lane, total)| {
            let number = lane.id.get();
            let vehicles = boxes.iter().filter(|b| b.lane == Some(number)).count() as u32;
            *total += vehicles;
            InLane {
                lane: number,
                direction: match lane.direction {
                    Direction::Toward => "toward",
                    Direction::Away => "away",
                    Direction::Unknown => "",
                },
                length_m: lane.length_m,
                vehicles,
                mean: *total as f32 / totals.pictures as f32,
            }
        });
        let lanes = lanes.collect();
        let (scene, shift) = (line.scene(), preset.shift());
        Self {
            size: [size.width, size.height],
            boxes,
            lanes,
            aim: scene.map_or("not checked", |scene| scene.aiming().name()),
            shift_px: [shift.u, shift.v],
            light: scene.map(|scene| match scene.light() {
                Light::Day => "day",
                Light::Night => "night",
            }),
            road_age_s: scene.and_then(|scene| scene.road_age()).map(|age| age.as_secs()),
        }
    }
}

/// Where the lanes of a table lie in a picture.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Outlines {
    /// Pixels of a row that lie in a lane: lane, row, first and last column, and the distances of these
    /// two from the lane's upstream end, dm.
    runs: Vec<[u16; 6]>,
    /// Pixels at the sections where vehicles are counted: lane, column, row.
    sections: Vec<[u16; 3]>,
}

impl Outlines {
    /// As the table has them; runs of every `step`-th row.
    pub fn of(preset: &Preset, (width, height): (usize, usize), step: u16) -> Self {
        let side = |px: usize| u16::try_from(px).unwrap_or(u16::MAX);
        let size = ImageSize { width: side(width), height: side(height) };
        let mut all = Self::default();
        let mut above: Vec<Option<Place>> = vec![None; width];
        for v in 0..size.height {
            let mut left = None;
            for (u, above) in (0..size.width).zip(&mut above) {
                let at = ImagePoint { u: f32::from(u) + 0.5, v: f32::from(v) + 0.5 };
                let place = preset.place_at(at, size);
                if let Some(place) = place {
                    if v % step.max(1) == 0 {
                        all.add(place, u, v);
                    }
                    let besides = [left, *above].into_iter().flatten();
                    if besides.into_iter().any(|beside| preset.is_section_between([place, beside]))
                    {
                        all.sections.push([place.lane.get().into(), u, v]);
                    }
                }
                (left, *above) = (place, place);
            }
        }
        all
    }

    /// The next pixel of a row.
    fn add(&mut self, place: Place, u: u16, v: u16) {
        let (lane, s_dm) = (u16::from(place.lane.get()), (place.s_m * 10.0) as u16);
        match self.runs.last_mut() {
            Some(last) if last[..2] == [lane, v] && last[3] + 1 == u => {
                (last[3], last[5]) = (u, s_dm);
            }
            _ => self.runs.push([lane, v, u, u, s_dm, s_dm]),
        }
    }
}
