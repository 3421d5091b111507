//! The picture of a calibration: what it makes of the road, and how well it fits.
//!
//! Owns the drawing (one-metre dots, lanes, key points and residuals) and the HTML page
//! around it (numbers, residuals, the losses of the three stages as in the paper's figure).
//! Does not own the calibration.

pub mod canvas;

use crate::camera::Camera;
use crate::files::calibration::{Calibration, StageLoss};
use crate::model::VehicleModel;
use crate::road::drawn_lane::DrawnLane;
use crate::vehicle::{Pair, Vehicle};
use canvas::{Canvas, Colour};
use nalgebra::{Rotation2, Vector2, Vector3};
use std::fmt::Write;

const DOT: Colour = [230, 30, 30];
const LANE: Colour = [60, 200, 255];
const AXIS: Colour = [255, 220, 0];
const LABELLED: Colour = [40, 255, 60];
const FITTED: Colour = [255, 60, 255];

/// Furthest dots from the camera, m, and how far to either side they go.
const DOTS_AHEAD_M: i32 = 150;
const DOTS_ASIDE_M: i32 = 40;
/// Dots closer together than this part of the picture's width are left out.
const DOT_SPACING_WIDTHS: f64 = 0.006;

/// Draws dots one metre apart on the road, as in the paper's snapshots.
pub fn draw_metres(canvas: &mut Canvas, camera: &Camera) {
    let foot = camera.pose.camera_centre();
    let axis = camera.pose.rotation.inverse() * Vector3::z();
    let ahead = Vector2::new(axis.x, axis.y).try_normalize(1e-9).unwrap_or(Vector2::y());
    let aside = Vector2::new(ahead.y, -ahead.x);
    let min_gap = DOT_SPACING_WIDTHS * f64::from(camera.image_size[0]);
    for y in 1..DOTS_AHEAD_M {
        for x in -DOTS_ASIDE_M..=DOTS_ASIDE_M {
            let at = |x: f64, y: f64| {
                let p = foot.xy() + ahead * y + aside * x;
                camera.project(&Vector3::new(p.x, p.y, 0.0))
            };
            let (x, y) = (f64::from(x), f64::from(y));
            if let (Some(uv), Some(beside)) = (at(x, y), at(x + 1.0, y))
                && (beside - uv).norm() > min_gap
            {
                canvas.dot(uv, 1.5, DOT);
            }
        }
    }
}

/// Draws the lanes' outlines and a dot every 5 m along their centre lines.
pub fn draw_lanes(canvas: &mut Canvas, camera: &Camera, lanes: &[DrawnLane]) {
    for lane in lanes {
        canvas.outline(&lane.polygon, 2.0, LANE);
        for p in lane.axis.every(5.0) {
            if let Some(uv) = camera.project(&Vector3::new(p.x, p.y, 0.0)) {
                canvas.dot(uv, 3.5, AXIS);
            }
        }
    }
}

/// A labelled vehicle as the best model stands on the calibrated road.
#[derive(Clone, Debug)]
pub struct Placed {
    /// The vehicle.
    pub name: String,
    /// The model that fits best.
    pub model: String,
    /// Root mean square distance between labelled and projected points, px.
    pub rms_px: f64,
    /// For each point: its label, where it was labelled, where the model puts it, px.
    pub points: Vec<(u8, Vector2<f64>, Vector2<f64>)>,
}

/// Puts each vehicle's best model on the road; vehicles above the horizon are left out.
pub fn place(camera: &Camera, vehicles: &[Vehicle], models: &[VehicleModel]) -> Vec<Placed> {
    let fits = |vehicle: &Vehicle| {
        let own = vehicle.body.model().map_or(models, std::slice::from_ref);
        own.iter()
            .filter_map(|model| place_model(camera, vehicle, model))
            .min_by(|a, b| a.rms_px.total_cmp(&b.rms_px))
    };
    vehicles.iter().filter_map(fits).collect()
}

