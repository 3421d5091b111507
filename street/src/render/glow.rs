//! Lights after dark and in rain: beams on the road, glare around lamps, red and green signals.
//!
//! Owns what lamps add to the picture; lamp glass itself is a face of the mesh.

use nalgebra::{Point3, Vector3};

use super::canvas::Canvas;
use super::light::Lighting;
use super::vehicles::in_picture;
use crate::camera::Camera;
use crate::order;
use crate::simulation::{Placed, Simulation, Snapshot};
use crate::vehicle::mesh::{Face, Material, mesh_of};

/// A beam fades over so many nested ovals.
const BEAM_LAYERS: i32 = 10;

/// Beams of headlights on the road; painted before the vehicles.
pub fn beams(canvas: &mut Canvas, snapshot: &Snapshot, light: &Lighting, camera: &Camera) {
    if light.glare < 0.4 {
        return;
    }
    for vehicle in snapshot.vehicles.iter().filter(|v| in_picture(v, camera)) {
        let model = vehicle.model();
        let [middle, _] = model.centre_m();
        let front = model.ends_m[0];
        for step in 0..BEAM_LAYERS {
            let t = f64::from(step) / f64::from(BEAM_LAYERS - 1);
            let (near, far) = (0.4 + 3.5 * t, 22.0 - 15.0 * t);
            let half = 2.1 - 1.6 * t;
            let points: Option<Vec<_>> = (0..16)
                .map(|i| {
                    let (sin, cos) = (f64::from(i) * std::f64::consts::TAU / 16.0).sin_cos();
                    let along = (near + far) / 2.0 + (far - near) / 2.0 * cos;
                    let wide = half * (0.6 + 0.4 * along / far);
                    camera.project(&vehicle.world([middle + wide * sin, front - along, 0.0]))
                })
                .collect();
            if let Some(points) = points {
                canvas.shine(&points, [255, 246, 220], 0.020 * light.glare);
            }
        }
    }
}

/// Glare around lamps that face the camera; painted after the vehicles.
pub fn glare(canvas: &mut Canvas, snapshot: &Snapshot, light: &Lighting, camera: &Camera) {
    if !light.lights_on {
        return;
    }
    let eye = camera.position();
    let lorries: Vec<&Placed> = snapshot.vehicles.iter().filter(|v| order::is_long(v)).collect();
    for vehicle in snapshot.vehicles.iter().filter(|v| in_picture(v, camera)) {
        for lamp in &mesh_of(vehicle.model_index).decals {
            // Glare spreads around what hides a lamp, but not around a whole lorry.
            let place = vehicle.world(lamp.middle);
            if lorries.iter().any(|l| l.id != vehicle.id && l.hides(&place, &eye)) {
                continue;
            }
            lamp_glare(canvas, vehicle, lamp, light, camera, &eye);
        }
    }
}

fn lamp_glare(
    canvas: &mut Canvas,
    vehicle: &Placed,
    lamp: &Face,
    light: &Lighting,
    camera: &Camera,
    eye: &Point3<f64>,
) {
    let (reach, colour, strength) = match lamp.material {
        Material::Headlight => (1.5, [255, 248, 225], 0.75),
        Material::Taillight if vehicle.braking => (0.75, [255, 40, 25], 0.5),
        Material::Taillight => (0.45, [255, 35, 20], 0.3),
        _ => return,
    };
    let middle = vehicle.world(lamp.middle);
    let to_eye = eye - middle;
    let distance = to_eye.norm();
    let facing = vehicle.turn(lamp.normal).dot(&to_eye) / distance;
    if facing <= 0.05 {
        return;
    }
    let Some(image) = camera.project(&middle) else { return };
    let size = camera.focal_px / distance;
    let beam = facing.powf(0.7) as f32;
    let opacity = strength * light.glare * beam;
    canvas.glow(image, (reach * size).max(1.2), colour, opacity);
    if light.wet > 0.2 {
        // The wet road mirrors a lamp as a streak below it.
        let below = Point3::new(middle.x, middle.y, -middle.z);
        if let Some(mirror) = camera.project(&below) {
            for step in 0..5 {
                let t = 0.3 + 0.35 * f64::from(step);
                let at =
                    [image[0] + t * (mirror[0] - image[0]), image[1] + t * (mirror[1] - image[1])];
                canvas.glow(at, (0.5 * reach * size).max(1.0), colour, 0.35 * opacity * light.wet);
            }
        }
    }
}

/// Signal heads beside the stop lines, with the aspect of the moment.
pub fn signals(
    canvas: &mut Canvas,
    street: &Simulation,
    snapshot: &Snapshot,
    light: &Lighting,
    camera: &Camera,
) {
    let scene = street.scene();
    for (index, lane) in scene.lanes.iter().enumerate() {
        let Some(signal) = lane.signal else { continue };
        let s = street.lane_lines()[index].reference_s(signal.at_m);
        let right = lane.offset_m > (scene.road.left_edge_m + scene.road.right_edge_m) / 2.0;
        let aside =
            if right { scene.road.right_edge_m + 0.6 } else { scene.road.left_edge_m - 0.6 };
        let [x, y] = street.road().at(s).beside(aside);
        let across = Vector3::new(camera.rotation[(0, 0)], camera.rotation[(0, 1)], 0.0);
        let distance = (Point3::new(x, y, 3.0) - camera.position()).norm();
        let slab = |half: f64, low: f64, high: f64| -> Option<Vec<[f64; 2]>> {
            [(-half, low), (half, low), (half, high), (-half, high)]
                .into_iter()
                .map(|(d, z)| camera.project(&Point3::new(x + d * across.x, y + d * across.y, z)))
                .collect()
        };
        let grey = light
            .levels(light.irradiance(&Vector3::new(0.0, -1.0, 0.0), 1.0, 0.5).map(|e| 0.2 * e));
        if let (Some(post), Some(head)) = (slab(0.06, 0.0, 3.0), slab(0.2, 2.6, 3.6)) {
            canvas.polygon(&post, grey, 1.0);
            canvas.polygon(&head, [18, 18, 18], 1.0);
        }
        let (z, colour) =
            if snapshot.red[index] { (3.4, [255, 40, 20]) } else { (2.8, [40, 255, 140]) };
        if let Some(lamp) = camera.project(&Point3::new(x, y, z)) {
            let size = camera.focal_px / distance;
            canvas.disc(lamp, (0.13 * size).max(0.5), colour);
            canvas.glow(lamp, (0.7 * size).max(1.0), colour, 0.3 + 0.5 * light.glare);
        }
    }
}
