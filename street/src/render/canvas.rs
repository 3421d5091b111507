//! The canvas: a finer picture than the camera's, on which polygons and glows are painted.
//!
//! Owns the door to tiny-skia: supersampling, margins, paths. Image coordinates go in in px of
//! the camera's picture. Owns no light and no geometry.

use tiny_skia::{
    BlendMode, Color, FillRule, GradientStop, Paint, PathBuilder, Pixmap, PixmapPaint, Point,
    RadialGradient, Rect, Shader, SpreadMode, Transform,
};

/// A picture under construction.
#[derive(Clone)]
pub struct Canvas {
    pixmap: Pixmap,
    scale: f32,
    margin: f32,
}

impl Canvas {
    /// A black canvas for a picture of `width` x `height` px with `margin` px around it, at
    /// `scale` samples per px.
    pub fn new(width: u32, height: u32, margin: u32, scale: u32) -> Self {
        let (w, h) = ((width + 2 * margin) * scale, (height + 2 * margin) * scale);
        let mut pixmap = Pixmap::new(w, h).expect("scene checks keep sizes within 32..=4096 px");
        pixmap.fill(Color::BLACK);
        Canvas { pixmap, scale: scale as f32, margin: margin as f32 }
    }

    /// Width in samples.
    pub fn columns(&self) -> usize {
        self.pixmap.width() as usize
    }

    /// Height in samples.
    pub fn rows(&self) -> usize {
        self.pixmap.height() as usize
    }

    /// Samples per px.
    pub fn scale(&self) -> usize {
        self.scale as usize
    }

    /// The samples, RGBA.
    pub fn data(&self) -> &[u8] {
        self.pixmap.data()
    }

    /// The samples, RGBA, to write; keep alpha 255.
    pub fn data_mut(&mut self) -> &mut [u8] {
        self.pixmap.data_mut()
    }

    /// The image point in px of the middle of a sample.
    pub fn image_of(&self, column: usize, row: usize) -> [f64; 2] {
        [
            (column as f64 + 0.5) / f64::from(self.scale) - f64::from(self.margin),
            (row as f64 + 0.5) / f64::from(self.scale) - f64::from(self.margin),
        ]
    }

    fn sample_of(&self, image: [f64; 2]) -> (f32, f32) {
        ((image[0] as f32 + self.margin) * self.scale, (image[1] as f32 + self.margin) * self.scale)
    }

    /// Fills a polygon with a colour; `opacity` 0 to 1.
    pub fn polygon(&mut self, points: &[[f64; 2]], colour: [u8; 3], opacity: f32) {
        self.fill(points, colour, opacity, BlendMode::SourceOver);
    }

    /// Adds light to a polygon.
    pub fn shine(&mut self, points: &[[f64; 2]], colour: [u8; 3], opacity: f32) {
        self.fill(points, colour, opacity, BlendMode::Plus);
    }

    fn fill(&mut self, points: &[[f64; 2]], colour: [u8; 3], opacity: f32, mode: BlendMode) {
        let (mut low, mut high) = ((f32::MAX, f32::MAX), (f32::MIN, f32::MIN));
        let mut builder = PathBuilder::with_capacity(points.len() + 1, points.len());
        for (i, point) in points.iter().enumerate() {
            let (x, y) = self.sample_of(*point);
            low = (low.0.min(x), low.1.min(y));
            high = (high.0.max(x), high.1.max(y));
            if i == 0 { builder.move_to(x, y) } else { builder.line_to(x, y) }
        }
        let (w, h) = (self.pixmap.width() as f32, self.pixmap.height() as f32);
        let outside = high.0 < 0.0 || high.1 < 0.0 || low.0 > w || low.1 > h;
        if outside || high.0 - low.0 < 0.3 || high.1 - low.1 < 0.3 {
            return;
        }
        builder.close();
        let Some(path) = builder.finish() else { return };
        let alpha = (255.0 * opacity.clamp(0.0, 1.0)).round() as u8;
        let shader = Shader::SolidColor(Color::from_rgba8(colour[0], colour[1], colour[2], alpha));
        let paint = Paint { shader, blend_mode: mode, anti_alias: false, ..Paint::default() };
        self.pixmap.fill_path(&path, &paint, FillRule::Winding, Transform::identity(), None);
    }

