//! A drawing measured: the camera, how well it is known, and what is wrong with the lanes.
//!
//! Owns how the answer to each click comes about (its values are `answer`'s). Does not own the fit nor the verdicts
//! (see `road`, `trust`); the answer has whatever they refuse, in their own words.

use super::answer::{
    CameraLook, ErrorLook, LaneLook, LaneMeasured, LengthLook, Limits, Look, RectangleLook,
    StripLook, TrafficLook, VehicleLook,
};
use super::drawing::{Drawing, Lane, Px};
use super::strips::Strip;
use crate::camera::Camera;
use crate::error::{Error, Result};
use crate::files::calibration::{Calibration, VehicleMatch};
use crate::joint::{self, untold::untold};
use crate::length_error::UncertainCamera;
use crate::model::{VehicleModel, parse_models};
use crate::problem::Problem;
use crate::road::drawn_lane::{self, DrawnLane};
use crate::road::fit::{self, BoxCue, Fit, LaneCue, PlaceErrors};
use crate::road::judge::{Judged, MAX_SPAN_M, MIN_CAR_PX, judge_lanes};
use crate::road::lane_table::require_apart;
use crate::road::outline;
use crate::trust::{MAX_ACROSS_REL_ERR, MAX_FAR_REL_ERR, MAX_REL_ERR, Reason, Trust};
use crate::validation::check_vehicle;
use nalgebra::{Vector2, Vector3};
use std::sync::LazyLock;
use std::time::Instant;
use verge::lane::DEFAULT_CELL_LENGTH_M;
use verge::units::{Direction, LaneId};

/// Half the length of the stretches whose error colours the road, m.
const HALF_STRETCH_M: f64 = 3.0;
/// How far the dots go on beyond what is drawn, m.
const MARGIN_M: f64 = 2.0;
/// Dots closer together than this part of the picture's width are left out.
const DOT_SPACING_WIDTHS: f64 = 0.006;
/// Most dots.
const MOST_DOTS: usize = 2500;
/// A proposed lane ends where half of what `road::judge` allows is used up.
const PROPOSED_PART: f64 = 0.5;
/// Steps in which a proposed lane is shortened.
const PROPOSAL_STEPS: u32 = 40;

static MODELS: LazyLock<Vec<VehicleModel>> = LazyLock::new(|| {
    let text = include_str!("../../data/vehicles_rear.json");
    parse_models(text).expect("the shipped vehicle models are readable")
});

/// Measures a drawing. `boxes` are the vehicles that a detector found.
pub fn look(drawing: &Drawing, boxes: &[BoxCue]) -> Look {
    let start = Instant::now();
    let mut answer = Look::default();
    let measured = measure(drawing, boxes, &mut answer);
    answer.fit_ms = 1e3 * start.elapsed().as_secs_f64();
    let found = match measured {
        Ok(found) => found,
        Err(error) => {
            answer.problem = Some(error.to_string());
            None
        }
    };
    let strips = drawing.strips();
    answer.strips = strips.iter().map(|s| strip_look(s, found.as_ref())).collect();
    if let Some(found) = &found {
        answer.camera = Some(camera_look(found));
        answer.lengths = length_looks(drawing, found);
        answer.rectangles = found.rectangles.iter().map(rectangle_look).collect();
        answer.dots = dots(drawing, &found.known);
    }
    let known = found.as_ref().map(|f| &f.known);
    answer.lanes = drawing.lanes.iter().map(|l| lane_look(drawing, l, known)).collect();
    answer.lanes_problem = known.and_then(|k| whole_problem(drawing, k));
    answer
}

/// The camera of a drawing, whatever its trust.
///
/// # Errors
/// What the fit says.
pub fn camera(drawing: &Drawing, boxes: &[BoxCue]) -> Result<Camera> {
    let found = measure(drawing, boxes, &mut Look::default())?.ok_or_else(nothing)?;
    Ok(*found.camera())
}

/// The camera of a drawing with everything that may be saved.
///
/// # Errors
/// What the fit says.
pub fn calibration(drawing: &Drawing, boxes: &[BoxCue]) -> Result<Calibration> {
    let mut answer = Look::default();
    let found = measure(drawing, boxes, &mut answer)?.ok_or_else(nothing)?;
    let mut calibration = found.calibration();
    let contradicted = found.doubts.iter().find_map(|d| Some((d, d.others.as_ref()?)));
    if let (Trust::Ok, Some((doubt, others))) = (&calibration.trust, contradicted) {
        let (name, known_m, measured_m) = (doubt.name.clone(), doubt.known_m, others.metres);
        calibration.trust = Trust::Refused(Reason::Contradiction { name, known_m, measured_m });
    }
    calibration.vehicles = answer
        .vehicles
        .iter()
        .enumerate()
        .filter(|(_, v)| v.misfit_px.is_some())
        .map(|(k, v)| VehicleMatch {
            name: format!("vehicle {}", k + 1),
            model: None,
            rms_px: v.misfit_px,
        })
        .collect();
    Ok(calibration)
}

