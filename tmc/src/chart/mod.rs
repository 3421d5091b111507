//! Drawing: one list of shapes, written as SVG (for a page), PDF (for print) or PNG.
//!
//! Owns shapes in pixels and their SVG, of which resvg makes the PNG; `axes` places data in them. Our
//! own, for one drawing is three files: chart libraries (plotters) write SVG and PNG, no PDF.

pub mod axes;
mod pdf;
mod png;
mod svg;

pub use axes::Axes;

/// Red, green, blue and opacity.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Colour(pub u8, pub u8, pub u8, pub f32);

/// Text and frames.
pub const INK: Colour = Colour(40, 40, 40, 1.0);
/// Grid lines.
pub const PALE: Colour = Colour(222, 222, 222, 1.0);
/// Colour of unknown values.
pub const UNKNOWN: Colour = Colour(236, 236, 236, 1.0);

/// Where a text begins, lies or ends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Anchor {
    /// Begins at the point.
    Start,
    /// Lies with its middle at the point.
    Middle,
    /// Ends at the point.
    End,
}

/// A shape in pixels, y downwards.
#[derive(Clone, Debug)]
pub enum Shape {
    /// A filled rectangle: left, top, width, height.
    Rectangle([f64; 4], Colour),
    /// A filled circle: centre and radius.
    Dot([f64; 2], f64, Colour),
    /// An open line of that width.
    Line(Vec<[f64; 2]>, f64, Colour),
    /// A filled polygon.
    Area(Vec<[f64; 2]>, Colour),
    /// A text of that height at a point of its base line; `upward` turns it by a quarter.
    Text {
        /// The words.
        text: String,
        /// A point of its base line.
        at: [f64; 2],
        /// Height of its capitals and a little more, px.
        size: f64,
        /// How it lies to that point.
        anchor: Anchor,
        /// Reads from below.
        upward: bool,
    },
}

/// A drawing of a given size.
#[derive(Clone, Debug)]
pub struct Drawing {
    /// Width, px.
    pub width: u32,
    /// Height, px.
    pub height: u32,
    /// The shapes, the lowest first.
    pub shapes: Vec<Shape>,
}

impl Drawing {
    /// An empty one.
    pub fn new(width: u32, height: u32) -> Self {
        Self { width, height, shapes: Vec::new() }
    }

    /// Adds a level text.
    pub fn text(&mut self, text: impl Into<String>, at: [f64; 2], size: f64, anchor: Anchor) {
        let text = text.into();
        self.shapes.push(Shape::Text { text, at, size, anchor, upward: false });
    }

    /// Adds all of another drawing, moved.
    pub fn place(&mut self, other: Self, [dx, dy]: [f64; 2]) {
        let moved = |points: Vec<[f64; 2]>| {
            points.into_iter().map(|[x, y]| [x + dx, y + dy]).collect::<Vec<_>>()
        };
        self.shapes.extend(other.shapes.into_iter().map(|shape| match shape {
            Shape::Rectangle([x, y, w, h], c) => Shape::Rectangle([x + dx, y + dy, w, h], c),
            Shape::Dot([x, y], r, c) => Shape::Dot([x + dx, y + dy], r, c),
            Shape::Line(points, w, c) => Shape::Line(moved(points), w, c),
            Shape::Area(points, c) => Shape::Area(moved(points), c),
            Shape::Text { text, at: [x, y], size, anchor, upward } => {
                Shape::Text { text, at: [x + dx, y + dy], size, anchor, upward }
            }
        }));
    }

    /// As an SVG element.
    pub fn svg(&self) -> String {
        svg::svg(self)
    }

    /// As a PDF file of one page.
    pub fn pdf(&self) -> Vec<u8> {
        pdf::pdf(self)
    }

    /// As a PNG file on white.
    pub fn png(&self) -> Vec<u8> {
        png::png(self)
    }
}

/// Dark blue (0) over green to light yellow (1): a lighter colour is a higher density, as in
/// the paper's figures. Five anchors, linear between them.
pub fn shade(share: f64) -> Colour {
    const ANCHORS: [[f64; 3]; 5] = [
        [38.0, 22.0, 84.0],
        [45.0, 84.0, 142.0],
        [34.0, 145.0, 140.0],
        [120.0, 204.0, 88.0],
        [253.0, 240.0, 110.0],
    ];
    let at = share.clamp(0.0, 1.0) * (ANCHORS.len() - 1) as f64;
    let below = (at as usize).min(ANCHORS.len() - 2);
    let part = at - below as f64;
    let mix = |i: usize| {
        (ANCHORS[below][i] + part * (ANCHORS[below + 1][i] - ANCHORS[below][i])).round() as u8
    };
    Colour(mix(0), mix(1), mix(2), 1.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_drawing_becomes_svg_and_png() {
        let mut drawing = Drawing::new(60, 30);
        drawing.shapes.push(Shape::Rectangle([0.0, 0.0, 30.0, 30.0], Colour(255, 0, 0, 1.0)));
        drawing.text("a < b & \"c\"", [5.0, 20.0], 10.0, Anchor::Start);
        let svg = drawing.svg();
        assert!(svg.contains("a &lt; b &amp; &quot;c&quot;") && svg.ends_with("</svg>\n"), "{svg}");
        let png = resvg::tiny_skia::Pixmap::decode_png(&drawing.png()).unwrap();
        let pixel = |x, y| png.pixel(x, y).map(|p| (p.red(), p.green(), p.blue())).unwrap();
        assert_eq!(pixel(2, 2), (255, 0, 0));
        assert_eq!(pixel(58, 2), (255, 255, 255));
    }

    #[test]
    fn the_scale_ends_where_it_should() {
        assert_eq!(shade(-1.0), Colour(38, 22, 84, 1.0));
        assert_eq!(shade(2.0), Colour(253, 240, 110, 1.0));
    }
}
