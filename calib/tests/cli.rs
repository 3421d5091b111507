//! The commands end to end on camera K109F: what they write, what they say about bad input,
//! and the exit codes.

mod k109f;

use k109f::data;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

/// A folder of its own for one test, removed at the end.
struct Folder(PathBuf);

impl Folder {
    fn new(test: &str) -> Self {
        let path = std::env::temp_dir().join(format!("mvcalib-{test}-{}", std::process::id()));
        std::fs::create_dir_all(&path).unwrap();
        Folder(path)
    }

    fn join(&self, name: &str) -> PathBuf {
        self.0.join(name)
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

fn mvcalib(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_mvcalib")).args(arguments).output().unwrap()
}

fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

fn calibrate(labels: &Path, out: &Path, more: &[&str]) -> Output {
    let models = data("vehicles.json");
    let mut arguments = vec!["calibrate", "--labels", text(labels), "--vehicles", text(&models)];
    arguments.extend(["--out", text(out)]);
    arguments.extend(more);
    mvcalib(&arguments)
}

fn stderr(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// Lanes made for this test: two strips of the picture's road.
const LANES: &str = r#"{"imageWidth":320,"imageHeight":240,"shapes":[
  {"label":"lane 1","shape_type":"polygon","flags":{"toward":true},
   "points":[[149,110],[166,110],[128,215],[84,215]]},
  {"label":"2","shape_type":"polygon","flags":{"toward":true},
   "points":[[168,110],[190,110],[165,215],[131,215]]}]}"#;

#[test]
fn from_labels_to_a_lane_table_and_a_report() {
    let folder = Folder::new("whole");
    let (json, lut) = (folder.join("k.json"), folder.join("k.lut"));
    let lines = data("k109f/lane_lines.json");
    let shifts = data("k109f/frames.json");
    let more = ["--method", "joint", "--camera-id", "K109F", "--lane-lines", text(&lines)];
    let more = [&more[..], &["--frame-shifts", text(&shifts)]].concat();
    let out = calibrate(&data("k109f/labels"), &json, &more);
    assert!(out.status.success(), "{}", stderr(&out));
    let written: serde_json::Value =
        serde_json::from_slice(&std::fs::read(&json).unwrap()).unwrap();
    for field in ["f", "rvec", "tvec", "loss", "rel_err", "seed", "evaluations", "wall_time_s"] {
        assert!(!written[field].is_null(), "{field} is missing");
    }
    assert_eq!(written["vehicles"].as_array().unwrap().len(), 7);
    assert_eq!(written["trust"], "ok");

    let lanes = folder.join("lanes.json");
    std::fs::write(&lanes, LANES).unwrap();
    let overlay = folder.join("o.png");
    let out = mvcalib(&[
        "table",
        "--calibration",
        text(&json),
        "--lanes",
        text(&lanes),
        "--out",
        text(&lut),
        "--overlay",
        text(&overlay),
    ]);
    assert!(out.status.success(), "{}", stderr(&out));
    assert!(std::fs::read(&overlay).unwrap().starts_with(b"\x89PNG"));
    let bytes = std::fs::read(&lut).unwrap();
    let table = verge::lane::LaneTable::parse(&bytes[..]).unwrap();
    let description = table.description();
    assert_eq!(description.camera_id.as_str(), "K109F");
    let stated = written["rel_err"].as_f64().unwrap();
    assert!((f64::from(description.length_rel_err.unwrap()) - stated).abs() < 1e-6);

    let marks = folder.join("marks.json");
    let one = r#"{"marks":[{"points":[[157.6,158.8],[145.1,181.7]],"segment_length_m":6.0}]}"#;
    std::fs::write(&marks, one).unwrap();
    let out = mvcalib(&["verify", "--calibration", text(&json), "--marks", text(&marks)]);
    let accuracy: serde_json::Value = serde_json::from_slice(&out.stdout).unwrap();
    for field in ["rmse_m", "mae_m", "mape_pct"] {
        assert!(accuracy[field].is_number(), "{field}");
    }

    let page = folder.join("r.html");
    let out = mvcalib(&["report", "--calibration", text(&json), "--out", text(&page)]);
    assert!(out.status.success(), "{}", stderr(&out));
    assert!(std::fs::read_to_string(&page).unwrap().contains("K109F"));
}

#[test]
fn the_same_seed_gives_the_same_calibration() {
    let folder = Folder::new("seed");
    let run = |name: &str, seed: &str| {
        let json = folder.join(name);
        let out = calibrate(&data("k109f/labels"), &json, &["--method", "mvcalib", "--seed", seed]);
        assert!(out.status.success(), "{}", stderr(&out));
        let text = std::fs::read_to_string(&json).unwrap();
        let lines = text.lines().filter(|l| !l.contains("wall_time_s"));
        lines.map(str::to_owned).collect::<Vec<_>>()
    };
    assert_eq!(run("a.json", "5"), run("b.json", "5"));
    assert_ne!(run("c.json", "6"), run("d.json", "5"));
}

/// Writes the labels of one vehicle, changed by `edit`, into a folder of their own.
fn one_vehicle(folder: &Folder, edit: impl Fn(String) -> String) -> PathBuf {
    let labels = folder.join("labels");
    std::fs::create_dir_all(&labels).unwrap();
    let source = std::fs::read_to_string(data("k109f/labels/vehicle_07.json")).unwrap();
    std::fs::write(labels.join("vehicle_07.json"), edit(source)).unwrap();
    labels
}

#[test]
fn bad_labels_name_the_vehicle_and_the_point() {
    let cases: [(&str, &str, &str); 5] = [
        ("184.0, 205.6", "1e999, 205.6", "line"),
        ("\"label\": \"2\"", "\"label\": \"1\"", "labelled twice"),
        ("\"label\": \"2\"", "\"label\": \"wheel\"", "wheel"),
        ("[[184.0, 205.6]]", "[[1840.0, 205.6]]", "outside"),
        ("[[184.0, 205.6]]", "[[150.0, 203.0]]", "swapped"),
    ];
    for (index, (from, to, expected)) in cases.into_iter().enumerate() {
        let folder = Folder::new(&format!("bad-{index}"));
        let labels = one_vehicle(&folder, |s| s.replace(from, to));
        let json = folder.join("out.json");
        let out = calibrate(&labels, &json, &[]);
        let message = stderr(&out);
        assert_eq!(out.status.code(), Some(65), "{message}");
        assert!(message.contains("vehicle_07") && message.contains(expected), "{message}");
        assert!(!json.exists(), "nothing is written after an error");
    }
}

#[test]
fn a_flag_states_the_body_which_only_joint_knows() {
    let flagged = |flag: &str| {
        let folder = Folder::new(&format!("body-{flag}"));
        let with = format!(r#"{{ "flags": {{"{flag}": true}}, "#);
        let labels = one_vehicle(&folder, |s| s.replacen('{', &with, 1));
        let code_and_message = |method| {
            let out = calibrate(&labels, &folder.join("k.json"), &["--method", method]);
            (out.status.code().unwrap(), stderr(&out))
        };
        ["joint", "mvcalib"].map(code_and_message)
    };
    for (code, message) in flagged("lorry") {
        assert!(code == 65 && message.contains("vehicle_07, flag 'lorry'"), "{code}: {message}");
    }
    let [joint, mvcalib] = flagged("taxi");
    assert_eq!(joint.0, 0, "{}", joint.1);
    assert!(mvcalib.0 == 64 && mvcalib.1.contains("vehicle_07 is a taxi"), "{mvcalib:?}");
}

#[test]
fn one_vehicle_is_not_trusted_and_its_table_is_refused_unless_forced() {
    for method in ["joint", "mvcalib"] {
        let folder = Folder::new(&format!("one-{method}"));
        let labels = one_vehicle(&folder, |s| s);
        let (json, lut) = (folder.join("k.json"), folder.join("k.lut"));
        let out = calibrate(&labels, &json, &["--method", method]);
        assert!(out.status.success() && stderr(&out).contains("NOT TRUSTED"), "{}", stderr(&out));
        let lanes = folder.join("lanes.json");
        std::fs::write(&lanes, LANES).unwrap();
        let (json, lanes, out) = (text(&json), text(&lanes), text(&lut));
        let table = ["table", "--calibration", json, "--lanes", lanes, "--out", out];
        let refused = mvcalib(&table);
        assert_eq!(refused.status.code(), Some(65));
        let why = if method == "joint" { "at the far end are uncertain by" } else { "1 vehicle" };
        assert!(stderr(&refused).contains(why), "{}", stderr(&refused));
        assert!(!lut.exists());
        let forced = mvcalib(&[&table[..], &["--force"]].concat());
        assert!(forced.status.success(), "{}", stderr(&forced));
        let cells = |length| mvcalib(&[&table[..], &["--force", "--cell-length", length]].concat());
        for wrong in ["1.9", "101", "-10", "NaN", "ten"] {
            let refused = cells(wrong);
            assert_eq!(refused.status.code(), Some(64), "{wrong}: {}", stderr(&refused));
        }
        // A method that states its error does so for each lane and cell.
        let versions = if method == "joint" { [4, 4] } else { [1, 3] };
        for (length, version) in ["10", "7.5"].into_iter().zip(versions) {
            assert!(cells(length).status.success());
            let bytes = std::fs::read(&lut).unwrap();
            let table = verge::lane::LaneTable::parse(&bytes[..]).unwrap();
            assert_eq!(table.description().cell_length_m.to_string(), length);
            assert_eq!(bytes[8], version);
        }
    }
}

#[test]
fn a_vehicle_in_the_sky_is_named() {
    // All vehicles of the camera, and one high above them: no road holds both.
    let folder = Folder::new("sky");
    let labels = one_vehicle(&folder, |s| s);
    for n in 1..=6 {
        let name = format!("vehicle_{n:02}.json");
        std::fs::copy(data(&format!("k109f/labels/{name}")), labels.join(&name)).unwrap();
    }
    let up = |s: String| {
        ["204.0", "205.6", "209.4", "195.4", "191.7", "194.8", "181.6"].iter().fold(s, |s, v| {
            let moved: f64 = v.parse::<f64>().unwrap() - 175.0;
            s.replace(&format!(", {v}]"), &format!(", {moved:.1}]"))
        })
    };
    let labels = one_vehicle(&folder, up);
    let json = folder.join("k.json");
    let out = calibrate(&labels, &json, &["--method", "joint"]);
    let message = stderr(&out);
    assert!(message.contains("NOT TRUSTED") && message.contains("vehicle_07"), "{message}");
}

/// Four lengths on K109F's road: two dashes and gaps of 6 m, the width of a lane near and far.
const LENGTHS: &str = r#"{"imageWidth":320,"imageHeight":240,"shapes":[
  {"label":"6 m","shape_type":"linestrip","points":[[157.56,158.78],[145.14,181.74]]},
  {"label":"hk-lane","shape_type":"linestrip","points":[[169.80,125.08],[166.16,139.30]]},
  {"label":"3.5 m","shape_type":"line","points":[[145.14,181.74],[177.6,181.74]]},
  {"label":"lane 3.5","shape_type":"line","points":[[170.70,114.04],[190.7,114.04]]}]}"#;

