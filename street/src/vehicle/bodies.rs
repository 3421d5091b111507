//! The shapes of the ten models: three-box cars, van, double-decker, trucks, motorcycle.
//!
//! Owns the proportions. All lengths in metres in the model frame (front at negative Y).

use super::loft::{Builder, Ring, Strip};
use super::mesh::{Material, Mesh};
use super::{Class, Model};

/// The mesh of a model.
pub fn build(model: &Model) -> Mesh {
    let mut builder = Builder::new(model.centre_m()[0]);
    match model.class {
        Class::Car => car(&mut builder, model),
        Class::Van => van(&mut builder, model),
        Class::Bus => bus(&mut builder, model),
        Class::Truck if model.length_m() > 12.0 => articulated(&mut builder, model),
        Class::Truck => truck(&mut builder, model),
        Class::Motorcycle => motorcycle(&mut builder, model),
    }
    builder.finish()
}

const fn strip(window: Material, rail: Material, top: Material) -> Strip {
    Strip { side: Material::Paint, window, rail, top }
}

const BODY: Strip = strip(Material::Paint, Material::Paint, Material::Paint);

fn car(b: &mut Builder, model: &Model) {
    use Material::{Glass, Headlight, Paint, Plate, Roof, Shade, Taillight, Trim};
    let half = model.width_m() / 2.0 - 0.01;
    let [front, rear] = model.ends_m;
    let length = model.length_m();
    let roof = model.height_m;
    let along = |fraction: f64| front + fraction * length;
    let cowl = model.key_points[3][1];
    // A ring of hood or trunk: flat top at z, no window.
    let low = |y: f64, w: f64, belt: f64, z: f64| Ring {
        y,
        half: [0.93 * w * half, w * half, 0.985 * w * half, 0.90 * w * half, 0.74 * w * half],
        z: [0.22, 0.5, belt, z - 0.015, z],
        crown: z + 0.02,
    };
    // A ring of the cabin: windows between belt and roof edge.
    let high = |y: f64, belt: f64, z: f64, top: f64| Ring {
        y,
        half: [0.94 * half, half, 0.975 * half, top * half + 0.05, top * half - 0.03],
        z: [0.2, 0.5, belt, z - 0.10, z - 0.03],
        crown: z,
    };
    let rings = [
        low(front, 0.80, 0.52, 0.60),
        low(front + 0.14, 0.93, 0.62, 0.72),
        low(front + 0.45, 0.985, 0.72, 0.82),
        low(cowl - 0.25, 1.0, 0.86, 0.95),
        low(cowl, 1.0, 0.90, 0.99),
        high(cowl + 0.8, 0.93, roof - 0.05, 0.72),
        high(along(0.53), 0.94, roof, 0.74),
        high(along(0.70), 0.96, roof - 0.04, 0.72),
        low(along(0.86), 1.0, 0.97, 1.06),
        low(rear - 0.12, 0.97, 0.93, 1.03),
        low(rear, 0.90, 0.80, 0.90),
    ];
    let cabin = strip(Glass, Paint, Roof);
    let screen = strip(Glass, Paint, Glass);
    let strips = [BODY, BODY, BODY, BODY, screen, cabin, cabin, screen, BODY, BODY];
    b.loft(&rings, &strips, Paint, Paint);

    let [x0, x1] = [model.centre_m()[0] - half, model.centre_m()[0] + half];
    let middle = model.centre_m()[0];
    // Front: lower intake, grille, lights at their key points, plate.
    let nose = front - 0.004;
    b.on_front([x0 + 0.22, x1 - 0.22], [0.22, 0.38], nose, Shade);
    b.on_front([middle - 0.42, middle + 0.42], [0.46, 0.60], nose, Trim);
    let lights = (&model.key_points[0], &model.key_points[1]);
    for (light, outward) in [(lights.0, -1.0), (lights.1, 1.0)] {
        let (inner, outer) = (light[0] - outward * 0.14, light[0] + outward * 0.2);
        let span = [inner.min(outer).max(x0 + 0.04), inner.max(outer).min(x1 - 0.04)];
        b.on_front(span, [light[2] - 0.08, light[2] + 0.07], light[1] - 0.2, Headlight);
    }
    b.on_front(
        [middle - 0.26, middle + 0.26],
        [model.key_points[2][2] - 0.06, model.key_points[2][2] + 0.06],
        nose,
        Plate,
    );
    // Rear: lights, plate, bumper.
    let tail = rear + 0.004;
    b.on_rear([x0 + 0.08, x0 + 0.45], [0.66, 0.86], tail, Taillight);
    b.on_rear([x1 - 0.45, x1 - 0.08], [0.66, 0.86], tail, Taillight);
    b.on_rear([middle - 0.26, middle + 0.26], [0.60, 0.72], tail, Plate);
    b.on_rear([x0 + 0.12, x1 - 0.12], [0.22, 0.36], tail, Trim);
    // Flanks: pillars, wheels.
    b.on_flanks(0.985 * half, [along(0.53) - 0.04, along(0.53) + 0.05], [0.5, 0.93], Paint);
    b.wheels(half, front + 0.19 * length, 0.32);
    b.wheels(half, front + 0.79 * length, 0.32);
    mirrors(b, model, 0.12);
}

