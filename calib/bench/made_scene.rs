//! Made scenes with known truth: a camera over a road, labelled vehicles, road marks.
//!
//! Owns the generator behind `mvcalib compare` and the accuracy tests. Does not own the
//! methods that are compared. Everything follows from the seed.
//!
//! A scene: focal length 0.8 to 1.8 widths (log-uniform), height 6 to 20 m, nearest vehicle
//! 1.3 to 2.2 heights away, furthest 2.6 times that, within 6 m of the middle of the road,
//! yaw 6 degrees (sd), roll 2 degrees (sd), one back corner hidden. Unless asked for
//! otherwise ground is flat, the principal point in the middle, every vehicle a car; the lens
//! has no distortion, label noise is normal: kinder than a street in all five.

#![allow(dead_code, reason = "each program that includes this file uses a part of it")]

use mvcalib::bodies::Body;
use mvcalib::camera::Camera;
use mvcalib::joint::scene::CameraState;
use mvcalib::joint::shape::{OTHER_BODIES, Spread};
use mvcalib::model::VehicleModel;
use mvcalib::problem::Problem;
use mvcalib::road::marks::{Mark, Marks};
use mvcalib::vehicle::{KeyPoint, Vehicle};
use nalgebra::{Rotation3, Vector2, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

/// Which cars drive through a made scene.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Fleet {
    /// Exactly the known models.
    Known,
    /// Like them, but none of them: overall size 4 %, each axis 3 %, each key point 5 cm,
    /// every car on its own.
    Unknown,
    /// The same about another mean: the fleet as a whole differs by 3 % in size and 2 %
    /// along each axis, which no method can see.
    Foreign,
}

/// What kind of scene.
#[derive(Clone, Copy, Debug)]
pub struct Kind {
    /// Width and height of the picture, px.
    pub image_size: [u32; 2],
    /// Standard deviation of each label's coordinates, px.
    pub noise_px: f64,
    /// The cars.
    pub fleet: Fleet,
    /// How many of them.
    pub vehicles: usize,
    /// Length of a segment of the road marks, m.
    pub segment_m: f64,
    /// Which end of the vehicles the camera sees.
    pub seen: Seen,
    /// How many of the vehicles, the first ones, have this body instead of a car's. They
    /// scatter about it as [`OTHER_BODIES`] states.
    pub others: (usize, Body),
    /// Curvature of the road's profile from the nearest vehicle on, 1/m: above 0 it turns
    /// upwards (a sag), below 0 downwards (a crest).
    pub profile_per_m: f64,
    /// How far the principal point is from the picture's middle, as parts of its width.
    pub off_centre: [f64; 2],
}

/// Which end of the vehicles the camera sees.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Seen {
    /// They come towards it: the paper's eight key points.
    Front,
    /// They drive away: back corners, mirrors and the key points of the rear.
    Rear,
}

impl Seen {
    fn shows(self, label: u8) -> bool {
        match self {
            Seen::Front => label <= 8,
            Seen::Rear => label >= 5,
        }
    }
}

/// A made scene.
#[derive(Clone, Debug)]
pub struct MadeScene {
    /// What a calibration is given.
    pub problem: Problem,
    /// The camera that it should find.
    pub truth: Camera,
    /// Road marks without noise, for judging.
    pub marks: Marks,
    /// The same camera in the terms of the joint method.
    pub state: CameraState,
    /// How the vehicles really stand, in the problem's order.
    pub standing: Vec<Standing>,
}

/// What a made vehicle is and how it stands on the road.
#[derive(Clone, Copy, Debug)]
pub struct Standing {
    /// Index of the model that it is, or is like.
    pub model: usize,
    /// Where its middle is on the road, m.
    pub position: Vector2<f64>,
    /// Its yaw, rad.
    pub yaw: f64,
}

/// Hong Kong's camera in the paper: 320 x 240, marks 6 m apart.
pub const HK_LIKE: Kind = Kind {
    image_size: [320, 240],
    noise_px: 1.0,
    fleet: Fleet::Known,
    vehicles: 7,
    segment_m: 6.0,
    seen: Seen::Front,
    others: (0, Body::Car),
    profile_per_m: 0.0,
    off_centre: [0.0; 2],
};
/// Sacramento's: 720 x 480, marks 40 feet apart. Seven vehicles here, six in the paper.
pub const SAC_LIKE: Kind = Kind { image_size: [720, 480], segment_m: 12.192, ..HK_LIKE };

/// Draws of a scene before it is given up and begun again, and of a vehicle in a scene.
const ATTEMPTS: usize = 200;

