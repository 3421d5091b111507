//! A drawing as a PDF file of one page (ISO 32000-1), for print.
//!
//! Owns as much of PDF as a drawing asks for: filled and stroked paths, opacities, and text in
//! Helvetica, one of the fonts that every reader has, in Latin 1. One pixel is 0.75 points.

use super::{Anchor, Colour, Drawing, Shape};
use std::collections::BTreeMap;
use std::fmt::Write;

/// Points of a pixel (96 a inch, 72 points a inch).
const POINTS: f64 = 0.75;
/// Distance of a quarter circle's control points, of its radius.
const KAPPA: f64 = 0.552_284_8;
/// Widths of Helvetica's characters 32 to 126, thousandths of the size (Adobe's metrics).
const WIDTHS: [u16; 95] = [
    278, 278, 355, 556, 556, 889, 667, 191, 333, 333, 389, 584, 278, 333, 278, 278, 556, 556, 556,
    556, 556, 556, 556, 556, 556, 556, 278, 278, 584, 584, 584, 556, 1015, 667, 667, 722, 722, 667,
    611, 778, 722, 278, 500, 667, 556, 833, 722, 778, 667, 778, 722, 667, 611, 722, 667, 944, 667,
    667, 611, 278, 278, 278, 469, 556, 333, 556, 556, 500, 556, 556, 278, 556, 556, 222, 222, 500,
    222, 833, 556, 556, 556, 556, 333, 500, 278, 556, 500, 722, 500, 500, 500, 334, 260, 334, 584,
];

pub(super) fn pdf(drawing: &Drawing) -> Vec<u8> {
    let height = f64::from(drawing.height);
    let mut opacities = BTreeMap::<u32, f32>::new();
    // y goes up in PDF.
    let mut content = format!("{POINTS} 0 0 -{POINTS} 0 {:.2} cm\n", height * POINTS);
    for shape in &drawing.shapes {
        paint(&mut content, shape, &mut opacities);
    }
    let states: String =
        opacities.iter().map(|(key, a)| format!("/G{key} << /ca {a:.3} /CA {a:.3} >> ")).collect();
    let (w, h) = (f64::from(drawing.width) * POINTS, height * POINTS);
    let objects = [
        "<< /Type /Catalog /Pages 2 0 R >>".to_owned(),
        "<< /Type /Pages /Kids [3 0 R] /Count 1 >>".to_owned(),
        format!(
            "<< /Type /Page /Parent 2 0 R /MediaBox [0 0 {w:.2} {h:.2}] /Contents 4 0 R \
             /Resources << /Font << /F1 5 0 R >> /ExtGState << {states}>> >> >>"
        ),
        // A byte a character, as it is written below.
        format!("<< /Length {} >>\nstream\n{content}\nendstream", content.chars().count()),
        "<< /Type /Font /Subtype /Type1 /BaseFont /Helvetica /Encoding /WinAnsiEncoding >>"
            .to_owned(),
    ];
    let mut out = b"%PDF-1.4\n%\xe2\xe3\xcf\xd3\n".to_vec();
    let mut offsets = Vec::new();
    for (index, object) in objects.iter().enumerate() {
        offsets.push(out.len());
        out.extend(format!("{} 0 obj\n", index + 1).bytes());
        // Content is Latin 1, a byte a character.
        out.extend(object.chars().map(|c| u8::try_from(u32::from(c)).unwrap_or(b'?')));
        out.extend(b"\nendobj\n");
    }
    let start = out.len();
    let mut table = format!("xref\n0 {}\n0000000000 65535 f \n", objects.len() + 1);
    for offset in offsets {
        let _ = writeln!(table, "{offset:010} 00000 n ");
    }
    let _ = write!(
        table,
        "trailer\n<< /Size {} /Root 1 0 R >>\nstartxref\n{start}\n%%EOF\n",
        objects.len() + 1
    );
    out.extend(table.bytes());
    out
}