fn mirrors(b: &mut Builder, model: &Model, height: f64) {
    for (point, outward) in [(model.key_points[4], -1.0), (model.key_points[5], 1.0)] {
        let inner = point[0] - outward * 0.18;
        let x = [point[0].min(inner), point[0].max(inner)];
        let z = [point[2] - height / 2.0, point[2] + height / 2.0];
        b.cuboid(x, [point[1] - 0.05, point[1] + 0.06], z, Material::Paint);
    }
}

fn van(b: &mut Builder, model: &Model) {
    use Material::{Glass, Headlight, Paint, Plate, Roof, Shade, Taillight, Trim};
    let half = model.width_m() / 2.0;
    let [front, rear] = model.ends_m;
    let roof = model.height_m;
    let ring = |y: f64, w: f64, belt: f64, edge: f64, z: f64| Ring {
        y,
        half: [0.95 * w * half, w * half, 0.985 * w * half, edge * half + 0.05, edge * half],
        z: [0.25, 0.6, belt, z - 0.16, z - 0.05],
        crown: z,
    };
    let rings = [
        ring(front, 0.86, 0.62, 0.70, 0.82),
        ring(front + 0.15, 0.96, 0.74, 0.82, 0.98),
        ring(front + 0.7, 1.0, 1.02, 0.86, 1.28),
        ring(front + 1.45, 1.0, 1.15, 0.84, roof - 0.06),
        ring(front + 2.1, 1.0, 1.18, 0.86, roof),
        ring(rear - 0.1, 1.0, 1.18, 0.86, roof),
        ring(rear, 0.99, 1.18, 0.82, roof - 0.08),
    ];
    let strips = [
        BODY,
        BODY,
        strip(Glass, Paint, Glass),
        strip(Glass, Paint, Roof),
        strip(Paint, Paint, Roof),
        strip(Paint, Paint, Roof),
    ];
    b.loft(&rings, &strips, Paint, Paint);
    let middle = model.centre_m()[0];
    let (x0, x1) = (middle - half, middle + half);
    let nose = front - 0.004;
    b.on_front([x0 + 0.25, x1 - 0.25], [0.25, 0.42], nose, Shade);
    b.on_front([middle - 0.5, middle + 0.5], [0.58, 0.74], nose, Trim);
    b.on_front([x0 + 0.1, x0 + 0.42], [0.68, 0.9], front - 0.02, Headlight);
    b.on_front([x1 - 0.42, x1 - 0.1], [0.68, 0.9], front - 0.02, Headlight);
    b.on_front([middle - 0.26, middle + 0.26], [0.44, 0.56], nose - 0.002, Plate);
    let tail = rear + 0.004;
    b.on_rear([x0 + 0.18, middle - 0.05], [1.25, 1.85], tail, Glass);
    b.on_rear([middle + 0.05, x1 - 0.18], [1.25, 1.85], tail, Glass);
    b.on_rear([x0 + 0.03, x0 + 0.18], [0.8, 1.2], tail, Taillight);
    b.on_rear([x1 - 0.18, x1 - 0.03], [0.8, 1.2], tail, Taillight);
    b.on_rear([middle - 0.26, middle + 0.26], [0.7, 0.82], tail, Plate);
    b.on_rear([x0 + 0.1, x1 - 0.1], [0.28, 0.45], tail, Trim);
    b.wheels(half, front + 0.95, 0.34);
    b.wheels(half, rear - 1.0, 0.34);
    mirrors(b, model, 0.24);
}

