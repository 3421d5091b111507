//! `verge replay` and `verge detect` as a user runs them.

mod common;

use common::{
    COCO_MODEL, K109F_TABLE, STREET_FRAMES, STREET_TABLE, folder, jpeg, k109f_frames, stderr, verge,
};
use serde_json::Value;
use std::path::Path;
use std::process::Command;

/// The windows of the street's recording, byte for byte: a change of them reaches every user.
const WINDOWS: &str = "tests/data/curve/windows.jsonl";

fn text(path: &Path) -> &str {
    path.to_str().expect("a path in UTF-8")
}

#[test]
fn the_same_replay_gives_the_same_bytes() {
    let folder = folder();
    let once = |name: &str| {
        let boxes = folder.path().join(name);
        let output = verge(&[
            "replay",
            "--table",
            STREET_TABLE,
            "--frames",
            STREET_FRAMES,
            "--json",
            "--window",
            "60",
            "--detections",
            text(&boxes),
        ]);
        assert!(output.status.success(), "{}", stderr(&output));
        (output.stdout, std::fs::read(boxes).expect("the detections were written"))
    };
    let (windows, boxes) = once("a.jsonl");
    assert_eq!((windows.clone(), boxes.clone()), once("b.jsonl"));
    if std::env::var_os("VERGE_WRITE").is_some_and(|value| value == "1") {
        std::fs::write(WINDOWS, &windows).expect("the golden file can be written");
    }
    let golden = std::fs::read(WINDOWS).expect("it ships");
    assert!(windows == golden, "windows are not those of {WINDOWS}: VERGE_WRITE=1, then git diff");
    let windows: Vec<Value> = lines(&windows);
    let used: u64 = windows.iter().map(|w| w["lanes"][0]["frames_used"].as_u64().unwrap()).sum();
    assert_eq!((windows.len(), used), (3, 90), "three minutes, a frame each two seconds");
    assert_eq!(lines::<Value>(&boxes).len(), 90);
}

fn lines<T: serde::de::DeserializeOwned>(bytes: &[u8]) -> Vec<T> {
    let text = std::str::from_utf8(bytes).expect("UTF-8");
    text.lines().map(|line| serde_json::from_str(line).expect("JSON Lines")).collect()
}

#[test]
fn vehicles_in_the_four_lanes_agree_with_the_papers_detector() {
    let Some(frames) = k109f_frames() else { return };
    let Some(labels) = common::shared("data/k109f/vehicle_detection/outputs/labels") else {
        return;
    };
    let table = lane_table();
    let mut difference = 0.0;
    for number in 1..=7 {
        let name = format!("vehicle_{number:02}");
        let folder = folder();
        std::fs::copy(frames.join(format!("{name}.jpg")), folder.path().join("frame.jpg"))
            .expect("copying a frame");
        let output = verge(&[
            "replay",
            "--table",
            K109F_TABLE,
            "--frames",
            text(folder.path()),
            "--json",
            "--interval",
            "120",
        ]);
        assert!(output.status.success(), "{}", stderr(&output));
        let window: Value = serde_json::from_slice(&output.stdout).expect("one window");
        let lanes = window["lanes"].as_array().expect("lanes");
        let ours: f64 = lanes.iter().map(|l| l["vehicles_mean"].as_f64().expect("known")).sum();
        let text = std::fs::read_to_string(labels.join(name + ".txt")).expect("its labels");
        let papers = text.lines().filter(|line| in_lanes(&table, line)).count() as f64;
        eprintln!("frame {number}: {ours} vehicles, the paper's detector {papers}");
        difference += (ours - papers).abs() / 7.0;
    }
    eprintln!("mean absolute difference {difference:.2} vehicles");
    assert!(difference <= 5.0, "{difference}");
}

