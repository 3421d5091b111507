//! Precision over recall as a picture: both axes 0 to 1, a line every 0.1, one curve a slice.
//!
//! Black is all, orange day, blue night; other slices are not drawn.

use super::average::{Score, Slice};
use image::{Rgb, RgbImage};
use std::path::Path;
use verge_desk::Failure;

const SIDE_PX: u32 = 500;
const MARGIN_PX: u32 = 40;
const COLOURS: [(&str, Rgb<u8>); 3] =
    [("all", Rgb([20, 20, 20])), ("day", Rgb([225, 130, 10])), ("night", Rgb([30, 80, 200]))];

/// Digits and the point, three columns by five rows, top row first.
const GLYPHS: [(char, [u8; 5]); 4] = [
    ('0', [0b111, 0b101, 0b101, 0b101, 0b111]),
    ('1', [0b010, 0b110, 0b010, 0b010, 0b111]),
    ('5', [0b111, 0b100, 0b111, 0b001, 0b111]),
    ('.', [0b000, 0b000, 0b000, 0b000, 0b010]),
];

/// The curves as PNG; `path` only names them in an error.
pub(super) fn png(scores: &[(Slice, Score)], path: &Path) -> Result<Vec<u8>, Failure> {
    let side = SIDE_PX + 2 * MARGIN_PX;
    let mut picture = RgbImage::from_pixel(side, side, Rgb([255, 255, 255]));
    for tenth in 0..=10 {
        let at = f64::from(tenth) / 10.0;
        let shade = if tenth % 5 == 0 { 150 } else { 225 };
        segment(&mut picture, (at, 0.0), (at, 1.0), Rgb([shade; 3]), 0);
        segment(&mut picture, (0.0, at), (1.0, at), Rgb([shade; 3]), 0);
    }
    for (text, at) in [("0", 0.0), ("0.5", 0.5), ("1", 1.0)] {
        let (x, y) = pixel((at, 0.0));
        write(&mut picture, text, x as u32 - 6, y as u32 + 8);
        let (x, y) = pixel((0.0, at));
        write(&mut picture, text, x as u32 - 32, y as u32 - 5);
    }
    for (name, colour) in COLOURS {
        if let Some((_, score)) = scores.iter().find(|(slice, _)| slice.name == name) {
            for pair in score.curve.windows(2) {
                segment(&mut picture, pair[0], pair[1], colour, 1);
            }
        }
    }
    let mut bytes = std::io::Cursor::new(Vec::new());
    picture.write_to(&mut bytes, image::ImageFormat::Png).map_err(|error| Failure::Write {
        path: path.to_owned(),
        source: std::io::Error::other(error),
    })?;
    Ok(bytes.into_inner())
}

fn pixel((recall, precision): (f64, f64)) -> (f64, f64) {
    let (side, margin) = (f64::from(SIDE_PX), f64::from(MARGIN_PX));
    (margin + recall * side, margin + (1.0 - precision) * side)
}

fn segment(
    picture: &mut RgbImage,
    from: (f64, f64),
    to: (f64, f64),
    colour: Rgb<u8>,
    thickness: u32,
) {
    let (a, b) = (pixel(from), pixel(to));
    let steps = (b.0 - a.0).abs().max((b.1 - a.1).abs()).ceil().max(1.0) as u32;
    for step in 0..=steps {
        let t = f64::from(step) / f64::from(steps);
        let (x, y) = (a.0 + (b.0 - a.0) * t, a.1 + (b.1 - a.1) * t);
        for (dx, dy) in (0..=thickness).flat_map(|dx| (0..=thickness).map(move |dy| (dx, dy))) {
            let (x, y) = (x.round() as u32 + dx, y.round() as u32 + dy);
            if x < picture.width() && y < picture.height() {
                picture.put_pixel(x, y, colour);
            }
        }
    }
}

fn write(picture: &mut RgbImage, text: &str, x: u32, y: u32) {
    const DOT_PX: u32 = 2;
    for (index, letter) in text.chars().enumerate() {
        let Some((_, rows)) = GLYPHS.iter().find(|(known, _)| *known == letter) else { continue };
        for (row, bits) in rows.iter().enumerate() {
            for column in (0..3).filter(|column| bits >> (2 - column) & 1 == 1) {
                for (dx, dy) in (0..DOT_PX).flat_map(|dx| (0..DOT_PX).map(move |dy| (dx, dy))) {
                    let px = x + index as u32 * 4 * DOT_PX + column * DOT_PX + dx;
                    picture.put_pixel(px, y + row as u32 * DOT_PX + dy, Rgb([60; 3]));
                }
            }
        }
    }
}