fn bus(b: &mut Builder, model: &Model) {
    use Material::{Glass, Headlight, Paint, Plate, Roof, Shade, Sign, Taillight, Trim};
    let half = model.width_m() / 2.0;
    let [front, rear] = model.ends_m;
    let roof = model.height_m;
    let ring = |y: f64, w: f64, top: f64| Ring {
        y,
        half: [0.97 * w * half, w * half, w * half, 0.97 * w * half, 0.93 * w * half],
        z: [0.3, 1.0, 1.15, 3.9_f64.min(top - 0.3), top - 0.08],
        crown: top,
    };
    let rings = [
        ring(front, 0.93, roof - 0.15),
        ring(front + 0.25, 1.0, roof),
        ring(rear - 0.2, 1.0, roof),
        ring(rear, 0.96, roof - 0.1),
    ];
    let body = strip(Paint, Paint, Roof);
    b.loft(&rings, &[body, body, body], Paint, Paint);
    let middle = model.centre_m()[0];
    let (x0, x1) = (middle - half, middle + half);
    let nose = front - 0.004;
    b.on_front([x0 + 0.18, x1 - 0.18], [1.15, 2.1], nose, Glass);
    b.on_front([x0 + 0.18, x1 - 0.18], [2.72, 3.75], nose, Glass);
    b.on_front([x0 + 0.35, x1 - 0.35], [2.2, 2.6], nose, Trim);
    b.on_front([x0 + 0.5, x1 - 0.5], [2.26, 2.54], nose, Sign);
    b.on_front([x0 + 0.15, x0 + 0.5], [0.62, 0.85], nose, Headlight);
    b.on_front([x1 - 0.5, x1 - 0.15], [0.62, 0.85], nose, Headlight);
    b.on_front([x0 + 0.2, x1 - 0.2], [0.3, 0.38], nose, Shade);
    b.on_front([middle - 0.26, middle + 0.26], [0.4, 0.52], nose, Plate);
    // Window bands of both decks, cut by pillars.
    for (low, high) in [(1.25, 2.1), (2.75, 3.65)] {
        let mut y = front + 0.35;
        while y + 1.35 < rear {
            b.on_flanks(half + 0.003, [y, y + 1.3], [low, high], Glass);
            y += 1.42;
        }
    }
    let tail = rear + 0.004;
    b.on_rear([x0 + 0.25, x1 - 0.25], [2.8, 3.6], tail, Glass);
    b.on_rear([x0 + 0.4, x1 - 0.4], [1.5, 2.2], tail, Trim);
    b.on_rear([x0 + 0.08, x0 + 0.3], [0.8, 1.4], tail, Taillight);
    b.on_rear([x1 - 0.3, x1 - 0.08], [0.8, 1.4], tail, Taillight);
    b.on_rear([x0 + 0.3, x1 - 0.3], [0.5, 1.2], tail, Shade);
    b.on_rear([middle - 0.26, middle + 0.26], [0.5, 0.62], tail, Plate);
    b.wheels(half, front + 2.6, 0.48);
    b.wheels(half, rear - 3.2, 0.48);
    mirrors(b, model, 0.35);
}

