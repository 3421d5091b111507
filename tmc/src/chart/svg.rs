//! A drawing as an SVG element.

use super::{Anchor, Colour, Drawing, Shape};
use std::fmt::Write;

pub(super) fn svg(drawing: &Drawing) -> String {
    let (w, h) = (drawing.width, drawing.height);
    let mut out = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {w} {h}\" width=\"{w}\" \
         height=\"{h}\" font-family=\"sans-serif\">\n"
    );
    for shape in &drawing.shapes {
        // Writing to a string does not fail.
        let _ = writeln!(out, "{}", element(shape));
    }
    out.push_str("</svg>\n");
    out
}

fn element(shape: &Shape) -> String {
    match shape {
        // Cells of a map meet without a seam, however large it is shown.
        Shape::Rectangle([x, y, w, h], c) => format!(
            "<rect x=\"{x:.1}\" y=\"{y:.1}\" width=\"{w:.2}\" height=\"{h:.2}\" \
             shape-rendering=\"crispEdges\" {}/>",
            fill(*c)
        ),
        Shape::Dot([x, y], r, c) => {
            format!("<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"{r:.1}\" {}/>", fill(*c))
        }
        Shape::Line(points, width, Colour(r, g, b, a)) => format!(
            "<polyline points=\"{}\" fill=\"none\" stroke=\"rgb({r},{g},{b})\" \
             stroke-opacity=\"{a}\" stroke-width=\"{width}\"/>",
            listed(points)
        ),
        Shape::Area(points, c) => format!("<polygon points=\"{}\" {}/>", listed(points), fill(*c)),
        Shape::Text { text, at: [x, y], size, anchor, upward } => {
            let anchor = match anchor {
                Anchor::Start => "start",
                Anchor::Middle => "middle",
                Anchor::End => "end",
            };
            let turn = if *upward {
                format!(" transform=\"rotate(-90 {x:.1} {y:.1})\"")
            } else {
                String::new()
            };
            format!(
                "<text x=\"{x:.1}\" y=\"{y:.1}\" font-size=\"{size}\" \
                 text-anchor=\"{anchor}\"{turn}>{}</text>",
                escaped(text)
            )
        }
    }
}

fn fill(Colour(r, g, b, a): Colour) -> String {
    let opacity = if a < 1.0 { format!(" fill-opacity=\"{a}\"") } else { String::new() };
    format!("fill=\"rgb({r},{g},{b})\"{opacity}")
}

fn listed(points: &[[f64; 2]]) -> String {
    points.iter().map(|[x, y]| format!("{x:.1},{y:.1}")).collect::<Vec<_>>().join(" ")
}

/// Text escaped for SVG and HTML.
pub fn escaped(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for part in text.chars() {
        match part {
            '&' => out.push_str("&amp;"),
            '<' => out.push_str("&lt;"),
            '>' => out.push_str("&gt;"),
            '"' => out.push_str("&quot;"),
            other => out.push(other),
        }
    }
    out
}
