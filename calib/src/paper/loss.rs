//! The paper's two losses, in the paper's form and in the form of the authors' code.
//!
//! Owns the projection loss (Eq. 2d_loss) and the weighted back-projection loss
//! (Eq. 3d_loss, obj_func), laid out for millions of evaluations. Does not own the
//! searches over them (see `model_matching`, `fine_tuning`).
//!
//! Where the two forms differ: the paper sums |length difference| + alpha sin(angle) over
//! the pairs of key points; the code takes the mean over the pairs and squares the length
//! difference. The paper weighs vehicles by exp(tau d) with d in metres from the anchor's
//! back-projected centroid; the code scales d to 0..1 over the vehicles first and takes
//! the anchor's centroid from its model. With tau = 0, the default of both, all vehicles
//! weigh the same.

use crate::camera::Pose;
use crate::paper::cmaes::Point;
use crate::vehicle::Pair;
use nalgebra::{Rotation3, Vector2, Vector3};

/// Which of the two readings of the method.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Form {
    /// As printed in the paper.
    Paper,
    /// As in the authors' published program.
    Authors,
}

/// Weights of the fine-tuning loss.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Weights {
    /// Paper or authors.
    pub form: Form,
    /// Weight of the angle against the length; the paper uses 6.
    pub alpha: f64,
    /// Temperature of the weights of the vehicles, 1/m in the paper's form.
    pub tau: f64,
}

/// The seven parameters as a pose and a focal length (px).
pub fn unpack(x: &Point) -> (Pose, f64) {
    let pose = Pose {
        rotation: Rotation3::new(Vector3::new(x[0], x[1], x[2])),
        translation: Vector3::new(x[3], x[4], x[5]),
    };
    (pose, x[6])
}

/// A pose and a focal length as the seven parameters.
pub fn pack(pose: &Pose, f: f64) -> Point {
    let r = pose.rvec();
    let t = pose.translation;
    Point::from([r.x, r.y, r.z, t.x, t.y, t.z, f])
}

/// Distance between labelled and projected key points of one vehicle (Eq. 2d_loss), px:
/// the sum in the paper's form, the mean in the authors'. Infinite when a point is behind
/// the camera.
pub fn projection_loss(pairs: &[Pair], centre: Vector2<f64>, form: Form, x: &Point) -> f64 {
    let (pose, f) = unpack(x);
    let mut sum = 0.0;
    for pair in pairs {
        let p = pose.transform(&pair.world);
        if p.z <= 0.0 {
            return f64::INFINITY;
        }
        sum += (p.xy() * (f / p.z) + centre - pair.image).norm();
    }
    match form {
        Form::Paper => sum,
        Form::Authors => sum / pairs.len() as f64,
    }
}

/// One vehicle of the fine-tuning loss, arrays side by side for the vector unit.
struct Target {
    /// Image coordinates less the principal point, px, and heights in the model, m.
    u: Vec<f64>,
    v: Vec<f64>,
    z: Vec<f64>,
    /// Indices of the points of each pair.
    pairs: Vec<(u8, u8)>,
    /// Difference of the two model points of each pair, m, and its length, m.
    dx: Vec<f64>,
    dy: Vec<f64>,
    dz: Vec<f64>,
    length: Vec<f64>,
    /// Mean of the model points, m.
    model_centroid: Vector3<f64>,
}

/// The weighted back-projection loss L_f of Eq. obj_func over all vehicles.
pub struct FineTuningLoss {
    targets: Vec<Target>,
    weights: Weights,
}

/// Pairs of points on one vehicle, at most: 13 key points.
const MAX_PAIRS: usize = 13 * 12 / 2;
const MAX_POINTS: usize = 13;

impl FineTuningLoss {
    /// Prepares the loss for vehicles with their matched models. `centre` is the
    /// principal point, px.
    pub fn new(vehicles: &[Vec<Pair>], centre: Vector2<f64>, weights: Weights) -> Self {
        let targets = vehicles.iter().map(|pairs| Target::new(pairs, centre)).collect();
        FineTuningLoss { targets, weights }
    }

    /// L_f with vehicle `anchor` as the anchor. Infinite when a key point lies at or
    /// above the horizon.
    pub fn evaluate(&self, anchor: usize, x: &Point) -> f64 {
        let (pose, f) = unpack(x);
        let view = View::new(&pose, f);
        if self.weights.tau == 0.0 {
            let mut sum = 0.0;
            for target in &self.targets {
                sum += self.primary(target, &view).0;
            }
            return sum / self.targets.len() as f64;
        }
        let each: Vec<(f64, Vector3<f64>)> =
            self.targets.iter().map(|t| self.primary(t, &view)).collect();
        let from = match self.weights.form {
            Form::Paper => each[anchor].1,
            Form::Authors => self.targets[anchor].model_centroid,
        };
        let mut distances: Vec<f64> = each.iter().map(|(_, c)| (c - from).norm()).collect();
        if self.weights.form == Form::Authors {
            scale_to_unit(&mut distances);
        }
        // Shifted by the largest exponent: the same weights without overflow.
        let top = distances.iter().map(|d| self.weights.tau * d).fold(f64::MIN, f64::max);
        let w: Vec<f64> = distances.iter().map(|d| (self.weights.tau * d - top).exp()).collect();
        each.iter().zip(&w).map(|((loss, _), w)| loss * w).sum::<f64>() / w.iter().sum::<f64>()
    }