/// The paper's bars on its own camera: the count within 10 %, lanes within 9.04 veh/km on average. Its
/// third frame is the second again and is left out.
#[test]
fn vehicles_in_the_four_lanes_agree_with_the_eye() {
    let Some(frames) = k109f_frames() else { return };
    let different = ["01", "02", "04", "05", "06", "07"].map(|n| format!("vehicle_{n}.jpg"));
    let folder = folder();
    for name in &different {
        std::fs::copy(frames.join(name), folder.path().join(name)).expect("copying a frame");
    }
    let output = verge(&[
        "replay",
        "--table",
        K109F_TABLE,
        "--frames",
        text(folder.path()),
        "--json",
        "--interval",
        "120",
        "--unwatched",
    ]);
    assert!(output.status.success(), "{}", stderr(&output));
    let window: Value = serde_json::from_slice(&output.stdout).expect("one window");
    let labels = std::fs::read_to_string("tests/data/k109f/vehicles.json").expect("it ships");
    let labels: Value = serde_json::from_str(&labels).expect("JSON");
    let table = lane_table();
    let mut seen = [0.0; 4];
    for frame in labels["frames"].as_array().expect("frames") {
        let name = frame["frame"].as_str().expect("a name");
        if !different.iter().any(|different| different == name) {
            continue;
        }
        for vehicle in frame["vehicles"].as_array().expect("vehicles") {
            let at = |i: usize| vehicle["box"][i].as_f64().expect("px") as f32;
            let point = verge::units::ImagePoint { u: (at(0) + at(2)) / 2.0, v: at(3) };
            if table.place(point).is_some() {
                let lane = vehicle["lane"].as_u64().expect("a lane") as usize;
                seen[lane - 1] += 1.0;
            }
        }
    }
    let (mut counted, mut off) = (0.0, 0.0);
    for (lane, seen) in window["lanes"].as_array().expect("lanes").iter().zip(seen) {
        let number = |key: &str| lane[key].as_f64().expect("known");
        let truth = seen / 6.0 / number("length_m") * 1000.0;
        let density = number("density_veh_km");
        eprintln!("lane {}: {density:.1} veh/km, by eye {truth:.1}", lane["lane"]);
        counted += number("vehicles_mean") * 6.0;
        off += (density - truth).abs() / 4.0;
    }
    let seen: f64 = seen.iter().sum();
    eprintln!("{counted:.0} vehicles, by eye {seen:.0}; lanes off by {off:.1} veh/km on average");
    assert!((counted / seen - 1.0).abs() <= 0.1 && off <= 9.04, "{counted} {seen} {off}");
}

type Table = verge::lane::LaneTable<Vec<u8>>;

fn lane_table() -> Table {
    Table::parse(std::fs::read(K109F_TABLE).expect("it ships")).expect("a right table")
}

/// Whether a line `class cx cy w h` (parts of the picture) has its lower edge's middle in a
/// lane.
fn in_lanes(table: &Table, line: &str) -> bool {
    let numbers: Vec<f32> = line.split(' ').map(|n| n.parse().expect("a number")).collect();
    let (u, v) = (numbers[1] * 320.0, (numbers[2] + numbers[4] / 2.0) * 240.0);
    v < 239.5 && table.place(verge::units::ImagePoint { u, v }).is_some()
}

#[test]
fn vehicles_labelled_by_eye_are_put_into_their_lanes() {
    let text = std::fs::read_to_string("tests/data/k109f/vehicles.json").expect("it ships");
    let labels: Value = serde_json::from_str(&text).expect("JSON");
    let table = lane_table();
    let (mut right, mut wrong) = (0, 0);
    for frame in labels["frames"].as_array().expect("frames") {
        for vehicle in frame["vehicles"].as_array().expect("vehicles") {
            let at = |i: usize| vehicle["contact"][i].as_f64().expect("px") as f32;
            let point = verge::units::ImagePoint { u: at(0), v: at(1) };
            // Vehicles before and behind the measured stretch have no lane in the table.
            let Some(place) = table.place(point) else { continue };
            let same = u64::from(place.lane.get()) == vehicle["lane"].as_u64().expect("a lane");
            *if same { &mut right } else { &mut wrong } += 1;
        }
    }
    eprintln!("{right} of {} vehicles in their lane", right + wrong);
    assert!(right + wrong >= 60);
    assert!(f64::from(right) >= 0.95 * f64::from(right + wrong));
}

