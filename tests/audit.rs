//! `verge audit` as an operator runs it, on frames of the street whose truth is known.

mod common;

use common::{MODEL, STREET_FRAMES, STREET_TABLE, folder, stderr, verge};
use serde_json::Value;
use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

fn text(path: &Path) -> &str {
    path.to_str().expect("a path in UTF-8")
}

/// A part of the recording, so that a test takes seconds.
fn frames(folder: &Path, each: usize) -> PathBuf {
    let frames = folder.join("frames");
    std::fs::create_dir(&frames).expect("a folder");
    let mut names: Vec<_> = std::fs::read_dir(STREET_FRAMES)
        .expect("it ships")
        .map(|entry| entry.expect("a frame").path())
        .collect();
    names.sort();
    for path in names.iter().step_by(each) {
        std::fs::copy(path, frames.join(path.file_name().expect("a name"))).expect("copying");
    }
    frames
}

/// Vehicles by frame and lane, as they truly stand there.
fn truth() -> BTreeMap<String, BTreeMap<u64, u64>> {
    let rows = std::fs::read_to_string("tests/data/curve/truth.jsonl").expect("it ships");
    let row = |line: &str| {
        let row: Value = serde_json::from_str(line).expect("JSON");
        let vehicles = |lane: &Value| lane["vehicles"].as_u64().expect("vehicles");
        let lanes = row["lanes"].as_array().expect("lanes");
        let by_lane = lanes.iter().map(|l| (l["lane"].as_u64().expect("lane"), vehicles(l)));
        (row["frame"].as_str().expect("a name").to_owned(), by_lane.collect())
    };
    rows.lines().map(row).collect()
}

/// Answers for these frames; `change` may falsify one.
fn answers(names: &[&str], change: impl Fn(&str, u64, u64) -> u64) -> String {
    let truth = truth();
    let mut text = "frame,lane,vehicles\n".to_owned();
    for name in names {
        for (&lane, &vehicles) in &truth[*name] {
            writeln!(text, "{name},{lane},{}", change(name, lane, vehicles)).expect("a string");
        }
    }
    text
}

struct Site {
    folder: tempfile::TempDir,
    frames: PathBuf,
}

impl Site {
    fn new() -> Self {
        let folder = folder();
        let frames = frames(folder.path(), 6);
        Self { folder, frames }
    }

    fn audit(&self, more: &[&str]) -> std::process::Output {
        let mut args = vec!["audit", "--table", STREET_TABLE, "--frames", text(&self.frames)];
        args.extend(more);
        verge(&args)
    }

    fn chosen(&self, most: &str) -> Vec<String> {
        let output = self.audit(&["--choose", most]);
        assert!(output.status.success(), "{}", stderr(&output));
        String::from_utf8(output.stdout).expect("UTF-8").lines().map(str::to_owned).collect()
    }

    fn learn(&self, counts: &str, out: &Path) -> std::process::Output {
        let file = self.folder.path().join("counts.csv");
        std::fs::write(&file, counts).expect("writing answers");
        self.audit(&["--counts", text(&file), "--out", text(out)])
    }

    fn replay(&self, more: &[&str]) -> Value {
        let mut args = vec!["replay", "--table", STREET_TABLE, "--frames", text(&self.frames)];
        args.extend(["--json", "--window", "900"]);
        args.extend(more);
        let output = verge(&args);
        assert!(output.status.success(), "{}", stderr(&output));
        serde_json::from_slice(&output.stdout).expect("one window")
    }
}

/// Standard errors of counting, all lanes together, veh/km.
fn counting(window: &Value) -> f64 {
    let lanes = window["lanes"].as_array().expect("lanes");
    lanes.iter().map(|lane| lane["counting_se"].as_f64().expect("known")).sum()
}

