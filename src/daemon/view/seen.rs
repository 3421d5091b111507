//! A measured picture as the page shows it: boxes in their lanes, counts, and how the camera is.
//!
//! Owns the values that are sent to the page and their names. Counts as the line does: what it
//! shows is what the line has found and where the lane table puts it.

use crate::daemon::line::Line;
use crate::daemon::presets::Preset;
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

/// Runs of pixels that lie in a lane, as the table has it: lane, row, first and last column; every
/// `step`-th row.
pub fn outlines(preset: &Preset, (width, height): (usize, usize), step: usize) -> Vec<[u16; 4]> {
    let side = |px: usize| u16::try_from(px).unwrap_or(u16::MAX);
    let size = ImageSize { width: side(width), height: side(height) };
    let mut runs: Vec<[u16; 4]> = Vec::new();
    for v in (0..size.height).step_by(step.max(1)) {
        for u in 0..size.width {
            let at = ImagePoint { u: f32::from(u) + 0.5, v: f32::from(v) + 0.5 };
            let Some(place) = preset.place_at(at, size) else { continue };
            let lane = u16::from(place.lane.get());
            match runs.last_mut() {
                Some(last) if last[0] == lane && last[1] == v && last[3] + 1 == u => last[3] = u,
                _ => runs.push([lane, v, u, u]),
            }
        }
    }
    runs
}