/// Makes the scene of this seed.
pub fn make(kind: &Kind, models: &[VehicleModel], seed: u64) -> MadeScene {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    loop {
        if let Some(scene) = attempt(kind, models, &mut rng) {
            return scene;
        }
    }
}

fn attempt(kind: &Kind, models: &[VehicleModel], rng: &mut ChaCha8Rng) -> Option<MadeScene> {
    let [width, height] = kind.image_size.map(f64::from);
    let f = width * rng.random_range(0.8f64.ln()..1.8f64.ln()).exp();
    let h: f64 = rng.random_range(6.0..20.0);
    let near = h * rng.random_range(1.3..2.2);
    let far = 2.6 * near;
    // The nearest vehicle stands low in the picture.
    let tilt = (h / near).atan() - (0.40 * height / f).atan();
    let fleet = fleet_size(kind.fleet, rng);
    let roll = 2f64.to_radians() * normal(rng);
    let state =
        CameraState { log_f: f.ln(), tilt, roll, log_height: h.ln(), ..CameraState::default() };
    let mut truth = state.camera(kind.image_size);
    truth.lens.centre += Vector2::from(kind.off_centre) * width;
    let road = Road { curved_from_m: near, profile_per_m: kind.profile_per_m };
    let (mut vehicles, mut standing) = (Vec::new(), Vec::new());
    for index in 0..kind.vehicles {
        let body = if index < kind.others.0 { kind.others.1 } else { Body::Car };
        let name = format!("vehicle_{:02}", index + 1);
        let (found, stands) = (0..ATTEMPTS).find_map(|_| {
            let y = near * rng.random_range(0.0..(far / near).ln()).exp();
            let x = rng.random_range(-6.0..6.0);
            vehicle(kind, models, (&truth, road), (&name, body), Vector2::new(x, y), fleet, rng)
        })?;
        vehicles.push(found);
        standing.push(stands);
    }
    let marks = marks(kind, &truth, road, near, far)?;
    let problem = Problem::new(kind.image_size, vehicles, models.to_vec()).ok()?;
    Some(MadeScene { problem, truth, marks, state, standing })
}

/// How cars that are none of the models scatter about them.
const CARS: Spread = Spread { scale: 0.04, axis: 0.03, point_m: 0.05 };

/// The road's profile: level up to a distance, then an arc.
#[derive(Clone, Copy)]
struct Road {
    curved_from_m: f64,
    profile_per_m: f64,
}

impl Road {
    /// Where a point of a thing is that stands at a place, x across and y along the road. The
    /// thing tilts with the road under its middle.
    fn place(self, at: Vector2<f64>, point: Vector3<f64>) -> Vector3<f64> {
        let along = (at.y - self.curved_from_m).max(0.0);
        let slope = along * self.profile_per_m;
        let stands = if slope == 0.0 {
            Vector3::new(at.x, at.y, 0.0)
        } else {
            let arc = Vector2::new(slope.sin(), 1.0 - slope.cos()) / self.profile_per_m;
            Vector3::new(at.x, self.curved_from_m + arc.x, arc.y)
        };
        Rotation3::from_axis_angle(&Vector3::x_axis(), slope) * point + stands
    }
}

/// Size of the mean car along each axis against the models'.
fn fleet_size(fleet: Fleet, rng: &mut ChaCha8Rng) -> Vector3<f64> {
    if fleet != Fleet::Foreign {
        return Vector3::repeat(1.0);
    }
    let size = (0.03 * normal(rng)).exp();
    Vector3::from_fn(|_, _| size * (0.02 * normal(rng)).exp())
}

fn normal(rng: &mut ChaCha8Rng) -> f64 {
    StandardNormal.sample(rng)
}

