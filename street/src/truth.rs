//! The truth of a frame: boxes, key points, lanes, speeds; density, flow and speed per lane.
//!
//! Owns the definitions:
//! - `box`: smallest upright rectangle around the whole vehicle's outline, clipped by the
//!   picture and not by what is in front: what a perfect detector reports.
//! - `contact`: image of the centre of the footprint on the road; `near_contact`: image of the
//!   middle of the footprint's end that is nearer to the camera.
//! - `s_m`: distance of the footprint's centre along the lane from the near end of the measured
//!   stretch, growing away from the camera whatever the direction of travel.
//! - `occlusion`: share of the vehicle's pixels hidden by nearer vehicles and barriers; pixels
//!   outside the picture do not count.
//! - lane density: vehicles whose footprint centre lies in the measured stretch, by its length;
//!   speed: their mean (space mean), null with no vehicle; flow = density x speed.
//! - since the frame before: distance covered and time spent by all vehicles on the stretch, from
//!   which flow, density and speed of any time follow by Edie's definitions; vehicles that passed
//!   its section, and the time for which one covered it. The first frame has 0.

use std::collections::BTreeMap;

use nalgebra::Point3;
use serde::Serialize;

use crate::camera::Camera;
use crate::faults::Picture;
use crate::measured::MeasuredLane;
use crate::outline::{OutlineMap, hull_boxes};
use crate::simulation::{Moved, Placed, Simulation, Snapshot};
use crate::vehicle::Class;
use crate::vehicle::mesh::mesh_of;

/// Boxes less wide or high than this are not listed, px.
const SMALLEST_BOX_PX: f64 = 1.0;

/// The truth of one frame.
#[derive(Debug, Clone, Serialize)]
pub struct FrameTruth {
    /// The frame's file name.
    pub frame: String,
    /// UTC, RFC 3339.
    pub time: String,
    /// The kind of picture. Frozen frames list the vehicles of the frame they repeat, black
    /// frames none; lanes always have the street's true state at `time`.
    pub picture: Picture,
    /// Vehicles in the picture, nearest first.
    pub vehicles: Vec<VehicleTruth>,
    /// Every measured lane.
    pub lanes: Vec<LaneTruth>,
}

/// One vehicle in the picture.
#[derive(Debug, Clone, Serialize)]
pub struct VehicleTruth {
    /// Unique in the recording.
    pub id: u64,
    /// Class.
    pub class: Class,
    /// Model name.
    pub model: &'static str,
    /// Lane number from 1.
    pub lane: usize,
    /// Along the lane from the near end of the measured stretch, m.
    pub s_m: f64,
    /// Speed, m/s.
    pub speed_m_s: f64,
    /// x0, y0, x1, y1, px.
    #[serde(rename = "box")]
    pub bounds: [f64; 4],
    /// Visible key points by number 1 to 8, px.
    pub keypoints: BTreeMap<u8, [f64; 2]>,
    /// Image of the centre of the footprint, px.
    pub contact: [f64; 2],
    /// Image of the middle of the footprint's nearer end, px.
    pub near_contact: [f64; 2],
    /// Hidden share, 0 to 1.
    pub occlusion: f64,
}

/// The true state of a measured lane.
#[derive(Debug, Clone, Serialize)]
pub struct LaneTruth {
    /// Lane number from 1.
    pub lane: usize,
    /// Vehicles in the stretch.
    pub vehicles: usize,
    /// Density, veh/km.
    pub density_veh_km: f64,
    /// Flow, veh/h.
    pub flow_veh_h: f64,
    /// Space-mean speed, km/h; null with no vehicle.
    pub speed_km_h: Option<f64>,
    /// Length of the stretch, m.
    pub length_m: f64,
    /// Since the frame before: distance covered by all vehicles on the stretch, m.
    pub distance_m: f64,
    /// Likewise time spent, s.
    pub time_s: f64,
    /// Likewise time for which a vehicle covered the section, s.
    pub occupied_s: f64,
    /// Likewise vehicles that passed it.
    pub passed: u32,
}

/// The true state of every lane at a snapshot, and what its vehicles have done since the one before.
pub fn lanes(measured: &[MeasuredLane], snapshot: &Snapshot, moved: &[Moved]) -> Vec<LaneTruth> {
    let state = |(lane, moved): (&MeasuredLane, &Moved)| {
        let inside = snapshot
            .vehicles
            .iter()
            .filter(|v| v.lane + 1 == lane.number && lane.contains(v.lane_s_m));
        let speeds: Vec<f64> = inside.map(|v| v.speed_m_s * 3.6).collect();
        let density_veh_km = speeds.len() as f64 / (lane.length_m() / 1000.0);
        // `+ 0.0` turns the empty sum's -0 into 0.
        let mean = (speeds.iter().sum::<f64>() + 0.0) / speeds.len().max(1) as f64;
        LaneTruth {
            lane: lane.number,
            vehicles: speeds.len(),
            density_veh_km: round(density_veh_km),
            flow_veh_h: round(density_veh_km * mean),
            speed_km_h: (!speeds.is_empty()).then(|| round(mean)),
            length_m: round(lane.length_m()),
            distance_m: round(moved.distance_m),
            time_s: round(moved.time_s),
            occupied_s: round(moved.occupied_s),
            passed: moved.passed,
        }
    };
    measured.iter().zip(moved).map(state).collect()
}