/// The lanes of a drawing on the road of a camera, all of them good.
///
/// # Errors
/// Names the first lane that cannot be used.
pub fn lanes(drawing: &Drawing, calibration: &Calibration) -> Result<Vec<DrawnLane>> {
    let camera = calibration.camera();
    let drawn = drawn_lane::lanes(&drawing.labelme(&drawing.lanes), "the drawing", &camera)?;
    let known = calibration.known();
    let judged = judge_lanes(&drawn, &camera, known.as_ref(), DEFAULT_CELL_LENGTH_M);
    crate::road::judge::require(&judged)?;
    require_apart(&drawn, camera.image_size)?;
    Ok(drawn)
}

fn nothing() -> Error {
    Error::Usage(
        "nothing to calibrate from yet: mark a known length along the road near the camera, and \
         one far from it"
            .into(),
    )
}

fn measure(drawing: &Drawing, boxes: &[BoxCue], answer: &mut Look) -> Result<Option<Fit>> {
    let mut cues = drawing.cues()?;
    let vehicles = drawing.vehicles()?;
    let (mut usable, mut doubts) = (Vec::new(), Vec::new());
    for vehicle in &vehicles {
        let problem = check_vehicle(vehicle, &MODELS).err().map(|e| e.to_string());
        if problem.is_none() {
            usable.push(vehicle.clone());
        }
        answer.vehicles.push(VehicleLook { misfit_px: None, problem });
    }
    if !usable.is_empty() {
        let problem = Problem::new(drawing.image_size, usable, MODELS.clone())?;
        let joint = joint::calibrate(&problem, &joint::Settings::default())?;
        let mut misfits = joint.misfit_px.iter();
        for vehicle in answer.vehicles.iter_mut().filter(|v| v.problem.is_none()) {
            vehicle.misfit_px = misfits.next().copied();
        }
        cues.labelled = Some(joint.labelled());
        doubts = untold(&problem, &joint::Settings::default(), &joint.estimate);
    }
    if cues.lanes.is_empty() {
        // They say where the road runs. Were their width a cue, a lane over two lanes would bend the
        // camera until it has the width of one, and be its own judge.
        let of = |lane: LaneCue| LaneCue { steady: false, ..lane };
        cues.lanes = drawing.outlines().into_iter().map(of).collect();
    }
    if drawing.use_traffic && !cues.lanes.is_empty() {
        cues.boxes = boxes.to_vec();
    }
    let empty = cues.marks.is_empty()
        && cues.lanes.is_empty()
        && cues.rectangles.is_empty()
        && cues.labelled.is_none();
    if empty {
        return Err(nothing());
    }
    let mut found = fit::fit(&cues, drawing.image_size)?;
    let used = |v: &(usize, &mut VehicleLook)| v.1.misfit_px.is_some();
    let mut used: Vec<_> = answer.vehicles.iter_mut().enumerate().filter(used).collect();
    for (k, doubt) in doubts.iter().enumerate() {
        let (place, vehicle) = &mut used[doubt.vehicle];
        let reason = Reason::OtherBody {
            vehicles: vec![format!("vehicle {}", *place + 1)],
            body: doubt.body.name(),
            odds: doubt.log_odds.exp(),
        };
        vehicle.problem = Some(reason.to_string());
        if k == 0 {
            found.trust = Trust::Refused(reason);
        }
    }
    Ok(Some(found))
}

fn camera_look(found: &Fit) -> CameraLook {
    let camera = found.camera();
    let errors = found.errors();
    let one =
        |p: &PlaceErrors| ErrorLook { at: p.at, along: p.along.rel_sd, across: p.across.rel_sd };
    CameraLook {
        f_px: camera.lens.f,
        height_m: camera.height_m(),
        tilt_deg: camera.tilt_rad().to_degrees(),
        trust: found.trust.to_string(),
        errors: [one(&errors.near), one(&errors.middle), one(&errors.far)],
        limits: Limits { along: MAX_FAR_REL_ERR, across: MAX_ACROSS_REL_ERR },
        whole: errors.whole.rel_sd,
        traffic: found.traffic.as_ref().map(|t| TrafficLook {
            used: t.used,
            longer: t.car_length[0],
            longer_sd: t.car_length[1],
        }),
    }
}

