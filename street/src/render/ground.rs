//! The still part of the picture, ray by ray: asphalt, markings, roadside, sky and skyline.
//!
//! Owns surfaces and their texture. Every sample is a ray through the lens model, so curves and
//! distortion are exact. Standing objects are `scenery.rs`.

use nalgebra::Vector3;

use super::canvas::Canvas;
use super::light::{Lighting, mix, scale};
use super::painted::Mark;
use super::shadows::Shadows;
use crate::camera::Camera;
use crate::random::{cell, smooth};
use crate::road::{LaneLine, Road};
use crate::scene::{Daylight, Ground, Scene};
use crate::vehicle::paint::Rgb;

/// Everything a ground sample depends on.
pub struct GroundPainter<'a> {
    /// The scene.
    pub scene: &'a Scene,
    /// The reference line.
    pub road: &'a Road,
    /// The lanes' centre lines.
    pub lines: &'a [LaneLine],
    /// The light.
    pub light: &'a Lighting,
    /// Words and symbols on the road.
    pub marks: &'a [Mark],
    /// Shadows on the ground.
    pub shadows: &'a Shadows,
    /// Seed of the texture.
    pub salt: u64,
}

/// Width of a stop line, m.
const STOP_LINE_M: f64 = 0.35;

impl GroundPainter<'_> {
    /// Paints every sample of a canvas as the camera sees the empty street.
    pub fn paint(&self, canvas: &mut Canvas, camera: &Camera) {
        let eye = camera.position();
        let (columns, rows) = (canvas.columns(), canvas.rows());
        let to_world = camera.rotation.inverse();
        for row in 0..rows {
            let mut hint = 0;
            for column in 0..columns {
                let ray = to_world * camera.ray_in_cam(canvas.image_of(column, row));
                let radiance = if ray.z < -1e-4 {
                    let reach = -eye.z / ray.z;
                    let point = [eye.x + reach * ray.x, eye.y + reach * ray.y];
                    let distance = reach * ray.norm();
                    let near = self.surface(point, distance, &ray.normalize(), &mut hint);
                    self.light.through_haze(near, distance)
                } else {
                    self.sky(&ray.normalize())
                };
                let levels = self.light.levels(radiance);
                let at = (row * columns + column) * 4;
                canvas.data_mut()[at..at + 3].copy_from_slice(&levels);
            }
        }
    }

    /// How brightly the row of street lamps lights a place, 1 below a lamp.
    pub fn lamp_light(&self, s: f64, d: f64) -> f32 {
        let rows = &self.scene.roadside.lamps;
        if rows.is_empty() {
            return 0.25;
        }
        let from = |row: &crate::scene::LampRow| {
            let inward = if row.offset_m > 0.0 { -1.5 } else { 1.5 };
            let t = ((s - row.from_m) / row.spacing_m).round().max(0.0);
            let last = ((row.to_m - row.from_m) / row.spacing_m).floor().max(0.0);
            (-1..=1)
                .map(|k| {
                    let lamp_s = row.from_m + (t + f64::from(k)).clamp(0.0, last) * row.spacing_m;
                    let far = (s - lamp_s).powi(2) + (d - row.offset_m - inward).powi(2);
                    (1.0 + far / (1.2 * row.height_m).powi(2)).powf(-1.6)
                })
                .fold(0.0, f64::max)
        };
        (0.18 + rows.iter().map(from).sum::<f64>().min(1.2)) as f32
    }

    fn surface(&self, point: [f64; 2], distance: f64, ray: &Vector3<f64>, hint: &mut usize) -> Rgb {
        let (s, d) = self.road.locate(point, hint);
        let spec = &self.scene.road;
        let on_road = (spec.left_edge_m..=spec.right_edge_m).contains(&d);
        let albedo =
            if on_road { self.asphalt(s, d, point) } else { self.roadside(s, d, point, distance) };
        let wet = self.light.wet * if on_road { 1.0 } else { 0.3 };
        let light =
            self.light.irradiance(&Vector3::z(), self.shadows.sunlit(point), self.lamp_light(s, d));
        let mut out = [0.0; 3];
        let cos = (-ray.z) as f32;
        let fresnel = wet * (0.03 + 0.9 * (1.0 - cos).powi(5)) * 0.6;
        let above = self.light.surroundings(&Vector3::new(ray.x, ray.y, -ray.z));
        for k in 0..3 {
            out[k] = albedo[k] * (1.0 - 0.45 * wet) * light[k] + fresnel * above[k];
        }
        out
    }

    fn asphalt(&self, s: f64, d: f64, point: [f64; 2]) -> Rgb {
        let base = self.scene.road.asphalt as f32;
        let noise =
            |size: f64, salt: u64| smooth(point[0] / size, point[1] / size, self.salt ^ salt);
        let grain = 0.10 * (noise(0.12, 1) - 0.5) + 0.10 * (noise(0.9, 2) - 0.5);
        let stain =
            0.22 * (noise(7.0, 3) - 0.5) + 0.10 * (smooth(s / 30.0, d / 1.2, self.salt ^ 4) - 0.5);
        let mut tone = 1.0 + grain + stain;
        // Wheel tracks are polished, the middle of a lane is dark with oil.
        for (lane, line) in self.scene.lanes.iter().zip(self.lines) {
            let across = (d - line.offset_m()).abs();
            if across < lane.width_m / 2.0 {
                let bump = |at: f64, wide: f64| (-((across - at) / wide).powi(2)).exp() as f32;
                tone += 0.05 * bump(0.85, 0.3) - 0.08 * bump(0.0, 0.45);
            }
        }
        // Joints and repairs: a patch of another age in some cells of the road.
        let (i, j) = ((s / 23.0).floor() as i64, ((d + 100.0) / 3.6).floor() as i64);
        if cell(i, j, self.salt ^ 5) < 0.13 {
            tone *= 0.84 + 0.1 * cell(i, j, self.salt ^ 6);
        }
        let joint = (s / 12.0 - (s / 12.0).floor()) * 12.0;
        if joint < 0.06 && cell((s / 12.0).floor() as i64, 7, self.salt) < 0.3 {
            tone *= 0.72;
        }
        let asphalt = scale([1.0, 0.985, 0.95], base * tone);
        match self.paint_at(s, d, point) {
            Some((colour, cover)) => {
                let wear = smooth(point[0] / 0.35, point[1] / 0.35, self.salt ^ 8);
                let worn = smooth(point[0] / 4.0, point[1] / 4.0, self.salt ^ 9);
                let left = cover * (1.0 - 0.5 * (wear * worn * 2.0).min(1.0));
                mix(asphalt, colour, left)
            }
            None => asphalt,
        }
    }

    /// Road paint at a place: its colour and cover.
    fn paint_at(&self, s: f64, d: f64, point: [f64; 2]) -> Option<(Rgb, f32)> {
        if let Some(found) = self.marks.iter().rev().find_map(|m| m.at(s, d, point, self.salt)) {
            return Some(found);
        }
        for marking in &self.scene.markings {
            if (d - marking.offset_m).abs() > marking.width_m / 2.0 {
                continue;
            }
            let painted =
                marking.dash_m.is_none_or(|dash| s.rem_euclid(dash + marking.gap_m) < dash);
            if painted {
                let colour = if marking.yellow { [0.62, 0.43, 0.06] } else { [0.7, 0.7, 0.68] };
                return Some((colour, 0.92));
            }
        }
        for (lane, line) in self.scene.lanes.iter().zip(self.lines) {
            if let Some(signal) = lane.signal {
                let at = line.reference_s(signal.at_m);
                let across = (d - line.offset_m()).abs() < lane.width_m / 2.0;
                if across && (s - at).abs() < STOP_LINE_M / 2.0 {
                    return Some(([0.7, 0.7, 0.68], 0.95));
                }
            }
        }
        None
    }

    fn roadside(&self, s: f64, d: f64, point: [f64; 2], distance: f64) -> Rgb {
        let strip = self.scene.roadside.strips.iter().rev();
        let ground = strip
            .into_iter()
            .find(|x| (x.from_m..x.to_m).contains(&d))
            .map_or(Ground::Grass, |x| x.ground);
        let noise =
            |size: f64, salt: u64| smooth(point[0] / size, point[1] / size, self.salt ^ salt);
        let edge = [self.scene.road.left_edge_m, self.scene.road.right_edge_m];
        // A kerb stone on both edges of the carriageway.
        if (d - edge[0]).abs() < 0.18 || (d - edge[1]).abs() < 0.18 {
            return [0.34, 0.335, 0.32];
        }
        match ground {
            Ground::Grass => {
                let tone = 0.65 + 0.5 * noise(0.5, 11) + 0.4 * noise(5.0, 12) * noise(0.2, 15);
                mix(scale([0.062, 0.115, 0.024], tone), [0.14, 0.13, 0.06], 0.5 * noise(9.0, 13))
            }
            Ground::Pavement => {
                let slab = cell((s / 0.9).floor() as i64, (d / 0.6).floor() as i64, self.salt ^ 14);
                let seam = (s / 0.9).fract().abs() < 0.05 && distance < 60.0;
                let tone = 0.9 + 0.16 * slab + 0.2 * (noise(3.0, 16) - 0.5);
                scale([0.30, 0.285, 0.26], if seam { 0.7 * tone } else { tone })
            }
            Ground::Concrete => {
                scale([0.33, 0.325, 0.31], 0.85 + 0.3 * noise(2.5, 17) * noise(0.3, 18))
            }
            Ground::Planting => {
                let leaf = noise(0.35, 19) * 0.6 + noise(1.3, 20) * 0.7;
                scale([0.06, 0.105, 0.035], 0.25 + 1.3 * leaf * leaf)
            }
        }
    }

    /// Sky with clouds, and a skyline of distant buildings and hills along the horizon.
    fn sky(&self, ray: &Vector3<f64>) -> Rgb {
        let (azimuth, elevation) = (ray.x.atan2(ray.y).to_degrees(), ray.z.asin().to_degrees());
        let night = self.scene.light.daylight == Daylight::Night;
        let hill = 1.2
            + 1.6 * f64::from(smooth(azimuth / 9.0, 0.5, self.salt ^ 31))
            + 0.4 * f64::from(smooth(azimuth / 1.1, 0.5, self.salt ^ 32));
        let block = (azimuth / 2.3).floor() as i64;
        let tower = f64::from(cell(block, 1, self.salt ^ 33)) * 7.0 - 1.0;
        let inset = (azimuth / 2.3 - block as f64) * 2.3;
        let width = 1.2 + 1.1 * f64::from(cell(block, 2, self.salt ^ 34));
        if elevation < tower && inset < width {
            let wall = 0.12 + 0.3 * cell(block, 3, self.salt ^ 35);
            let (wx, wy) = ((inset / 0.26).floor() as i64, (elevation / 0.30).floor() as i64);
            let window = (inset / 0.26).fract() > 0.4 && (elevation / 0.30).fract() > 0.45;
            let light = self.light.irradiance(&Vector3::new(0.0, -1.0, 0.0), 0.7, 0.05);
            let mut colour = [wall * light[0], wall * 0.97 * light[1], wall * 0.92 * light[2]];
            if window {
                let lit = night && cell(wx ^ (block << 8), wy, self.salt ^ 36) < 0.35;
                colour = if lit { [0.10, 0.08, 0.05] } else { scale(colour, 0.55) };
            }
            return self.light.through_haze(colour, 250.0);
        }
        if elevation < hill {
            let light = self.light.irradiance(&Vector3::z(), 0.8, 0.0);
            let tone = 0.03 + 0.05 * smooth(azimuth * 2.0, elevation * 4.0, self.salt ^ 37);
            let green = [0.8 * tone * light[0], tone * light[1], 0.5 * tone * light[2]];
            return self.light.through_haze(green, 350.0);
        }
        let clear = mix(self.light.horizon, self.light.zenith, (ray.z.max(0.0) as f32).sqrt());
        let flat = [ray.x / (ray.z + 0.1), ray.y / (ray.z + 0.1)];
        let puff = 0.6 * smooth(flat[0] * 1.2, flat[1] * 1.2, self.salt ^ 38)
            + 0.4 * smooth(flat[0] * 3.1, flat[1] * 3.1, self.salt ^ 39);
        mix(clear, scale(self.light.horizon, 1.12), ((puff - 0.5) * 2.5).clamp(0.0, 0.8))
    }
}
