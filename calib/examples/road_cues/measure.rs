//! Fits of made cameras by sets of cues, and how far they are from the truth.
//!
//! Owns how a person would read the cues: every point with an error, lane lines with a part
//! that all points of a line share. Does not own the cameras (see `made`).

use mvcalib::camera::Camera;
use mvcalib::files::calibration::Calibration;
use mvcalib::files::labelme::LabelFile;
use mvcalib::road::cue_files;
use mvcalib::road::drawn_lane::{DrawnLane, lanes};
use mvcalib::road::fit::{BoxCue, Class, Cues, LaneCue, MarkCue, fit};
use mvcalib::road::lane_axis::LaneAxis;
use nalgebra::{Vector2, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use std::f64::consts::PI;
use std::path::{Path, PathBuf};

/// Standard deviation of a read point, px; a bounded hand is off by no more than that.
const READING_PX: f64 = 1.0;
/// The same of a drawn lane line's points, of each and shared along the line.
const TRACE_PX: [f64; 2] = [0.5, 0.5];
/// Length of the near length and of dashes' pitch, m.
const PITCH_M: f64 = 12.0;
/// How well a tape measures.
const TAPE: f64 = 0.005;
/// Boxes of a camera that are used.
const BOXES: usize = 500;

struct Made {
    name: String,
    truth: Camera,
    lanes: Vec<DrawnLane>,
    drawn: Vec<LaneCue>,
    boxes: Vec<BoxCue>,
}

fn read(folder: &Path, exact: bool) -> Option<Made> {
    let truth = Calibration::read(&folder.join("calibration.json"), None).ok()?.camera();
    let file = LabelFile::read(&folder.join("lanes.json")).ok()?;
    let drawn = cue_files::of_file(&file).expect("the street's lanes have two sides");
    let lanes = lanes(&file, "lanes.json", &truth).expect("the street's lanes are right");
    let detections = folder.join("detections.jsonl");
    let boxes = if detections.exists() && !exact {
        cue_files::boxes(&detections, truth.image_size).expect("a detector's boxes")
    } else {
        true_boxes(&folder.join("truth.jsonl"))
    };
    let name = folder.file_name()?.to_string_lossy().into_owned();
    Some(Made { name, truth, lanes, drawn, boxes })
}

fn true_boxes(path: &Path) -> Vec<BoxCue> {
    let text = std::fs::read_to_string(path).unwrap_or_default();
    let mut all = Vec::new();
    for (frame, line) in text.lines().enumerate() {
        let value: serde_json::Value = serde_json::from_str(line).expect("the street's truth");
        for vehicle in value["vehicles"].as_array().into_iter().flatten() {
            let corners = [0, 1, 2, 3].map(|k| vehicle["box"][k].as_f64().unwrap_or(f64::NAN));
            if vehicle["occlusion"].as_f64().unwrap_or(0.0) < 0.1
                && corners.iter().all(|c| c.is_finite())
            {
                let class = vehicle["class"].as_str().and_then(Class::of_name);
                all.push(BoxCue { frame, corners, class });
            }
        }
    }
    all
}

/// A reader with an unsteady hand.
struct Hand {
    random: ChaCha8Rng,
    /// Points are off by at most `READING_PX` in u and in v, evenly, and said to be so.
    bounded: bool,
}

impl Hand {
    fn normal(&mut self) -> f64 {
        StandardNormal.sample(&mut self.random)
    }

    fn point(&mut self, camera: &Camera, p: Vector2<f64>) -> Vector2<f64> {
        let uv =
            camera.project(&Vector3::new(p.x, p.y, 0.0)).expect("the road is before the camera");
        uv + Vector2::new(self.reading(), self.reading())
    }

    /// Error of a coordinate, px.
    fn reading(&mut self) -> f64 {
        if self.bounded {
            self.random.random_range(-READING_PX..=READING_PX)
        } else {
            READING_PX * self.normal()
        }
    }

    fn length(&mut self, camera: &Camera, name: &str, points: &[Vector2<f64>]) -> MarkCue {
        let metres = (points[1] - points[0]).norm();
        let read = points.iter().map(|p| self.point(camera, *p)).collect();
        let told = metres * (1.0 + TAPE * self.normal());
        let px_sd = if self.bounded { READING_PX / 3_f64.sqrt() } else { READING_PX };
        MarkCue { rel_sd: TAPE, px_sd, ..MarkCue::measured(name, read, told) }
    }

    /// About nine points of a line.
    fn line(&mut self, line: &[Vector2<f64>]) -> Vec<Vector2<f64>> {
        let n = line.len().min(9);
        let [own, shared] = TRACE_PX;
        let (offset, slope) = (self.normal(), self.normal());
        (0..n)
            .map(|k| {
                let t = k as f64 / (n - 1) as f64;
                let p = line[(t * (line.len() - 1) as f64).round() as usize];
                let along = (line[line.len() - 1] - line[0]).normalize();
                let across = Vector2::new(along.y, -along.x);
                // Offset and slope together have the stated scatter on average along the line.
                let beside = shared * (0.87 * offset + 1.7 * slope * (t - 0.5) * 0.5);
                p + across * (beside + own * self.normal())
            })
            .collect()
    }
}

/// The sets of cues.
const SETS: [&str; 11] = [
    "four lengths",
    "lanes alone",
    "lanes, 100 boxes",
    "lanes, 500 boxes",
    "lanes, 500 boxes, near length",
    "lanes, 500 boxes, long distance",
    "lanes, near length",
    "lanes, long distance",
    "lanes, dashes",
    "lanes, 500 boxes, dashes",
    "lanes, four lengths",
];

fn cues(made: &Made, set: &str, hand: &mut Hand) -> Cues {
    let lane = &made.lanes[hand.random.random_range(0..made.lanes.len())];
    let axis = &lane.axis;
    let (length, truth) = (axis.length_m(), &made.truth);
    let foot = truth.pose.camera_centre().xy();
    let near_first = (axis.at(0.0).0 - foot).norm() < (axis.at(length).0 - foot).norm();
    // Distances are from the near end.
    let at = |s: f64| axis.at(if near_first { s } else { length - s });
    let pitch = PITCH_M.min(0.4 * length);
    let across = |s: f64| {
        // The whole carriageway at this place.
        let (p, along) = at(s);
        let side = Vector2::new(along.y, -along.x);
        let offset = |other: &DrawnLane, half: f64| {
            (other.axis.at(0.5 * other.axis.length_m()).0 - at(0.5 * length).0).dot(&{
                let (_, a) = at(0.5 * length);
                Vector2::new(a.y, -a.x)
            }) + half
        };
        let offsets: Vec<f64> = made
            .lanes
            .iter()
            .flat_map(|l| {
                let half = 0.5 * l.axis.widths_m()[8];
                [offset(l, -half), offset(l, half)]
            })
            .collect();
        let low = offsets.iter().copied().fold(f64::INFINITY, f64::min);
        let high = offsets.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let inside = |o: f64| {
            let uv = truth.project(&Vector3::new((p + side * o).x, (p + side * o).y, 0.0));
            uv.is_some_and(|uv| {
                let [w, h] = truth.image_size.map(f64::from);
                uv.x > 0.0 && uv.y > 0.0 && uv.x < w && uv.y < h
            })
        };
        // What lies outside the picture cannot be clicked.
        let (mut a, mut b) = (low, high);
        while !inside(a) && a < 0.0 {
            a += 0.25;
        }
        while !inside(b) && b > 0.0 {
            b -= 0.25;
        }
        [p + side * a, p + side * b]
    };
    let mut cues = Cues::default();
    if set.contains("four") {
        cues.marks = vec![
            hand.length(truth, "near along", &[at(0.0).0, at(pitch).0]),
            hand.length(truth, "far along", &[at(length - pitch).0, at(length).0]),
            hand.length(truth, "near across", &across(0.0)),
            hand.length(truth, "far across", &across(length)),
        ];
    }
    if set.contains("near length") {
        cues.marks.push(hand.length(truth, "near", &[at(0.0).0, at(pitch).0]));
    }
    if set.contains("long") {
        cues.marks.push(hand.length(truth, "long", &[at(0.0).0, at(length).0]));
    }
    if set.contains("dashes") {
        let start =
            hand.random.random_range(0.0..1.0) * (length - (length / PITCH_M).floor() * PITCH_M);
        let points: Vec<_> = (0..)
            .map(|k| start + PITCH_M * f64::from(k))
            .take_while(|s| *s <= length)
            .map(|s| at(s).0)
            .collect();
        if points.len() > 1 {
            let mut mark = hand.length(truth, "dashes", &points);
            mark.segment_m = PITCH_M * (1.0 + 0.01 * hand.normal());
            mark.rel_sd = 0.01;
            cues.marks.push(mark);
        }
    }
    if set.contains("lanes") {
        cues.lanes = made
            .drawn
            .iter()
            .map(|l| LaneCue { right: hand.line(&l.right), left: hand.line(&l.left), ..l.clone() })
            .collect();
    }
    let boxes = if set.contains("500") {
        BOXES
    } else if set.contains("100") {
        100
    } else {
        0
    };
    cues.boxes = made.boxes.iter().take(boxes).cloned().collect();
    cues
}

/// How one fit did.
struct Outcome {
    /// Error of each stretch, as a part of it.
    errors: Vec<f64>,
    /// Their mean.
    error: f64,
    mean: f64,
    stated: f64,
    /// Logarithm of the measured over the true length of the longest lane.
    signed: f64,
    /// Mean error of the same stretches that the posterior expects: where its intervals hold, no
    /// estimate from these cues has a smaller one.
    expected: f64,
    held: [bool; 4],
    seconds: f64,
}

fn judge(made: &Made, cues: &Cues) -> Option<Outcome> {
    let start = cpu_seconds();
    let found = fit(cues, made.truth.image_size).ok()?;
    let seconds = cpu_seconds() - start;
    let known = &found.known;
    let image = |p: Vector2<f64>| made.truth.project(&Vector3::new(p.x, p.y, 0.0));
    let stretch = |axis: &LaneAxis, s: f64, length: f64| {
        Some([image(axis.at(s - 0.5 * length).0)?, image(axis.at(s + 0.5 * length).0)?])
    };
    let mut errors = Vec::new();
    let (mut sum, mut expected) = (0.0, 0.0);
    for lane in &made.lanes {
        let length = lane.axis.length_m();
        for k in 0..12 {
            let s = 3.0 + (length - 6.0) * f64::from(k) / 11.0;
            let ends = stretch(&lane.axis, s, 6.0)?;
            let of_stretch = known.of_stretches(&[ends]);
            let measured = of_stretch.map_or(f64::INFINITY, |e| e.length_m);
            // Mean absolute value of a normal variable.
            expected += of_stretch.map_or(f64::INFINITY, |e| e.rel_sd) * (2.0 / PI).sqrt();
            errors.push((measured / 6.0 - 1.0).abs());
            sum += measured / 6.0;
        }
    }
    let lane = made.lanes.iter().max_by(|a, b| a.axis.length_m().total_cmp(&b.axis.length_m()))?;
    let length = lane.axis.length_m();
    let holds = |s: f64, true_m: f64| {
        let error = stretch(&lane.axis, s, true_m).and_then(|e| known.of_stretches(&[e]));
        error.is_some_and(|e| (e.length_m / true_m).ln().abs() < 1.645 * e.rel_sd)
    };
    let whole = stretch(&lane.axis, 0.5 * length, length).and_then(|e| known.of_stretches(&[e]))?;
    Some(Outcome {
        error: errors.iter().sum::<f64>() / errors.len() as f64,
        expected: expected / errors.len() as f64,
        mean: (sum / errors.len() as f64 - 1.0).abs(),
        stated: whole.rel_sd,
        signed: (whole.length_m / length).ln(),
        held: [
            holds(3.0, 6.0),
            holds(0.5 * length, 6.0),
            holds(length - 3.0, 6.0),
            holds(0.5 * length, length),
        ],
        seconds,
        errors,
    })
}

/// The value below which a part `q` lies.
fn quantile(values: impl IntoIterator<Item = f64>, q: f64) -> f64 {
    let mut values: Vec<f64> = values.into_iter().collect();
    values.sort_by(f64::total_cmp);
    let at = ((values.len() as f64 - 1.0) * q).round() as usize;
    values.get(at).copied().unwrap_or(f64::NAN)
}

/// Time that this thread had a core, s, on Linux.
fn cpu_seconds() -> f64 {
    let text = std::fs::read_to_string("/proc/thread-self/schedstat").unwrap_or_default();
    text.split_whitespace().next().and_then(|n| n.parse::<f64>().ok()).unwrap_or(0.0) * 1e-9
}

/// What to measure.
#[derive(clap::Args)]
pub struct Wanted {
    /// What `make` wrote.
    folder: PathBuf,
    /// Only the cue sets whose name contains this.
    #[arg(long, default_value = "")]
    only: String,
    /// Draw so many times with other reading errors.
    #[arg(long, default_value_t = 1)]
    draws: u64,
    /// Print each camera too.
    #[arg(long)]
    each: bool,
    /// Take the true boxes of vehicles that nothing covers in place of the detector's.
    #[arg(long)]
    true_boxes: bool,
    /// Read no coordinate wrong by more than 1 px, in place of a standard deviation of 1 px.
    #[arg(long)]
    bounded: bool,
}

/// Prints the table.
pub fn table(wanted: &Wanted) {
    let Wanted { folder, only, draws, each, true_boxes, bounded } = wanted;
    let mut folders: Vec<_> =
        std::fs::read_dir(folder).expect("a folder").flatten().map(|e| e.path()).collect();
    folders.sort();
    let all: Vec<Made> = folders.iter().filter_map(|f| read(f, *true_boxes)).collect();
    println!(
        "| cues | picture | cameras | median | p90 | of stretches: median | p90 | expected | of the mean: median | p90 | near, middle, far, whole hold | stated | cpu ms | failed |\n|---|---|---|---|---|---|---|---|---|---|---|---|---|---|"
    );
    for set in SETS.into_iter().filter(|s| s.contains(only.as_str())) {
        for width in [320, 720] {
            let mut outcomes = Vec::new();
            let mut failed = 0;
            for (k, made) in all.iter().filter(|m| m.truth.image_size[0] == width).enumerate() {
                for draw in 0..*draws {
                    let random = ChaCha8Rng::seed_from_u64(1000 * draw + k as u64);
                    let mut hand = Hand { random, bounded: *bounded };
                    match judge(made, &cues(made, set, &mut hand)) {
                        Some(o) => {
                            if *each {
                                println!(
                                    "  {} {:.1} %, whole {:+.1} % stated {:.1} % {:?}",
                                    made.name,
                                    100.0 * o.error,
                                    100.0 * o.signed,
                                    100.0 * o.stated,
                                    o.held
                                );
                            }
                            outcomes.push(o);
                        }
                        None => failed += 1,
                    }
                }
            }
            let of = |of: fn(&Outcome) -> f64, q| 100.0 * quantile(outcomes.iter().map(of), q);
            let stretches =
                |q| 100.0 * quantile(outcomes.iter().flat_map(|o| o.errors.iter().copied()), q);
            let held = |k: usize| {
                100.0 * outcomes.iter().filter(|o| o.held[k]).count() as f64
                    / outcomes.len().max(1) as f64
            };
            println!(
                "| {set} | {width} | {} | {:.1} % | {:.1} % | {:.1} % | {:.1} % | {:.1} % | {:.1} % | {:.1} % | {:.0}, {:.0}, {:.0}, {:.0} % | {:.1} % | {:.1} | {failed} |",
                outcomes.len(),
                of(|o| o.error, 0.5),
                of(|o| o.error, 0.9),
                stretches(0.5),
                stretches(0.9),
                of(|o| o.expected, 0.5),
                of(|o| o.mean, 0.5),
                of(|o| o.mean, 0.9),
                held(0),
                held(1),
                held(2),
                held(3),
                of(|o| o.stated, 0.5),
                10.0 * of(|o| o.seconds, 0.5),
            );
        }
    }
}
