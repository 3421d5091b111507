//! What is known of the road beside the vehicles: lines side by side, marks of known length.
//!
//! Owns the residuals of these cues, which depend on the camera alone. Does not own the
//! vehicles' terms (see `residuals`).

use super::scene::{CAMERA, CameraState};
use crate::camera::Camera;
use crate::files::labelme::LinePair;
use crate::road::marks::Segment;
use nalgebra::{DMatrix, DVector, Vector2, Vector3};

/// What else is known of the road: terms that depend on the camera alone.
#[derive(Clone, Debug, Default)]
pub struct RoadCues {
    /// Pairs of lines with a constant unknown spacing: points (px) of the one and the
    /// other. No vanishing point is used, so the lines may curve.
    pub line_pairs: Vec<LinePair>,
    /// Segments of known length.
    pub segments: Vec<Segment>,
}

/// Standard deviation of a traced line across it, px.
const TRACE_SD_PX: f64 = 0.5;
/// Standard deviation of a painted line against its plan, m, from point to point.
const PAINT_SD_M: f64 = 0.05;
/// Standard deviation of the change of a lane's width from one end of the traced stretch
/// to the other, m.
const TAPER_SD_M: f64 = 0.10;
/// The spacing itself is as good as unknown, m.
const SPACING_SD_M: f64 = 100.0;
/// Standard deviation of the ends of a known length, px.
const MARK_SD_PX: f64 = 0.5;
/// Step of the central differences in log f, rad and log m.
const DIFFERENCE: f64 = 1e-5;

/// Whitened residuals of the road cues and their derivative by the camera.
pub struct CueTerms {
    /// Whitened residuals.
    pub residual: DVector<f64>,
    /// By the camera's unknowns.
    pub jacobian: DMatrix<f64>,
}

/// The noise of the cues as seen from one camera, held while the camera is fitted: a noise
/// that moved with the camera would reward cameras that see the road badly.
#[derive(Clone, Debug, Default)]
pub struct CueNoise {
    /// Lower Cholesky factor of the covariance.
    whitener: DMatrix<f64>,
    /// Mean spacing of each pair of lines, m.
    spacing_m: Vec<f64>,
}

