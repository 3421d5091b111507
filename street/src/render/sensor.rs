//! From samples to the picture a cheap traffic camera sends: lens blur, halos, noise, smear.
//!
//! Owns the imaging chain up to, not with, JPEG. Works in 8-bit levels as the camera's own
//! electronics do, in integers and f32 with a fixed order, so the same seed gives the same bytes.

use super::Image;
use super::canvas::Canvas;
use crate::random::hash;
use crate::scene::Imaging;

/// One picture as three planes of f32 levels: luma and two colour differences.
struct Planes {
    width: usize,
    height: usize,
    luma: Vec<f32>,
    blue: Vec<f32>,
    red: Vec<f32>,
}

/// Turns a canvas into the camera's picture. `salt` differs from frame to frame.
pub fn expose(canvas: &Canvas, width: usize, height: usize, imaging: &Imaging, salt: u64) -> Image {
    let mut planes = downsample(canvas, width, height);
    let blur = kernel(imaging.blur_px);
    let soft_chroma = kernel(imaging.chroma_smear_px.max(imaging.blur_px));
    smooth(&mut planes.luma, width, height, &blur, true);
    if imaging.sharpening > 0.0 {
        sharpen(&mut planes, imaging.sharpening as f32);
    }
    for plane in [&mut planes.blue, &mut planes.red] {
        smooth(plane, width, height, &soft_chroma, false);
    }
    develop(&planes, imaging.noise_levels as f32, salt)
}

fn downsample(canvas: &Canvas, width: usize, height: usize) -> Planes {
    let scale = canvas.scale();
    let stride = canvas.columns() * 4;
    let area = 1.0 / (scale * scale) as f32;
    let mut planes = Planes {
        width,
        height,
        luma: Vec::with_capacity(width * height),
        blue: Vec::with_capacity(width * height),
        red: Vec::with_capacity(width * height),
    };
    let mut sums = vec![[0u32; 3]; width];
    for y in 0..height {
        sums.fill([0; 3]);
        for row in y * scale..(y + 1) * scale {
            let line = &canvas.data()[row * stride..row * stride + width * scale * 4];
            for (sum, block) in sums.iter_mut().zip(line.chunks_exact(4 * scale)) {
                for sample in block.chunks_exact(4) {
                    for k in 0..3 {
                        sum[k] += u32::from(sample[k]);
                    }
                }
            }
        }
        for sum in &sums {
            let [r, g, b] = sum.map(|s| s as f32 * area);
            // ITU-R BT.601, as JPEG.
            let luma = 0.299 * r + 0.587 * g + 0.114 * b;
            planes.luma.push(luma);
            planes.blue.push((b - luma) * 0.564);
            planes.red.push((r - luma) * 0.713);
        }
    }
    planes
}

/// Half of a Gaussian kernel with deviation `sigma` px, from the middle; sums to 1 mirrored.
fn kernel(sigma: f64) -> Vec<f32> {
    if sigma < 0.1 {
        return vec![1.0];
    }
    let reach = (2.5 * sigma).ceil() as usize;
    let weight = |i: usize| (-((i * i) as f64) / (2.0 * sigma * sigma)).exp();
    let sum: f64 = weight(0) + 2.0 * (1..=reach).map(weight).sum::<f64>();
    (0..=reach).map(|i| (weight(i) / sum) as f32).collect()
}

fn smooth(plane: &mut [f32], width: usize, height: usize, kernel: &[f32], both: bool) {
    if kernel.len() == 1 {
        return;
    }
    let reach = kernel.len() - 1;
    let mut line = vec![0.0; width + 2 * reach];
    for row in plane.chunks_exact_mut(width) {
        line[..reach].fill(row[0]);
        line[reach..reach + width].copy_from_slice(row);
        line[reach + width..].fill(row[width - 1]);
        for (x, out) in row.iter_mut().enumerate() {
            let mut sum = kernel[0] * line[x + reach];
            for (i, weight) in kernel.iter().enumerate().skip(1) {
                sum += weight * (line[x + reach - i] + line[x + reach + i]);
            }
            *out = sum;
        }
    }
    if !both {
        return;
    }
    let source = plane.to_vec();
    for y in 0..height {
        let row = |offset: isize| {
            let y = (y as isize + offset).clamp(0, height as isize - 1) as usize;
            &source[y * width..(y + 1) * width]
        };
        let out = &mut plane[y * width..(y + 1) * width];
        for (o, s) in out.iter_mut().zip(row(0)) {
            *o = kernel[0] * s;
        }
        for (i, weight) in kernel.iter().enumerate().skip(1) {
            let (above, below) = (row(-(i as isize)), row(i as isize));
            for ((o, a), b) in out.iter_mut().zip(above).zip(below) {
                *o += weight * (a + b);
            }
        }
    }
}

/// Unsharp mask with the wide, strong kernel of cheap cameras: bright and dark halos.
fn sharpen(planes: &mut Planes, amount: f32) {
    let mut soft = planes.luma.clone();
    smooth(&mut soft, planes.width, planes.height, &kernel(1.2), true);
    for (value, soft) in planes.luma.iter_mut().zip(&soft) {
        *value += amount * (*value - soft).clamp(-60.0, 60.0);
    }
}

fn develop(planes: &Planes, noise: f32, salt: u64) -> Image {
    let (width, height) = (planes.width, planes.height);
    let mut data = Vec::with_capacity(width * height * 3);
    let corner = ((width * width + height * height) as f32) / 4.0;
    for y in 0..height {
        let dy = y as f32 + 0.5 - height as f32 / 2.0;
        for x in 0..width {
            let i = y * width + x;
            let bits = hash(salt ^ i as u64);
            // Sum of four 16-bit uniforms: close to normal, deviation 1 after scaling.
            let sum =
                (bits & 0xffff) + (bits >> 16 & 0xffff) + (bits >> 32 & 0xffff) + (bits >> 48);
            let normal = (sum as f32 / 65_535.0 - 2.0) * 1.732;
            let tint = ((bits >> 7 & 0xff) as f32 - 127.5) / 127.5;
            let dx = x as f32 + 0.5 - width as f32 / 2.0;
            let vignette = 1.0 - 0.12 * (dx * dx + dy * dy) / corner;
            // Shot noise: more of it in the dark after gamma.
            let grain = noise * (1.25 - planes.luma[i].clamp(0.0, 255.0) / 400.0);
            let luma = planes.luma[i] * vignette + grain * normal;
            let blue = planes.blue[i] + 0.4 * grain * tint;
            let red = planes.red[i] - 0.3 * grain * tint;
            let r = luma + 1.403 * red;
            let g = luma - 0.344 * blue - 0.714 * red;
            let b = luma + 1.773 * blue;
            data.extend([r, g, b].map(|level| level.round().clamp(0.0, 255.0) as u8));
        }
    }
    Image { width: width as u32, height: height as u32, data }
}