#[test]
fn frames_that_cannot_be_read_are_named_and_the_rest_is_measured() {
    let folder = folder();
    let file = |name: &str, bytes: &[u8]| {
        std::fs::write(folder.path().join(name), bytes).expect("writing a frame");
    };
    let whole = jpeg(320, 240, 90);
    file("20260105T080000Z.jpg", &whole);
    file("20260105T080010Z.jpg", &whole[..whole.len() / 2]);
    file("20260105T080020Z.jpg", b"");
    file("20260105T080030Z.jpg", b"<html>no picture</html>");
    file("20260105T080040Z.jpg", &jpeg(64, 64, 90));
    file("20260105T080050Z.jpg", &jpeg(320, 240, 120));
    // A second picture of an instant that has one.
    file("20260105T080050Z_copy.jpg", &jpeg(320, 240, 60));
    // Nobody will ever write into it.
    let fifo = folder.path().join("20260105T080025Z.jpg");
    assert!(Command::new("mkfifo").arg(&fifo).status().expect("coreutils").success());
    let output = verge(&[
        "replay",
        "--table",
        K109F_TABLE,
        "--frames",
        text(folder.path()),
        "--json",
        "--window",
        "60",
    ]);
    assert!(output.status.success(), "{}", stderr(&output));
    let said = stderr(&output);
    for expected in [
        "080010Z.jpg is left out",
        "not a plain file",
        "cut off",
        "empty",
        "HTML page",
        "64x64",
        "320x240",
    ] {
        assert!(said.contains(expected), "{expected}: {said}");
    }
    let twice =
        "1 of 8 files are left out, for others have the same time: 20260105T080050Z_copy.jpg";
    assert!(said.contains(twice), "{said}");
    let window: Value = serde_json::from_slice(&output.stdout).expect("one window");
    let lane = &window["lanes"][0];
    assert_eq!((&lane["frames_used"], &lane["frames_expected"]), (&2.into(), &6.into()));
    assert_eq!(window["from"], "2026-01-05T08:00:00.000Z");
}

#[test]
fn frames_that_are_gone_are_said_once_with_their_number() {
    let folder = folder();
    let name = |second: u32| folder.path().join(format!("20260105T0800{second:02}Z.jpg"));
    std::fs::write(name(0), jpeg(320, 240, 90)).expect("writing a frame");
    for second in [10, 20, 30] {
        std::os::unix::fs::symlink("gone", name(second)).expect("a link to nothing");
    }
    let output = verge(&["replay", "--table", K109F_TABLE, "--frames", text(folder.path())]);
    let said = stderr(&output);
    let lines: Vec<_> = said.lines().filter(|line| line.contains("no such file")).collect();
    assert!(lines.len() == 2 && lines[1].contains("2 more frames are left out"), "{said}");
}

/// Runs replay with these arguments and returns its exit code and what it said.
fn fails(args: &[&str]) -> (i32, String) {
    let output = verge(&[&["replay"], args].concat());
    assert!(output.stdout.is_empty(), "a failed replay prints no window");
    (output.status.code().expect("an exit code"), stderr(&output))
}

