//! Fuzzing on stable Rust: what comes from outside never makes the daemon panic, hang or
//! take memory without bound.
//!
//! As a test each target does a short run, always the same. A long one:
//! `VERGE_FUZZ_EXECUTIONS=1000000 VERGE_FUZZ_SEED=7 cargo test --test fuzz -- --nocapture`,
//! with a target's name behind `fuzz` for that one alone. What has been run:
//! `docs/measured/fuzzing.md`.
//!
//! Targets: `pictures`, `large_pictures`, `http_answers`, `streams`, `descriptions`, `packets`,
//! `sessions` (camera), `configurations`, `lane_tables`, `spool_recovery`, `models` (files),
//! `wire_messages`, `json_messages` (messages read
//! back).

#[path = "../common/mod.rs"]
mod common;
mod http;
mod mutate;
mod rtsp;
mod runner;
mod streams;

use crc::{CRC_32_ISO_HDLC, Crc};
use fastrand::Rng;
use runner::Target;
use std::fs;
use std::path::Path;
use verge::daemon::capture::{DecodeError, decode};
use verge::daemon::config::Config;
use verge::daemon::detect::inspect;
use verge::daemon::frame::Picture;
use verge::daemon::publish::{Identity, payload};
use verge::daemon::spool::{self, Spool};
use verge::density::{Aggregator, SampleZoneStatus, Start};
use verge::lane::{self, Description, Lane, LaneTable, Name};
use verge::scene::{Point, Reference};
use verge::sensor::ClosedWindow;
use verge::units::{Direction, ImagePoint, ImageSize, LaneId, UtcMs, VehicleClass};
use verge::wire::{self, CalibrationRef, DensityMessage, ModelRef};
use verge_messages::formats::{Exporter, Format, Publisher};
use verge_messages::{Density, Status, read};

const CRC: Crc<u32> = Crc::<u32>::new(&CRC_32_ISO_HDLC);

/// Outcome of something that worked, in a way that `kind` tells from others, or said why
/// not.
fn outcome<T>(result: Result<T, impl std::fmt::Display>, kind: impl FnOnce(T) -> String) -> String {
    result.map_or_else(|error| error.to_string(), |value| format!("right {}", kind(value)))
}

/// A number as letters: its magnitude, for outcomes.
fn magnitude(number: usize) -> String {
    "i".repeat(number.checked_ilog2().map_or(0, |log| log as usize + 1))
}

/// A message's outcome: its lanes, and what is known of them.
fn message_kind(message: &Density) -> String {
    let known = |lane: &verge_messages::Lane| {
        let is_known = [
            lane.density_veh_km.is_some(),
            lane.by_class.is_some(),
            lane.space_occupancy.is_some(),
            lane.cells.as_ref().is_some_and(|cells| cells.density_veh_km.is_some()),
            lane.status == Status::Ok,
        ];
        is_known.map(|known| if known { 'k' } else { '-' }).iter().collect::<String>()
    };
    message.lanes.iter().map(known).collect::<Vec<_>>().join("/")
}

/// Makes the last four bytes the checksum of those before, nine times in ten: a reader
/// that looks no further than the checksum is tested once in a while only.
fn mend_trailer(rng: &mut Rng, input: &mut [u8]) {
    if rng.u8(..10) > 0
        && let Some((body, trailer)) = input.split_last_chunk_mut::<4>()
    {
        *trailer = CRC.checksum(body).to_le_bytes();
    }
}

/// The pictures that the repository has for this, and made ones.
fn pictures_to_begin_with() -> Vec<Vec<u8>> {
    let mut pictures = vec![common::jpeg(8, 8, 10), common::jpeg(33, 17, 200)];
    let mut png = Vec::new();
    let grey = image::GrayImage::from_fn(9, 7, |x, y| image::Luma([(x * y) as u8]));
    image::DynamicImage::from(grey)
        .write_to(&mut std::io::Cursor::new(&mut png), image::ImageFormat::Png)
        .expect("encoding to memory");
    pictures.push(png);
    let mut files: Vec<_> = fs::read_dir("tests/data/fuzz")
        .expect("it ships")
        .map(|entry| entry.expect("an entry").path())
        .collect();
    files.sort();
    pictures.extend(files.iter().map(|file| fs::read(file).expect("a picture")));
    pictures
}

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
fn pictures() {
    let mut picture = Picture::default();
    let target = Target {
        name: "pictures",
        executions: 3_000,
        corpus: pictures_to_begin_with(),
        tokens: &[
            b"\xff\xd8",
            b"\xff\xd9",
            b"\xff\xda",
            b"\xff\xdb",
            b"\xff\xc0",
            b"\xff\xc1",
            b"\xff\xc2",
            b"\x08\x08\x70\x0f\x00",
            b"\xff\xc4",
            b"\xff\xc9",
            b"\xff\xdd\0\x04\0\x01",
            b"\xff\xd0",
            b"\xff\xe0",
            b"\xff\xee\0\x0eAdobe",
            b"\xff\0",
            b"IHDR",
            b"IDAT",
            b"IEND",
            b"PLTE",
            b"iCCP",
            b"zTXt",
            b"iTXt",
            b"eXIf",
            b"Exif\0\0MM\0*",
            b"\xff\xe1",
            b"\xff\xc4",
            b"tRNS",
            b"acTL",
        ],
        longest: 1 << 16,
    };
    target.run(|rng, input| {
        if input.starts_with(b"\x89PNG") {
            mend_chunks(rng, input);
        } else if !input.ends_with(b"\xff\xd9") && rng.u8(..4) > 0 {
            input.extend_from_slice(b"\xff\xd9");
        }
        let result = decode(input, &mut picture);
        assert!(!matches!(result, Err(DecodeError::Decoder)), "the decoder panics");
        if result.is_ok() {
            assert_eq!(picture.rgb.len(), picture.width * picture.height * 3);
        }
        // Its buffer is not an input's own memory.
        let picture = std::mem::take(&mut picture);
        outcome(result, |()| magnitude(picture.rgb.len()))
    });
}