#[test]
fn counted_frames_correct_the_count_and_narrow_its_interval() {
    let site = Site::new();
    let chosen = site.chosen("10");
    assert_eq!(chosen.len(), 10);
    let names: Vec<&str> = chosen.iter().map(String::as_str).collect();
    let all = site.folder.path().join("ten.toml");
    let output = site.learn(&answers(&names, |_, _, n| n), &all);
    assert!(output.status.success(), "{}", stderr(&output));
    let few = site.folder.path().join("three.toml");
    let output = site.learn(&answers(&names[..3], |_, _, n| n), &few);
    assert!(output.status.success(), "{}", stderr(&output));

    let truth = truth();
    let frames = || truth.iter().filter(|(name, _)| site.frames.join(name).exists());
    let mean = |lane: u64| {
        frames().map(|(_, lanes)| lanes[&lane] as f64).sum::<f64>() / frames().count() as f64
    };
    let off = |window: &Value| {
        let lanes = window["lanes"].as_array().expect("lanes");
        let counted: f64 = lanes.iter().map(|l| l["vehicles_mean"].as_f64().expect("a mean")).sum();
        (counted - (1..=4).map(mean).sum::<f64>()).abs()
    };
    let plain = site.replay(&[]);
    let (ten, three) =
        (site.replay(&["--audit", text(&all)]), site.replay(&["--audit", text(&few)]));
    eprintln!(
        "vehicles off: {:.2} plain, {:.2} with three, {:.2} with ten frames",
        off(&plain),
        off(&three),
        off(&ten)
    );
    // 3 % of what stands there. Without an audit the count is right to a tenth of a vehicle here,
    // which counted frames cannot better: they must not spoil it.
    assert!(off(&ten) <= 0.4 && off(&three) <= 0.4);
    let errors = [&ten, &three, &plain].map(counting);
    assert!(errors.is_sorted_by(|a, b| a < b), "{errors:?}");
    // The queue, and what its interval says of it.
    let queue = &ten["lanes"][2];
    let true_density = mean(3) / queue["length_m"].as_f64().expect("a length") * 1000.0;
    let ci = queue["density_ci90"].as_array().expect("an interval");
    let [low, high] = [0, 1].map(|n| ci[n].as_f64().expect("a number"));
    assert!(low <= true_density && true_density <= high, "{low} {true_density} {high}");
}

#[test]
fn contradictory_answers_are_refused_with_their_reason() {
    let site = Site::new();
    let chosen = site.chosen("6");
    let names: Vec<&str> = chosen.iter().map(String::as_str).collect();
    let out = site.folder.path().join("site.toml");
    let busy = names.iter().copied().max_by_key(|name| truth()[*name][&3]).expect("frames");
    for (counts, said) in [
        (
            answers(&names, |name, lane, n| if name == busy && lane == 3 { 1 } else { n }),
            "beyond doubt",
        ),
        (
            answers(&names, |name, _, n| if name == busy { n + 30 } else { n }),
            "by the other answers",
        ),
        (answers(&names[..2], |_, _, n| n), "2 frames are counted"),
        (
            answers(&names, |_, _, n| n).replace(names[1], "20010101T000000Z.jpg"),
            "counts.csv, line 6: frame 20010101T000000Z.jpg is not in ",
        ),
    ] {
        let output = site.learn(&counts, &out);
        assert_eq!(output.status.code(), Some(65), "{said}: {}", stderr(&output));
        assert!(stderr(&output).contains(said), "{said}: {}", stderr(&output));
        assert!(!out.exists(), "nothing is half-written");
    }
}

