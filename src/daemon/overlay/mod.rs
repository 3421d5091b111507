//! Overlay: a picture with what the line makes of it drawn over it, for the eyes of who installs
//! a camera or doubts a number.
//!
//! Owns how lanes, boxes, contact points and counts are drawn. Counts nothing: what it draws is
//! what the line has found and where the lane table puts it.

mod canvas;

use super::frame::{Detection, Frame};
use super::presets::Preset;
use crate::lane::{Lane, Place};
use crate::units::{Direction, ImagePoint, ImageSize, LaneId};
use canvas::{BLACK, Canvas, Colour, GREY, LARGE, SMALL, WHITE};
use std::io::Cursor;

/// Least width of a drawing, px: below it letters would cover the road.
const LEAST_WIDTH_PX: usize = 960;
/// How much of a lane's colour lies over the road, 0 to 255.
const TINT: u8 = 56;
/// Least shift of the scene that is worth reporting, px.
const LEAST_SHIFT_PX: f32 = 0.1;
/// The stretches of a lane, as shares of its length, between whose middles its arrow lies.
const ARROW: [std::ops::Range<f32>; 2] = [0.25..0.45, 0.55..0.75];
/// Colours that people with a weakness in seeing them tell apart (Okabe and Ito, 2008).
const PALETTE: [Colour; 7] = [
    Colour::new(86, 180, 233),
    Colour::new(230, 159, 0),
    Colour::new(0, 158, 115),
    Colour::new(240, 228, 66),
    Colour::new(204, 121, 167),
    Colour::new(0, 114, 178),
    Colour::new(213, 94, 0),
];

/// Draws what was found in `frame` and where `preset` puts it, with `note` in the last line.
/// Returns a PNG, enlarged by a whole number where the picture is narrower than 960 px.
///
/// # Errors
/// Where the picture has no size that a PNG can have.
pub fn png(
    frame: &Frame,
    preset: &Preset,
    found: &[Detection],
    note: &str,
) -> Result<Vec<u8>, image::ImageError> {
    let (drawing, mut canvas) = begin(frame, preset);
    drawing.vehicles(&mut canvas, found);
    drawing.legend(&mut canvas, found, &frame.name, note);
    encode(canvas)
}

/// The same with the lanes alone, for people to count in: what the line finds would lead them.
///
/// # Errors
/// As of [`png`].
pub fn lanes_png(frame: &Frame, preset: &Preset) -> Result<Vec<u8>, image::ImageError> {
    let (_, canvas) = begin(frame, preset);
    encode(canvas)
}

/// The picture with its lanes.
fn begin<'a>(frame: &Frame, preset: &'a Preset) -> (Drawing<'a>, Canvas) {
    let picture = &frame.picture;
    let scale = LEAST_WIDTH_PX.div_ceil(picture.width.max(1)).max(1);
    let mut canvas = Canvas::enlarged(picture, scale);
    let side = |px: usize| u16::try_from(px).unwrap_or(u16::MAX);
    let size = ImageSize { width: side(picture.width), height: side(picture.height) };
    let drawing = Drawing { preset, size, scale: scale as f32 };
    drawing.lanes(&mut canvas);
    (drawing, canvas)
}

fn encode(canvas: Canvas) -> Result<Vec<u8>, image::ImageError> {
    let mut bytes = Cursor::new(Vec::new());
    canvas.into_image().write_to(&mut bytes, image::ImageFormat::Png)?;
    Ok(bytes.into_inner())
}

/// A picture's lane table, at the scale of the drawing.
struct Drawing<'a> {
    preset: &'a Preset,
    size: ImageSize,
    scale: f32,
}

