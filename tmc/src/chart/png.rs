//! A drawing as a PNG file, by tiny-skia.

use super::{Anchor, Colour, Drawing, INK, Shape, font};
use tiny_skia::{
    FillRule, LineCap, LineJoin, Paint, Path, PathBuilder, Pixmap, Rect, Stroke, Transform,
};

pub(super) fn png(drawing: &Drawing) -> Vec<u8> {
    let mut picture = Pixmap::new(drawing.width.max(1), drawing.height.max(1))
        .expect("drawings have the sizes of pictures");
    picture.fill(tiny_skia::Color::WHITE);
    for shape in &drawing.shapes {
        draw(&mut picture, shape);
    }
    picture.encode_png().expect("encoding to memory")
}

fn paint(Colour(r, g, b, a): Colour) -> Paint<'static> {
    let mut paint = Paint::default();
    paint.set_color_rgba8(r, g, b, (a * 255.0).round() as u8);
    paint
}

fn draw(picture: &mut Pixmap, shape: &Shape) {
    let same = Transform::identity();
    match shape {
        Shape::Rectangle([x, y, w, h], colour) => {
            let rect = Rect::from_xywh(*x as f32, *y as f32, *w as f32, *h as f32);
            // One without an area shows nothing.
            let Some(rect) = rect else { return };
            let mut paint = paint(*colour);
            // Cells of a map meet without a seam.
            paint.anti_alias = false;
            picture.fill_rect(rect, &paint, same, None);
        }
        Shape::Dot([x, y], r, colour) => {
            if let Some(path) = PathBuilder::from_circle(*x as f32, *y as f32, *r as f32) {
                picture.fill_path(&path, &paint(*colour), FillRule::Winding, same, None);
            }
        }
        Shape::Line(points, width, colour) => {
            if let Some(path) = path(points, false) {
                let stroke = Stroke { width: *width as f32, ..Stroke::default() };
                picture.stroke_path(&path, &paint(*colour), &stroke, same, None);
            }
        }
        Shape::Area(points, colour) => {
            if let Some(path) = path(points, true) {
                picture.fill_path(&path, &paint(*colour), FillRule::Winding, same, None);
            }
        }
        Shape::Text { text, at, size, anchor, upward } => {
            letters(picture, text, *at, *size, *anchor, *upward);
        }
    }
}

fn path(points: &[[f64; 2]], close: bool) -> Option<Path> {
    let mut builder = PathBuilder::new();
    for (index, &[x, y]) in points.iter().enumerate() {
        let (x, y) = (x as f32, y as f32);
        if index == 0 { builder.move_to(x, y) } else { builder.line_to(x, y) }
    }
    if close {
        builder.close();
    }
    builder.finish()
}

fn letters(
    picture: &mut Pixmap,
    text: &str,
    [x, y]: [f64; 2],
    size: f64,
    anchor: Anchor,
    upward: bool,
) {
    let unit = size / font::HEIGHT;
    let length = font::length(text) * unit;
    let begin = match anchor {
        Anchor::Start => 0.0,
        Anchor::Middle => -length / 2.0,
        Anchor::End => -length,
    };
    let place = |[right, down]: [f64; 2]| {
        let (along, below) = (begin + right * unit, down * unit);
        if upward { [x + below, y - along] } else { [x + along, y + below] }
    };
    let stroke = Stroke {
        width: (size / 11.0).max(0.9) as f32,
        line_cap: LineCap::Round,
        line_join: LineJoin::Round,
        ..Stroke::default()
    };
    for line in font::strokes(text) {
        let points: Vec<[f64; 2]> = line.into_iter().map(place).collect();
        if let Some(path) = path(&points, false) {
            picture.stroke_path(&path, &paint(INK), &stroke, Transform::identity(), None);
        }
    }
}
