//! Vehicles and barriers in the picture: shadows on the road, then bodies from far to near.
//!
//! Owns the order of painting (a painter's algorithm over convex-ish bodies: back faces are
//! dropped, the rest is sorted by distance, decals last). The order of the bodies is `order.rs`,
//! lights' glare is `glow.rs`.

use nalgebra::{Point3, Vector3};

use super::canvas::Canvas;
use super::light::{LOWEST_SUN, Lighting};
use crate::camera::Camera;
use crate::order::{self, Item};
use crate::outline::{hull, hull_boxes};
use crate::simulation::{Placed, Snapshot};
use crate::solid::{Block, Surface};
use crate::vehicle::mesh::{Face, mesh_of};

/// Vehicles lower than this in the picture get no decals, px.
const DECALS_FROM_PX: f64 = 5.0;

/// Paints shadows, then barriers and vehicles.
pub fn paint(
    canvas: &mut Canvas,
    snapshot: &Snapshot,
    blocks: &[Block],
    light: &Lighting,
    camera: &Camera,
) {
    let eye = camera.position();
    let mut items: Vec<Item<Thing>> = Vec::new();
    for vehicle in &snapshot.vehicles {
        if in_picture(vehicle, camera) {
            items.push(Item::vehicle(vehicle, &eye, Thing::Vehicle(vehicle)));
        }
    }
    items.extend(blocks.iter().map(|block| Item::block(block, &eye, Thing::Block(block))));
    let items = order::far_to_near(items, &snapshot.vehicles, &eye);
    for item in &items {
        match item.what {
            Thing::Vehicle(vehicle) => shadow(canvas, vehicle, light, camera),
            Thing::Block(block) if block.shadow => block_shadow(canvas, block, light, camera),
            Thing::Block(_) => {}
        }
    }
    for item in &items {
        match item.what {
            Thing::Vehicle(vehicle) => body(canvas, vehicle, item.distance, light, camera),
            Thing::Block(block) => barrier(canvas, block, item.distance, light, camera),
        }
    }
}