#[test]
fn lengths_alone_calibrate_a_camera_and_state_its_error() {
    let folder = Folder::new("road");
    let (json, lengths) = (folder.join("k.json"), folder.join("lengths.json"));
    std::fs::write(&lengths, LENGTHS).unwrap();
    let road = |more: &[&str]| {
        let given = ["calibrate", "--method", "road", "--out", text(&json)];
        mvcalib(&[&given[..], more].concat())
    };
    let size = ["--image-size", "320x240"];
    let nothing = road(&size);
    assert_eq!(nothing.status.code(), Some(64), "{}", stderr(&nothing));
    assert!(stderr(&nothing).contains("give --lengths first"), "{}", stderr(&nothing));
    let sizeless = road(&["--lengths", text(&lengths)]);
    assert!(stderr(&sizeless).contains("--image-size"), "{}", stderr(&sizeless));
    assert!(!json.exists(), "nothing is written after an error");

    let out = road(&[&size[..], &["--lengths", text(&lengths)]].concat());
    assert!(out.status.success(), "{}", stderr(&out));
    let said = stderr(&out);
    assert!(said.contains("far (v") && said.contains("mark 2 (hk-lane): 6.00 m"), "{said}");
    let written: serde_json::Value =
        serde_json::from_slice(&std::fs::read(&json).unwrap()).unwrap();
    assert_eq!(written["method"], "road");
    assert!(written["rel_err"].as_f64().unwrap() > 0.0);
    for place in ["near", "middle", "far"] {
        assert!(written["errors"][place]["along"].is_number(), "{place}");
    }

    let marks = text(&lengths);
    let verify = ["verify", "--calibration", text(&json), "--marks", marks];
    let (table, plain) = (mvcalib(&verify), mvcalib(&[&verify[..], &["--json"]].concat()));
    assert!(stderr(&table).contains("the mean length is off by"), "{}", stderr(&table));
    assert_eq!((plain.stdout, plain.stderr.len()), (table.stdout, 0));
}