fn truck(b: &mut Builder, model: &Model) {
    use Material::{Glass, Headlight, Paint, Plate, Roof, Shade, Taillight, Trim};
    let half = model.width_m() / 2.0;
    let [front, rear] = model.ends_m;
    let ring = |y: f64, w: f64, top: f64, belt: f64| Ring {
        y,
        half: [0.9 * w * half, 0.93 * w * half, 0.93 * w * half, 0.88 * w * half, 0.8 * w * half],
        z: [0.35, 0.9, belt, top - 0.2, top - 0.05],
        crown: top,
    };
    // Cab: a flat front that leans back over the windscreen.
    let rings = [
        ring(front, 0.97, 1.55, 1.2),
        ring(front + 0.12, 1.0, 1.75, 1.35),
        ring(front + 0.45, 1.0, 2.5, 1.45),
        ring(front + 1.75, 1.0, 2.55, 1.45),
    ];
    let screen = strip(Glass, Paint, Glass);
    b.loft(&rings, &[BODY, screen, strip(Glass, Paint, Paint)], Paint, Paint);
    let middle = model.centre_m()[0];
    let (x0, x1) = (middle - half, middle + half);
    // Chassis and load.
    b.cuboid([x0 + 0.15, x1 - 0.15], [front + 1.6, rear - 0.1], [0.45, 1.0], Trim);
    b.cuboid([x0, x1], [front + 1.95, rear], [0.98, model.height_m], Roof);
    let nose = front - 0.004;
    b.on_front([x0 + 0.35, x1 - 0.35], [0.95, 1.2], nose, Trim);
    b.on_front([x0 + 0.14, x0 + 0.45], [0.68, 0.9], nose, Headlight);
    b.on_front([x1 - 0.45, x1 - 0.14], [0.68, 0.9], nose, Headlight);
    b.on_front([x0 + 0.3, x1 - 0.3], [0.35, 0.48], nose, Shade);
    b.on_front([middle - 0.26, middle + 0.26], [0.5, 0.62], nose, Plate);
    let tail = rear + 0.004;
    b.on_rear([middle - 0.02, middle + 0.02], [1.0, model.height_m - 0.1], tail, Shade);
    b.on_rear([x0 + 0.1, x0 + 0.5], [0.82, 0.97], tail, Taillight);
    b.on_rear([x1 - 0.5, x1 - 0.1], [0.82, 0.97], tail, Taillight);
    b.on_rear([middle - 0.26, middle + 0.26], [0.6, 0.72], tail, Plate);
    b.wheels(half - 0.1, front + 0.95, 0.42);
    b.wheels(half - 0.1, rear - 1.7, 0.42);
    mirrors(b, model, 0.4);
}

/// Length of a semi-trailer, m.
const TRAILER_M: f64 = 13.6;

