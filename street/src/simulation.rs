//! The street in time: all lanes' traffic on the road, and where each vehicle is in the world.
//!
//! Owns the clock of the simulation and the placing of vehicles. Car following is `traffic/`,
//! pictures are `render/`, what is measured is `truth.rs`.

use nalgebra::{Point3, Vector3};

use crate::error::Result;
use crate::measured::{MeasuredLane, measured_lanes};
use crate::random::Stream;
use crate::road::{Direction, LaneLine, Road};
use crate::scene::{Light, Scene};
use crate::traffic::{Fleet, LaneTraffic, Vehicle};
use crate::vehicle::paint::Livery;
use crate::vehicle::{MODELS, Model};

/// Car following is integrated in steps of at most this, s.
const LONGEST_STEP_S: f64 = 0.1;

/// A vehicle at an instant, in the world.
#[derive(Debug, Clone)]
pub struct Placed {
    /// Unique in the recording, from 1.
    pub id: u64,
    /// Index into [`MODELS`].
    pub model_index: usize,
    /// Lane number from 0.
    pub lane: usize,
    /// Distance of the footprint's centre along the lane from the road's start, m.
    pub lane_s_m: f64,
    /// Speed, m/s.
    pub speed_m_s: f64,
    /// The brake lights are on.
    pub braking: bool,
    /// Colours.
    pub livery: Livery,
    /// Centre of the footprint, world (X, Y) m.
    pub centre: [f64; 2],
    /// Direction of travel: sine and cosine of its angle clockwise from +Y.
    pub heading: [f64; 2],
}

impl Placed {
    /// Its model.
    pub fn model(&self) -> &'static Model {
        &MODELS[self.model_index]
    }

    /// The world point of a point of the model frame, m.
    pub fn world(&self, point: [f64; 3]) -> Point3<f64> {
        let middle = self.model().centre_m();
        let offset = self.turn(Vector3::new(point[0] - middle[0], point[1] - middle[1], point[2]));
        Point3::new(self.centre[0] + offset.x, self.centre[1] + offset.y, offset.z)
    }

    /// The point of the model frame at a world point, m.
    pub fn model_point(&self, world: &Point3<f64>) -> Point3<f64> {
        let [sin, cos] = self.heading;
        let middle = self.model().centre_m();
        let (x, y) = (world.x - self.centre[0], world.y - self.centre[1]);
        Point3::new(middle[0] - cos * x + sin * y, middle[1] - sin * x - cos * y, world.z)
    }

    /// True when the box around the body, above its wheels' hubs, cuts the line between two world
    /// points.
    pub fn hides(&self, from: &Point3<f64>, to: &Point3<f64>) -> bool {
        let (a, b) = (self.model_point(from), self.model_point(to));
        let model = self.model();
        let sides = [model.sides_m, model.ends_m, [0.5, model.height_m]];
        let (mut enter, mut leave) = (0.0_f64, 1.0_f64);
        for (k, [low, high]) in sides.into_iter().enumerate() {
            let way = b[k] - a[k];
            if way.abs() < 1e-9 {
                if a[k] < low || a[k] > high {
                    return false;
                }
                continue;
            }
            let ends = [(low - a[k]) / way, (high - a[k]) / way];
            enter = enter.max(ends[0].min(ends[1]));
            leave = leave.min(ends[0].max(ends[1]));
        }
        enter < leave
    }

    /// The world direction of a direction of the model frame.
    pub fn turn(&self, v: Vector3<f64>) -> Vector3<f64> {
        // Model +Y is against travel, +X = Y x Z.
        let [sin, cos] = self.heading;
        Vector3::new(-cos * v.x - sin * v.y, sin * v.x - cos * v.y, v.z)
    }
}

/// All vehicles at one instant.
#[derive(Debug, Clone)]
pub struct Snapshot {
    /// Time after the first frame, s.
    pub time_s: f64,
    /// Vehicles, by lane and then from downstream to upstream.
    pub vehicles: Vec<Placed>,
    /// Per lane: its signal shows red.
    pub red: Vec<bool>,
}

/// Motion of a lane's vehicles on its measured stretch since the last query, by their footprints'
/// centres: flow, density and speed by Edie's definitions follow from it, and at the section the count
/// and the time occupancy.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Moved {
    /// Distance covered by all of them, m.
    pub distance_m: f64,
    /// Time spent on the stretch by all of them, s.
    pub time_s: f64,
    /// Time for which a vehicle covered the section, s.
    pub occupied_s: f64,
    /// Vehicles that passed the section.
    pub passed: u32,
}

impl Moved {
    /// Adds a vehicle of that length that went from one place along the lane to another in `dt_s`.
    fn add(&mut self, stretch: &MeasuredLane, [from, to]: [f64; 2], length_m: f64, dt_s: f64) {
        let section = stretch.section_m;
        let (low, high) = (from.min(to), from.max(to));
        let part = |near: f64, far: f64| {
            if high - low < 1e-9 {
                return f64::from(u8::from((near..far).contains(&low)));
            }
            ((high.min(far) - low.max(near)) / (high - low)).max(0.0)
        };
        let on_stretch = part(stretch.near_m, stretch.far_m);
        self.distance_m += on_stretch * (high - low);
        self.time_s += on_stretch * dt_s;
        self.occupied_s += dt_s * part(section - length_m / 2.0, section + length_m / 2.0);
        self.passed += u32::from(low < section && section <= high);
    }
}