/// Pictures that claim the largest size there may be: what one costs at most.
#[test]
fn large_pictures() {
    let claims_4k = |mut jpeg: Vec<u8>| {
        let frame =
            jpeg.windows(2).position(|pair| pair[0] == 0xff && (0xc0..=0xc2).contains(&pair[1]));
        let size = frame.expect("a start of frame") + 5;
        jpeg[size..size + 4].copy_from_slice(&[0x08, 0x70, 0x0f, 0x00]);
        jpeg
    };
    let progressive = fs::read("tests/data/fuzz/progressive.jpg").expect("it ships");
    let target = Target {
        name: "large_pictures",
        executions: 8,
        corpus: vec![claims_4k(progressive), claims_4k(common::jpeg(33, 17, 200))],
        tokens: &[b"\xff\xda", b"\xff\xd9"],
        longest: 1 << 16,
    };
    target.run(|_, input| {
        input.extend_from_slice(b"\xff\xd9");
        let mut picture = Picture::default();
        let result = decode(input, &mut picture);
        assert!(!matches!(result, Err(DecodeError::Decoder)), "the decoder panics");
        outcome(result, |()| magnitude(picture.rgb.len()))
    });
}

/// Makes the checksums of a PNG's chunks right, nine times in ten.
fn mend_chunks(rng: &mut Rng, png: &mut [u8]) {
    if rng.u8(..10) == 0 {
        return;
    }
    let mut at = 8;
    while let Some(len) = png.get(at..at + 4) {
        let len = u32::from_be_bytes([len[0], len[1], len[2], len[3]]) as usize;
        let Some(end) = at.checked_add(8).and_then(|begin| begin.checked_add(len)) else { return };
        let Some(chunk) = png.get(at + 4..end) else { return };
        let sum = CRC.checksum(chunk).to_be_bytes();
        let Some(stored) = png.get_mut(end..end + 4) else { return };
        stored.copy_from_slice(&sum);
        at = end + 4;
    }
}

#[test]
fn http_answers() {
    let camera = http::Camera::start();
    let target = Target {
        name: "http_answers",
        executions: 300,
        corpus: http::answers_to_begin_with(),
        tokens: http::TOKENS,
        longest: 1 << 16,
    };
    target.run(|_, input| {
        http::without_redirects(input);
        camera.ask(input)
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
        // What is wrong stands in the last line, behind a quotation of the file.
        outcome(result, |config| format!("{:?}", config.mqtt.format))
            .lines()
            .last()
            .unwrap_or_default()
            .to_owned()
    });
}