/// Rigid fit on the road plane of a model to the points back-projected at its heights.
fn place_model(camera: &Camera, vehicle: &Vehicle, model: &VehicleModel) -> Option<Placed> {
    let pairs: Vec<Pair> = model.pairs(vehicle);
    let ground: Vec<Vector2<f64>> = pairs
        .iter()
        .map(|p| Some(camera.back_project(&p.image, p.world.z)?.xy()))
        .collect::<Option<_>>()?;
    let n = pairs.len() as f64;
    let from = pairs.iter().map(|p| p.world.xy()).sum::<Vector2<f64>>() / n;
    let to = ground.iter().sum::<Vector2<f64>>() / n;
    let (mut sine, mut cosine) = (0.0, 0.0);
    for (pair, g) in pairs.iter().zip(&ground) {
        let (a, b) = (pair.world.xy() - from, g - to);
        cosine += a.dot(&b);
        sine += a.perp(&b);
    }
    let turn = Rotation2::new(sine.atan2(cosine));
    let labelled = vehicle.points.iter().filter(|k| model.point(k.label).is_some());
    let points: Vec<_> = labelled
        .zip(&pairs)
        .map(|(k, pair)| {
            let p = turn * (pair.world.xy() - from) + to;
            Some((k.label, k.uv, camera.project(&Vector3::new(p.x, p.y, pair.world.z))?))
        })
        .collect::<Option<_>>()?;
    let squared: f64 = points.iter().map(|(_, a, b)| (a - b).norm_squared()).sum();
    let rms_px = (squared / n).sqrt();
    Some(Placed { name: vehicle.name.clone(), model: model.name.clone(), rms_px, points })
}

/// Draws labelled points (green), fitted points (magenta crosses) and what lies between.
pub fn draw_vehicles(canvas: &mut Canvas, placed: &[Placed]) {
    for (_, labelled, fitted) in placed.iter().flat_map(|p| &p.points) {
        canvas.line(*labelled, *fitted, 1.5, FITTED);
        canvas.dot(*labelled, 3.0, LABELLED);
        canvas.cross(*fitted, 4.0, FITTED);
    }
}

/// The page: picture, numbers, residuals, losses.
pub fn html(calibration: &Calibration, picture: &[u8], placed: &[Placed]) -> String {
    let camera = calibration.camera();
    let title = escape(calibration.camera_id.as_deref().unwrap_or("calibration"));
    let mut page = String::new();
    let or_dash =
        |x: Option<f64>, unit: &str| x.map_or("not stated".into(), |x| format!("{x:.1}{unit}"));
    let _ = write!(
        page,
        "<!doctype html><html lang=en><meta charset=utf-8><title>{title}</title>\
         <style>body{{font:15px sans-serif;margin:2em;max-width:1300px}}\
         table{{border-collapse:collapse}}td,th{{padding:2px 10px;text-align:right;\
         border-bottom:1px solid #ccc}}th:first-child,td:first-child{{text-align:left}}\
         img{{max-width:100%}}</style><h1>{title}</h1>\
         <p><b>{}</b>: focal length {:.1} px, {:.2} m above the road, {:.1} degrees down. \
         Error of a length on the road (1 sigma): {}. Trust: {}.</p>\
         <img alt='one-metre dots, lanes, key points' src='data:image/png;base64,{}'>\
         <p>Red: one metre apart on the road. Blue: lanes, yellow every 5 m along them. \
         Green: labelled key points; magenta: where the best of the known models puts them.</p>",
        escape(&calibration.method),
        calibration.f,
        camera.height_m(),
        camera.tilt_rad().to_degrees(),
        or_dash(calibration.rel_err.map(|e| 100.0 * e), " %"),
        escape(&calibration.trust.to_string()),
        base64(picture),
    );
    if let Some(u) = &calibration.uncertainty {
        let _ = write!(
            page,
            "<h2>Uncertainty (1 sigma)</h2><table><tr><th>of<th>value<th>+-\
             <tr><td>focal length, px<td>{:.1}<td>{:.1}<tr><td>height, m<td>{:.2}<td>{:.2}\
             <tr><td>tilt, degrees<td>{:.2}<td>{:.2}<tr><td>label, px<td><td>{}</table>",
            calibration.f,
            u.f_px,
            camera.height_m(),
            u.height_m,
            camera.tilt_rad().to_degrees(),
            u.tilt_rad.to_degrees(),
            u.label_sd_px.map_or("none".into(), |px| format!("{px:.2}")),
        );
    }
    residual_table(&mut page, placed);
    if let Some(stages) = &calibration.stages {
        page.push_str("<h2>Fine-tuning loss after each stage</h2>");
        let of = [&stages.candidates, &stages.refined, &stages.tuned];
        page.push_str(&loss_chart(&of.map(Vec::as_slice)));
    }
    page.push_str("</html>\n");
    page
}