    /// L_p of Eq. 3d_loss for one vehicle, and the centroid of its back-projected points.
    #[inline]
    fn primary(&self, target: &Target, view: &View) -> (f64, Vector3<f64>) {
        let n = target.u.len().min(MAX_POINTS);
        let (mut x, mut y) = ([0.0; MAX_POINTS], [0.0; MAX_POINTS]);
        let mut nearest = f64::INFINITY;
        for k in 0..n {
            let (steps, px, py) = view.back_project(target.u[k], target.v[k], target.z[k]);
            nearest = nearest.min(steps);
            (x[k], y[k]) = (px, py);
        }
        if nearest <= 0.0 {
            return (f64::INFINITY, Vector3::zeros());
        }
        let m = target.pairs.len().min(MAX_PAIRS);
        let (mut hx, mut hy) = ([0.0; MAX_PAIRS], [0.0; MAX_PAIRS]);
        for (k, &(a, b)) in target.pairs[..m].iter().enumerate() {
            let (a, b) = (usize::from(a), usize::from(b));
            (hx[k], hy[k]) = (x[a] - x[b], y[a] - y[b]);
        }
        let (dx, dy, dz) = (&target.dx[..m], &target.dy[..m], &target.dz[..m]);
        let length = &target.length[..m];
        let squared = self.weights.form == Form::Authors;
        let (mut lengths, mut sines) = (0.0, 0.0);
        for k in 0..m {
            let hat = hx[k] * hx[k] + hy[k] * hy[k] + dz[k] * dz[k];
            let dot = hx[k] * dx[k] + hy[k] * dy[k] + dz[k] * dz[k];
            let gap = hat.sqrt() - length[k];
            lengths += if squared { gap * gap } else { gap.abs() };
            let cosine2 = (dot * dot / (hat * length[k] * length[k])).min(1.0);
            sines += (1.0 - cosine2).sqrt();
        }
        let sum = lengths + self.weights.alpha * sines;
        let loss = if squared { sum / m as f64 } else { sum };
        let mean = |values: &[f64]| values[..n].iter().sum::<f64>() / n as f64;
        (loss, Vector3::new(mean(&x), mean(&y), mean(&target.z)))
    }

    /// How many vehicles there are.
    pub fn vehicle_count(&self) -> usize {
        self.targets.len()
    }
}

fn scale_to_unit(values: &mut [f64]) {
    let low = values.iter().copied().fold(f64::INFINITY, f64::min);
    let high = values.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    // All alike: the authors divide 0 by 0; equal weights are meant.
    let width = if high > low { high - low } else { 1.0 };
    values.iter_mut().for_each(|v| *v = (*v - low) / width);
}

impl Target {
    fn new(pairs: &[Pair], centre: Vector2<f64>) -> Self {
        let n = pairs.len().min(MAX_POINTS);
        let indices = (0..n).flat_map(|a| (a + 1..n).map(move |b| (a, b)));
        let differences: Vec<Vector3<f64>> =
            indices.clone().map(|(a, b)| pairs[a].world - pairs[b].world).collect();
        Target {
            u: pairs.iter().map(|p| p.image.x - centre.x).collect(),
            v: pairs.iter().map(|p| p.image.y - centre.y).collect(),
            z: pairs.iter().map(|p| p.world.z).collect(),
            pairs: indices.map(|(a, b)| (a as u8, b as u8)).collect(),
            dx: differences.iter().map(|d| d.x).collect(),
            dy: differences.iter().map(|d| d.y).collect(),
            dz: differences.iter().map(|d| d.z).collect(),
            length: differences.iter().map(|d| d.norm()).collect(),
            model_centroid: pairs.iter().map(|p| p.world).sum::<Vector3<f64>>() / n as f64,
        }
    }
}

/// A camera ready for back-projection of many points.
struct View {
    centre: Vector3<f64>,
    world_from_ray: nalgebra::Matrix3<f64>,
    inverse_f: f64,
}

impl View {
    fn new(pose: &Pose, f: f64) -> Self {
        let world_from_ray = pose.rotation.matrix().transpose();
        View { centre: -(world_from_ray * pose.translation), world_from_ray, inverse_f: 1.0 / f }
    }

    /// Steps along the ray (positive in front), X and Y at height z, m.
    #[inline]
    fn back_project(&self, u: f64, v: f64, z: f64) -> (f64, f64, f64) {
        let (a, b) = (u * self.inverse_f, v * self.inverse_f);
        let m = &self.world_from_ray;
        let ray_x = m.m11 * a + m.m12 * b + m.m13;
        let ray_y = m.m21 * a + m.m22 * b + m.m23;
        let ray_z = m.m31 * a + m.m32 * b + m.m33;
        let steps = (z - self.centre.z) / ray_z;
        (steps, self.centre.x + ray_x * steps, self.centre.y + ray_y * steps)
    }
}