fn articulated(b: &mut Builder, model: &Model) {
    use Material::{Glass, Headlight, Paint, Plate, Roof, Shade, Taillight, Trim};
    let half = model.width_m() / 2.0;
    let [front, rear] = model.ends_m;
    let ring = |y: f64, w: f64, top: f64, belt: f64| Ring {
        y,
        half: [0.92 * w * half, 0.95 * w * half, 0.95 * w * half, 0.92 * w * half, 0.82 * w * half],
        z: [0.35, 1.0, belt, top - 0.25, top - 0.06],
        crown: top,
    };
    // Cab over the engine, with a fairing up to the trailer's roof.
    let rings = [
        ring(front, 0.97, 2.0, 1.5),
        ring(front + 0.1, 1.0, 2.2, 1.7),
        ring(front + 0.3, 1.0, 2.95, 1.8),
        ring(front + 1.0, 1.0, 3.45, 1.8),
        ring(front + 2.2, 1.0, 3.75, 1.8),
    ];
    let side = strip(Glass, Paint, Paint);
    let back = strip(Paint, Paint, Paint);
    b.loft(&rings, &[BODY, strip(Glass, Paint, Glass), side, back], Paint, Shade);
    let middle = model.centre_m()[0];
    let (x0, x1) = (middle - half, middle + half);
    // Chassis in the gap behind the cab, the trailer's bed and its box. Bed and box have one middle,
    // so that sorting by distance paints the box over its bed.
    b.cuboid([x0 + 0.35, x1 - 0.35], [front + 2.1, rear - TRAILER_M], [0.5, 1.05], Trim);
    b.cuboid([x0 + 0.25, x1 - 0.25], [rear - TRAILER_M + 1.6, rear - 1.6], [0.7, 1.15], Trim);
    b.cuboid([x0, x1], [rear - TRAILER_M, rear], [1.15, model.height_m], Roof);
    let nose = front - 0.004;
    b.on_front([x0 + 0.3, x1 - 0.3], [1.0, 1.45], nose, Trim);
    b.on_front([x0 + 0.14, x0 + 0.5], [0.72, 0.96], nose, Headlight);
    b.on_front([x1 - 0.5, x1 - 0.14], [0.72, 0.96], nose, Headlight);
    b.on_front([x0 + 0.3, x1 - 0.3], [0.35, 0.5], nose, Shade);
    b.on_front([middle - 0.26, middle + 0.26], [0.5, 0.62], nose, Plate);
    let tail = rear + 0.004;
    b.on_rear([middle - 0.02, middle + 0.02], [1.2, model.height_m - 0.1], tail, Shade);
    b.on_rear([x0 + 0.08, x0 + 0.55], [0.9, 1.08], tail, Taillight);
    b.on_rear([x1 - 0.55, x1 - 0.08], [0.9, 1.08], tail, Taillight);
    b.on_rear([x0 + 0.1, x1 - 0.1], [0.5, 0.62], tail, Trim);
    b.on_rear([middle - 0.26, middle + 0.26], [0.66, 0.78], tail, Plate);
    for y in [front + 1.4, front + 5.2, rear - 4.6, rear - 3.3, rear - 2.0] {
        b.wheels(half - 0.08, y, 0.48);
    }
    b.on_flanks(half - 0.2, [front + 6.4, rear - 5.4], [0.55, 1.1], Trim);
    mirrors(b, model, 0.5);
}

fn motorcycle(b: &mut Builder, model: &Model) {
    use Material::{Cloth, Headlight, Helmet, Paint, Plate, Shade, Taillight, Tyre};
    let middle = model.centre_m()[0];
    let [front, rear] = model.ends_m;
    let slim = |half: f64, y: [f64; 2], z: [f64; 2]| ([middle - half, middle + half], y, z);
    let parts = [
        (slim(0.07, [front, front + 0.6], [0.0, 0.6]), Tyre),
        (slim(0.08, [rear - 0.62, rear - 0.02], [0.0, 0.6]), Tyre),
        (slim(0.2, [front + 0.5, rear - 0.3], [0.3, 0.75]), Shade),
        (slim(0.17, [front + 0.45, rear - 0.05], [0.6, 0.85]), Paint),
        (slim(0.2, [front + 0.15, front + 0.5], [0.6, 1.1]), Paint),
        (slim(0.39, [front + 0.5, front + 0.56], [1.05, 1.2]), Shade),
        (slim(0.26, [front + 0.85, front + 1.3], [0.35, 0.95]), Cloth),
        (slim(0.24, [front + 0.8, front + 1.2], [0.9, 1.4]), Cloth),
        (slim(0.13, [front + 0.8, front + 1.08], [1.38, 1.65]), Helmet),
        (slim(0.2, [rear - 0.4, rear], [0.7, 1.0]), Shade),
    ];
    for ((x, y, z), material) in parts {
        b.cuboid(x, y, z, material);
    }
    b.on_front([middle - 0.08, middle + 0.08], [0.76, 0.94], front + 0.14, Headlight);
    b.on_rear([middle - 0.1, middle + 0.1], [0.72, 0.8], rear + 0.004, Taillight);
    b.on_rear([middle - 0.1, middle + 0.1], [0.5, 0.66], rear + 0.002, Plate);
}
