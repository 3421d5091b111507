//! Rain in front of the camera: short slanted streaks.
//!
//! Owns only the drops; wet road, haze and lights are `light.rs` and `glow.rs`.

use super::canvas::Canvas;
use crate::random::Stream;

/// Streaks per picture in heavy rain.
const STREAKS: f64 = 260.0;

/// Paints one frame's streaks; `rain` 0 to 1.
pub fn paint(canvas: &mut Canvas, size: (u32, u32), rain: f64, seed: u64, frame: u64) {
    let mut rng = Stream::new(seed ^ frame.wrapping_mul(0x9e37_79b9_7f4a_7c15), "rain");
    let (width, height) = (f64::from(size.0), f64::from(size.1));
    for _ in 0..(STREAKS * rain) as usize {
        let (x, y) = (rng.range(0.0, width), rng.range(-0.1 * height, height));
        let length = rng.range(0.02, 0.07) * height;
        let lean = 0.12 * length;
        let half = rng.range(0.15, 0.4);
        let streak = [
            [x - half, y],
            [x + half, y],
            [x + half + lean, y + length],
            [x - half + lean, y + length],
        ];
        canvas.polygon(&streak, [205, 210, 215], rng.range(0.08, 0.22) as f32);
    }
}