/// A street whose traffic runs.
#[derive(Debug, Clone)]
pub struct Simulation {
    scene: Scene,
    road: Road,
    lines: Vec<LaneLine>,
    lanes: Vec<LaneTraffic>,
    measured: Vec<MeasuredLane>,
    moved: Vec<Moved>,
    time_s: f64,
    next_id: u64,
}

impl Simulation {
    /// A street after its warm-up, at the time of the first frame.
    ///
    /// # Errors
    /// [`crate::error::Error::LaneNotVisible`] when a lane has no stretch to measure.
    pub fn new(scene: &Scene, seed: u64) -> Result<Self> {
        let road = scene.reference_line();
        let lines: Vec<LaneLine> =
            scene.lanes.iter().map(|lane| LaneLine::new(&road, lane.offset_m)).collect();
        let measured = measured_lanes(scene, &road, &lines)?;
        let start_s = -scene.warmup_s;
        let lanes = scene.lanes.iter().zip(&lines).enumerate();
        let lanes = lanes
            .map(|(i, (spec, line))| {
                let stream = Stream::new(seed, &format!("lane {}", i + 1));
                let fleet = Fleet::new(scene.fleet, spec.speed_km_h / 3.6, stream);
                LaneTraffic::new(spec.clone(), line.length_m(), fleet, start_s)
            })
            .collect();
        let scene = scene.clone();
        let moved = vec![Moved::default(); measured.len()];
        let mut street =
            Simulation { scene, road, lines, lanes, measured, moved, time_s: start_s, next_id: 1 };
        street.step(-start_s);
        street.time_s = 0.0;
        street.take_moved();
        Ok(street)
    }

    /// Lets traffic run for `dt_s` seconds.
    pub fn step(&mut self, dt_s: f64) {
        let steps = (dt_s / LONGEST_STEP_S - 1e-9).ceil().max(0.0) as u64;
        let from_s = self.time_s;
        for step in 0..steps {
            let now_s = from_s + dt_s * step as f64 / steps as f64;
            let step_s = dt_s / steps as f64;
            for (index, lane) in self.lanes.iter_mut().enumerate() {
                let before: Vec<(u64, f64)> = lane.vehicles().map(|v| (v.id, v.front_m)).collect();
                lane.step(now_s, step_s, &mut self.next_id);
                let mut before = before.into_iter().peekable();
                // Both from downstream to upstream; who has gone or come is beyond the stretch.
                for vehicle in lane.vehicles() {
                    while before.next_if(|(id, _)| *id < vehicle.id).is_some() {}
                    let Some((_, front_m)) = before.next_if(|(id, _)| *id == vehicle.id) else {
                        continue;
                    };
                    let length_m = vehicle.model().length_m();
                    let way = [front_m, vehicle.front_m].map(|m| lane.lane_s(m - length_m / 2.0));
                    self.moved[index].add(&self.measured[index], way, length_m, step_s);
                }
            }
        }
        self.time_s = from_s + dt_s;
    }

    /// Changes light and weather; traffic does not mind.
    pub(crate) fn set_light(&mut self, light: Light) {
        self.scene.light = light;
    }

    /// The motion of each lane's vehicles since the last call, in the scene's order.
    pub fn take_moved(&mut self) -> Vec<Moved> {
        std::mem::replace(&mut self.moved, vec![Moved::default(); self.measured.len()])
    }

    /// The scene it was made from.
    pub fn scene(&self) -> &Scene {
        &self.scene
    }

    /// The reference line.
    pub fn road(&self) -> &Road {
        &self.road
    }

    /// The lanes' centre lines, in the scene's order.
    pub fn lane_lines(&self) -> &[LaneLine] {
        &self.lines
    }

    /// The lanes' traffic, in the scene's order.
    pub fn lanes(&self) -> &[LaneTraffic] {
        &self.lanes
    }

    /// The measured stretch of each lane, in the scene's order.
    pub fn measured(&self) -> &[MeasuredLane] {
        &self.measured
    }

    /// Time after the first frame, s.
    pub fn time_s(&self) -> f64 {
        self.time_s
    }

    /// Where everything is now.
    pub fn snapshot(&self) -> Snapshot {
        let mut vehicles = Vec::new();
        for (lane, traffic) in self.lanes.iter().enumerate() {
            for vehicle in traffic.vehicles() {
                vehicles.push(self.place(lane, traffic, vehicle));
            }
        }
        let red = self.lanes.iter().map(|lane| lane.is_red(self.time_s)).collect();
        Snapshot { time_s: self.time_s, vehicles, red }
    }

    fn place(&self, lane: usize, traffic: &LaneTraffic, vehicle: &Vehicle) -> Placed {
        let direction = self.scene.lanes[lane].direction;
        let lane_s_m = traffic.lane_s(vehicle.front_m - vehicle.model().length_m() / 2.0);
        let place = self.lines[lane].at(&self.road, lane_s_m, vehicle.driver.aside_m);
        let heading = match direction {
            Direction::Away => place.heading,
            Direction::Toward => place.heading + std::f64::consts::PI,
        };
        Placed {
            id: vehicle.id,
            model_index: vehicle.model_index,
            lane,
            lane_s_m,
            speed_m_s: vehicle.speed_m_s,
            braking: vehicle.acceleration_m_s2 < -0.4 || vehicle.speed_m_s < 0.3,
            livery: vehicle.livery,
            centre: [place.x, place.y],
            heading: [heading.sin(), heading.cos()],
        }
    }
}
