//! Standing scenery of the still picture: trees, buildings, bridges, lamp posts, signals' posts.
//!
//! Owns their shapes. Painted far to near over the ground, once per camera pose. It never
//! hides vehicles: scenes put it beside the lanes or beyond them.

use nalgebra::{Point3, Vector3};

use super::canvas::Canvas;
use super::light::{Lighting, scale};
use crate::camera::Camera;
use crate::random::Stream;
use crate::road::Road;
use crate::scene::{Daylight, Scene};
use crate::vehicle::paint::Rgb;

enum Thing {
    Polygon(Vec<Point3<f64>>, Rgb, Vector3<f64>),
    Ball(Point3<f64>, f64, Rgb),
    Light(Point3<f64>),
}

/// Paints all standing scenery of a scene.
pub fn paint(
    canvas: &mut Canvas,
    scene: &Scene,
    road: &Road,
    light: &Lighting,
    camera: &Camera,
    seed: u64,
) {
    let mut rng = Stream::new(seed, "scenery");
    let mut things = Vec::new();
    let night = scene.light.daylight == Daylight::Night;
    for row in &scene.roadside.buildings {
        let mut s = row.from_m;
        while s < row.to_m {
            let length = rng.range(14.0, 30.0).min(row.to_m - s + 5.0);
            let height = row.height_m * rng.range(0.6, 1.4);
            building(&mut things, road, [s, s + length], row.offset_m, height, night, &mut rng);
            s += length + rng.range(0.0, 4.0);
        }
    }
    for row in &scene.roadside.trees {
        let mut s = row.from_m;
        while s <= row.to_m {
            let [x, y] = road.at(s).beside(row.offset_m + rng.normal(0.0, 0.8));
            tree(&mut things, [x, y], row.height_m * rng.range(0.8, 1.2), light, &mut rng);
            s += row.spacing_m * rng.range(0.8, 1.2);
        }
    }
    for row in &scene.roadside.lamps {
        let mut s = row.from_m;
        while s <= row.to_m {
            lamp(&mut things, road, s, row.offset_m, row.height_m);
            s += row.spacing_m;
        }
    }
    for bridge in &scene.roadside.bridges {
        let place = road.at(bridge.at_m);
        let span = bridge.half_span_m;
        let (near, deck) = (bridge.clearance_m, bridge.clearance_m + bridge.depth_m);
        for (from, to, tone) in
            [(near, near + 0.5 * bridge.depth_m, 0.26), (near + 0.5 * bridge.depth_m, deck, 0.42)]
        {
            let ([ax, ay], [bx, by]) = (place.beside(-span), place.beside(span));
            let corners = vec![
                Point3::new(ax, ay, from),
                Point3::new(bx, by, from),
                Point3::new(bx, by, to),
                Point3::new(ax, ay, to),
            ];
            let facing = Vector3::new(-place.heading.sin(), -place.heading.cos(), 0.0);
            things.push(Thing::Polygon(corners, [tone, tone, 0.97 * tone], facing));
        }
    }
    let eye = camera.position();
    let depth = |thing: &Thing| match thing {
        Thing::Polygon(corners, ..) => {
            corners.iter().map(|c| (c - eye).norm()).sum::<f64>() / corners.len() as f64
        }
        Thing::Ball(centre, ..) | Thing::Light(centre) => (centre - eye).norm(),
    };
    let mut ordered: Vec<(f64, Thing)> = things.into_iter().map(|t| (depth(&t), t)).collect();
    ordered.sort_by(|a, b| b.0.total_cmp(&a.0));
    for (distance, thing) in &ordered {
        draw(canvas, thing, *distance, light, camera);
    }
}

fn draw(canvas: &mut Canvas, thing: &Thing, distance: f64, light: &Lighting, camera: &Camera) {
    match thing {
        Thing::Polygon(corners, albedo, normal) => {
            let image: Option<Vec<_>> = corners.iter().map(|c| camera.project(c)).collect();
            let Some(image) = image else { return };
            let falling = light.irradiance(normal, 1.0, 0.25);
            let radiance = std::array::from_fn(|k| albedo[k] * falling[k]);
            canvas.polygon(&image, light.levels(light.through_haze(radiance, distance)), 1.0);
        }
        Thing::Ball(centre, radius, radiance) => {
            let Some(image) = camera.project(centre) else { return };
            let size = camera.focal_px * radius / distance;
            canvas.disc(image, size, light.levels(light.through_haze(*radiance, distance)));
        }
        Thing::Light(centre) => {
            if light.glare < 0.4 {
                return;
            }
            let Some(image) = camera.project(centre) else { return };
            let size = camera.focal_px / distance;
            canvas.glow(image, (2.2 * size).max(2.5), [255, 214, 150], 0.8 * light.glare);
            canvas.disc(image, (0.3 * size).max(0.6), [255, 244, 214]);
        }
    }
}

