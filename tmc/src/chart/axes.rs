//! Axes: from data to pixels, with ticks at round numbers and labels.

use super::{Anchor, Colour, Drawing, INK, PALE, Shape};

const LEFT: f64 = 62.0;
const RIGHT: f64 = 24.0;
const TOP: f64 = 30.0;
const BOTTOM: f64 = 46.0;
const SMALL: f64 = 12.0;

/// A tick: where, and what it says.
pub type Tick = (f64, String);

/// A frame with two axes inside a drawing of its own.
#[derive(Clone, Debug)]
pub struct Axes {
    drawing: Drawing,
    x: [f64; 2],
    y: [f64; 2],
}

impl Axes {
    /// A frame of that size over those ranges of data.
    pub fn new([width, height]: [u32; 2], x: [f64; 2], y: [f64; 2]) -> Self {
        let wide = |[low, high]: [f64; 2]| [low, if high > low { high } else { low + 1.0 }];
        Self { drawing: Drawing::new(width, height), x: wide(x), y: wide(y) }
    }

    /// The pixel of a point of the data.
    pub fn at(&self, x: f64, y: f64) -> [f64; 2] {
        let (width, height) = (f64::from(self.drawing.width), f64::from(self.drawing.height));
        let share = |value: f64, [low, high]: [f64; 2]| (value - low) / (high - low);
        [
            LEFT + share(x, self.x) * (width - LEFT - RIGHT),
            height - BOTTOM - share(y, self.y) * (height - BOTTOM - TOP),
        ]
    }

    /// A title, names of the axes with their units, grid lines and ticks.
    pub fn labels(&mut self, title: &str, names: [&str; 2]) {
        let ticks = [self.x, self.y].map(round_ticks);
        self.labels_at(title, names, ticks, true);
    }

    /// The same with ticks of one's own, and with or without grid lines.
    pub fn labels_at(&mut self, title: &str, names: [&str; 2], ticks: [Vec<Tick>; 2], grid: bool) {
        let [x_ticks, y_ticks] = ticks;
        let ([x0, x1], [y0, y1]) = (self.x, self.y);
        let (width, height) = (f64::from(self.drawing.width), f64::from(self.drawing.height));
        for (x, text) in x_ticks {
            let [px, py] = self.at(x, y0);
            let end = if grid { self.at(x, y1) } else { [px, py + 4.0] };
            self.line(vec![[px, py], end], 1.0, if grid { PALE } else { INK });
            self.drawing.text(text, [px, py + 15.0], SMALL, Anchor::Middle);
        }
        for (y, text) in y_ticks {
            let [px, py] = self.at(x0, y);
            let end = if grid { self.at(x1, y) } else { [px - 4.0, py] };
            self.line(vec![[px, py], end], 1.0, if grid { PALE } else { INK });
            self.drawing.text(text, [px - 7.0, py + 4.0], SMALL, Anchor::End);
        }
        let corners = [(x0, y0), (x1, y0), (x1, y1), (x0, y1), (x0, y0)];
        let frame = corners.map(|(x, y)| self.at(x, y)).to_vec();
        self.line(frame, 1.0, INK);
        let middle = f64::midpoint(LEFT, width - RIGHT);
        self.drawing.text(title, [middle, 18.0], 14.0, Anchor::Middle);
        self.drawing.text(names[0], [middle, height - 10.0], SMALL, Anchor::Middle);
        self.drawing.shapes.push(Shape::Text {
            text: names[1].to_owned(),
            at: [16.0, f64::midpoint(TOP, height - BOTTOM)],
            size: SMALL,
            anchor: Anchor::Middle,
            upward: true,
        });
    }

    /// A dot at a point of the data.
    pub fn dot(&mut self, x: f64, y: f64, radius: f64, colour: Colour) {
        let at = self.at(x, y);
        self.drawing.shapes.push(Shape::Dot(at, radius, colour));
    }

    /// A line through points of the data.
    pub fn curve(&mut self, points: &[[f64; 2]], width: f64, colour: Colour) {
        let points = points.iter().map(|&[x, y]| self.at(x, y)).collect();
        self.line(points, width, colour);
    }

    /// The area between two lines over the same x: x, low, high.
    pub fn band(&mut self, rows: &[[f64; 3]], colour: Colour) {
        let low = rows.iter().map(|&[x, low, _]| self.at(x, low));
        let high = rows.iter().rev().map(|&[x, _, high]| self.at(x, high));
        let outline = low.chain(high).collect();
        self.drawing.shapes.push(Shape::Area(outline, colour));
    }

    /// A cell of a map, from one corner of the data to the other.
    pub fn cell(&mut self, [x0, y0]: [f64; 2], [x1, y1]: [f64; 2], colour: Colour) {
        let ([left, low], [right, high]) = (self.at(x0, y0), self.at(x1, y1));
        // Whole pixels, so that neighbours meet.
        let (left, right, top, low) =
            (left.round(), right.round(), high.min(low).round(), high.max(low).round());
        let shape = Shape::Rectangle([left, top, right - left, low - top], colour);
        self.drawing.shapes.push(shape);
    }

    /// A shape in pixels of the drawing.
    pub fn shape(&mut self, shape: Shape) {
        self.drawing.shapes.push(shape);
    }

    /// A note at the left of the frame's top, `row` from 0.
    pub fn note(&mut self, row: usize, text: &str) {
        let y = TOP + 18.0 + 17.0 * row as f64;
        self.drawing.text(text, [LEFT + 8.0, y], SMALL, Anchor::Start);
    }

    /// A line of the key inside the frame, `row` from 0.
    pub fn key(&mut self, row: usize, text: &str, colour: Colour) {
        let x = f64::from(self.drawing.width) - RIGHT - 10.0;
        let y = TOP + 18.0 + 17.0 * row as f64;
        self.drawing.text(text, [x - 30.0, y], SMALL, Anchor::End);
        self.line(vec![[x - 24.0, y - 4.0], [x, y - 4.0]], 3.0, colour);
    }

    fn line(&mut self, points: Vec<[f64; 2]>, width: f64, colour: Colour) {
        self.drawing.shapes.push(Shape::Line(points, width, colour));
    }

    /// The finished drawing.
    pub fn finish(self) -> Drawing {
        self.drawing
    }
}

/// Four to ten ticks at multiples of 1, 2 or 5 times a power of ten.
pub fn round_ticks([low, high]: [f64; 2]) -> Vec<Tick> {
    let rough = (high - low) / 7.0;
    let power = 10f64.powf(rough.log10().floor());
    let step = [1.0, 2.0, 5.0, 10.0]
        .map(|factor| factor * power)
        .into_iter()
        .find(|&step| step >= rough)
        .unwrap_or(rough);
    let decimals = (-step.log10().floor()).max(0.0) as usize;
    let first = (low / step - 1e-9).ceil() as i64;
    let last = (high / step + 1e-9).floor() as i64;
    (first..=last)
        .map(|i| {
            let value = i as f64 * step;
            (value, format!("{value:.decimals$}"))
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_are_round() {
        let texts = |range| round_ticks(range).into_iter().map(|t| t.1).collect::<Vec<_>>();
        assert_eq!(texts([0.0, 100.0]), ["0", "20", "40", "60", "80", "100"]);
        assert_eq!(texts([0.0, 0.7]), ["0.0", "0.1", "0.2", "0.3", "0.4", "0.5", "0.6", "0.7"]);
    }
}
