//! Letters as strokes, for pictures without a font file.
//!
//! A letter is a list of strokes, a stroke a list of points, a point two digits: x from 0
//! (left) to 4, y from 0 (top) over 6 (base line) to 8.

/// Height that one size unit stands for: capitals are 6 high.
pub const HEIGHT: f64 = 8.5;
const BASE_LINE: f64 = 6.0;
/// From one letter to the next.
const ADVANCE: f64 = 5.2;
const NARROW: f64 = 3.0;

const LETTERS: [(char, &str); 77] = [
    ('0', "10 30 41 45 36 16 05 01 10"),
    ('1', "11 20 26,16 36"),
    ('2', "01 10 30 41 42 06 46"),
    ('3', "01 10 30 41 42 33 13,33 44 45 36 16 05"),
    ('4', "36 30 04 44"),
    ('5', "40 00 03 13 33 44 45 36 06"),
    ('6', "40 20 02 05 16 36 45 44 33 03"),
    ('7', "00 40 16"),
    ('8', "13 02 01 10 30 41 42 33 13 04 05 16 36 45 44 33"),
    ('9', "43 13 02 01 10 30 41 44 26 06"),
    ('A', "06 20 46,14 34"),
    ('B', "06 00 30 41 42 33 03,33 44 45 36 06"),
    ('C', "41 30 10 01 05 16 36 45"),
    ('D', "06 00 30 41 45 36 06"),
    ('E', "40 00 06 46,03 33"),
    ('F', "40 00 06,03 33"),
    ('G', "41 30 10 01 05 16 36 45 43 23"),
    ('H', "00 06,40 46,03 43"),
    ('I', "10 30,20 26,16 36"),
    ('J', "40 45 36 16 05"),
    ('K', "00 06,40 03 46"),
    ('L', "00 06 46"),
    ('M', "06 00 23 40 46"),
    ('N', "06 00 46 40"),
    ('O', "10 30 41 45 36 16 05 01 10"),
    ('P', "06 00 30 41 42 33 03"),
    ('Q', "10 30 41 45 36 16 05 01 10,24 46"),
    ('R', "06 00 30 41 42 33 03,23 46"),
    ('S', "41 30 10 01 02 13 33 44 45 36 16 05"),
    ('T', "00 40,20 26"),
    ('U', "00 05 16 36 45 40"),
    ('V', "00 26 40"),
    ('W', "00 16 22 36 40"),
    ('X', "00 46,40 06"),
    ('Y', "00 23 40,23 26"),
    ('Z', "00 40 06 46"),
    ('a', "12 32 43 46 16 05 14 44"),
    ('b', "00 06 36 45 43 32 02"),
    ('c', "42 12 03 05 16 46"),
    ('d', "40 46 16 05 03 12 42"),
    ('e', "04 44 43 32 12 03 05 16 46"),
    ('f', "40 30 21 26,12 32"),
    ('g', "46 16 05 03 12 42 47 38 08"),
    ('h', "00 06,02 32 43 46"),
    ('i', "22 26,20 20"),
    ('j', "32 37 28 08,30 30"),
    ('k', "00 06,42 04 46"),
    ('l', "10 20 26 36"),
    ('m', "06 02 22 26,22 32 43 46"),
    ('n', "06 02 32 43 46"),
    ('o', "12 32 43 45 36 16 05 03 12"),
    ('p', "08 02 32 43 45 36 06"),
    ('q', "48 42 12 03 05 16 46"),
    ('r', "06 02,04 12 42"),
    ('s', "42 12 03 14 34 45 36 06"),
    ('t', "10 15 26 36,02 32"),
    ('u', "02 05 16 46 42"),
    ('v', "02 26 42"),
    ('w', "02 16 23 36 42"),
    ('x', "02 46,42 06"),
    ('y', "02 26,42 26 18 08"),
    ('z', "02 42 06 46"),
    ('.', "26 26"),
    (',', "26 17"),
    (':', "23 23,26 26"),
    ('-', "03 43"),
    ('+', "03 43,21 25"),
    ('/', "06 40"),
    ('%', "06 40,11 11,35 35"),
    ('(', "30 21 25 36"),
    (')', "10 21 25 16"),
    ('=', "02 42,04 44"),
    ('_', "07 47"),
    ('#', "11 15,31 35,02 42,04 44"),
    ('<', "41 03 45"),
    ('>', "01 43 05"),
    ('*', "21 25,02 44,42 04"),
];

fn advance(letter: char) -> f64 {
    if matches!(letter, '.' | ',' | ':' | 'i' | 'l' | ' ' | '(' | ')') { NARROW } else { ADVANCE }
}

/// Length of a text, in the units of the letters.
pub fn length(text: &str) -> f64 {
    text.chars().map(advance).sum::<f64>() - (ADVANCE - 4.0)
}

/// The strokes of a text: x from its beginning, y from its base line, downwards. A letter
/// that has no strokes is drawn as a box.
pub fn strokes(text: &str) -> Vec<Vec<[f64; 2]>> {
    let mut all = Vec::new();
    let mut left = 0.0;
    for letter in text.chars() {
        let found = LETTERS.iter().find(|(known, _)| *known == letter).map(|(_, drawn)| *drawn);
        let drawn = found.unwrap_or(if letter == ' ' { "" } else { "00 40 46 06 00" });
        let shift = (4.0 - advance(letter) + (ADVANCE - 4.0)) / 2.0;
        for stroke in drawn.split(',').filter(|stroke| !stroke.is_empty()) {
            let mut points: Vec<[f64; 2]> = stroke
                .split(' ')
                .map(|point| {
                    let digit = |at: usize| f64::from(point.as_bytes()[at] - b'0');
                    [left + digit(0) - shift, digit(1) - BASE_LINE]
                })
                .collect();
            // A stroke of one point twice is a dot, which needs a length to be drawn.
            if let [first, last] = &mut points[..]
                && first == last
            {
                last[0] += 0.2;
            }
            all.push(points);
        }
        left += advance(letter);
    }
    all
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_letter_is_written_as_points() {
        for (letter, drawn) in LETTERS {
            for point in drawn.split([',', ' ']) {
                let right = point.len() == 2 && point.bytes().all(|b| b.is_ascii_digit());
                assert!(right && &point[..1] <= "4" && &point[1..] <= "8", "{letter}: {point:?}");
            }
        }
        assert_eq!(strokes("a b").len(), 2);
        assert!(length("ll") < length("mm"));
    }
}