#[test]
fn wrong_input_has_a_clear_message_and_the_right_exit_code() {
    let folder = folder();
    let frames = folder.path().join("frames");
    std::fs::create_dir(&frames).expect("a folder");
    let good = std::fs::read(K109F_TABLE).expect("it ships");
    let mut flipped = good.clone();
    flipped[good.len() / 2] ^= 4;
    let path = |name: &str, bytes: &[u8]| {
        let path = folder.path().join(name);
        std::fs::write(&path, bytes).expect("writing a file");
        path.to_str().expect("UTF-8").to_owned()
    };
    let flipped = path("flipped.lut", &flipped);
    let cut = path("cut.lut", &good[..1000]);
    let none = path("none.lut", b"hello, this is a letter and no table");
    let frames = text(&frames);
    for (table, code, expected) in [
        (flipped.as_str(), 65, "checksum"),
        (&cut, 65, "cut off"),
        (&none, 65, "mvcalib table"),
        ("missing.lut", 66, "missing.lut"),
        (K109F_TABLE, 66, "no .jpg"),
    ] {
        let picture = folder.path().join("frames/a.jpg");
        if table == K109F_TABLE {
            let _ = std::fs::remove_file(&picture);
        } else {
            std::fs::write(&picture, jpeg(320, 240, 9)).expect("writing a frame");
        }
        let (actual, said) = fails(&["--table", table, "--frames", frames, "--interval", "1"]);
        assert_eq!(actual, code, "{said}");
        assert!(said.contains(expected), "{expected}: {said}");
    }
    assert_eq!(fails(&["--frames", frames]).0, 64);
    for (wrong, expected) in [
        (["--window", "0"], "give whole seconds"),
        (["--window", "7"], "give whole seconds"),
        (["--interval", "0"], "give 0.001 to 86400 s"),
        (["--interval", "-1"], "give 0.001 to 86400 s"),
        (["--interval", "nan"], "give 0.001 to 86400 s"),
    ] {
        let (code, said) =
            fails(&[&["--table", K109F_TABLE, "--frames", frames], &wrong[..]].concat());
        assert!(code == 64 && said.contains(expected), "{code}: {said}");
    }
    let (code, said) = fails(&["--table", K109F_TABLE, "--frames", frames, "--window", "60"]);
    assert_eq!(code, 66, "{said}");
    let (code, said) = fails(&["--table", K109F_TABLE, "--frames", frames, "--top-speed", "5"]);
    assert!(code == 64 && said.contains("10 to 300"), "{said}");
    for score in ["2", "nan", "-1"] {
        let (code, said) = fails(&["--table", K109F_TABLE, "--frames", frames, "--score", score]);
        assert!(code == 64 && said.contains("give 0 to 1"), "{said}");
    }
    for (input, expected) in [("641x480", "a multiple of 32"), ("0x480", "a multiple of 32")] {
        let (code, said) = fails(&["--table", K109F_TABLE, "--frames", frames, "--input", input]);
        assert!(code == 64 && said.contains(expected), "{said}");
    }
    let args = ["--table", K109F_TABLE, "--frames", frames, "--interval", "9"];
    std::fs::write(folder.path().join("frames/a.jpg"), jpeg(320, 240, 9)).expect("a frame");
    let (code, said) = fails(&[&args[..], &["--input", "64x64"]].concat());
    assert!(code == 64 && said.contains("hardly one is found"), "{said}");
    let (code, said) = fails(&[&args[..4], &["--interval", "90", "--window", "60"]].concat());
    assert!(
        code == 64 && said.contains("--window: a frame every 90 s cannot fill windows of 60 s"),
        "{said}"
    );
    let (code, said) = fails(&[&args[..], &["--detections", K109F_TABLE]].concat());
    assert!(code == 73 && said.contains("an input, which would be lost"), "{said}");
    for (sections, expected) in [
        (&["7=40"][..], "no lane table has a lane 7"),
        (&["2=400"], "lane 2 has "),
        (&["2=20", "2=30"], "lane 2 has two sections"),
    ] {
        let mut args = vec!["--table", K109F_TABLE, "--frames", frames, "--interval", "9"];
        args.extend(sections.iter().flat_map(|section| ["--section", *section]));
        let (code, said) = fails(&args);
        assert!(code == 64 && said.contains(&format!("--section: {expected}")), "{said}");
    }
}

