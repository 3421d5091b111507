//! Files that the daemon reads: configuration, lane table, model, and its own spool.

use super::messages::messages_to_begin_with;
use super::runner::Target;
use super::{common, magnitude, mend_trailer, name, outcome};
use std::fs;
use verge::daemon::config::Config;
use verge::daemon::detect::inspect;
use verge::daemon::spool::{self, Spool};
use verge::lane::{self, Description, Lane, LaneTable};
use verge::scene::{Point, Reference};
use verge::units::{Direction, ImagePoint, ImageSize, LaneId};
use verge::wire::DensityMessage;

#[test]
fn models() {
    let folder = common::folder();
    let path = folder.path().join("model.onnx");
    let target = Target {
        name: "models",
        executions: 100,
        corpus: vec![fs::read("tests/data/models/tiny.onnx").expect("it ships")],
        tokens: &[
            b"Conv",
            b"QuantizeLinear",
            b"DequantizeLinear",
            b"LeakyRelu",
            b"Reshape",
            b"Resize",
            b"Slice",
            b"Split",
            b"Transpose",
            b"pads",
            b"strides",
            b"group",
            b"axis",
        ],
        longest: 8192,
    };
    target.run(|_, input| {
        fs::write(&path, &*input).expect("writing a model");
        outcome(inspect(&path, None), |model| magnitude(model.outputs.len() + model.left.len()))
    });
}

#[test]
fn configurations() {
    let folder = common::folder();
    let path = folder.path().join("verge.toml");
    let example = fs::read_to_string("boards/linux/verge.toml").expect("it ships");
    let full: String = example
        .lines()
        .map(|line| match line.strip_prefix('#') {
            Some(key) if !key.starts_with(' ') && key.contains(" = ") => key.to_owned() + "\n",
            _ => line.to_owned() + "\n",
        })
        .collect();
    let bare: String =
        full.lines().filter(|l| !l.starts_with('#')).map(|l| l.to_owned() + "\n").collect();
    let target = Target {
        name: "configurations",
        executions: 2_000,
        corpus: vec![bare.into_bytes(), full.into_bytes(), example.into_bytes()],
        tokens: &[
            b"[camera]\n",
            b"[[camera]]\n",
            b"[windows]\n",
            b"lengths_s = [",
            b"interval_s = ",
            b"nan",
            b"inf",
            b"-1",
            b"1e999",
            b"0x7fffffffffffffff",
            b"9223372036854775808",
            b"true",
            b"\"\"\"",
            b"'''",
            b"{ a = {",
            b"a.b.c.d = 1\n",
            b"1979-05-27T07:32:00Z",
            b"\\u0000",
            b"\\U0010ffff",
            b"[[[[[[[[",
            b"{{{{{{{{",
            b"port = 70000\n",
            b"\xc3\x28",
            b"\xef\xbb\xbf",
            b"\r\n",
            b"\"http://\"",
        ],
        longest: 1 << 14,
    };
    target.run(|_, input| {
        // A new file: to write over one makes some file systems wait for the disk.
        let _ = fs::remove_file(&path);
        fs::write(&path, &*input).expect("writing the configuration");
        let result = Config::read(&path);
        if let Ok(config) = &result {
            assert!(!config.interval().is_zero());
            assert!(!config.root_topic().is_empty());
        }
        // The reason is in the last line, behind a quotation of the file.
        outcome(result, |config| format!("{:?}", config.mqtt.format))
            .lines()
            .last()
            .unwrap_or_default()
            .to_owned()
    });
}

/// A reference of a scene: two rows of points in both grids.
fn small_scene() -> Reference {
    let mut scene = Reference { width: 160, height: 120, ..Reference::default() };
    for n in 0..200 {
        let point = Point { x: n % 100, y: 7 + n / 100, edge: [100, -20] };
        scene.fine.push(point).expect("room for more");
        let _ = scene.coarse.push(Point { x: point.x / 2, ..point });
    }
    scene
}

/// A table of 16x8 cells with two lanes: format 1, 2 with a scene, 3 with cells of another length.
pub fn small_table(cell_length_m: f32, scene: Option<&Reference>) -> Vec<u8> {
    table(ImageSize { width: 16, height: 8 }, cell_length_m, scene)
}