#[test]
fn a_length_that_contradicts_the_others_is_named() {
    let folder = Folder::new("contradiction");
    let (json, lengths) = (folder.join("k.json"), folder.join("lengths.json"));
    // 6 m typed as 60, beside three more that agree with the rest.
    let more = r#"{"label":"12 m","shape_type":"linestrip","points":[[166.16,139.30],[145.14,181.74]]},
      {"label":"60 m","shape_type":"linestrip","points":[[170.49,105.52],[170.70,114.04]]},"#;
    let edited = LENGTHS.replacen(r#""shapes":["#, &format!(r#""shapes":[{more}"#), 1);
    std::fs::write(&lengths, edited).unwrap();
    let out = mvcalib(&[
        "calibrate",
        "--method",
        "road",
        "--image-size",
        "320x240",
        "--lengths",
        text(&lengths),
        "--out",
        text(&json),
    ]);
    let said = stderr(&out);
    assert!(said.contains("NOT TRUSTED") && said.contains("(60 m) is given as 60.00 m"), "{said}");
}

#[test]
fn wrong_marks_are_named_with_their_file_and_place() {
    let folder = Folder::new("wrong-marks");
    let street = Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/data/freeway");
    let calibration = street.join("calibration.json");
    let marks = folder.join("marks.json");
    let labelme = |shapes: &str| {
        format!(r#"{{"shapes":[{shapes}],"imageWidth":640,"imageHeight":480,"imagePath":"a.png"}}"#)
    };
    let on_road = r#"{"points":[[300,400],[310,420]],"segment_length_m":6}"#;
    for (content, words) in [
        // Outside of the picture a length is whatever the plane of the road makes of it.
        (
            format!(
                r#"{{"marks":[{on_road},{{"points":[[300,400],[2300.5,460]],"segment_length_m":6}}]}}"#
            ),
            &["mark 2", "(2300.5, 460.0)", "outside", "720x480"][..],
        ),
        (
            labelme(r#"{"label":"dash 6 m","points":[[300,400],[300,900]],"shape_type":"line"}"#),
            &["mark 1 (dash 6 m)", "(300.0, 900.0)", "outside"],
        ),
        (
            labelme(
                r#"{"label":"rectangle 6 x 3 m","points":[[300,400],[330,400],[340,440],[-290,440]],
                    "shape_type":"polygon"}"#,
            ),
            &["rectangle 1 (rectangle 6 x 3 m)", "(-290.0, 440.0)"],
        ),
        ("{}".into(), &["\"marks\""]),
        (r#"{"marks":[]}"#.into(), &["\"marks\""]),
        ("3".into(), &["3", "an object"]),
        (
            r#"{"marks":[{"points":[["a",2],[3,4]],"segment_length_m":6}]}"#.into(),
            &["\"a\"", "a number", "line 1"],
        ),
        (r#"{"marks":[{"points":[[1],[3,4]],"segment_length_m":6}]}"#.into(), &["a list of 2"]),
        (r#"{"marks":[{"segment_length_m":6}]}"#.into(), &["\"points\" is missing"]),
        (r#"{"marks":[{"points":[[1,2"#.into(), &["ends too early"]),
        (
            r#"{"marks":[{"points":[[1,2],[3,4]],"segment_length_m":0}]}"#.into(),
            &["mark 1 has segments of 0 m"],
        ),
    ] {
        std::fs::write(&marks, &content).unwrap();
        let out =
            mvcalib(&["verify", "--calibration", text(&calibration), "--marks", text(&marks)]);
        let said = stderr(&out);
        assert_eq!(out.status.code(), Some(65), "{content}: {said}");
        assert!(out.stdout.is_empty() && said.contains("marks.json: "), "{said}");
        for word in words {
            assert!(said.contains(word), "{word} in {said}");
        }
        for rust in ["struct", "f64", "tuple", "array", "sequence", "`", ", expected"] {
            assert!(!said.contains(rust), "{rust} in {said}");
        }
    }
}

#[test]
fn exit_codes_follow_sysexits() {
    let folder = Folder::new("codes");
    let labels = data("k109f/labels");
    let code = |out: Output| out.status.code().unwrap();
    assert_eq!(code(mvcalib(&["calibrate"])), 64);
    assert_eq!(code(mvcalib(&["--help"])), 0);
    let missing = folder.join("missing");
    assert_eq!(code(calibrate(&missing, &folder.join("a.json"), &[])), 66);
    assert_eq!(code(calibrate(&labels, &folder.join("a.json"), &["--f0", "-5"])), 64);
    let nowhere = missing.join("a.json");
    assert_eq!(code(calibrate(&labels, &nowhere, &["--method", "joint"])), 73);
    assert!(!missing.exists());
}

#[test]
fn what_a_method_does_not_take_is_refused() {
    let folder = Folder::new("taken");
    let (labels, json) = (data("k109f/labels"), folder.join("k.json"));
    let boxes = folder.join("boxes.jsonl");
    std::fs::write(&boxes, r#"{"frame":"a","boxes":[[600,400,640,440,0.9,"car"]]}"#).unwrap();
    for (more, expected) in [
        (&["--lane-width", "3.5"][..], "--lane-width is an observation of --method road"),
        (&["--camera-height", "5"], "--camera-height is an observation of --method road"),
        (&["--detections", text(&boxes)], "--detections is an observation of --method road"),
        (&["--method", "cg", "--distortion"], "--distortion is an option of --method joint"),
        (&["--method", "road", "--sway-px", "3"], "--sway-px is an option of --method joint"),
    ] {
        let out = calibrate(&labels, &json, more);
        let said = stderr(&out);
        assert!(out.status.code() == Some(64) && said.contains(expected), "{more:?}: {said}");
    }
    let lengths = folder.join("lengths.json");
    std::fs::write(&lengths, LENGTHS).unwrap();
    let road = |out: &Path, more: &[&str]| {
        let given = ["calibrate", "--method", "road", "--image-size", "320x240"];
        let lengths = ["--lengths", text(&lengths), "--out", text(out)];
        mvcalib(&[&given[..], &lengths, more].concat())
    };
    // Boxes of another camera, and none.
    let out = road(&json, &["--detections", text(&boxes)]);
    assert!(out.status.code() == Some(65), "{}", stderr(&out));
    assert!(stderr(&out).contains("lies outside pictures of 320x240"), "{}", stderr(&out));
    std::fs::write(&boxes, "").unwrap();
    let out = road(&json, &["--detections", text(&boxes)]);
    assert!(stderr(&out).contains("no box in it"), "{}", stderr(&out));
    // An input stays what it is.
    let out = road(&lengths, &[]);
    assert!(out.status.code() == Some(73), "{}", stderr(&out));
    assert_eq!(std::fs::read_to_string(&lengths).unwrap(), LENGTHS);
    assert!(road(&json, &[]).status.success());
    let (marks, size) = (text(&lengths), "640x480");
    let out =
        mvcalib(&["verify", "--calibration", text(&json), "--marks", marks, "--image-size", size]);
    assert!(out.status.code() == Some(65), "{}", stderr(&out));
    let lanes = folder.join("lanes.json");
    std::fs::write(&lanes, LANES).unwrap();
    let table = ["table", "--calibration", text(&json), "--lanes", text(&lanes), "--force"];
    let lut = folder.join("k.lut");
    for (made, drawn) in [(&json, None), (&lanes, None), (&lut, Some(&lut))] {
        let overlay = drawn.map_or_else(Vec::new, |path| vec!["--overlay", text(path)]);
        let out = mvcalib(&[&table[..], &["--out", text(made)], &overlay].concat());
        assert!(out.status.code() == Some(73), "{}", stderr(&out));
    }
}