fn paint(content: &mut String, shape: &Shape, opacities: &mut BTreeMap<u32, f32>) {
    let mut colour = |content: &mut String, Colour(r, g, b, a): Colour, operator: &str| {
        let key = (a * 1000.0).round() as u32;
        opacities.insert(key, a);
        let share = |value: u8| f64::from(value) / 255.0;
        let _ = writeln!(
            content,
            "/G{key} gs {:.3} {:.3} {:.3} {operator}",
            share(r),
            share(g),
            share(b)
        );
    };
    // Writing to a string does not fail.
    match shape {
        Shape::Rectangle([x, y, w, h], c) => {
            colour(content, *c, "rg");
            let _ = writeln!(content, "{x:.2} {y:.2} {w:.2} {h:.2} re f");
        }
        Shape::Dot([x, y], r, c) => {
            colour(content, *c, "rg");
            let k = KAPPA * r;
            let _ = writeln!(
                content,
                "{:.2} {y:.2} m {:.2} {:.2} {:.2} {:.2} {x:.2} {:.2} c \
                 {:.2} {:.2} {:.2} {:.2} {:.2} {y:.2} c {:.2} {:.2} {:.2} {:.2} {x:.2} {:.2} c \
                 {:.2} {:.2} {:.2} {:.2} {:.2} {y:.2} c f",
                x + r,
                x + r,
                y + k,
                x + k,
                y + r,
                y + r,
                x - k,
                y + r,
                x - r,
                y + k,
                x - r,
                x - r,
                y - k,
                x - k,
                y - r,
                y - r,
                x + k,
                y - r,
                x + r,
                y - k,
                x + r,
            );
        }
        Shape::Line(points, width, c) => {
            colour(content, *c, "RG");
            let _ = writeln!(content, "{width} w {} S", path(points));
        }
        Shape::Area(points, c) => {
            colour(content, *c, "rg");
            let _ = writeln!(content, "{} h f", path(points));
        }
        Shape::Text { text, at: [x, y], size, anchor, upward } => {
            colour(content, super::INK, "rg");
            let width = width(text) * size;
            let shift = match anchor {
                Anchor::Start => 0.0,
                Anchor::Middle => -width / 2.0,
                Anchor::End => -width,
            };
            // Text is turned back upright, for y goes down here.
            let (matrix, [x, y]) = if *upward {
                ("0 -1 -1 0", [*x, y - shift])
            } else {
                ("1 0 0 -1", [x + shift, *y])
            };
            let _ = writeln!(
                content,
                "BT /F1 {size} Tf {matrix} {x:.2} {y:.2} Tm ({}) Tj ET",
                escaped(text)
            );
        }
    }
}

fn path(points: &[[f64; 2]]) -> String {
    let mut out = String::new();
    for (index, [x, y]) in points.iter().enumerate() {
        let operator = if index == 0 { 'm' } else { 'l' };
        let _ = write!(out, "{x:.2} {y:.2} {operator} ");
    }
    out
}

/// Width of a text in Helvetica, of its size.
fn width(text: &str) -> f64 {
    let of = |c: char| {
        let index = u32::from(c).checked_sub(32).and_then(|at| WIDTHS.get(at as usize));
        f64::from(index.copied().unwrap_or(556)) / 1000.0
    };
    text.chars().map(of).sum()
}

/// Text in parentheses; what Latin 1 has not becomes a question mark.
fn escaped(text: &str) -> String {
    let mut out = String::new();
    for c in text.chars() {
        match c {
            '(' | ')' | '\\' => out.extend(['\\', c]),
            '\u{2013}' | '\u{2212}' => out.push('-'),
            c if c.is_control() || u32::from(c) > 255 => out.push('?'),
            c => out.push(c),
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_table_of_objects_is_right() {
        let mut drawing = Drawing::new(80, 40);
        drawing.shapes.push(Shape::Rectangle([0.0, 0.0, 8.0, 8.0], Colour(255, 0, 0, 0.5)));
        drawing.shapes.push(Shape::Dot([20.0, 20.0], 4.0, Colour(0, 0, 255, 1.0)));
        drawing.text("a (b) \u{e4} \u{4e2d}", [5.0, 20.0], 10.0, Anchor::Middle);
        let bytes = pdf(&drawing);
        let text: String = bytes.iter().map(|&byte| char::from(byte)).collect();
        assert!(text.starts_with("%PDF-1.4") && text.ends_with("%%EOF\n"));
        assert!(text.contains("(a \\(b\\) \u{e4} ?) Tj") && text.contains("/G500 << /ca 0.500"));
        let start: usize =
            text.split("startxref\n").nth(1).unwrap().lines().next().unwrap().parse().unwrap();
        assert!(text[..].is_char_boundary(0) && bytes[start..].starts_with(b"xref\n0 6\n"));
        let entries = String::from_utf8_lossy(&bytes[start..]).into_owned();
        for (number, line) in entries.lines().skip(3).take(5).enumerate() {
            let offset: usize = line[..10].parse().unwrap();
            let header = format!("{} 0 obj\n", number + 1);
            assert!(bytes[offset..].starts_with(header.as_bytes()), "{line}");
        }
        let length: usize =
            text.split("/Length ").nth(1).unwrap().split(' ').next().unwrap().parse().unwrap();
        let begin = text.split("stream\n").next().unwrap().chars().count() + "stream\n".len();
        assert!(bytes[begin + length..].starts_with(b"\nendstream"));
    }
}