fn residual_table(page: &mut String, placed: &[Placed]) {
    if placed.is_empty() {
        return;
    }
    page.push_str(
        "<h2>Vehicles</h2><table><tr><th>vehicle<th>best known model<th>rms px<th>worst point",
    );
    for p in placed {
        let off = |x: &(u8, Vector2<f64>, Vector2<f64>)| (x.1 - x.2).norm();
        let worst = p.points.iter().max_by(|a, b| off(a).total_cmp(&off(b)));
        let worst = worst.map_or(String::new(), |w| format!("{} ({:.1} px)", w.0, off(w)));
        let (name, model) = (escape(&p.name), escape(&p.model));
        let _ = write!(page, "<tr><td>{name}<td>{model}<td>{:.2}<td>{worst}", p.rms_px);
    }
    page.push_str("</table>");
}

/// The paper's figure of the three stages: the loss of every camera by vehicle, a column of
/// circles for each stage, on a logarithmic axis.
fn loss_chart(stages: &[&[StageLoss]; 3]) -> String {
    const COLOURS: [&str; 3] = ["#999999", "#1f77b4", "#d62728"];
    const NAMES: [&str; 3] = ["candidates", "model matching", "fine tuning"];
    let mut names: Vec<&str> = stages.iter().flat_map(|s| s.iter().map(|l| &*l.vehicle)).collect();
    names.sort_unstable();
    names.dedup();
    let finite =
        || stages.iter().flat_map(|s| s.iter().filter_map(|l| l.loss)).filter(|l| *l > 0.0);
    let (low, high) = finite().fold((f64::INFINITY, 0.0f64), |(l, h), x| (l.min(x), h.max(x)));
    if names.is_empty() || low >= high {
        return String::new();
    }
    let (width, height) = (90.0 * names.len() as f64 + 80.0, 320.0);
    let y = |loss: f64| 20.0 + 250.0 * (high / loss).ln() / (high / low).ln();
    let mut svg = format!("<svg width='{width}' height='{height}' font-size='12'>");
    for tick in [low, (low * high).sqrt(), high] {
        let _ = write!(svg, "<text x='2' y='{:.0}'>{tick:.2}</text>", y(tick) + 4.0);
    }
    for (k, name) in names.iter().enumerate() {
        let x = 60.0 + 90.0 * k as f64;
        let _ = write!(svg, "<text x='{x:.0}' y='292'>{}</text>", escape(name));
        for (s, stage) in stages.iter().enumerate() {
            for loss in stage.iter().filter(|l| l.vehicle == *name).filter_map(|l| l.loss) {
                let _ = write!(
                    svg,
                    "<circle cx='{:.0}' cy='{:.1}' r='4' fill='{}' fill-opacity='0.7'/>",
                    x + 10.0 + 22.0 * s as f64,
                    y(loss.max(low)),
                    COLOURS[s],
                );
            }
        }
    }
    for (s, name) in NAMES.iter().enumerate() {
        let x = 60 + 150 * s;
        let colour = COLOURS[s];
        let _ = write!(svg, "<text x='{x}' y='314' fill='{colour}'>{name}</text>");
    }
    svg.push_str("</svg>");
    svg
}

fn escape(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('\'', "&#39;").replace('"', "&quot;")
}

/// RFC 4648, section 4.
fn base64(bytes: &[u8]) -> String {
    const ALPHABET: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let mut text = String::with_capacity(bytes.len().div_ceil(3) * 4);
    for chunk in bytes.chunks(3) {
        let byte = |k: usize| u32::from(chunk.get(k).copied().unwrap_or(0));
        let bits = byte(0) << 16 | byte(1) << 8 | byte(2);
        for k in 0..4 {
            let index = (bits >> (18 - 6 * k) & 63) as usize;
            text.push(if k <= chunk.len() { char::from(ALPHABET[index]) } else { '=' });
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn base64_matches_the_vectors_of_rfc_4648() {
        for (plain, coded) in
            [("", ""), ("f", "Zg=="), ("fo", "Zm8="), ("foo", "Zm9v"), ("foobar", "Zm9vYmFy")]
        {
            assert_eq!(base64(plain.as_bytes()), coded);
        }
    }

    #[test]
    fn names_cannot_break_the_page() {
        assert_eq!(escape("<b>'x'&"), "&lt;b>&#39;x&#39;&amp;");
    }
}