/// The vehicles that a camera sees, nearest first.
pub fn vehicles(street: &Simulation, snapshot: &Snapshot, camera: &Camera) -> Vec<VehicleTruth> {
    let map = OutlineMap::draw(street, snapshot, camera);
    let eye = camera.position();
    let mut order: Vec<&Placed> = snapshot.vehicles.iter().collect();
    order.sort_by(|a, b| reach(a, &eye).total_cmp(&reach(b, &eye)).then(a.id.cmp(&b.id)));
    let mut seen = Vec::new();
    for vehicle in order {
        let Some(bounds) = bounding_box(vehicle, camera) else { continue };
        let Some(occlusion) = map.occlusion(vehicle.id) else { continue };
        let model = vehicle.model();
        let on_road = |x: f64, y: f64| camera.project(&vehicle.world([x, y, 0.0]));
        let [mid_x, mid_y] = model.centre_m();
        let ends = model.ends_m.map(|y| vehicle.world([mid_x, y, 0.0]));
        let nearer = if (ends[0] - eye).norm() < (ends[1] - eye).norm() { 0 } else { 1 };
        let near_contact = camera.project(&ends[nearer]);
        let (Some(contact), Some(near_contact)) = (on_road(mid_x, mid_y), near_contact) else {
            continue;
        };
        let near_end = street.measured()[vehicle.lane].near_m;
        seen.push(VehicleTruth {
            id: vehicle.id,
            class: model.class,
            model: model.name,
            lane: vehicle.lane + 1,
            s_m: round(vehicle.lane_s_m - near_end),
            speed_m_s: round(vehicle.speed_m_s),
            bounds: bounds.map(round),
            keypoints: visible_key_points(vehicle, camera, &map),
            contact: contact.map(round),
            near_contact: near_contact.map(round),
            occlusion: round(occlusion),
        });
    }
    seen
}

/// The images of a vehicle's eight key points, px, whether visible or not; `None` behind the
/// camera.
pub fn key_points(vehicle: &Placed, camera: &Camera) -> [Option<[f64; 2]>; 8] {
    vehicle.model().key_points.map(|point| camera.project(&vehicle.world(point)))
}

fn reach(vehicle: &Placed, eye: &Point3<f64>) -> f64 {
    (vehicle.centre[0] - eye.x).hypot(vehicle.centre[1] - eye.y)
}

fn bounding_box(vehicle: &Placed, camera: &Camera) -> Option<[f64; 4]> {
    let [x0, y0, x1, y1] = hull_boxes(vehicle, camera)?;
    let (w, h) = (f64::from(camera.width), f64::from(camera.height));
    let bounds = [x0.max(0.0), y0.max(0.0), x1.min(w), y1.min(h)];
    let large = |a: f64, b: f64| b - a >= SMALLEST_BOX_PX;
    (large(bounds[0], bounds[2]) && large(bounds[1], bounds[3])).then_some(bounds)
}

/// A key point is visible when it lies in the picture, no nearer outline covers it, and the
/// body's own faces do not hide it.
fn visible_key_points(
    vehicle: &Placed,
    camera: &Camera,
    map: &OutlineMap,
) -> BTreeMap<u8, [f64; 2]> {
    let mut visible = BTreeMap::new();
    let eye = vehicle.model_point(&camera.position());
    for (index, image) in key_points(vehicle, camera).into_iter().enumerate() {
        let Some(image) = image else { continue };
        if map.shows(vehicle.id, image) && !hidden_by_own_body(vehicle, &eye, index) {
            visible.insert(index as u8 + 1, image.map(round));
        }
    }
    visible
}

/// Key points lie on or near the skin: the last so many metres before one are not tested.
const SKIN_M: f64 = 0.25;

fn hidden_by_own_body(vehicle: &Placed, eye_in_model: &Point3<f64>, index: usize) -> bool {
    let eye = eye_in_model;
    let ray = Point3::from(vehicle.model().key_points[index]) - eye;
    let distance = ray.norm();
    let direction = ray / distance;
    mesh_of(vehicle.model_index).faces.iter().any(|face| {
        let facing = face.normal.dot(&direction);
        if facing >= -1e-6 {
            return false;
        }
        let reach = face.normal.dot(&(Point3::from(face.middle) - eye)) / facing;
        if reach <= 0.0 || reach >= distance - SKIN_M {
            return false;
        }
        let hit = eye + direction * reach;
        let corners = &face.corners;
        (0..corners.len()).all(|i| {
            let (a, b) = (Point3::from(corners[i]), Point3::from(corners[(i + 1) % corners.len()]));
            (b - a).cross(&(hit - a)).dot(&face.normal) >= 0.0
        })
    })
}

/// Millimetres, hundredths of a pixel and the like: three decimals.
fn round(value: f64) -> f64 {
    (value * 1000.0).round() / 1000.0
}
