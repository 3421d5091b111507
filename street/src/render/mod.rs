//! The picture of the street at an instant, as the camera sends it.
//!
//! Owns the order of the layers and the still background, which is made once per camera aim and
//! then only turned with the sway (a pure rotation of the camera moves image points without
//! parallax, so this is exact). Truth is `truth.rs`.

mod canvas;
mod glow;
mod ground;
mod light;
mod overlay;
mod painted;
mod rain;
mod scenery;
mod sensor;
mod shadows;
mod vehicles;

use canvas::Canvas;
use ground::GroundPainter;
use light::Lighting;
use shadows::Shadows;

use crate::camera::Camera;
use crate::error::{Error, Result};
use crate::faults::{Picture, View};
use crate::random::{Stream, hash};
use crate::simulation::{Simulation, Snapshot};
use crate::solid::{Block, barrier_blocks};

/// The background is known so far beyond the picture, px more than the sway.
const MARGIN_PX: u32 = 4;

/// Mesh of the map that turns the background, px.
const WARP_CELL_PX: usize = 16;

/// A picture, 8-bit RGB, rows from the top.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Image {
    /// Width, px.
    pub width: u32,
    /// Height, px.
    pub height: u32,
    /// `width * height * 3` bytes.
    pub data: Vec<u8>,
}

impl Image {
    /// The picture as baseline JPEG with 4:2:0 colour; `frame` names it in errors.
    ///
    /// # Errors
    /// [`Error::Jpeg`] when the encoder refuses.
    pub fn jpeg(&self, quality: u8, frame: &str) -> Result<Vec<u8>> {
        let mut bytes = Vec::new();
        let mut encoder = jpeg_encoder::Encoder::new(&mut bytes, quality);
        encoder.set_sampling_factor(jpeg_encoder::SamplingFactor::F_2_2);
        let size = (self.width as u16, self.height as u16);
        encoder
            .encode(&self.data, size.0, size.1, jpeg_encoder::ColorType::Rgb)
            .map_err(|fault| Error::Jpeg { frame: frame.to_owned(), message: fault.to_string() })?;
        Ok(bytes)
    }
}

/// Draws pictures of one street.
pub struct Renderer {
    seed: u64,
    texture: u64,
    light: Lighting,
    blocks: Vec<Block>,
    background: Option<(Camera, Canvas)>,
    work: Canvas,
    last_live: Option<Image>,
}

impl Renderer {
    /// A renderer for a street; the seed fixes texture, scenery, noise and rain.
    pub fn new(street: &Simulation, seed: u64) -> Self {
        let scene = street.scene();
        let scale = match scene.imaging.supersampling {
            0 if scene.camera.width <= 400 => 3,
            0 => 2,
            given => given,
        };
        Renderer {
            seed,
            texture: Stream::new(seed, "texture").bits(),
            light: Lighting::of(scene),
            blocks: barrier_blocks(street),
            background: None,
            work: Canvas::new(scene.camera.width, scene.camera.height, 0, scale),
            last_live: None,
        }
    }

    /// The picture of a snapshot. Frames must come in order when the scene freezes: a frozen
    /// picture is the last live one given before.
    pub fn render(&mut self, street: &Simulation, snapshot: &Snapshot, view: &View) -> Image {
        let scene = street.scene();
        let (width, height) = (scene.camera.width, scene.camera.height);
        match (view.picture, &self.last_live) {
            (Picture::Frozen, Some(last)) => return last.clone(),
            (Picture::Black, _) => {
                let data = vec![0; (width * height * 3) as usize];
                return Image { width, height, data };
            }
            _ => {}
        }
        self.lay_background(street, view);
        let camera = view.camera();
        let (canvas, light) = (&mut self.work, &self.light);
        glow::beams(canvas, snapshot, light, &camera);
        vehicles::paint(canvas, snapshot, &self.blocks, light, &camera);
        glow::signals(canvas, street, snapshot, light, &camera);
        glow::glare(canvas, snapshot, light, &camera);
        let instant = (snapshot.time_s * 1000.0).round() as u64;
        if scene.light.rain > 0.0 {
            rain::paint(canvas, (width, height), scene.light.rain, self.seed, instant);
        }
        let salt = hash(self.texture ^ instant);
        let mut picture =
            sensor::expose(canvas, width as usize, height as usize, &scene.imaging, salt);
        let frame = (snapshot.time_s / scene.interval_s).round() as usize;
        overlay::burn(&mut picture, &scene.overlays, scene.frame_time(frame));
        if scene.faults.frozen_from_s.is_some() {
            self.last_live = Some(picture.clone());
        }
        picture
    }

    fn lay_background(&mut self, street: &Simulation, view: &View) {
        let scene = street.scene();
        let stale = self.background.as_ref().is_none_or(|(camera, _)| *camera != view.aim);
        if stale {
            let margin = MARGIN_PX + scene.faults.shake_px.ceil() as u32;
            let scale = self.work.scale() as u32;
            let mut canvas = Canvas::new(scene.camera.width, scene.camera.height, margin, scale);
            let marks = painted::marks(scene, street.lane_lines());
            let shadows = Shadows::of(scene, street.road(), &self.light, self.texture);
            let painter = GroundPainter {
                scene,
                road: street.road(),
                lines: street.lane_lines(),
                light: &self.light,
                marks: &marks,
                shadows: &shadows,
                salt: self.texture,
            };
            painter.paint(&mut canvas, &view.aim);
            scenery::paint(&mut canvas, scene, street.road(), &self.light, &view.aim, self.seed);
            self.background = Some((view.aim.clone(), canvas));
        }
        let Some((_, background)) = &self.background else { return };
        if view.sway.angle() == 0.0 {
            self.work.copy_middle(background);
        } else {
            turn(background, view, &mut self.work);
        }
    }
}

/// Resamples the background as the swayed camera sees it.
fn turn(background: &Canvas, view: &View, out: &mut Canvas) {
    let scale = out.scale();
    let cell = WARP_CELL_PX * scale;
    let (columns, rows) = (out.columns(), out.rows());
    let back = view.sway.inverse();
    let source = |column: usize, row: usize| -> [f32; 2] {
        let image = [column as f64 / scale as f64, row as f64 / scale as f64];
        let ray = back * view.aim.ray_in_cam(image);
        let (x, y) = (ray.x / ray.z, ray.y / ray.z);
        let stretch = view.aim.focal_px * (1.0 + view.aim.k1 * (x * x + y * y));
        let (w, h) = (f64::from(view.aim.width), f64::from(view.aim.height));
        [(w / 2.0 + stretch * x) as f32, (h / 2.0 + stretch * y) as f32]
    };
    for top in (0..rows).step_by(cell) {
        for left in (0..columns).step_by(cell) {
            let corners = [(0, 0), (cell, 0), (0, cell), (cell, cell)]
                .map(|(dx, dy)| source(left + dx, top + dy));
            for row in top..(top + cell).min(rows) {
                let fy = (row as f32 + 0.5 - top as f32) / cell as f32;
                for column in left..(left + cell).min(columns) {
                    let fx = (column as f32 + 0.5 - left as f32) / cell as f32;
                    let image = std::array::from_fn(|k| {
                        let above = corners[0][k] + fx * (corners[1][k] - corners[0][k]);
                        let below = corners[2][k] + fx * (corners[3][k] - corners[2][k]);
                        above + fy * (below - above)
                    });
                    let levels = background.sample(image);
                    let at = (row * columns + column) * 4;
                    out.data_mut()[at..at + 3].copy_from_slice(&levels);
                }
            }
        }
    }
}