impl RoadCues {
    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.line_pairs.is_empty() && self.segments.is_empty()
    }

    /// Half the sum of squares, or `None` where a point is above the horizon.
    pub fn cost(
        &self,
        camera: &CameraState,
        image_size: [u32; 2],
        noise: &CueNoise,
    ) -> Option<f64> {
        let raw = self.raw(&camera.camera(image_size), &noise.spacing_m)?;
        Some(0.5 * noise.whitener.solve_lower_triangular(&raw)?.norm_squared())
    }

    /// Residuals and derivatives (central differences; five unknowns make that cheap).
    pub fn linearise(
        &self,
        camera: &CameraState,
        image_size: [u32; 2],
        noise: &CueNoise,
    ) -> Option<CueTerms> {
        let at = |v| self.raw(&CameraState::of_vector(&v).camera(image_size), &noise.spacing_m);
        let whiten = |raw: &DVector<f64>| noise.whitener.solve_lower_triangular(raw);
        let residual = whiten(&at(camera.vector())?)?;
        let mut jacobian = DMatrix::zeros(residual.len(), CAMERA);
        for k in 0..CAMERA {
            let (mut up, mut down) = (camera.vector(), camera.vector());
            up[k] += DIFFERENCE;
            down[k] -= DIFFERENCE;
            jacobian.set_column(k, &whiten(&((at(up)? - at(down)?) / (2.0 * DIFFERENCE)))?);
        }
        Some(CueTerms { residual, jacobian })
    }

    /// The noise as this camera sees it, or `None` where a point is above its horizon.
    pub fn noise(&self, camera: &CameraState, image_size: [u32; 2]) -> Option<CueNoise> {
        if self.is_empty() {
            return Some(CueNoise::default());
        }
        let view = camera.camera(image_size);
        let n = self.line_pairs.iter().map(|[a, _]| a.len()).sum::<usize>() + self.segments.len();
        let mut covariance = DMatrix::zeros(n, n);
        let mut spacing_m = Vec::new();
        let mut row = 0;
        for pair in &self.line_pairs {
            let ground = on_ground(&view, &pair[0])?;
            let along = fractions(&ground);
            for (i, p) in ground.iter().enumerate() {
                let trace = TRACE_SD_PX * metres_per_px(&view, p);
                covariance[(row + i, row + i)] += trace * trace + PAINT_SD_M * PAINT_SD_M;
                for j in 0..ground.len() {
                    let taper = TAPER_SD_M * TAPER_SD_M * along[i] * along[j];
                    covariance[(row + i, row + j)] += taper + SPACING_SD_M * SPACING_SD_M;
                }
            }
            spacing_m.push(mean(&spacings(&view, pair)?));
            row += ground.len();
        }
        for segment in &self.segments {
            let ends = on_ground(&view, &segment.ends)?;
            let pixel = (ends[0] - ends[1]).norm() / (segment.ends[0] - segment.ends[1]).norm();
            let sd = MARK_SD_PX * std::f64::consts::SQRT_2 * pixel;
            covariance[(row, row)] = sd * sd + PAINT_SD_M * PAINT_SD_M;
            row += 1;
        }
        Some(CueNoise { whitener: covariance.cholesky()?.unpack(), spacing_m })
    }

    /// Deviations of the spacing from its own mean, as parts of it in units of the held
    /// spacing (m), then length errors (m). As parts, because in plain metres a smaller
    /// world would look like a better one.
    fn raw(&self, view: &Camera, spacing_m: &[f64]) -> Option<DVector<f64>> {
        let mut values = Vec::new();
        for (pair, held) in self.line_pairs.iter().zip(spacing_m) {
            let spacings = spacings(view, pair)?;
            let mean = mean(&spacings);
            values.extend(spacings.iter().map(|d| held * (d / mean - 1.0)));
        }
        for segment in &self.segments {
            values.push(segment.measure(view).ok()? - segment.length_m);
        }
        Some(DVector::from_vec(values))
    }
}

/// Distance (m) of each point of the first line from the second.
fn spacings(view: &Camera, [first, second]: &LinePair) -> Option<Vec<f64>> {
    let second = on_ground(view, second)?;
    Some(on_ground(view, first)?.iter().map(|p| distance(p, &second)).collect())
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

fn on_ground(view: &Camera, line: &[Vector2<f64>]) -> Option<Vec<Vector2<f64>>> {
    line.iter().map(|uv| Some(view.back_project(uv, 0.0)?.xy())).collect()
}

/// Where each point lies along its line, -0.5 to 0.5.
fn fractions(line: &[Vector2<f64>]) -> Vec<f64> {
    let mut sum = 0.0;
    let mut all = vec![0.0];
    for w in line.windows(2) {
        sum += (w[1] - w[0]).norm();
        all.push(sum);
    }
    all.iter().map(|s| s / sum.max(f64::MIN_POSITIVE) - 0.5).collect()
}

/// Distance of a point from a polyline; its first and last edge extend without end, so that
/// lines traced over different stretches compare too.
fn distance(p: &Vector2<f64>, line: &[Vector2<f64>]) -> f64 {
    let last = line.len().saturating_sub(2);
    line.windows(2)
        .enumerate()
        .map(|(k, w)| {
            let edge = w[1] - w[0];
            let mut t = (p - w[0]).dot(&edge) / edge.norm_squared().max(f64::MIN_POSITIVE);
            if k > 0 {
                t = t.max(0.0);
            }
            if k < last {
                t = t.min(1.0);
            }
            (w[0] + edge * t - p).norm()
        })
        .fold(f64::INFINITY, f64::min)
}

/// Road length across the view that one pixel spans at a point of the road, m.
fn metres_per_px(view: &Camera, p: &Vector2<f64>) -> f64 {
    view.pose.transform(&Vector3::new(p.x, p.y, 0.0)).z / view.lens.f
}