impl Drawing<'_> {
    /// The colour of a lane, by its place among the lanes of the table.
    fn colour(&self, lane: LaneId) -> Colour {
        let index = self.preset.table().lanes.iter().position(|known| known.id == lane);
        PALETTE[index.unwrap_or(0) % PALETTE.len()]
    }

    /// Tints the lanes, draws their edges, sections, arrows and numbers.
    fn lanes(&self, canvas: &mut Canvas) {
        let (width, height) = canvas.size();
        let lanes = &self.preset.table().lanes;
        let mut sums = vec![[(0.0_f32, 0.0_f32, 0.0_f32); 2]; lanes.len()];
        let mut above: Vec<Option<Place>> = vec![None; width];
        for y in 0..height {
            let mut left: Option<Place> = None;
            for (x, above) in above.iter_mut().enumerate() {
                let at = |px: usize| (px as f32 + 0.5) / self.scale;
                let place = self.preset.place_at(ImagePoint { u: at(x), v: at(y) }, self.size);
                let lane = place.map(|place| place.lane);
                if let Some(place) = place {
                    canvas.tint(x, y, self.colour(place.lane), TINT);
                    if let Some(index) = lanes.iter().position(|known| known.id == place.lane) {
                        let share = place.s_m / lanes[index].length_m;
                        for (sum, stretch) in sums[index].iter_mut().zip(&ARROW) {
                            if stretch.contains(&share) {
                                *sum = (sum.0 + x as f32, sum.1 + y as f32, sum.2 + 1.0);
                            }
                        }
                    }
                }
                for beside in [left, *above] {
                    let neighbour = beside.map(|place| place.lane);
                    if neighbour != lane
                        && let Some(edge) = lane.or(neighbour)
                    {
                        canvas.tint(x, y, self.colour(edge), 255);
                    }
                    if let (Some(place), Some(beside)) = (place, beside)
                        && self.preset.is_section_between([place, beside])
                    {
                        canvas.tint(x, y, WHITE, 255);
                    }
                }
                (left, *above) = (place, place);
            }
        }
        for (lane, [tail, head]) in lanes.iter().zip(sums) {
            let middle =
                |(u, v, count): (f32, f32, f32)| (count > 0.0).then(|| (u / count, v / count));
            let (Some(tail), Some(head)) = (middle(tail), middle(head)) else { continue };
            if lane.direction != Direction::Unknown {
                canvas.arrow(tail, head, self.colour(lane.id));
            }
            let between = ((tail.0 + head.0) / 2.0, (tail.1 + head.1) / 2.0);
            canvas.label(between, &lane.id.get().to_string(), self.colour(lane.id));
        }
    }

    /// Draws each box in its lane's colour, grey outside the lanes, with the point at which the
    /// vehicle meets the road.
    fn vehicles(&self, canvas: &mut Canvas, found: &[Detection]) {
        for detection in found {
            let contact = self.preset.contact(&detection.bounds, self.size);
            let lane = contact.and_then(|at| self.preset.place_at(at, self.size));
            let colour = lane.map_or(GREY, |place| self.colour(place.lane));
            let bounds = &detection.bounds;
            let at = |u: f32, v: f32| (u * self.scale, v * self.scale);
            let text = format!("{} {:.2}", detection.class.name(), detection.score);
            canvas.rectangle(at(bounds.x0, bounds.y0), at(bounds.x1, bounds.y1), colour, &text);
            if let Some(contact) = contact {
                canvas.point(at(contact.u, contact.v), colour);
            }
        }
    }

    /// Says what was counted: a line for each lane, then the frame.
    fn legend(&self, canvas: &mut Canvas, found: &[Detection], name: &str, note: &str) {
        let places: Vec<_> = found
            .iter()
            .filter_map(|detection| self.preset.contact(&detection.bounds, self.size))
            .filter_map(|contact| self.preset.place_at(contact, self.size))
            .collect();
        let table = self.preset.table();
        let row = |lane: &Lane| {
            let count = places.iter().filter(|place| place.lane == lane.id).count();
            let density = count as f32 / (lane.length_m / 1000.0);
            let direction = match lane.direction {
                Direction::Toward => "toward",
                Direction::Away => "away",
                Direction::Unknown => "",
            };
            format!("lane {} {direction:<6} {count:>3} veh {density:>6.1} veh/km", lane.id.get())
        };
        let mut rows: Vec<(String, Colour)> =
            table.lanes.iter().map(|lane| (row(lane), self.colour(lane.id))).collect();
        let outside = found.len() - places.len();
        rows.push((format!("outside lanes {outside:>4} veh"), GREY));
        canvas.rows(&rows, LARGE, canvas::Corner::Upper);
        let (shift, camera) = (self.preset.shift(), table.camera_id.as_str());
        let mut last = format!("{camera}  {name}");
        if shift.u.abs().max(shift.v.abs()) >= LEAST_SHIFT_PX {
            last += &format!("  scene {:+.1}, {:+.1} px off its place", shift.u, shift.v);
        }
        if !note.is_empty() {
            last += &format!("  {note}");
        }
        canvas.rows(&[(last, WHITE)], SMALL, canvas::Corner::Lower);
    }
}

/// Colours that the text behind a label needs: black on light, white on dark.
fn ink_on(colour: Colour) -> Colour {
    use embedded_graphics::pixelcolor::RgbColor;
    let bright = 3 * u32::from(colour.r()) + 6 * u32::from(colour.g()) + u32::from(colour.b());
    if bright > 1300 { BLACK } else { WHITE }
}
