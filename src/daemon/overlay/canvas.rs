//! Canvas of an overlay: pixels in RGB, with shapes and letters of embedded-graphics.

use super::ink_on;
use crate::daemon::frame::Picture;
use embedded_graphics::mono_font::{MonoFont, MonoTextStyle, ascii};
use embedded_graphics::pixelcolor::{Rgb888, RgbColor};
use embedded_graphics::prelude::*;
use embedded_graphics::primitives::{
    Circle, Line, PrimitiveStyle, PrimitiveStyleBuilder, Rectangle,
};
use embedded_graphics::text::{Alignment, Baseline, Text, TextStyleBuilder};
use image::imageops::{FilterType, resize};
use image::{Rgb, RgbImage};
use std::convert::Infallible;

/// A colour of 8 bits a channel.
pub type Colour = Rgb888;
pub const WHITE: Colour = Colour::WHITE;
pub const BLACK: Colour = Colour::BLACK;
/// For what lies in no lane.
pub const GREY: Colour = Colour::new(190, 190, 190);
/// Letters of the counts.
pub const LARGE: &MonoFont<'static> = &ascii::FONT_10X20;
/// Letters of the rest.
pub const SMALL: &MonoFont<'static> = &ascii::FONT_7X13_BOLD;

/// How much of the black behind text covers the picture, 0 to 255.
const SHADE: u8 = 170;
/// Space around text, px.
const MARGIN: i32 = 6;
/// Length of an arrow's head, px.
const HEAD_PX: f32 = 16.0;

/// Where rows of text stand, at the left edge.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Corner {
    Upper,
    Lower,
}

/// The pixels.
pub struct Canvas(RgbImage);

impl OriginDimensions for Canvas {
    fn size(&self) -> Size {
        Size::new(self.0.width(), self.0.height())
    }
}

impl DrawTarget for Canvas {
    type Color = Colour;
    type Error = Infallible;

    fn draw_iter<I: IntoIterator<Item = Pixel<Colour>>>(
        &mut self,
        pixels: I,
    ) -> Result<(), Infallible> {
        for Pixel(Point { x, y }, colour) in pixels {
            let at = u32::try_from(x).ok().zip(u32::try_from(y).ok());
            if let Some(pixel) = at.and_then(|(x, y)| self.0.get_pixel_mut_checked(x, y)) {
                *pixel = Rgb([colour.r(), colour.g(), colour.b()]);
            }
        }
        Ok(())
    }
}

fn point((x, y): (f32, f32)) -> Point {
    Point::new(x.round() as i32, y.round() as i32)
}

impl Canvas {
    /// A picture, its sides multiplied by `scale`.
    pub fn enlarged(picture: &Picture, scale: usize) -> Self {
        let (width, height) = (picture.width as u32, picture.height as u32);
        let image = RgbImage::from_raw(width, height, picture.rgb.clone())
            .unwrap_or_else(|| RgbImage::new(width, height));
        if scale == 1 {
            return Self(image);
        }
        let scale = scale as u32;
        Self(resize(&image, width * scale, height * scale, FilterType::Triangle))
    }

    /// The picture.
    pub fn into_image(self) -> RgbImage {
        self.0
    }

    /// Columns and rows, px.
    pub fn size(&self) -> (usize, usize) {
        (self.0.width() as usize, self.0.height() as usize)
    }

    /// Lays a colour over a pixel, 255 covers it.
    pub fn tint(&mut self, x: usize, y: usize, colour: Colour, cover: u8) {
        let Some(pixel) = self.0.get_pixel_mut_checked(x as u32, y as u32) else { return };
        let cover = u16::from(cover);
        for (under, over) in pixel.0.iter_mut().zip([colour.r(), colour.g(), colour.b()]) {
            *under = ((u16::from(*under) * (255 - cover) + u16::from(over) * cover) / 255) as u8;
        }
    }