#[test]
fn one_table_is_not_two_presets() {
    let folder = folder();
    let (copy, link) = (folder.path().join("copy.lut"), folder.path().join("link.lut"));
    std::fs::copy(common::STREET_TABLE, &copy).expect("copied");
    let here = std::env::current_dir().expect("a working directory");
    std::os::unix::fs::symlink(here.join(common::STREET_TABLE), &link).expect("a link");
    for other in [common::STREET_TABLE, text(&copy), text(&link)] {
        let (code, said) = fails(&[
            "--table",
            common::STREET_TABLE,
            "--table",
            other,
            "--frames",
            common::STREET_FRAMES,
        ]);
        let words = format!("lane table {other} shows the same pose of the camera as ");
        assert!(code == 65 && said.contains(&words), "{code}: {said}");
    }
}

#[test]
fn what_bench_and_view_cannot_have_is_said_plainly() {
    let bench = verge(&["bench", "--count", "0"]);
    assert_eq!(bench.status.code(), Some(64), "{}", stderr(&bench));
    assert!(stderr(&bench).contains("give 1 to"), "{}", stderr(&bench));
    let folder = folder();
    let bench = Command::new(env!("CARGO_BIN_EXE_verge"))
        .arg("bench")
        .current_dir(folder.path())
        .output()
        .expect("it runs");
    assert_eq!(bench.status.code(), Some(66), "{}", stderr(&bench));
    let said = stderr(&bench);
    assert!(said.contains("--frames and --table") && !said.contains("demo"), "{said}");
    let taken = std::net::TcpListener::bind((std::net::Ipv4Addr::LOCALHOST, 0)).expect("a port");
    let port = taken.local_addr().expect("bound").port();
    let said = verge_desk::loopback::Loopback::bind(port).err().expect("it is taken");
    assert!(said.contains(&format!("port {port} is in use")), "{said}");
    assert!(said.contains("--port") && !said.contains("os error"), "{said}");
}

#[test]
fn flow_and_speed_have_columns_where_vehicles_are_followed() {
    let frames = folder();
    for step in 0..4 {
        let name = format!("20260105T080000.{}00Z.jpg", 2 * step);
        std::fs::write(frames.path().join(name), jpeg(320, 240, 90)).expect("writing a frame");
    }
    let replay = |more: &[&str]| {
        let args =
            ["replay", "--table", K109F_TABLE, "--frames", text(frames.path()), "--unwatched"];
        let output = verge(&[&args, more].concat());
        assert!(output.status.success(), "{}", stderr(&output));
        let text = String::from_utf8(output.stdout).expect("UTF-8");
        text.lines().map(|line| line.split_whitespace().count()).collect::<Vec<_>>()
    };
    let [heading, rows @ ..] = &replay(&[])[..] else { panic!("nothing was printed") };
    // The heading says `from (UTC)` and `time %`, and nothing over the direction.
    assert_eq!((*heading, rows), (12, &[11; 4][..]), "density, flow, speed, occupancy");
    let [heading, rows @ ..] = &replay(&["--top-speed", "300"])[..] else { panic!("nothing") };
    assert_eq!(
        (*heading, rows),
        (8, &[8; 4][..]),
        "the lanes are too short for that: density alone"
    );
}

#[test]
fn a_table_of_another_shape_is_refused() {
    let folder = folder();
    for name in ["a.jpg", "b.jpg", "c.jpg"] {
        std::fs::write(folder.path().join(name), jpeg(640, 360, 9)).expect("writing a frame");
    }
    let (code, said) =
        fails(&["--table", K109F_TABLE, "--frames", text(folder.path()), "--interval", "9"]);
    assert_eq!(code, 65, "{said}");
    assert!(said.contains("640x360") && said.contains("K109F"), "{said}");
    // A fault that all frames share is logged once, with their number.
    assert!(said.contains("frame a.jpg is left out") && !said.contains("frame b.jpg"), "{said}");
    assert!(said.contains("2 more frames are left out"), "{said}");
}