/// The fit's marks are those of the drawing whose length is known, in order.
fn length_looks(drawing: &Drawing, found: &Fit) -> Vec<Option<LengthLook>> {
    let number = |k: usize| format!("mark {}", k + 1);
    let of = |k: usize| {
        let name = number(k);
        let own =
            |m: &&fit::MarkResidual| m.name == name || m.name.starts_with(&format!("{name} "));
        let mark = found.marks.iter().find(own)?;
        let measured_m = mark.measured_m.iter().sum::<f64>() / mark.measured_m.len() as f64;
        let doubt = found.doubts.iter().find(|d| d.name == mark.name);
        Some(LengthLook {
            known_m: mark.known_m,
            measured_m,
            in_sd: mark.in_sd,
            doubt: doubt.map(|d| d.to_string()),
            is_contradicted: doubt.is_some_and(|d| d.others.is_some()),
        })
    };
    (0..drawing.lengths.len()).map(of).collect()
}

fn rectangle_look(found: &fit::RectangleResidual) -> RectangleLook {
    RectangleLook { sides_m: found.sides_m, angle_deg: found.angle_deg, in_sd: found.in_sd }
}

fn strip_look(strip: &Strip, found: Option<&Fit>) -> StripLook {
    let name = strip.cue().name;
    let width_m =
        found.and_then(|f| f.lanes.iter().find(|l| l.name == name)).map(|lane| lane.width_m);
    let width_err = found
        .and_then(|f| f.errors().lanes.iter().find(|l| l.name == name))
        .map(|lane| lane.places.map(|(_, error)| error.rel_sd));
    let outline = found.map_or_else(
        || strip.outline(1.0),
        |found| proposed(strip, &found.known).unwrap_or_else(|| strip.outline(1.0)),
    );
    let outline = outline.into_iter().map(Px::from).collect();
    StripLook { lines: strip.lines, width_m, width_err, outline }
}

/// The longest near part of a strip that is seen well enough at its far end.
fn proposed(strip: &Strip, known: &UncertainCamera) -> Option<Vec<Vector2<f64>>> {
    let id = LaneId::new(1)?;
    (1..=PROPOSAL_STEPS).rev().map(|k| f64::from(k) / f64::from(PROPOSAL_STEPS)).find_map(|part| {
        let outline = strip.outline(part);
        let lane = drawn_lane::on_road(
            outline::Outline {
                label: "1".into(),
                id,
                direction: Direction::Away,
                widens: false,
                polygon: outline.clone(),
            },
            &known.camera,
        );
        let judged = judge_lanes(&[lane.ok()?], &known.camera, Some(known), DEFAULT_CELL_LENGTH_M);
        let g = &judged.first()?.geometry;
        let good = g.far_span_m < PROPOSED_PART * MAX_SPAN_M
            && g.far_car_px[0] * PROPOSED_PART > MIN_CAR_PX
            && g.rel_err.is_none_or(|e| e < MAX_REL_ERR);
        good.then_some(outline)
    })
}

fn lane_look(drawing: &Drawing, lane: &Lane, known: Option<&UncertainCamera>) -> LaneLook {
    let said = |error: Error| {
        let problem = match error {
            Error::Lane { problem, .. } => problem,
            other => other.to_string(),
        };
        LaneLook { problem: Some(problem), measured: None }
    };
    // Without a direction it has a width and a length all the same.
    let mut measurable = lane.clone();
    let undirected = lane.direction.is_empty();
    if undirected {
        measurable.direction = "away".into();
    }
    let outline = match outline::read(&drawing.labelme([&measurable])) {
        Ok(read) => read.lanes.into_iter().next(),
        Err(error) => return said(error),
    };
    let (Some(outline), Some(known)) = (outline, known) else {
        let problem = Some("there is no camera yet: go back to the road".into());
        return LaneLook { problem, measured: None };
    };
    let drawn = match drawn_lane::on_road(outline, &known.camera) {
        Ok(drawn) => drawn,
        Err(error) => return said(error),
    };
    let judged = judge_lanes(
        std::slice::from_ref(&drawn),
        &known.camera,
        Some(known),
        DEFAULT_CELL_LENGTH_M,
    );
    let Some(Judged { geometry: g, problem }) = judged.into_iter().next() else {
        return LaneLook { problem: None, measured: None };
    };
    let choose = || "choose which way its traffic moves: toward the camera or away from it".into();
    let image = |p: Vector2<f64>| known.camera.project(&Vector3::new(p.x, p.y, 0.0)).map(Px::from);
    LaneLook {
        problem: problem.or_else(|| undirected.then(choose)),
        measured: Some(LaneMeasured {
            length_m: g.length_m,
            near_width_m: g.near_width_m,
            far_width_m: g.far_width_m,
            far_span_m: g.far_span_m,
            rel_err: g.rel_err,
            middle: drawn.axis.every(2.0).filter_map(image).collect(),
        }),
    }
}

