//! The picture into the net's input: scaled without distortion, centred, normalised.
//!
//! Owns the geometry between picture and input, and the resampling. Scaling is linear
//! interpolation with aligned pixel centres; a picture that shrinks is averaged over the
//! pixels that each new one covers (a triangle filter as wide as the ratio), so that it
//! does not alias.

use super::sidecar::Normalisation;
use crate::daemon::flow::{Picture, PixelBox};

/// Value of the bars beside a picture of another shape, before normalisation.
const BAR: f32 = 114.0;

/// The net's input and what is needed to fill it. Everything is kept between pictures.
#[derive(Debug)]
pub(super) struct Letterbox {
    input: [usize; 2],
    normalisation: Normalisation,
    planes: Vec<f32>,
    fit: Option<Fit>,
    columns: Taps,
    rows: Taps,
    /// One picture row resampled to the new width, RGB interleaved, per cached row.
    cache: Vec<f32>,
    cached: Vec<usize>,
}

/// Where a picture of one size lies in the input.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Fit {
    picture: [usize; 2],
    size: [usize; 2],
    offset: [usize; 2],
}

impl Fit {
    fn new(picture: [usize; 2], input: [usize; 2]) -> Self {
        let scale = (input[0] as f64 / picture[0] as f64).min(input[1] as f64 / picture[1] as f64);
        let fitted =
            |axis: usize| ((picture[axis] as f64 * scale).round() as usize).clamp(1, input[axis]);
        let size = [fitted(0), fitted(1)];
        Self { picture, size, offset: [(input[0] - size[0]) / 2, (input[1] - size[1]) / 2] }
    }
}

impl Letterbox {
    pub(super) fn new(input: [usize; 2], normalisation: &Normalisation) -> Self {
        let planes = vec![0.0; 3 * input[0] * input[1]];
        Self {
            input,
            normalisation: *normalisation,
            planes,
            fit: None,
            columns: Taps::default(),
            rows: Taps::default(),
            cache: Vec::new(),
            cached: Vec::new(),
        }
    }

    /// Columns and rows of the input, px.
    pub(super) fn input(&self) -> [usize; 2] {
        self.input
    }

    /// The filled input: three planes of `rows x columns`.
    pub(super) fn planes(&self) -> &[f32] {
        &self.planes
    }

    /// Fills the input from `picture`.
    pub(super) fn fill(&mut self, picture: &Picture) {
        let fit = Fit::new([picture.width, picture.height], self.input);
        if self.fit != Some(fit) {
            self.refit(fit);
        }
        let [width, height] = self.input;
        let row_len = fit.size[0] * 3;
        self.cached.fill(usize::MAX);
        for row in 0..fit.size[1] {
            for (source, _) in self.rows.of(row) {
                let slot = source % self.cached.len();
                if self.cached[slot] != source {
                    self.cached[slot] = source;
                    let pixels = &picture.rgb[source * picture.width * 3..][..picture.width * 3];
                    let cache = &mut self.cache[slot * row_len..][..row_len];
                    resample_row(pixels, &self.columns, cache);
                }
            }
            let start = (row + fit.offset[1]) * width + fit.offset[0];
            for (plane, &(channel, mean, gain)) in self.normalisation.iter().enumerate() {
                let out = &mut self.planes[plane * width * height + start..][..fit.size[0]];
                out.fill(-mean * gain);
                for (source, weight) in self.rows.of(row) {
                    let slot = source % self.cached.len();
                    let cache = &self.cache[slot * row_len..][..row_len];
                    let weight = weight * gain;
                    for (out, pixel) in out.iter_mut().zip(cache.as_chunks::<3>().0) {
                        *out += pixel[channel] * weight;
                    }
                }
            }
        }
    }

    /// A box in the input, as one in the picture, clipped to it.
    pub(super) fn to_picture(&self, bounds: &PixelBox, picture: &Picture) -> PixelBox {
        let fit = Fit::new([picture.width, picture.height], self.input);
        let back = |value: f32, axis: usize| {
            let ratio = fit.picture[axis] as f32 / fit.size[axis] as f32;
            ((value - fit.offset[axis] as f32) * ratio).clamp(0.0, fit.picture[axis] as f32)
        };
        PixelBox {
            x0: back(bounds.x0, 0),
            y0: back(bounds.y0, 1),
            x1: back(bounds.x1, 0),
            y1: back(bounds.y1, 1),
        }
    }

    /// Prepares for pictures of another size: new taps, bars everywhere.
    fn refit(&mut self, fit: Fit) {
        self.columns = Taps::new(fit.picture[0], fit.size[0]);
        self.rows = Taps::new(fit.picture[1], fit.size[1]);
        let slots = self.rows.widest + 1;
        self.cached = vec![usize::MAX; slots];
        self.cache = vec![0.0; slots * fit.size[0] * 3];
        let plane_len = self.input[0] * self.input[1];
        for (plane, &(_, mean, gain)) in self.normalisation.iter().enumerate() {
            self.planes[plane * plane_len..][..plane_len].fill((BAR - mean) * gain);
        }
        self.fit = Some(fit);
    }
}

