//! What the camera burns into its picture: time, names, arrows, bands, an operator's sign.
//!
//! Owns their shapes and the blending, after the sensor and before JPEG: they have neither noise
//! nor blur, and the colour of JPEG. Owns no text of its own.

use jiff::Timestamp;

use super::Image;
use super::painted::arrow;
use crate::font;
use crate::scene::{Ink, Overlay, OverlayKind, Turn};

/// Samples along each side of a pixel.
const SAMPLES: u32 = 3;

/// Space around the shape in a box behind it, share of its height.
const PADDING: f64 = 0.15;

/// `{time}` in a text becomes this, UTC.
const TIME: &str = "%Y-%m-%d %H:%M:%S";

/// Burns overlays into a picture, in their order.
pub fn burn(image: &mut Image, overlays: &[Overlay], time: Timestamp) {
    for overlay in overlays {
        one(image, overlay, time);
    }
}

fn one(image: &mut Image, overlay: &Overlay, time: Timestamp) {
    let size = overlay.size_px;
    let left = overlay.x * f64::from(image.width);
    let top = overlay.y * f64::from(image.height);
    let text = overlay.text.replace("{time}", &time.strftime(TIME).to_string());
    let (strokes, units) = font::line_of(&text);
    let unit = size / font::LINE_HEIGHT;
    let width = match overlay.kind {
        OverlayKind::Text => units * unit,
        OverlayKind::Arrow => size,
        OverlayKind::Logo => 1.6 * size,
        OverlayKind::Bar => overlay.width * f64::from(image.width),
    };
    if let Some(behind) = overlay.behind {
        let pad = PADDING * size;
        let bounds = [left - pad, top - pad, left + width + pad, top + size + pad];
        fill(image, bounds, levels(behind), overlay.opacity, |_| true);
    }
    let bounds = [left, top, left + width, top + size];
    let (sin, cos) = overlay.turn_deg.to_radians().sin_cos();
    let polygons = arrow(Turn::Ahead);
    let holds = |[x, y]: [f64; 2]| match overlay.kind {
        OverlayKind::Bar => true,
        OverlayKind::Text => {
            let point = [x / unit, font::LINE_HEIGHT - y / unit];
            font::inked(&strokes, point, font::HALF_STROKE)
        }
        OverlayKind::Arrow => {
            let (right, up) = (2.0 * x / size - 1.0, 1.0 - 2.0 * y / size);
            let point = [right * cos - up * sin, right * sin + up * cos];
            polygons.iter().any(|polygon| font::in_polygon(polygon, point))
        }
        OverlayKind::Logo => {
            let (u, v) = (x / size, y / size);
            let ring = (u - 0.48).hypot(v - 0.5);
            let edge = u.min(v).min(1.6 - u).min(1.0 - v) < 0.06;
            edge || (0.2..0.32).contains(&ring) || (0.95..1.4).contains(&u) && (v - 0.5).abs() < 0.1
        }
    };
    fill(image, bounds, levels(overlay.colour), overlay.opacity, holds);
}

/// Blends a colour into the pixels of a rectangle as far as `holds` is true of their samples, px
/// from its upper left corner.
fn fill(
    image: &mut Image,
    bounds: [f64; 4],
    colour: [f64; 3],
    opacity: f64,
    holds: impl Fn([f64; 2]) -> bool,
) {
    let [left, top, right, bottom] = bounds;
    let last = |end: f64, size: u32| end.ceil().clamp(0.0, f64::from(size)) as u32;
    for row in top.max(0.0) as u32..last(bottom, image.height) {
        for column in left.max(0.0) as u32..last(right, image.width) {
            let mut inside = 0;
            for i in 0..SAMPLES * SAMPLES {
                let step = |k: u32| (f64::from(k) + 0.5) / f64::from(SAMPLES);
                let x = f64::from(column) + step(i % SAMPLES);
                let y = f64::from(row) + step(i / SAMPLES);
                let within = x >= left && x < right && y >= top && y < bottom;
                inside += u32::from(within && holds([x - left, y - top]));
            }
            let cover = opacity * f64::from(inside) / f64::from(SAMPLES * SAMPLES);
            let at = ((row * image.width + column) * 3) as usize;
            for (level, ink) in image.data[at..at + 3].iter_mut().zip(colour) {
                *level = (f64::from(*level) + cover * (ink - f64::from(*level))).round() as u8;
            }
        }
    }
}

fn levels(ink: Ink) -> [f64; 3] {
    match ink {
        Ink::White => [250.0, 250.0, 250.0],
        Ink::Black => [8.0, 8.0, 8.0],
        Ink::Yellow => [250.0, 225.0, 30.0],
        Ink::Red => [215.0, 25.0, 25.0],
        Ink::Green => [20.0, 160.0, 60.0],
        Ink::Blue => [25.0, 60.0, 170.0],
    }
}
