//! The stretch of each lane on which density is measured, and its polygon in the picture.
//!
//! Owns the rule: a place counts when the scene's longest vehicle, centred there, is whole in
//! the picture, and a 1.45 m high post there is at least `measure.min_car_height_px` high. So
//! no box of a vehicle on the stretch is cut by the picture's edge. Also writes the polygons as
//! labelme JSON. Owns no traffic.

use nalgebra::Point3;
use serde_json::{Value, json};

use crate::camera::Camera;
use crate::error::{Error, Result};
use crate::road::{Direction, LaneLine, Road};
use crate::scene::Scene;
use crate::vehicle::{CAR_MODELS, MODELS, Model};

/// Resolution of the search along a lane, m.
const SEARCH_STEP_M: f64 = 0.5;

/// A stretch shorter than this measures nothing useful, m: three standing cars.
const SHORTEST_M: f64 = 20.0;

/// Roof height of a common car, m.
const CAR_HEIGHT_M: f64 = 1.45;

/// Points of a lane edge in the polygon are this far apart, m.
const POLYGON_STEP_M: f64 = 4.0;

/// The measured stretch of one lane.
#[derive(Debug, Clone)]
pub struct MeasuredLane {
    /// Lane number from 1.
    pub number: usize,
    /// Way of travel.
    pub direction: Direction,
    /// Near end along the lane from the road's start, m.
    pub near_m: f64,
    /// Far end along the lane, m.
    pub far_m: f64,
    /// The section at which passages and time occupancy are taken, likewise, m.
    pub section_m: f64,
    /// The polygon in the picture, px: right edge outwards, left edge back.
    pub polygon: Vec<[f64; 2]>,
}

impl MeasuredLane {
    /// Length along the lane, m.
    pub fn length_m(&self) -> f64 {
        self.far_m - self.near_m
    }

    /// True when a place along the lane (m from the road's start) counts.
    pub fn contains(&self, lane_s_m: f64) -> bool {
        (self.near_m..self.far_m).contains(&lane_s_m)
    }
}

/// Finds the measured stretch of every lane, as the installed camera sees it.
///
/// # Errors
/// [`Error::LaneNotVisible`] with the length found, [`Error::SceneValue`] where a section is not on
/// its stretch.
pub fn measured_lanes(scene: &Scene, road: &Road, lines: &[LaneLine]) -> Result<Vec<MeasuredLane>> {
    let camera = scene.camera();
    let envelope = longest_model(scene);
    let mut found = Vec::new();
    for (index, (spec, line)) in scene.lanes.iter().zip(lines).enumerate() {
        let sees = |s: f64| whole(scene, &camera, road, line, spec.width_m, envelope, s);
        let steps = (line.length_m().min(scene.measure.far_m) / SEARCH_STEP_M) as usize;
        let place = |step: usize| step as f64 * SEARCH_STEP_M;
        let first = (0..=steps).find(|step| sees(place(*step))).unwrap_or(steps);
        let last = (first..=steps).take_while(|step| sees(place(*step))).last().unwrap_or(first);
        let (near_m, far_m) = (place(first), place(last));
        if far_m - near_m < SHORTEST_M {
            return Err(Error::LaneNotVisible {
                scene: scene.name.clone(),
                lane: index + 1,
                visible_m: far_m - near_m,
                required_m: SHORTEST_M,
                envelope_m: envelope.length_m(),
            });
        }
        let half = spec.width_m / 2.0;
        let pieces = ((far_m - near_m) / POLYGON_STEP_M).ceil().max(1.0);
        let edge = |i: f64, aside: f64| {
            let at = line.at(road, near_m + (far_m - near_m) * i / pieces, aside);
            camera.project(&Point3::new(at.x, at.y, 0.0))
        };
        let outwards = (0..=pieces as usize).filter_map(|i| edge(i as f64, half));
        let back = (0..=pieces as usize).rev().filter_map(|i| edge(i as f64, -half));
        let polygon = outwards.chain(back).collect();
        let middle_m = (far_m - near_m) / 2.0;
        let after_m = spec.section_m.unwrap_or(middle_m);
        if !(0.0..=far_m - near_m).contains(&after_m) {
            return Err(Error::SceneValue {
                origin: scene.name.clone(),
                key: format!("lane.{}.section_m", index + 1),
                value: after_m.to_string(),
                expected: format!("a place on its measured stretch of {} m", far_m - near_m),
            });
        }
        let section_m = match spec.direction {
            Direction::Away => near_m + after_m,
            Direction::Toward => far_m - after_m,
        };
        let (number, direction) = (index + 1, spec.direction);
        found.push(MeasuredLane { number, direction, near_m, far_m, section_m, polygon });
    }
    Ok(found)
}

