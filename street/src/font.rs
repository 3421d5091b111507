//! An own font of strokes, for words on the road and text burnt into the picture.
//!
//! Owns capital letters, digits and a few signs as polylines on a grid 4 wide and 6 high; other
//! characters are gaps. Own, because a road's letters are stretched several times along it, and
//! a line of text needs no more than this. Owns no place and no colour.

/// A straight stroke between two points, in grid units.
pub type Stroke = [[f64; 2]; 2];

/// Height of a line of text, grid units: the grid and half a stroke on each side.
pub const LINE_HEIGHT: f64 = 6.0 + 2.0 * HALF_STROKE;

/// Half the width of a stroke, grid units.
pub const HALF_STROKE: f64 = 0.5;

/// Free space between two characters' strokes, grid units.
const SPACING: f64 = 1.0;

/// Width of a space, grid units.
const SPACE: f64 = 2.0;

/// The characters that have strokes, beside the space.
pub const DRAWN: &str = "ABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789:.-/";

/// Polylines of a character, split by spaces: digits are x and y in turn.
fn outline(character: char) -> &'static str {
    match character.to_ascii_uppercase() {
        'A' => "002640 1232",
        'B' => "00063645443303 33424130 3000",
        'C' => "4536160501103041",
        'D' => "00062644422000",
        'E' => "46060040 0333",
        'F' => "460600 0333",
        'G' => "45361605011030414323",
        'H' => "0006 4046 0343",
        'I' => "2026",
        'J' => "4641301001",
        'K' => "0006 460340",
        'L' => "060040",
        'M' => "0006234640",
        'N' => "00064046",
        'O' | '0' => "103041453616050110",
        'P' => "00063645443303",
        'Q' => "103041453616050110 2240",
        'R' => "00063645443303 2340",
        'S' => "453616050413334241301001",
        'T' => "0646 2620",
        'U' => "060110304146",
        'V' => "062046",
        'W' => "0610233046",
        'X' => "0046 0640",
        'Y' => "062346 2320",
        'Z' => "06460040",
        '1' => "152620 1030",
        '2' => "051636450040",
        '3' => "05163645443313 334241301001",
        '4' => "30360242",
        '5' => "460604344341301001",
        '6' => "46160401103041423303",
        '7' => "064610",
        '8' => "13334445361605041302011030414233",
        '9' => "00304245361605041343",
        ':' => "2122 2425",
        '.' => "2021",
        '-' => "1333",
        '/' => "0046",
        _ => "",
    }
}

/// The strokes of a line of text and its width, grid units. The strokes' middles start at half a
/// stroke from the left and from the foot, so that all of the ink lies in the width and the height.
pub fn line_of(text: &str) -> (Vec<Stroke>, f64) {
    let mut strokes = Vec::new();
    let mut width = 0.0;
    for character in text.chars() {
        let outline = outline(character);
        let digits = || outline.bytes().filter(u8::is_ascii_digit).map(|b| f64::from(b - b'0'));
        let low = digits().step_by(2).fold(f64::MAX, f64::min);
        let high = digits().step_by(2).fold(f64::MIN, f64::max);
        if low > high {
            width += SPACE;
            continue;
        }
        let shift = width + HALF_STROKE - low;
        for part in outline.split(' ') {
            let points: Vec<[f64; 2]> = part
                .as_bytes()
                .chunks_exact(2)
                .map(|p| [shift + f64::from(p[0] - b'0'), HALF_STROKE + f64::from(p[1] - b'0')])
                .collect();
            strokes.extend(points.windows(2).map(|pair| [pair[0], pair[1]]));
        }
        width += high - low + 2.0 * HALF_STROKE + SPACING;
    }
    (strokes, (width - SPACING).max(0.0))
}

/// True when a point lies within `half` of a stroke.
pub fn inked(strokes: &[Stroke], point: [f64; 2], half: f64) -> bool {
    strokes.iter().any(|[a, b]| {
        let (dx, dy) = (b[0] - a[0], b[1] - a[1]);
        let (px, py) = (point[0] - a[0], point[1] - a[1]);
        let along = ((px * dx + py * dy) / (dx * dx + dy * dy)).clamp(0.0, 1.0);
        (px - along * dx).powi(2) + (py - along * dy).powi(2) <= half * half
    })
}

/// True when a point lies in a polygon (even-odd rule).
pub fn in_polygon(polygon: &[[f64; 2]], [x, y]: [f64; 2]) -> bool {
    let mut inside = false;
    for (i, a) in polygon.iter().enumerate() {
        let b = polygon[(i + 1) % polygon.len()];
        if (a[1] <= y) != (b[1] <= y) && x < a[0] + (y - a[1]) / (b[1] - a[1]) * (b[0] - a[0]) {
            inside = !inside;
        }
    }
    inside
}

#[cfg(test)]
mod tests {
    use super::{DRAWN, HALF_STROKE, LINE_HEIGHT, line_of};

    #[test]
    fn every_character_keeps_its_ink_within_its_cell_and_looks_like_no_other() {
        let mut seen: Vec<(char, Vec<super::Stroke>)> = Vec::new();
        for character in DRAWN.chars() {
            let (strokes, width) = line_of(&character.to_string());
            assert!(!strokes.is_empty(), "{character}");
            for [x, y] in strokes.iter().flatten() {
                assert!((HALF_STROKE..=width - HALF_STROKE + 1e-9).contains(x), "{character}");
                assert!((HALF_STROKE..=LINE_HEIGHT - HALF_STROKE).contains(y), "{character}");
            }
            let twin = seen.iter().find(|(other, same)| *same == strokes && *other != 'O');
            assert!(twin.is_none(), "{character} is drawn as {twin:?}");
            seen.push((character, strokes));
        }
    }
}