    /// Fills a disc.
    pub fn disc(&mut self, centre: [f64; 2], radius_px: f64, colour: [u8; 3]) {
        let (x, y) = self.sample_of(centre);
        let Some(path) = PathBuilder::from_circle(x, y, radius_px as f32 * self.scale) else {
            return;
        };
        let shader = Shader::SolidColor(Color::from_rgba8(colour[0], colour[1], colour[2], 255));
        let paint = Paint { shader, anti_alias: false, ..Paint::default() };
        self.pixmap.fill_path(&path, &paint, FillRule::Winding, Transform::identity(), None);
    }

    /// Adds a soft round light that fades to nothing at its radius.
    pub fn glow(&mut self, centre: [f64; 2], radius_px: f64, colour: [u8; 3], opacity: f32) {
        let (x, y) = self.sample_of(centre);
        let radius = radius_px as f32 * self.scale;
        if radius < 0.5 {
            return;
        }
        let stop = |at: f32, share: f32| {
            let alpha = (255.0 * opacity * share).clamp(0.0, 255.0) as u8;
            GradientStop::new(at, Color::from_rgba8(colour[0], colour[1], colour[2], alpha))
        };
        let stops = vec![stop(0.0, 1.0), stop(0.2, 0.5), stop(0.5, 0.14), stop(1.0, 0.0)];
        let middle = Point::from_xy(x, y);
        let gradient = RadialGradient::new(
            middle,
            0.0,
            middle,
            radius,
            stops,
            SpreadMode::Pad,
            Transform::identity(),
        );
        let square = Rect::from_xywh(x - radius, y - radius, 2.0 * radius, 2.0 * radius);
        let (Some(shader), Some(square)) = (gradient, square) else { return };
        let paint =
            Paint { shader, blend_mode: BlendMode::Plus, anti_alias: false, ..Paint::default() };
        self.pixmap.fill_rect(square, &paint, Transform::identity(), None);
    }

    /// Copies a canvas with a margin into this one without, at the same scale.
    pub fn copy_middle(&mut self, from: &Canvas) {
        let shift = -((from.margin - self.margin) * self.scale) as i32;
        let paint = PixmapPaint { blend_mode: BlendMode::Source, ..PixmapPaint::default() };
        self.pixmap.draw_pixmap(
            shift,
            shift,
            from.pixmap.as_ref(),
            &paint,
            Transform::identity(),
            None,
        );
    }

    /// The RGBA sample at an image point, bilinear; clamped to the canvas.
    pub fn sample(&self, image: [f32; 2]) -> [u8; 3] {
        let x = ((image[0] + self.margin) * self.scale - 0.5)
            .clamp(0.0, self.pixmap.width() as f32 - 1.001);
        let y = ((image[1] + self.margin) * self.scale - 0.5)
            .clamp(0.0, self.pixmap.height() as f32 - 1.001);
        let (i, j) = (x as usize, y as usize);
        let (fx, fy) = (((x - i as f32) * 256.0) as u32, ((y - j as f32) * 256.0) as u32);
        let stride = self.pixmap.width() as usize * 4;
        let at = j * stride + i * 4;
        let data = self.pixmap.data();
        std::array::from_fn(|k| {
            let top = u32::from(data[at + k]) * (256 - fx) + u32::from(data[at + k + 4]) * fx;
            let below = at + stride + k;
            let bottom = u32::from(data[below]) * (256 - fx) + u32::from(data[below + 4]) * fx;
            ((top * (256 - fy) + bottom * fy + 32_768) >> 16) as u8
        })
    }
}