/// A labelled vehicle as the camera sees it, or `None` when it is not wholly
/// in the picture.
fn vehicle(
    kind: &Kind,
    models: &[VehicleModel],
    (camera, road): (&Camera, Road),
    (name, body): (&str, Body),
    at: Vector2<f64>,
    fleet: Vector3<f64>,
    rng: &mut ChaCha8Rng,
) -> Option<(Vehicle, Standing)> {
    let index = rng.random_range(0..models.len());
    let (model, spread, fleet) = match body.model() {
        Some(own) => (own, OTHER_BODIES, Vector3::repeat(1.0)),
        None if kind.fleet == Fleet::Known => (&models[index], CARS.times(0.0), fleet),
        None => (&models[index], CARS, fleet),
    };
    let size = (spread.scale * normal(rng)).exp();
    let axes = Vector3::from_fn(|_, _| size * (spread.axis * normal(rng)).exp());
    let about = if kind.seen == Seen::Rear { std::f64::consts::PI } else { 0.0 };
    let yaw = about + 6f64.to_radians() * normal(rng);
    let turn = Rotation3::from_axis_angle(&Vector3::z_axis(), yaw);
    // From the front one back corner is hidden, from behind one mirror.
    let first = if kind.seen == Seen::Rear { 5 } else { 7 };
    let hidden = if rng.random_bool(0.5) { first } else { first + 1 };
    let [width, height] = kind.image_size.map(f64::from);
    let mut points = Vec::new();
    for (label, point) in (1u8..).zip(&model.points) {
        let scatter = Vector3::from_fn(|_, _| spread.point_m * normal(rng));
        let noise = Vector2::from_fn(|_, _| kind.noise_px * normal(rng));
        let Some(point) = point.filter(|_| label != hidden && kind.seen.shows(label)) else {
            continue;
        };
        let shape = point.component_mul(&axes).component_mul(&fleet) + scatter;
        // The model's origin is at its back; put its middle where the vehicle stands.
        let p = road.place(at, turn * (shape + Vector3::new(-0.9, 2.25, 0.0)));
        let uv = camera.project(&p)? + noise;
        let inside = uv.x >= 0.0 && uv.y >= 0.0 && uv.x <= width && uv.y <= height;
        if !inside {
            return None;
        }
        points.push(KeyPoint { label, uv });
    }
    let standing = Standing { model: index, position: at, yaw };
    Some((Vehicle { name: name.to_owned(), body, points }, standing))
}

/// Two lines of one to six segments, from the nearest to the furthest vehicle, as far as
/// they are in the picture.
fn marks(kind: &Kind, camera: &Camera, road: Road, near: f64, far: f64) -> Option<Marks> {
    let [width, height] = kind.image_size.map(f64::from);
    let line = |x: f64| {
        let points: Vec<[f64; 2]> = (0..=6)
            .map_while(|k| {
                let y = near + kind.segment_m * f64::from(k);
                if k > 1 && y > far {
                    return None;
                }
                let p = road.place(Vector2::new(x, y), Vector3::zeros());
                let uv = camera.project(&p)?;
                let inside = (0.0..width).contains(&uv.x) && (0.0..height).contains(&uv.y);
                inside.then(|| uv.into())
            })
            .collect();
        (points.len() > 1).then(|| Mark::new(points, kind.segment_m))
    };
    Some(Marks { marks: vec![line(-1.75)?, line(1.75)?], rectangles: Vec::new() })
}

#[cfg(test)]
mod tests {
    use super::*;
    use mvcalib::model::parse_models;

    #[test]
    fn a_scene_follows_from_its_seed_and_its_marks_have_their_length() {
        let models = parse_models(include_str!("../data/vehicles.json")).unwrap();
        for kind in [HK_LIKE, SAC_LIKE] {
            for seed in 0..20 {
                let scene = make(&kind, &models, seed);
                assert_eq!(scene.problem.vehicles.len(), 7);
                let accuracy = scene.marks.verify(&scene.truth).unwrap();
                assert!(accuracy.mape_pct < 1e-6);
                let again = make(&kind, &models, seed);
                assert_eq!(again.problem.vehicles, scene.problem.vehicles);
            }
        }
    }

    #[test]
    fn a_curved_profile_bends_the_road_and_tilts_what_stands_on_it() {
        let road = Road { curved_from_m: 20.0, profile_per_m: 1.0 / 500.0 };
        let at = |y: f64, up: f64| road.place(Vector2::new(1.0, y), Vector3::new(0.0, 0.0, up));
        assert_eq!(at(15.0, 2.0), Vector3::new(1.0, 15.0, 2.0));
        // 50 m along an arc of 500 m: 0.1 rad steep, 2.5 m up.
        let (foot, top) = (at(70.0, 0.0), at(70.0, 2.0));
        assert!((foot - Vector3::new(1.0, 69.92, 2.498)).norm() < 0.01, "{foot}");
        assert!((top - foot - Vector3::new(0.0, -0.2, 1.99)).norm() < 0.01, "{top}");
        assert!(((at(76.0, 0.0) - foot).norm() - 6.0).abs() < 1e-4);
    }

    #[test]
    fn the_first_vehicles_have_the_body_asked_for() {
        let models = parse_models(include_str!("../data/vehicles.json")).unwrap();
        let scene = make(&Kind { others: (2, Body::Van), ..HK_LIKE }, &models, 0);
        let bodies: Vec<Body> = scene.problem.vehicles.iter().map(|v| v.body).collect();
        assert_eq!(bodies[..3], [Body::Van, Body::Van, Body::Car]);
    }
}