fn resample_row(pixels: &[u8], columns: &Taps, out: &mut [f32]) {
    let pixels = pixels.as_chunks::<3>().0;
    for (column, out) in out.as_chunks_mut::<3>().0.iter_mut().enumerate() {
        let mut sum = [0.0; 3];
        for (source, weight) in columns.of(column) {
            for (sum, &value) in sum.iter_mut().zip(&pixels[source]) {
                *sum += f32::from(value) * weight;
            }
        }
        *out = sum;
    }
}

/// For each place of the new axis the places of the old one that it is mixed from.
#[derive(Debug, Default)]
struct Taps {
    /// First source and first weight of each place.
    starts: Vec<(usize, usize)>,
    weights: Vec<f32>,
    widest: usize,
}

impl Taps {
    fn new(from: usize, to: usize) -> Self {
        let ratio = from as f64 / to as f64;
        let reach = ratio.max(1.0);
        let mut taps = Self::default();
        for place in 0..to {
            let centre = (place as f64 + 0.5) * ratio;
            let first = ((centre - reach).floor().max(0.0)) as usize;
            let last = ((centre + reach).ceil() as usize).min(from);
            let weight =
                |source: usize| (1.0 - (source as f64 + 0.5 - centre).abs() / reach).max(0.0);
            let total: f64 = (first..last).map(weight).sum();
            taps.starts.push((first, taps.weights.len()));
            taps.weights.extend((first..last).map(|source| (weight(source) / total) as f32));
            taps.widest = taps.widest.max(last - first);
        }
        taps
    }

    /// Sources and weights of one place.
    fn of(&self, place: usize) -> impl Iterator<Item = (usize, f32)> + use<'_> {
        let (first, start) = self.starts[place];
        let end = self.starts.get(place + 1).map_or(self.weights.len(), |next| next.1);
        self.weights[start..end].iter().enumerate().map(move |(i, &weight)| (first + i, weight))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Planes in RGB, values as they are.
    const PLAIN: Normalisation = [(0, 0.0, 1.0), (1, 0.0, 1.0), (2, 0.0, 1.0)];

    fn picture(width: usize, height: usize, pixel: impl Fn(usize, usize) -> u8) -> Picture {
        let mut rgb = Vec::new();
        for v in 0..height {
            for u in 0..width {
                rgb.extend([pixel(u, v), 0, 255]);
            }
        }
        Picture { width, height, rgb }
    }

    #[test]
    fn a_ramp_stays_a_ramp() {
        let mut letterbox = Letterbox::new([16, 8], &PLAIN);
        letterbox.fill(&picture(8, 4, |u, _| u as u8 * 10));
        for column in 1..15 {
            let expected = (column as f32 + 0.5) / 2.0 * 10.0 - 5.0;
            for row in 0..8 {
                let value = letterbox.planes()[row * 16 + column];
                assert!((value - expected).abs() < 1e-3, "({column}, {row}): {value}");
            }
        }
    }

    #[test]
    fn shrinking_averages() {
        let mut letterbox = Letterbox::new([4, 4], &PLAIN);
        letterbox.fill(&picture(64, 64, |u, v| if (u + v) % 2 == 0 { 200 } else { 0 }));
        for &value in &letterbox.planes()[..16] {
            assert!((value - 100.0).abs() < 1.0, "{value}");
        }
    }

    #[test]
    fn another_shape_is_centred_between_bars_and_maps_back() {
        let mut letterbox = Letterbox::new([16, 16], &PLAIN);
        let wide = picture(32, 16, |_, _| 50);
        letterbox.fill(&wide);
        let column = |row: usize| letterbox.planes()[row * 16 + 8];
        assert_eq!((column(3), column(12)), (BAR, BAR));
        assert!((column(4) - 50.0).abs() < 1e-3 && (column(11) - 50.0).abs() < 1e-3);
        let whole = PixelBox { x0: 0.0, y0: 4.0, x1: 16.0, y1: 12.0 };
        let expected = PixelBox { x0: 0.0, y0: 0.0, x1: 32.0, y1: 16.0 };
        assert_eq!(letterbox.to_picture(&whole, &wide), expected);
    }

    #[test]
    fn a_picture_of_another_size_leaves_no_trace_of_the_last() {
        let mut letterbox = Letterbox::new([16, 16], &PLAIN);
        letterbox.fill(&picture(16, 16, |_, _| 9));
        letterbox.fill(&picture(32, 16, |_, _| 50));
        assert_eq!(letterbox.planes()[0], BAR);
    }
}