fn longest_model(scene: &Scene) -> &'static Model {
    let mix = &scene.fleet;
    let trailers = mix.truck * mix.trailer_share;
    let shares = [mix.van, mix.bus, mix.truck, mix.motorcycle, trailers];
    let share = |i: usize| if i < CAR_MODELS { mix.car } else { shares[i - CAR_MODELS] };
    MODELS
        .iter()
        .enumerate()
        .filter(|(i, _)| share(*i) > 0.0)
        .map(|(_, model)| model)
        .max_by(|a, b| a.length_m().total_cmp(&b.length_m()))
        .expect("check() asks for one share above 0")
}

fn whole(
    scene: &Scene,
    camera: &Camera,
    road: &Road,
    line: &LaneLine,
    width_m: f64,
    envelope: &Model,
    s: f64,
) -> bool {
    let margin = scene.measure.edge_margin_px;
    let inside = |p: [f64; 2]| {
        p[0] >= margin
            && p[1] >= margin
            && p[0] <= f64::from(camera.width) - margin
            && p[1] <= f64::from(camera.height) - margin
    };
    let sees = |along: f64, aside: f64, z: f64| {
        let at = line.at(road, s + along, aside);
        camera.project(&Point3::new(at.x, at.y, z))
    };
    let reach = envelope.length_m() / 2.0;
    let half = width_m.max(envelope.width_m() + 0.4) / 2.0;
    let corners = [-reach, reach].into_iter().flat_map(|along| {
        [-half, half]
            .into_iter()
            .flat_map(move |aside| [0.0, envelope.height_m].map(move |z| (along, aside, z)))
    });
    let in_picture = corners.into_iter().all(|(a, d, z)| sees(a, d, z).is_some_and(inside));
    let (Some(foot), Some(top)) = (sees(0.0, 0.0, 0.0), sees(0.0, 0.0, CAR_HEIGHT_M)) else {
        return false;
    };
    let height = (foot[0] - top[0]).hypot(foot[1] - top[1]);
    in_picture && height >= scene.measure.min_car_height_px
}

/// The lanes as labelme JSON: one polygon each, labelled with its number, with a flag `toward`
/// or `away`. `picture` names the frame they are drawn on.
pub fn labelme(scene: &Scene, lanes: &[MeasuredLane], picture: &str) -> Value {
    let round = |v: f64| (v * 1000.0).round() / 1000.0;
    let shapes: Vec<Value> = lanes
        .iter()
        .map(|lane| {
            let points: Vec<[f64; 2]> =
                lane.polygon.iter().map(|p| [round(p[0]), round(p[1])]).collect();
            let flags = match lane.direction {
                Direction::Toward => json!({"toward": true}),
                Direction::Away => json!({"away": true}),
            };
            json!({
                "label": lane.number.to_string(),
                "points": points,
                "group_id": null,
                "shape_type": "polygon",
                "flags": flags,
            })
        })
        .collect();
    json!({
        "version": "5.0.1",
        "flags": {},
        "shapes": shapes,
        "imagePath": picture,
        "imageData": null,
        "imageHeight": scene.camera.height,
        "imageWidth": scene.camera.width,
    })
}