enum Thing<'a> {
    Vehicle(&'a Placed),
    Block(&'a Block),
}

/// True when a sphere around the vehicle touches the picture.
pub fn in_picture(vehicle: &Placed, camera: &Camera) -> bool {
    let centre = Point3::new(vehicle.centre[0], vehicle.centre[1], 1.0);
    let depth = (camera.rotation * centre.coords + camera.translation).z;
    let Some(image) = camera.project(&centre) else { return false };
    if order::is_long(vehicle) && hull_boxes(vehicle, camera).is_none() {
        return false;
    }
    let reach = camera.focal_px * vehicle.model().length_m() / (depth - 6.0).max(2.0);
    image[0] > -reach
        && image[1] > -reach
        && image[0] < f64::from(camera.width) + reach
        && image[1] < f64::from(camera.height) + reach
}

/// The image of a convex set of road points.
fn on_road(points: impl Iterator<Item = [f64; 2]>, camera: &Camera) -> Option<Vec<[f64; 2]>> {
    let image: Option<Vec<_>> =
        points.map(|[x, y]| camera.project(&Point3::new(x, y, 0.0))).collect();
    image.map(hull)
}

fn shadow(canvas: &mut Canvas, vehicle: &Placed, light: &Lighting, camera: &Camera) {
    let model = vehicle.model();
    let sunny = light.sun[1] / (light.sun[1] + light.sky[1] + 1e-6);
    if sunny > 0.05 {
        let reach = light.to_sun / light.to_sun.z.max(LOWEST_SUN);
        let points = mesh_of(vehicle.model_index).parts.iter().flatten().map(|point| {
            let p = vehicle.world(*point);
            [p.x - p.z * reach.x, p.y - p.z * reach.y]
        });
        if let Some(outline) = on_road(points, camera) {
            // In gamma-coded levels a share s of light lost is about s^1.3 darker.
            canvas.polygon(&outline, [8, 8, 12], 0.62 * sunny);
        }
    }
    // The sky's light is missing below and close around the body.
    let wet_lift = 1.0 - 0.3 * light.wet;
    for (grow, opacity) in [(0.45, 0.16), (0.22, 0.28), (0.0, 0.55)] {
        let [x0, x1] = model.sides_m;
        let [y0, y1] = model.ends_m;
        let corners = [
            [x0 - grow, y0 - 0.6 * grow],
            [x1 + grow, y0 - 0.6 * grow],
            [x1 + grow, y1 + 0.6 * grow],
            [x0 - grow, y1 + 0.6 * grow],
        ];
        let points = corners.into_iter().map(|[x, y]| {
            let p = vehicle.world([x, y, 0.0]);
            [p.x, p.y]
        });
        if let Some(outline) = on_road(points, camera) {
            canvas.polygon(&outline, [6, 6, 8], opacity * wet_lift);
        }
    }
}

fn block_shadow(canvas: &mut Canvas, block: &Block, light: &Lighting, camera: &Camera) {
    let reach = light.to_sun / light.to_sun.z.max(LOWEST_SUN);
    let fallen = block.corners().map(|p| [p.x - p.z * reach.x, p.y - p.z * reach.y]);
    let around = block
        .foot
        .map(|p| std::array::from_fn(|k| block.middle[k] + 1.25 * (p[k] - block.middle[k])));
    let sunny = light.sun[1] / (light.sun[1] + light.sky[1] + 1e-6);
    let layers = [(fallen.to_vec(), 0.62 * sunny), (around.to_vec(), 0.3)];
    for (points, opacity) in layers {
        if let Some(outline) = on_road(points.into_iter(), camera).filter(|_| opacity > 0.03) {
            canvas.polygon(&outline, [8, 8, 12], opacity);
        }
    }
}

fn body(canvas: &mut Canvas, vehicle: &Placed, distance: f64, light: &Lighting, camera: &Camera) {
    let mesh = mesh_of(vehicle.model_index);
    let eye = camera.position();
    let mut facing: Vec<(f64, &Face, Vector3<f64>, Vector3<f64>)> = Vec::with_capacity(64);
    let see = |face: &'static Face| {
        let middle = vehicle.world(face.middle);
        let normal = vehicle.turn(face.normal);
        let to_eye = eye - middle;
        let far = to_eye.norm();
        (normal.dot(&to_eye) > 0.0).then(|| (far, face, normal, to_eye / far))
    };
    facing.extend(mesh.faces.iter().filter_map(see));
    facing.sort_by(|a, b| b.0.total_cmp(&a.0));
    let height_px = camera.focal_px * vehicle.model().height_m / distance.max(1.0);
    if height_px >= DECALS_FROM_PX {
        facing.extend(mesh.decals.iter().filter_map(see));
    }
    let mut image = Vec::with_capacity(12);
    for (far, face, normal, to_eye) in facing {
        image.clear();
        let corners = face.corners.iter().map(|corner| camera.project(&vehicle.world(*corner)));
        image.extend(corners.flatten());
        if image.len() < face.corners.len() {
            continue;
        }
        let radiance =
            light.face(&vehicle.livery, face.material, &normal, &to_eye, vehicle.braking);
        canvas.polygon(&image, light.levels(light.through_haze(radiance, far)), 1.0);
    }
}

fn barrier(canvas: &mut Canvas, block: &Block, distance: f64, light: &Lighting, camera: &Camera) {
    let corners = block.corners();
    let eye = camera.position();
    let albedo = match block.surface {
        Surface::Concrete => [0.36, 0.355, 0.34],
        Surface::Hedge => [0.045, 0.085, 0.025],
        Surface::Element => [0.42, 0.415, 0.40],
        Surface::Red => [0.55, 0.075, 0.03],
        Surface::White => [0.72, 0.72, 0.70],
    };
    // Sides around the foot, then the top.
    let faces = [[0, 1, 5, 4], [1, 2, 6, 5], [2, 3, 7, 6], [3, 0, 4, 7], [4, 5, 6, 7]];
    for face in faces {
        let [a, b, c, d] = face.map(|i| corners[i]);
        let normal = (b - a).cross(&(d - a)).normalize();
        if normal.dot(&(eye - a)) <= 0.0 {
            continue;
        }
        let image: Option<Vec<_>> = [a, b, c, d].iter().map(|p| camera.project(p)).collect();
        let Some(image) = image else { continue };
        let falling = light.irradiance(&normal, 1.0, 0.5);
        let radiance = std::array::from_fn(|k| albedo[k] * falling[k]);
        canvas.polygon(&image, light.levels(light.through_haze(radiance, distance)), 1.0);
    }
}