/// The same for a picture of any size.
pub fn table(size: ImageSize, cell_length_m: f32, scene: Option<&Reference>) -> Vec<u8> {
    let lane = |number, direction| Lane {
        id: LaneId::new(number).expect("in range"),
        direction,
        length_m: 40.0,
    };
    let description = Description {
        camera_id: name("camera"),
        image_size: size,
        lanes: [lane(1, Direction::Toward), lane(2, Direction::Away)].into_iter().collect(),
        length_rel_err: Some(0.02),
        calibration_id: name("calibration"),
        calibration_sha256: [3; 32],
        cell_length_m,
    };
    let mut bytes = vec![0; lane::encoded_len(&description, scene)];
    let cell = |u: u16, v: u16| {
        let lane = LaneId::new((u32::from(u) * 16 / u32::from(size.width) / 6) as u8)?;
        let s_m = f32::from(v) * 32.0 / f32::from(size.height);
        (lane.get() < 3).then_some(lane::Place { lane, s_m, span_m: 0.5 })
    };
    let len = lane::encode(&description, scene, cell, &mut bytes).expect("a right table");
    bytes.truncate(len);
    bytes
}

#[test]
fn lane_tables() {
    let target = Target {
        name: "lane_tables",
        executions: 50_000,
        corpus: vec![
            small_table(10.0, None),
            small_table(10.0, Some(&small_scene())),
            small_table(7.5, None),
        ],
        tokens: &[
            b"VERGELUT",
            b"VERGELUT\x01\0",
            b"VERGELUT\x02\0",
            b"VERGELUT\x03\0",
            b"\xff\xff\xff\xff\x0f",
            b"\0\0\xc0\x7f",
        ],
        longest: 1 << 12,
    };
    target.run(|rng, input| {
        mend_trailer(rng, input);
        let result = LaneTable::parse(&*input);
        if let Ok(table) = &result {
            let description = table.description();
            assert!((2.0..=100.0).contains(&description.cell_length_m), "cells of no such length");
            let size = description.image_size;
            let edges = [-1.0, 0.0, 0.5, f32::NAN, f32::MAX];
            let (right, low) = (f32::from(size.width), f32::from(size.height));
            for u in edges.into_iter().chain([right - 0.01, right]) {
                for v in edges.into_iter().chain([low - 0.01, low]) {
                    if let Some(place) = table.place(ImagePoint { u, v }) {
                        let lane = description.lane(place.lane).expect("a lane of the table");
                        assert!(place.s_m <= lane.length_m + 0.011, "beyond the lane's end");
                    }
                }
            }
        }
        outcome(result, |table| {
            let description = table.description();
            let lanes = "/".repeat(description.lanes.len());
            let scene = outcome(table.scene(), |scene| match scene {
                Some(scene) => magnitude(scene.fine.len()) + "+" + &magnitude(scene.coarse.len()),
                None => "no scene".to_owned(),
            });
            lanes + &magnitude(description.cell_count()) + &scene
        })
    });
}

/// A segment as the spool writes it, without the zeros at its end.
fn segment() -> Vec<u8> {
    let folder = common::folder();
    let mut spool = Spool::open(folder.path(), 10).expect("nobody else has it");
    for message in messages_to_begin_with().iter().cycle().take(4) {
        let (key, _) = spool.accept(60, |seq| DensityMessage { seq, ..message.clone() });
        spool.acknowledge(if key == 2 { 1 } else { 0 });
    }
    drop(spool);
    let files = fs::read_dir(folder.path()).expect("a folder");
    let mut paths = files.map(|entry| entry.expect("an entry").path());
    let path = paths.find(|path| path.extension().is_some()).expect("a segment");
    let mut bytes = fs::read(path).expect("readable");
    bytes.truncate(bytes.iter().rposition(|&byte| byte != 0).expect("records") + 1);
    bytes
}

#[test]
fn spool_recovery() {
    let target = Target {
        name: "spool_recovery",
        executions: 20_000,
        corpus: vec![segment()],
        tokens: &[b"VSP\x01", b"VR", b"VR\x01", b"VR\x02\x08\0", b"VR\x03", b"\0\0\0\0"],
        longest: 1 << 13,
    };
    target.run(|_, input| {
        let found = spool::examine(input);
        let [windows, notes, damaged] =
            [found.windows, found.notes, found.damaged as usize].map(magnitude);
        format!("{windows} windows {notes} notes {damaged} damaged {}", found.torn)
    });
}