#[test]
fn a_sheet_has_pictures_and_a_file_to_fill_in() {
    let site = Site::new();
    let sheet = site.folder.path().join("sheet");
    let output = site.audit(&["--choose", "4", "--sheet", text(&sheet)]);
    assert!(output.status.success(), "{}", stderr(&output));
    let counts = std::fs::read_to_string(sheet.join("counts.csv")).expect("it is there");
    assert_eq!(counts.lines().filter(|line| line.ends_with(',')).count(), 4 * 4);
    let pictures = std::fs::read_dir(&sheet).expect("a folder").filter(|entry| {
        let path = entry.as_ref().expect("a file").path();
        path.extension().is_some_and(|extension| extension == "png")
            && image::open(path).expect("a picture").width() >= 960
    });
    assert_eq!(pictures.count(), 4);
    // A sheet that someone has begun to fill in stays.
    assert_eq!(site.audit(&["--choose", "4", "--sheet", text(&sheet)]).status.code(), Some(73));
    let frames = ["replay", "--table", STREET_TABLE, "--frames", text(&site.frames)];
    let replay = |more: &[&str]| verge(&[&frames, more].concat());
    let output = replay(&["--overlay", text(&sheet)]);
    assert_eq!(output.status.code(), Some(73), "{}", stderr(&output));
    assert!(stderr(&output).contains("the sheet of an audit lies there"), "{}", stderr(&output));
    let output = replay(&["--audit", "x.toml", "--anchor", "box-centre"]);
    assert_eq!(output.status.code(), Some(64), "{}", stderr(&output));
}

#[test]
fn a_sheet_needs_as_many_frames_as_an_audit() {
    let folder = folder();
    let frames = frames(folder.path(), 61);
    let sheet = folder.path().join("sheet");
    let output = verge(&[
        "audit",
        "--table",
        STREET_TABLE,
        "--frames",
        text(&frames),
        "--sheet",
        text(&sheet),
    ]);
    assert_eq!(output.status.code(), Some(65), "{}", stderr(&output));
    assert!(stderr(&output).contains("an audit takes 3 at least"), "{}", stderr(&output));
    assert!(!sheet.exists(), "nothing is half-written");
}

#[test]
fn an_audit_of_another_input_is_refused_at_the_start() {
    let site = Site::new();
    let chosen = site.chosen("3");
    let names: Vec<&str> = chosen.iter().map(String::as_str).collect();
    let out = site.folder.path().join("site.toml");
    let output = site.learn(&answers(&names, |_, _, n| n), &out);
    assert!(output.status.success(), "{}", stderr(&output));
    let output = verge(&[
        "replay",
        "--table",
        STREET_TABLE,
        "--frames",
        text(&site.frames),
        "--model",
        MODEL,
        "--input",
        "640x480",
        "--audit",
        text(&out),
    ]);
    assert_eq!(output.status.code(), Some(65));
    assert!(stderr(&output).contains("the net's input was"), "{}", stderr(&output));
}

#[test]
fn the_factors_hold_for_the_score_and_the_views_with_which_they_were_counted() {
    let site = Site::new();
    let chosen = site.chosen("3");
    let names: Vec<&str> = chosen.iter().map(String::as_str).collect();
    let out = site.folder.path().join("site.toml");
    let output = site.learn(&answers(&names, |_, _, n| n), &out);
    assert!(output.status.success(), "{}", stderr(&output));
    // The audit's score wins over --score, with a warning.
    let plain = site.replay(&["--audit", text(&out)]);
    let asked = site.replay(&["--audit", text(&out), "--score", "0.95"]);
    assert_eq!(asked["lanes"], plain["lanes"]);
    let replay = |more: &[&str]| {
        let args = ["replay", "--table", STREET_TABLE, "--frames", text(&site.frames)];
        verge(&[&args, more].concat())
    };
    let said = stderr(&replay(&["--audit", text(&out), "--score", "0.95"]));
    assert!(said.contains("ignoring score 0.95: the audit was made with "), "{said}");
    let output = replay(&["--audit", text(&out), "--views", "auto"]);
    assert_eq!(output.status.code(), Some(65));
    assert!(stderr(&output).contains("other parts of the picture"), "{}", stderr(&output));
    // What a configuration says is not said twice, and no input becomes an output.
    let output = verge(&["audit", "--config", "x.toml", "--frames", "y", "--score", "0.4"]);
    assert_eq!(output.status.code(), Some(64), "{}", stderr(&output));
    let counts = site.folder.path().join("counts.csv");
    let before = std::fs::read(&counts).expect("counts");
    let output = site.audit(&["--counts", text(&counts), "--out", text(&counts)]);
    assert_eq!(output.status.code(), Some(73), "{}", stderr(&output));
    assert_eq!(std::fs::read(&counts).expect("counts"), before);
}