/// What is wrong with lanes that are good by themselves: a number twice, a place in two lanes.
fn whole_problem(drawing: &Drawing, known: &UncertainCamera) -> Option<String> {
    if drawing.lanes.iter().any(|l| l.direction.is_empty()) || drawing.lanes.is_empty() {
        return None;
    }
    let file = drawing.labelme(&drawing.lanes);
    drawn_lane::lanes(&file, "the drawing", &known.camera)
        .and_then(|lanes| require_apart(&lanes, known.camera.image_size))
        .err()
        .map(|e| e.to_string())
}

/// Dots a metre apart where something is drawn, each with the error of lengths there.
fn dots(drawing: &Drawing, known: &UncertainCamera) -> Vec<[f64; 3]> {
    let camera = &known.camera;
    let ground = |p: &Px| Some(camera.back_project(&Vector2::from(*p), 0.0)?.xy());
    let lines = drawing.lines.iter().flat_map(|l| &l.points);
    let lanes = drawing.lanes.iter().flat_map(|l| &l.polygon);
    let lengths = drawing.lengths.iter().flat_map(|l| &l.points);
    let places: Vec<Vector2<f64>> = lines.chain(lanes).chain(lengths).filter_map(ground).collect();
    let along = direction(drawing, &places, ground);
    let across = Vector2::new(along.y, -along.x);
    let range = |axis: Vector2<f64>, most: f64| {
        let at = |p: &Vector2<f64>| p.dot(&axis);
        let low = places.iter().map(at).fold(f64::INFINITY, f64::min) - MARGIN_M;
        let high = places.iter().map(at).fold(f64::NEG_INFINITY, f64::max) + MARGIN_M;
        (low.floor() as i32, (high.min(low + most)).ceil() as i32)
    };
    if places.is_empty() {
        return Vec::new();
    }
    let ((near, far), (left, right)) = (range(along, 250.0), range(across, 60.0));
    let min_gap = DOT_SPACING_WIDTHS * f64::from(camera.image_size[0]);
    let image = |s: f64, t: f64| {
        let p = along * s + across * t;
        camera.project(&Vector3::new(p.x, p.y, 0.0))
    };
    let middle = 0.5 * f64::from(left + right);
    let mut last: Option<Vector2<f64>> = None;
    let mut found = Vec::new();
    for s in near..=far {
        let s = f64::from(s);
        let Some(row) = image(s, middle) else { continue };
        if last.is_some_and(|l| (l - row).norm() < min_gap) {
            continue;
        }
        last = Some(row);
        for t in left..=right {
            let t = f64::from(t);
            let (Some(uv), Some(beside)) = (image(s, t), image(s, t + 1.0)) else { continue };
            let [w, h] = camera.image_size.map(f64::from);
            let inside = (0.0..w).contains(&uv.x) && (0.0..h).contains(&uv.y);
            if !inside || (beside - uv).norm() < min_gap || found.len() >= MOST_DOTS {
                continue;
            }
            let p = along * s + across * t;
            let half = along * HALF_STRETCH_M;
            if let Some(error) = known.between(p - half, p + half) {
                found.push([uv.x, uv.y, error.rel_sd]);
            }
        }
    }
    found
}

/// The direction of the longest line, away from the camera.
fn direction(
    drawing: &Drawing,
    places: &[Vector2<f64>],
    ground: impl Fn(&Px) -> Option<Vector2<f64>>,
) -> Vector2<f64> {
    let ends = |points: &[Px]| Some(ground(points.last()?)? - ground(points.first()?)?);
    let lines = drawing.lines.iter().filter_map(|l| ends(&l.points));
    let longest = lines.max_by(|a, b| a.norm().total_cmp(&b.norm()));
    let spread = places.iter().max_by(|a, b| a.y.total_cmp(&b.y)).zip(places.first());
    let along = longest.or_else(|| spread.map(|(far, first)| far - first));
    let along = along.and_then(|d| d.try_normalize(1e-6)).unwrap_or(Vector2::y());
    if along.y < 0.0 { -along } else { along }
}

/// Whether a calibration may be used, as an error where it may not.
///
/// # Errors
/// Its reason.
pub fn require_trust(calibration: &Calibration) -> Result<()> {
    match &calibration.trust {
        Trust::Ok => Ok(()),
        Trust::Refused(reason) => Err(Error::Usage(format!("the camera cannot be used: {reason}"))),
    }
}
