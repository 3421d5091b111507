//! Shadows that things beside the picture cast on the ground: masts, gantries, leaves.
//!
//! Owns how much of the sun reaches a place. The sun's disc softens an edge with the distance from
//! what casts it. They lie on the ground alone: vehicles that pass stay in the sun. Shadows of
//! vehicles and closures are `vehicles.rs`.

use super::light::{LOWEST_SUN, Lighting};
use crate::random::smooth;
use crate::road::Road;
use crate::scene::{Scene, Shadow, ShadowKind};

/// Diameter of the sun's disc, radians.
const SUN_RAD: f64 = 0.0093;

/// The shadows of a scene, on the ground.
pub struct Shadows {
    bars: Vec<Bar>,
    crowns: Vec<Crown>,
    direct: f32,
    salt: u64,
}

/// The shadow of a straight rod: from one ground point to another, half its width and the softness
/// of its edge at both, m.
struct Bar {
    ends: [[f64; 2]; 2],
    half_m: f64,
    soft_m: [f64; 2],
}

/// The shadow of a crown: an ellipse, longer away from the sun.
struct Crown {
    middle: [f64; 2],
    away: [f64; 2],
    half_m: [f64; 2],
    soft_m: f64,
}

impl Shadows {
    /// The shadows a scene asks for; none without sun.
    pub fn of(scene: &Scene, road: &Road, light: &Lighting, salt: u64) -> Self {
        let mut shadows = Shadows { bars: vec![], crowns: vec![], direct: light.direct, salt };
        if light.direct <= 0.0 {
            return shadows;
        }
        for shadow in &scene.roadside.shadows {
            shadows.cast(shadow, road, light);
        }
        shadows
    }

    fn cast(&mut self, shadow: &Shadow, road: &Road, light: &Lighting) {
        let sun_z = light.to_sun.z.max(LOWEST_SUN);
        let drift = [-light.to_sun.x / sun_z, -light.to_sun.y / sun_z];
        let fall = |p: [f64; 2], z: f64| [p[0] + z * drift[0], p[1] + z * drift[1]];
        let soft = |z: f64| 0.02 + SUN_RAD * z / sun_z / 2.0;
        let foot = beside(road, shadow.at_m, shadow.offset_m);
        let height = shadow.height_m;
        let mast = |foot: [f64; 2], height: f64, half_m: f64| Bar {
            ends: [foot, fall(foot, height)],
            half_m,
            soft_m: [soft(0.0), soft(height)],
        };
        match shadow.kind {
            ShadowKind::Mast => {
                self.bars.push(mast(foot, height, shadow.width_m.unwrap_or(0.25) / 2.0));
            }
            ShadowKind::Gantry => {
                let half_m = shadow.width_m.unwrap_or(0.8) / 2.0;
                let other_m = shadow.to_offset_m.unwrap_or(-shadow.offset_m);
                let other = beside(road, shadow.at_m, other_m);
                self.bars.push(mast(foot, height, 0.4 * half_m));
                self.bars.push(mast(other, height, 0.4 * half_m));
                let ends = [fall(foot, height), fall(other, height)];
                self.bars.push(Bar { ends, half_m, soft_m: [soft(height); 2] });
            }
            ShadowKind::Leaves => {
                let radius = shadow.width_m.unwrap_or(0.7 * height) / 2.0;
                let middle_m = (height - radius).max(0.5 * height);
                self.bars.push(mast(foot, middle_m, 0.2));
                let flat = drift[0].hypot(drift[1]);
                let away = if flat > 1e-9 { drift.map(|x| x / flat) } else { [0.0, 1.0] };
                self.crowns.push(Crown {
                    middle: fall(foot, middle_m),
                    away,
                    half_m: [radius * flat.hypot(1.0), radius],
                    soft_m: soft(middle_m),
                });
            }
        }
    }

    /// The share of the sun that reaches a ground point, 0 to 1.
    pub fn sunlit(&self, point: [f64; 2]) -> f32 {
        let mut lit = 1.0;
        for bar in &self.bars {
            lit *= 1.0 - bar.cover(point);
        }
        let mut leaves: f64 = 0.0;
        let mut gap_m: f64 = 0.4;
        for crown in &self.crowns {
            leaves = leaves.max(crown.cover(point));
            gap_m = gap_m.max(2.0 * crown.soft_m);
        }
        if leaves > 0.0 {
            // Gaps between leaves and between branches: spots of sun.
            let spot = |size: f64, salt: u64| {
                f64::from(smooth(point[0] / size, point[1] / size, self.salt ^ salt))
            };
            let dense = 0.55 * spot(gap_m, 51) + 0.45 * spot(3.5 * gap_m, 52) + 0.35 * leaves;
            lit *= 1.0 - 0.92 * ((dense - 0.55) * 5.0).clamp(0.0, 1.0) * leaves.min(0.35) / 0.35;
        }
        1.0 - self.direct * (1.0 - lit as f32)
    }
}

impl Bar {
    fn cover(&self, point: [f64; 2]) -> f64 {
        let [a, b] = self.ends;
        let (dx, dy) = (b[0] - a[0], b[1] - a[1]);
        let (px, py) = (point[0] - a[0], point[1] - a[1]);
        let along = ((px * dx + py * dy) / (dx * dx + dy * dy).max(1e-9)).clamp(0.0, 1.0);
        let away = (px - along * dx).hypot(py - along * dy);
        let soft = self.soft_m[0] + along * (self.soft_m[1] - self.soft_m[0]);
        // Where the edge is wider than the rod the shadow is never whole.
        let depth = (self.half_m / soft).min(1.0);
        depth * ((self.half_m + soft - away) / (2.0 * soft)).clamp(0.0, 1.0)
    }
}

impl Crown {
    /// 0 outside, 1 in the middle.
    fn cover(&self, point: [f64; 2]) -> f64 {
        let (x, y) = (point[0] - self.middle[0], point[1] - self.middle[1]);
        let along = (x * self.away[0] + y * self.away[1]) / self.half_m[0];
        let across = (x * self.away[1] - y * self.away[0]) / self.half_m[1];
        (1.0 - along.hypot(across)).clamp(0.0, 1.0)
    }
}

/// The ground point of a place that may lie beyond the ends of the road, which go straight on.
fn beside(road: &Road, s: f64, d: f64) -> [f64; 2] {
    let over = s - s.clamp(0.0, road.length_m());
    let place = road.at(s);
    let [x, y] = place.beside(d);
    [x + over * place.heading.sin(), y + over * place.heading.cos()]
}