    fn draw(&mut self, shape: &impl Drawable<Color = Colour>) {
        let Ok(_) = shape.draw(self);
    }

    /// An arrow between two points.
    pub fn arrow(&mut self, tail: (f32, f32), head: (f32, f32), colour: Colour) {
        let (dx, dy) = (head.0 - tail.0, head.1 - tail.1);
        let length = dx.hypot(dy);
        if length < 1.0 {
            return;
        }
        let (dx, dy) = (dx / length * HEAD_PX, dy / length * HEAD_PX);
        let barbs = [-0.5, 0.5].map(|side| (head.0 - dx + side * dy, head.1 - dy - side * dx));
        for (width, colour) in [(6, BLACK), (3, colour)] {
            let style = PrimitiveStyle::with_stroke(colour, width);
            for from in [tail, barbs[0], barbs[1]] {
                self.draw(&Line::new(point(from), point(head)).into_styled(style));
            }
        }
    }

    /// A short text on a disc about a point.
    pub fn label(&mut self, at: (f32, f32), text: &str, colour: Colour) {
        let style = PrimitiveStyleBuilder::new()
            .fill_color(colour)
            .stroke_color(BLACK)
            .stroke_width(2)
            .build();
        self.draw(&Circle::with_center(point(at), 28).into_styled(style));
        let middle =
            TextStyleBuilder::new().alignment(Alignment::Center).baseline(Baseline::Middle).build();
        let letters = MonoTextStyle::new(LARGE, ink_on(colour));
        self.draw(&Text::with_text_style(text, point(at), letters, middle));
    }

    /// A frame between two corners, with a text above it.
    pub fn rectangle(&mut self, upper: (f32, f32), lower: (f32, f32), colour: Colour, text: &str) {
        let frame = Rectangle::with_corners(point(upper), point(lower));
        self.draw(&frame.into_styled(PrimitiveStyle::with_stroke(BLACK, 4)));
        self.draw(&frame.into_styled(PrimitiveStyle::with_stroke(colour, 2)));
        let glyph = SMALL.character_size;
        let size = Size::new(glyph.width * text.len() as u32 + 4, glyph.height);
        let corner = point(upper) - Point::new(2, glyph.height as i32 + 1);
        let behind = Rectangle::new(corner, size);
        self.draw(&behind.into_styled(PrimitiveStyle::with_fill(colour)));
        let letters = MonoTextStyle::new(SMALL, ink_on(colour));
        self.draw(&Text::with_baseline(text, corner + Point::new(2, 0), letters, Baseline::Top));
    }

    /// A dot with a black rim.
    pub fn point(&mut self, at: (f32, f32), colour: Colour) {
        for (diameter, colour) in [(11, BLACK), (7, colour)] {
            let dot = Circle::with_center(point(at), diameter);
            self.draw(&dot.into_styled(PrimitiveStyle::with_fill(colour)));
        }
    }

    /// Rows of text, each in its colour, on a shade.
    pub fn rows(&mut self, rows: &[(String, Colour)], font: &MonoFont<'_>, corner: Corner) {
        let glyph = font.character_size;
        let longest = rows.iter().map(|(text, _)| text.chars().count()).max().unwrap_or(0);
        let (width, height) = self.size();
        let wide = (longest as i32 * glyph.width as i32 + 2 * MARGIN).min(width as i32);
        let high = (rows.len() as i32 * glyph.height as i32 + 2 * MARGIN).min(height as i32);
        let top = if corner == Corner::Upper { 0 } else { height as i32 - high };
        for y in top..top + high {
            for x in 0..wide {
                self.tint(x as usize, y as usize, BLACK, SHADE);
            }
        }
        for (number, (text, colour)) in rows.iter().enumerate() {
            let at = Point::new(MARGIN, top + MARGIN + number as i32 * glyph.height as i32);
            let letters = MonoTextStyle::new(font, *colour);
            self.draw(&Text::with_baseline(text, at, letters, Baseline::Top));
        }
    }
}
