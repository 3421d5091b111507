//! A region of the picture into the net's input: scaled without distortion, centred, normalised.
//!
//! Owns the geometry between region and input, and the resampling. Scaling is linear
//! interpolation with aligned pixel centres; a picture that shrinks is averaged over the
//! pixels that each new one covers (a triangle filter as wide as the ratio), so that it
//! does not alias.

use super::sidecar::Normalisation;
use crate::daemon::frame::{Picture, PixelBox, Region};
use verge_kernels::QuantParams;

/// Value of the bars beside a picture of another shape, before normalisation.
const BAR: f32 = 114.0;

/// Adding and subtracting it rounds values below 2^22 to the nearest even.
const ROUND: f32 = 12_582_912.0;

/// Destination of the input, and its form.
#[derive(Debug)]
pub(super) enum Into<'a> {
    /// Three planes of `rows x columns`.
    Planes(&'a mut [f32]),
    /// Row by row, three values a pixel.
    Pixels(&'a mut [f32]),
    /// As `Pixels`, in steps.
    Quantised(&'a mut [u8], QuantParams),
}

/// Fills a net's input. Everything is kept between pictures.
#[derive(Debug)]
pub(super) struct Letterbox {
    input: [usize; 2],
    normalisation: Normalisation,
    fit: Option<Fit>,
    columns: Taps,
    rows: Taps,
    /// One picture row resampled to the new width and normalised, three values a pixel in the
    /// net's order, per cached row.
    cache: Vec<f32>,
    cached: Vec<usize>,
    mixed: Vec<f32>,
}

/// Place of a region of one size in the input.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Fit {
    region: [usize; 2],
    size: [usize; 2],
    offset: [usize; 2],
}

impl Fit {
    fn new(region: &Region, input: [usize; 2]) -> Self {
        let region = [region.width, region.height];
        let scale = (input[0] as f64 / region[0] as f64).min(input[1] as f64 / region[1] as f64);
        let fitted =
            |axis: usize| ((region[axis] as f64 * scale).round() as usize).clamp(1, input[axis]);
        let size = [fitted(0), fitted(1)];
        Self { region, size, offset: [(input[0] - size[0]) / 2, (input[1] - size[1]) / 2] }
    }
}

impl Letterbox {
    pub(super) fn new(input: [usize; 2], normalisation: &Normalisation) -> Self {
        Self {
            input,
            normalisation: *normalisation,
            fit: None,
            columns: Taps::default(),
            rows: Taps::default(),
            cache: Vec::new(),
            cached: Vec::new(),
            mixed: Vec::new(),
        }
    }

    /// Values of the input.
    pub(super) fn len(&self) -> usize {
        3 * self.input[0] * self.input[1]
    }

    /// Fills the input from `region`, which lies in `picture`.
    pub(super) fn fill(&mut self, picture: &Picture, region: Region, mut into: Into<'_>) {
        let fit = Fit::new(&region, self.input);
        if self.fit != Some(fit) {
            self.refit(fit);
        }
        // Map of each channel's bytes: factor and summand.
        let (unit, zero) = match &into {
            Into::Quantised(_, steps) => (1.0 / steps.scale, f32::from(steps.zero_point)),
            _ => (1.0, 0.0),
        };
        let values = self
            .normalisation
            .map(|(channel, mean, gain)| (channel, gain * unit, zero - mean * gain * unit));
        let row_len = fit.size[0] * 3;
        self.cached.fill(usize::MAX);
        for row in 0..self.input[1] {
            let inside = row.checked_sub(fit.offset[1]).filter(|&row| row < fit.size[1]);
            let bar = |mixed: &mut [f32]| {
                for pixel in mixed.as_chunks_mut::<3>().0 {
                    *pixel = values.map(|(_, factor, summand)| BAR * factor + summand);
                }
            };
            let Some(place) = inside else {
                bar(&mut self.mixed);
                self.store(row, &mut into);
                continue;
            };
            for (source, _) in self.rows.of(place) {
                let slot = source % self.cached.len();
                if self.cached[slot] != source {
                    self.cached[slot] = source;
                    let first = (source + region.y) * picture.width + region.x;
                    let pixels = &picture.rgb[first * 3..][..region.width * 3];
                    let cache = &mut self.cache[slot * row_len..][..row_len];
                    resample_row(pixels, &self.columns, &values, cache);
                }
            }
            let first = fit.offset[0] * 3;
            bar(&mut self.mixed[..first]);
            bar(&mut self.mixed[first + row_len..]);
            let out = &mut self.mixed[first..first + row_len];
            out.fill(0.0);
            for (source, weight) in self.rows.of(place) {
                let slot = source % self.cached.len();
                let cache = &self.cache[slot * row_len..][..row_len];
                for (out, value) in out.iter_mut().zip(cache) {
                    *out += value * weight;
                }
            }
            self.store(row, &mut into);
        }
    }

    /// Stores one mixed row of the input.
    fn store(&self, row: usize, into: &mut Into<'_>) {
        let [width, height] = self.input;
        let values = row * width * 3..(row + 1) * width * 3;
        match into {
            Into::Planes(planes) => {
                for (channel, plane) in planes.chunks_exact_mut(width * height).enumerate() {
                    let out = &mut plane[row * width..][..width];
                    for (out, pixel) in out.iter_mut().zip(self.mixed.as_chunks::<3>().0) {
                        *out = pixel[channel];
                    }
                }
            }
            Into::Pixels(pixels) => pixels[values].copy_from_slice(&self.mixed),
            Into::Quantised(pixels, _) => {
                for (out, value) in pixels[values].iter_mut().zip(&self.mixed) {
                    let value = (value.clamp(0.0, 255.0) + ROUND) - ROUND;
                    *out = value as i32 as u8;
                }
            }
        }
    }

    /// A box in the input, as one in the picture, clipped to the region.
    pub(super) fn to_picture(&self, bounds: &PixelBox, region: Region) -> PixelBox {
        let fit = Fit::new(&region, self.input);
        let first = [region.x as f32, region.y as f32];
        let back = |value: f32, axis: usize| {
            let ratio = fit.region[axis] as f32 / fit.size[axis] as f32;
            let inside = (value - fit.offset[axis] as f32) * ratio;
            first[axis] + inside.clamp(0.0, fit.region[axis] as f32)
        };
        PixelBox {
            x0: back(bounds.x0, 0),
            y0: back(bounds.y0, 1),
            x1: back(bounds.x1, 0),
            y1: back(bounds.y1, 1),
        }
    }

    /// Prepares for regions of another size.
    fn refit(&mut self, fit: Fit) {
        self.columns = Taps::new(fit.region[0], fit.size[0]);
        self.rows = Taps::new(fit.region[1], fit.size[1]);
        let slots = self.rows.widest + 1;
        self.cached = vec![usize::MAX; slots];
        self.cache = vec![0.0; slots * fit.size[0] * 3];
        self.mixed = vec![0.0; self.input[0] * 3];
        self.fit = Some(fit);
    }
}

/// Resamples and normalises: `values` are channel of an RGB pixel, factor, summand.
fn resample_row(pixels: &[u8], columns: &Taps, values: &[(usize, f32, f32); 3], out: &mut [f32]) {
    let pixels = pixels.as_chunks::<3>().0;
    for (column, out) in out.as_chunks_mut::<3>().0.iter_mut().enumerate() {
        let mut sum = [0.0; 3];
        for (source, weight) in columns.of(column) {
            for (sum, &value) in sum.iter_mut().zip(&pixels[source]) {
                *sum += f32::from(value) * weight;
            }
        }
        *out = values.map(|(channel, factor, summand)| sum[channel] * factor + summand);
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

    fn planes(letterbox: &mut Letterbox, picture: &Picture) -> Vec<f32> {
        let mut planes = vec![f32::NAN; letterbox.len()];
        letterbox.fill(picture, Region::whole(picture), Into::Planes(&mut planes));
        planes
    }

    #[test]
    fn a_ramp_stays_a_ramp() {
        let mut letterbox = Letterbox::new([16, 8], &PLAIN);
        let planes = planes(&mut letterbox, &picture(8, 4, |u, _| u as u8 * 10));
        for column in 1..15 {
            let expected = (column as f32 + 0.5) / 2.0 * 10.0 - 5.0;
            for row in 0..8 {
                let value = planes[row * 16 + column];
                assert!((value - expected).abs() < 1e-3, "({column}, {row}): {value}");
            }
        }
    }

    #[test]
    fn shrinking_averages() {
        let mut letterbox = Letterbox::new([4, 4], &PLAIN);
        let checks = picture(64, 64, |u, v| if (u + v) % 2 == 0 { 200 } else { 0 });
        for &value in &planes(&mut letterbox, &checks)[..16] {
            assert!((value - 100.0).abs() < 1.0, "{value}");
        }
    }

    #[test]
    fn another_shape_is_centred_between_bars_and_maps_back() {
        let mut letterbox = Letterbox::new([16, 16], &PLAIN);
        let wide = picture(32, 16, |_, _| 50);
        let planes = planes(&mut letterbox, &wide);
        let column = |row: usize| planes[row * 16 + 8];
        assert_eq!((column(3), column(12)), (BAR, BAR));
        assert!((column(4) - 50.0).abs() < 1e-3 && (column(11) - 50.0).abs() < 1e-3);
        let whole = PixelBox { x0: 0.0, y0: 4.0, x1: 16.0, y1: 12.0 };
        let expected = PixelBox { x0: 0.0, y0: 0.0, x1: 32.0, y1: 16.0 };
        assert_eq!(letterbox.to_picture(&whole, Region::whole(&wide)), expected);
    }

    #[test]
    fn a_picture_of_another_size_leaves_no_trace_of_the_last() {
        let mut letterbox = Letterbox::new([16, 16], &PLAIN);
        planes(&mut letterbox, &picture(16, 16, |_, _| 9));
        assert_eq!(planes(&mut letterbox, &picture(32, 16, |_, _| 50))[0], BAR);
    }

    #[test]
    fn a_region_is_the_picture_that_it_cuts_out() {
        let pixel = |u: usize, v: usize| (u * 7 + v * 11) as u8;
        let all = picture(40, 30, pixel);
        let part = picture(16, 8, |u, v| pixel(u + 20, v + 5));
        let region = Region { x: 20, y: 5, width: 16, height: 8 };
        let mut letterbox = Letterbox::new([24, 24], &PLAIN);
        let expected = planes(&mut letterbox, &part);
        let mut cut = vec![f32::NAN; letterbox.len()];
        letterbox.fill(&all, region, Into::Planes(&mut cut));
        assert_eq!(cut, expected);
        let whole = PixelBox { x0: 0.0, y0: 6.0, x1: 30.0, y1: 18.0 };
        let expected = PixelBox { x0: 20.0, y0: 5.0, x1: 36.0, y1: 13.0 };
        assert_eq!(letterbox.to_picture(&whole, region), expected, "clipped to the region");
    }

    #[test]
    fn pixels_and_steps_are_the_planes_in_other_clothes() {
        let normalisation = [(2, 103.5, 1.0 / 57.4), (1, 116.3, 1.0 / 57.1), (0, 0.0, 0.5)];
        let mut letterbox = Letterbox::new([16, 16], &normalisation);
        let tall = picture(8, 16, |u, v| (u * 30 + v) as u8);
        let planes = planes(&mut letterbox, &tall);
        let mut pixels = vec![f32::NAN; letterbox.len()];
        letterbox.fill(&tall, Region::whole(&tall), Into::Pixels(&mut pixels));
        let steps = QuantParams { scale: 0.02, zero_point: 110 };
        let mut bytes = vec![1; letterbox.len()];
        letterbox.fill(&tall, Region::whole(&tall), Into::Quantised(&mut bytes, steps));
        for (i, &value) in pixels.iter().enumerate() {
            assert_eq!(value, planes[i % 3 * 256 + i / 3]);
            let expected = (value / steps.scale + 110.0).clamp(0.0, 255.0);
            let byte = f32::from(bytes[i]);
            assert!((byte - expected).abs() < 0.501, "{byte} for {expected}");
        }
    }
}