fn building(
    things: &mut Vec<Thing>,
    road: &Road,
    span: [f64; 2],
    offset: f64,
    height: f64,
    night: bool,
    rng: &mut Stream,
) {
    let (a, b) = (road.at(span[0]), road.at(span[1]));
    let depth = 16.0 * offset.signum();
    let tone = rng.range(0.14, 0.5) as f32;
    let wall = [tone, tone * rng.range(0.88, 0.98) as f32, tone * rng.range(0.75, 0.95) as f32];
    let ([ax, ay], [bx, by]) = (a.beside(offset), b.beside(offset));
    let ([cx, cy], [dx, dy]) = (a.beside(offset + depth), b.beside(offset + depth));
    let side = |p: [f64; 2], q: [f64; 2], low: f64, high: f64| {
        vec![
            Point3::new(p[0], p[1], low),
            Point3::new(q[0], q[1], low),
            Point3::new(q[0], q[1], high),
            Point3::new(p[0], p[1], high),
        ]
    };
    let to_road = Vector3::new(a.heading.cos(), -a.heading.sin(), 0.0) * -offset.signum();
    let to_near = Vector3::new(-a.heading.sin(), -a.heading.cos(), 0.0);
    things.push(Thing::Polygon(side([cx, cy], [ax, ay], 0.0, height), wall, to_near));
    things.push(Thing::Polygon(side([ax, ay], [bx, by], 0.0, height), wall, to_road));
    let roof = vec![
        Point3::new(ax, ay, height),
        Point3::new(bx, by, height),
        Point3::new(dx, dy, height),
        Point3::new(cx, cy, height),
    ];
    things.push(Thing::Polygon(roof, [0.2, 0.2, 0.2], Vector3::z()));
    let floors = (height / 3.2) as usize;
    let bays = ((span[1] - span[0]) / 3.5) as usize;
    for floor in 0..floors {
        for bay in 0..bays {
            let t = |k: f64| (bay as f64 + k) / bays as f64;
            // Slightly in front of the wall, so that it sorts nearer than the wall.
            let out = -0.05 * offset.signum();
            let at = |k: f64| {
                [ax + t(k) * (bx - ax) + out * to_road.x, ay + t(k) * (by - ay) + out * to_road.y]
            };
            let z = floor as f64 * 3.2 + 1.0;
            let lit = night && rng.unit() < 0.3;
            let glass = if lit { [2.5, 1.9, 1.1] } else { [0.05, 0.06, 0.07] };
            things.push(Thing::Polygon(side(at(0.25), at(0.75), z, z + 1.5), glass, to_road));
        }
    }
}

fn tree(things: &mut Vec<Thing>, foot: [f64; 2], height: f64, light: &Lighting, rng: &mut Stream) {
    let at = |x: f64, y: f64, z: f64| Point3::new(foot[0] + x, foot[1] + y, z);
    let trunk = vec![
        at(-0.15, 0.0, 0.0),
        at(0.15, 0.0, 0.0),
        at(0.1, 0.0, 0.5 * height),
        at(-0.1, 0.0, 0.5 * height),
    ];
    things.push(Thing::Polygon(trunk, [0.07, 0.05, 0.035], Vector3::new(0.0, -1.0, 0.0)));
    let crown = 0.40 * height;
    let hue = [0.06 * rng.range(0.8, 1.3), 0.10 * rng.range(0.85, 1.15), 0.035];
    let count = (130.0 * crown) as usize;
    for _ in 0..count {
        // A point in an upright ellipsoid, denser near its skin.
        let (azimuth, lift) = (rng.range(0.0, std::f64::consts::TAU), rng.range(-0.9, 1.0));
        let reach = rng.unit().powf(0.4);
        let flat = (1.0f64 - lift * lift).max(0.0).sqrt() * reach;
        let normal = Vector3::new(flat * azimuth.cos(), flat * azimuth.sin(), lift * reach);
        let centre = at(crown * normal.x, crown * normal.y, 0.62 * height + 0.9 * crown * normal.z);
        let towards = (normal + Vector3::new(0.0, 0.0, 0.15)).try_normalize(1e-9);
        let falling = light.irradiance(&towards.unwrap_or_else(Vector3::z), 1.0, 0.25);
        // Leaves shade each other: darker inside, speckled outside.
        let speckle = rng.range(0.35, 1.25) * (0.35 + 0.65 * reach * reach);
        let radiance: Rgb = std::array::from_fn(|k| (hue[k] * speckle) as f32 * falling[k]);
        things.push(Thing::Ball(centre, crown * rng.range(0.05, 0.13), scale(radiance, 1.1)));
    }
}

fn lamp(things: &mut Vec<Thing>, road: &Road, s: f64, offset: f64, height: f64) {
    let place = road.at(s);
    let inward = -offset.signum();
    let grey = [0.25, 0.25, 0.26];
    let facing = Vector3::new(-place.heading.sin(), -place.heading.cos(), 0.0);
    let at = |d: f64, z: f64| {
        let [x, y] = place.beside(offset + inward * d);
        Point3::new(x, y, z)
    };
    things.push(Thing::Polygon(
        vec![at(-0.09, 0.0), at(0.09, 0.0), at(0.06, height), at(-0.06, height)],
        grey,
        facing,
    ));
    things.push(Thing::Polygon(
        vec![
            at(0.0, height - 0.1),
            at(1.7, height + 0.25),
            at(1.7, height + 0.4),
            at(0.0, height + 0.05),
        ],
        grey,
        facing,
    ));
    things.push(Thing::Light(at(1.6, height + 0.1)));
}