fn name(text: &str) -> Name {
    Name::try_from(text).expect("short")
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
fn small_table(cell_length_m: f32, scene: Option<&Reference>) -> Vec<u8> {
    let lane = |number, direction| Lane {
        id: LaneId::new(number).expect("in range"),
        direction,
        length_m: 40.0,
    };
    let description = Description {
        camera_id: name("camera"),
        image_size: ImageSize { width: 16, height: 8 },
        lanes: [lane(1, Direction::Toward), lane(2, Direction::Away)].into_iter().collect(),
        length_rel_err: Some(0.02),
        calibration_id: name("calibration"),
        calibration_sha256: [3; 32],
        cell_length_m,
    };
    let mut bytes = vec![0; lane::encoded_len(&description, scene)];
    let cell = |u: u16, v: u16| {
        let lane = LaneId::new((u / 6) as u8)?;
        (lane.get() < 3).then(|| lane::Place { lane, s_m: f32::from(v) * 4.0, span_m: 0.5 })
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

/// Messages with and without density.
fn messages_to_begin_with() -> Vec<DensityMessage> {
    let table = LaneTable::parse(small_table(10.0, None)).expect("a right table");
    let minute = std::time::Duration::from_secs(60);
    let (lanes, cell_m) = (&table.description().lanes, table.description().cell_length_m);
    let mut line: Aggregator =
        Aggregator::new(lanes, cell_m, &[minute], minute / 3, 0.5, Start::AtNextWindow)
            .expect("right");
    let mut counts = line.counts();
    counts.add(LaneId::new(2).expect("in range"), 12.0, VehicleClass::Bus);
    let mut closed = Vec::new();
    for second in [0, 20, 40, 60] {
        closed.extend(line.observe(UtcMs(1_767_600_000_000 + second * 1000), &counts));
    }
    closed.extend(line.miss(UtcMs(1_767_600_120_000), SampleZoneStatus::PoorContrast));
    let model = ModelRef { name: name("model"), sha256: [7; 32] };
    let identity = Identity::new("site", &model);
    let calibration = &CalibrationRef::of(table.description());
    let message = |report, seq| identity.message(ClosedWindow { report, calibration }, true, seq);
    (1..).zip(&closed).map(|(seq, report)| message(report, seq)).collect()
}

/// Writes a message that was read in every format: none of it may panic.
fn export(message: &Density) {
    for format in Format::ALL {
        let text = Exporter::new(format, Publisher::default()).message(message);
        // A table of sites asks for a position.
        assert!(text.map_or_else(|reason| !reason.is_empty(), |text| !text.is_empty()));
    }
}

/// The message as the first verge wrote it: without cells and errors.
fn format_1(message: &DensityMessage) -> Vec<u8> {
    let mut message = message.clone();
    message.report.lanes.iter_mut().for_each(|lane| (lane.cells, lane.error) = (None, None));
    let mut buffer = [0; wire::MAX_MESSAGE];
    let bytes = wire::encode(&message, &mut buffer).expect("fits");
    // Behind the body stand two zeros for each lane, and the checksum.
    let body = &bytes[1..bytes.len() - 4 - 2 * message.report.lanes.len()];
    let mut old = [&[1], body].concat();
    old.extend_from_slice(&CRC.checksum(&old).to_le_bytes());
    assert_eq!(wire::decode(&old).as_ref(), Ok(&message));
    old
}

#[test]
fn wire_messages() {
    let mut buffer = [0; wire::MAX_MESSAGE];
    let encoded = |message| wire::encode(message, &mut buffer).expect("fits").to_vec();
    let messages = messages_to_begin_with();
    let mut corpus: Vec<_> = messages.iter().map(encoded).collect();
    corpus.extend(messages.iter().map(format_1));
    let target = Target {
        name: "wire_messages",
        executions: 50_000,
        corpus,
        tokens: &[
            b"\xff\xff\xff\xff\xff\xff\xff\xff\xff\x01",
            b"\x80\x80\x80\x80\x10",
            b"\0\0\xc0\x7f",
            b"\0\0\x80\x7f",
            b"\0\0\x80\xff",
            b"\xc3\x28",
        ],
        longest: 2 * wire::MAX_MESSAGE,
    };
    let mut buffer = [0; 4 * wire::MAX_MESSAGE];
    target.run(|rng, input| {
        mend_trailer(rng, input);
        let result = wire::decode(input);
        if let Ok(message) = &result {
            let bytes = wire::encode(message, &mut buffer).expect("what was read can be written");
            assert!(bytes.len() <= wire::MAX_MESSAGE, "{} bytes", bytes.len());
            let density = verge::messages::density(message, None);
            // What the check lets through is written by every format, and read again.
            if density.check().is_ok() {
                export(&density);
                assert_eq!(read(&verge_messages::json(&density)).as_ref(), Ok(&density));
            }
        }
        outcome(result, |message| message_kind(&verge::messages::density(&message, None)))
    });
}

#[test]
fn json_messages() {
    let target = Target {
        name: "json_messages",
        executions: 10_000,
        corpus: messages_to_begin_with().iter().map(|m| payload::density(m, None)).collect(),
        tokens: &[
            b"null",
            b"-1",
            b"1e999",
            b"1e-999",
            b"NaN",
            b"{",
            b"}",
            b"[",
            b"]",
            b"[[[[[[[[",
            b"\"schema\":1",
            b"\"lanes\":[",
            b"\"oK\"",
            b"\\u0000",
            b"\\ud800",
            b"\xc3\x28",
            b"9999-12-31T23:59:59.999Z",
            b"-009999-01-01T00:00:00Z",
            b"1e30",
            b"3.5e38",
        ],
        longest: 1 << 14,
    };
    target.run(|_, input| {
        let result = read(input);
        if let Ok(message) = &result {
            export(message);
            assert_eq!(read(&verge_messages::json(message)).as_ref(), Ok(message));
        }
        outcome(result, |message| message_kind(&message))
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

/// The corpus is what the repository ships, and stays small.
#[test]
fn the_corpus_is_small() {
    let folder = Path::new("tests/data/fuzz");
    let bytes: u64 = fs::read_dir(folder)
        .expect("it ships")
        .map(|entry| entry.and_then(|entry| entry.metadata()).expect("a file").len())
        .sum();
    assert!(bytes < 64 << 10, "{bytes} bytes in {}", folder.display());
}