#[test]
fn a_wrong_model_is_refused_with_the_reason() {
    let folder = folder();
    std::fs::write(folder.path().join("a.jpg"), jpeg(320, 240, 9)).expect("writing a frame");
    let frames = text(folder.path());
    let sidecar = std::fs::read_to_string(COCO_MODEL).expect("it ships");
    let detect = |model: &Path| {
        let boxes = folder.path().join("boxes.jsonl");
        let output = verge(&[
            "detect",
            "--frames",
            frames,
            "--detections",
            text(&boxes),
            "--model",
            text(model),
        ]);
        assert!(!boxes.exists(), "nothing is left behind");
        (output.status.code().expect("an exit code"), stderr(&output))
    };
    let unknown = folder.path().join("unknown.onnx");
    std::fs::write(&unknown, b"not a model").expect("writing a file");
    let (code, said) = detect(&unknown);
    assert_eq!(code, 65, "{said}");
    assert!(said.contains("unknown.toml"), "{said}");

    let other = folder.path().join("other.toml");
    let hash = "\"93cf";
    assert!(sidecar.contains(hash));
    std::fs::write(
        &other,
        sidecar.replace(
            "../../shared/models/nanodet_plus_m/nanodet_plus_m_coco_640x480.onnx",
            "unknown.onnx",
        ),
    )
    .expect("writing a file");
    let (code, said) = detect(&other);
    assert_eq!(code, 65, "{said}");
    assert!(said.contains("SHA-256"), "{said}");

    let Some(model) = common::shared("models/nanodet_plus_m/nanodet_plus_m_coco_640x480.onnx")
    else {
        return;
    };
    let model = std::fs::canonicalize(model).expect("it is there");
    for (from, to, expected) in [
        ("width_px = 640", "width_px = 416", "the input"),
        ("classes = 80", "classes = 81", "the output"),
    ] {
        let text = sidecar.replace(from, to).replace(
            "../../shared/models/nanodet_plus_m/nanodet_plus_m_coco_640x480.onnx",
            model.to_str().expect("UTF-8"),
        );
        std::fs::write(&other, text).expect("writing a file");
        let (code, said) = detect(&other);
        assert_eq!(code, 65, "{said}");
        assert!(said.contains(expected), "{said}");
    }
}

#[test]
fn frames_are_drawn_beside_the_recording_and_never_into_it() {
    let (frames, drawn) = (folder(), folder());
    for second in ["00", "10"] {
        let name = format!("20260105T0800{second}Z.jpg");
        std::fs::write(frames.path().join(name), jpeg(320, 240, 90)).expect("writing a frame");
    }
    let replay = |overlay: &Path| {
        let folders = [text(frames.path()), text(overlay)];
        verge(&[
            "replay",
            "--table",
            K109F_TABLE,
            "--frames",
            folders[0],
            "--window",
            "60",
            "--overlay",
            folders[1],
        ])
    };
    let output = replay(drawn.path());
    assert!(output.status.success(), "{}", stderr(&output));
    let drawing = drawn.path().join("20260105T080000Z.png");
    let drawing = image::open(drawing).expect("a picture").into_rgb8();
    assert_eq!(drawing.dimensions(), (960, 720), "three times the frame's");
    let grey = |pixel: &image::Rgb<u8>| pixel.0.iter().all(|&c| c.abs_diff(pixel.0[0]) < 8);
    let coloured = drawing.pixels().filter(|pixel| !grey(pixel)).count();
    assert!(coloured > 20_000, "{coloured} pixels of lanes over a grey frame");
    let refused = replay(frames.path());
    assert_eq!(refused.status.code(), Some(73), "{}", stderr(&refused));
    assert!(stderr(&refused).contains("another folder"), "{}", stderr(&refused));
    assert_eq!(std::fs::read_dir(frames.path()).expect("the frames").count(), 2);
}
