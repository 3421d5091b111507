//! The road fit on real cameras: K109F, and three views of BrnoCompSpeed's session 0.
//!
//! Prints the rows of `docs/measured/calibration.md` (`--nocapture`). BrnoCompSpeed is read from
//! `../shared` and skipped with a message where it is missing, which is a failure under
//! VERGE_NO_SKIP=1.

mod k109f;

use mvcalib::camera::Camera;
use mvcalib::files::labelme::LabelFile;
use mvcalib::length_error::UncertainCamera;
use mvcalib::road::cue_files;
use mvcalib::road::fit::{Cues, MarkCue, STATED_WIDTH_SD_M, fit};
use mvcalib::road::marks::Marks;
use nalgebra::Vector2;
use std::path::Path;

/// A length with both ends in the picture, px, and metres.
#[derive(Clone, Copy)]
struct Length {
    ends: [Vector2<f64>; 2],
    metres: f64,
}

impl Length {
    fn cue(&self, name: String) -> MarkCue {
        MarkCue::measured(name, self.ends.to_vec(), self.metres)
    }

    /// As the width of a lane that somebody states, which is no tape's length.
    fn width_cue(&self, name: String) -> MarkCue {
        MarkCue { rel_sd: STATED_WIDTH_SD_M / self.metres, ..self.cue(name) }
    }

    fn middle_v(&self) -> f64 {
        0.5 * (self.ends[0].y + self.ends[1].y)
    }

    fn measured(&self, camera: &Camera) -> f64 {
        let at = |k: usize| camera.back_project(&self.ends[k], 0.0).expect("on the road");
        (at(0) - at(1)).norm()
    }
}

/// Relative errors of lengths that the fit did not see, sorted, and whether the stated 90 %
/// interval holds the mean length.
fn judge(known: &UncertainCamera, held_out: &[Length]) -> (Vec<f64>, bool) {
    let error = |l: &Length| l.measured(&known.camera) / l.metres - 1.0;
    let mut errors: Vec<f64> = held_out.iter().map(|l| error(l).abs()).collect();
    errors.sort_by(f64::total_cmp);
    let ends: Vec<_> = held_out.iter().map(|l| l.ends).collect();
    let stated = known.of_stretches(&ends).expect("on the road");
    let true_m = held_out.iter().map(|l| l.metres).sum::<f64>() / held_out.len() as f64;
    (errors, (stated.length_m / true_m).ln().abs() < 1.645 * stated.rel_sd)
}

fn row(name: &str, known: &UncertainCamera, held_out: &[Length]) -> f64 {
    let (errors, holds) = judge(known, held_out);
    let middle = errors.len() / 2;
    let median = 0.5 * (errors[middle] + errors[(errors.len() - 1) / 2]);
    println!(
        "| {name} | {} | {:.1} % | {:.1} % | {} |",
        errors.len(),
        100.0 * median,
        100.0 * errors[errors.len() - 1],
        if holds { "holds" } else { "misses" }
    );
    median
}

fn brno(view: &str) -> Option<Vec<(Length, bool)>> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join(format!("../../shared/data/brnocompspeed/session0_{view}/gt_data.json"));
    let Ok(text) = std::fs::read_to_string(&path) else {
        verge_desk::skip(&format!("{} is missing", path.display()));
        return None;
    };
    let value: serde_json::Value = serde_json::from_str(&text).expect("the data set's JSON");
    let point = |p: &serde_json::Value| {
        let at = |k: usize| p[k].as_f64().expect("a coordinate") + 0.5;
        Vector2::new(at(0), at(1))
    };
    let lengths = value["distanceMeasurement"].as_array().expect("a list").iter().map(|m| {
        let ends = [point(&m["p1"]), point(&m["p2"])];
        let length = Length { ends, metres: m["distance"].as_f64().expect("metres") };
        (length, m["toVP1"].as_bool().expect("along or across"))
    });
    Some(lengths.collect())
}

#[test]
fn four_lengths_calibrate_the_views_of_session_0() {
    println!(
        "| view | held out | median | largest | 90 % interval of the mean |\n|---|---|---|---|---|"
    );
    for view in ["left", "center", "right"] {
        let Some(all) = brno(view) else { return };
        // The nearest and the farthest along the road and across it.
        let mut given = Vec::new();
        for along in [true, false] {
            let mut kind: Vec<usize> = (0..all.len()).filter(|&k| all[k].1 == along).collect();
            kind.sort_by(|&a, &b| all[a].0.middle_v().total_cmp(&all[b].0.middle_v()));
            given.extend([kind[0], kind[kind.len() - 1]]);
        }
        // Across are lanes from line to line, 3.5 m each of them.
        let cue = |k: usize| match all[k] {
            (length, true) => length.cue(format!("length {k}")),
            (width, false) => width.width_cue(format!("width {k}")),
        };
        let marks = given.iter().map(|&k| cue(k)).collect();
        let found = fit(&Cues { marks, ..Cues::default() }, [1920, 1080]).expect("a camera");
        let held_out: Vec<Length> =
            (0..all.len()).filter(|k| !given.contains(k)).map(|k| all[k].0).collect();
        let median = row(&format!("session 0 {view}, four lengths"), &found.known, &held_out);
        assert!(median < 0.04, "{view}: {median}");
    }
}

#[test]
fn a_lane_and_two_lengths_calibrate_k109f() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/data/k109f/marks.json");
    let marks = Marks::read(&path).expect("shipped marks");
    let all: Vec<Length> =
        marks.segments().map(|s| Length { ends: s.ends, metres: s.length_m }).collect();
    let lines = LabelFile::read(&k109f::data("k109f/lane_lines.json")).expect("shipped lines");
    let lanes = cue_files::of_file(&lines).expect("a pair of lines");
    // The nearest and the farthest but one of the first line; the farthest is hardly readable.
    let given = [4, 1];
    let cues = |lengths: bool, lines: bool| Cues {
        marks: given.iter().filter(|_| lengths).map(|&k| all[k].cue(format!("dash {k}"))).collect(),
        lanes: if lines { lanes.clone() } else { Vec::new() },
        ..Cues::default()
    };
    let held_out: Vec<Length> =
        (0..all.len()).filter(|k| !given.contains(k)).map(|k| all[k]).collect();
    println!(
        "| K109F, cues | held out | median | largest | 90 % interval of the mean |\n|---|---|---|---|---|"
    );
    for (name, lengths, lines, limit) in [
        ("two lengths along", true, false, 0.12),
        ("two lane lines and two lengths along", true, true, 0.08),
    ] {
        let found = fit(&cues(lengths, lines), [320, 240]).expect("a camera");
        let median = row(name, &found.known, &held_out);
        assert!(median < limit, "{name}: {median}");
        assert!(judge(&found.known, &held_out).1, "{name}: the interval misses");
    }
    // With the vehicles of joint as the prior, which knew no length.
    let joint =
        mvcalib::joint::calibrate(&k109f::problem(), &Default::default()).expect("seven cars");
    let with = Cues { labelled: Some(joint.labelled()), ..cues(true, true) };
    let found = fit(&with, [320, 240]).expect("a camera");
    row("seven cars, two lane lines, two lengths", &found.known, &held_out);
    assert!(judge(&found.known, &held_out).1);
}
