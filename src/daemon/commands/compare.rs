//! The comparison of `verge bench` with ONNX Runtime.
//!
//! Owns the child process that runs it. Both sides get the same model, the same picture and
//! one thread, and take turns, so that a busy machine slows both. Times are processor time.

use crate::daemon::clock;
use crate::daemon::detect::{Detector, LoadOptions, Precision};
use crate::daemon::exit::Failure;
use crate::daemon::frame::Picture;
use serde_json::{Value, json};
use std::io::{BufRead, BufReader, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};

const SCRIPT: &str = include_str!("onnxruntime.py");
/// Writes other forms of a model.
const FORMS: &str = include_str!("forms.py");

/// Turns that warm caches up and do not count.
const WARM_UP: usize = 5;

/// ONNX Runtime in a child process.
struct Reference {
    child: Child,
    orders: ChildStdin,
    answers: BufReader<ChildStdout>,
}

fn missing(reason: &str) -> Failure {
    Failure::OnnxRuntime(reason.to_owned())
}

impl Reference {
    fn start(input: &Path, models: &[&Path]) -> Result<(Self, String), Failure> {
        let mut child = Command::new("python3")
            .args(["-c", SCRIPT])
            .arg(input)
            .args(models)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .map_err(|error| missing(&format!("python3 does not start ({error})")))?;
        let (Some(orders), Some(answers)) = (child.stdin.take(), child.stdout.take()) else {
            return Err(missing("python3 has no standard input or output"));
        };
        let mut this = Self { child, orders, answers: BufReader::new(answers) };
        let ready = this.answer();
        match ready.as_deref().ok().and_then(|line| line.strip_prefix("ready ")) {
            Some(version) => {
                let version = version.to_owned();
                Ok((this, version))
            }
            None => Err(this.complaint()),
        }
    }

    /// The last line that the child wrote about its end.
    fn complaint(&mut self) -> Failure {
        let mut said = String::new();
        if let Some(mut errors) = self.child.stderr.take() {
            let _ = std::io::Read::read_to_string(&mut errors, &mut said);
        }
        missing(said.trim().lines().last().unwrap_or("it ended without a message"))
    }

    fn answer(&mut self) -> Result<String, Failure> {
        let mut line = String::new();
        match self.answers.read_line(&mut line) {
            Ok(len) if len > 0 => Ok(line.trim().to_owned()),
            _ => Err(missing("it ended before its answer")),
        }
    }

    /// Milliseconds of one run of a model.
    fn time(&mut self, model: usize) -> Result<f64, Failure> {
        if writeln!(self.orders, "{model}").and_then(|()| self.orders.flush()).is_err() {
            return Err(self.complaint());
        }
        let answer = self.answer()?;
        answer.parse().map_err(|_| missing(&format!("it answered {answer:?}")))
    }
}

impl Drop for Reference {
    fn drop(&mut self) {
        // It ends by itself at the end of its input; this is for a child that hangs.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// A folder of its own for the files that the child reads; goes with its owner.
struct Folder(PathBuf);

impl Folder {
    fn new() -> Result<Self, Failure> {
        let path = std::env::temp_dir().join(format!("verge-bench-{}", std::process::id()));
        match std::fs::create_dir(&path) {
            Ok(()) => Ok(Self(path)),
            Err(source) => Err(Failure::Write { path, source }),
        }
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        if let Err(error) = std::fs::remove_dir_all(&self.0) {
            log::warn!("{} stays behind: {error}", self.0.display());
        }
    }
}

fn time(work: impl FnOnce() -> Result<(), Failure>) -> Result<f64, Failure> {
    let begun = clock::processor_time();
    work()?;
    Ok((clock::processor_time() - begun).as_secs_f64() * 1e3)
}

fn median(values: &[f64]) -> f64 {
    quantile(values, 0.5)
}

fn quantile(values: &[f64], at: f64) -> f64 {
    let mut values = values.to_vec();
    values.sort_by(f64::total_cmp);
    let index = (values.len() as f64 - 1.0) * at;
    values.get(index.round() as usize).copied().unwrap_or(f64::NAN)
}

/// Median of the ratios of each turn, and the range that holds the middle 80 % of them.
fn ratio(ours: &[f64], theirs: &[f64]) -> Value {
    let ratios: Vec<f64> = ours.iter().zip(theirs).map(|(a, b)| a / b).collect();
    let digits = |v: f64| (v * 1e3).round() / 1e3;
    json!({
        "ratio": digits(median(&ratios)),
        "spread": [digits(quantile(&ratios, 0.1)), digits(quantile(&ratios, 0.9))],
    })
}

/// Writes the model in floats, and rounded before activations too where it rounds at all.
fn write_forms(model: &Path, float: &Path, early: &Path) -> Result<(), Failure> {
    let written = Command::new("python3")
        .args(["-c", FORMS])
        .args([model, float, early])
        .output()
        .map_err(|error| missing(&format!("python3 does not start ({error})")))?;
    if written.status.success() {
        return Ok(());
    }
    let said = String::from_utf8_lossy(&written.stderr);
    Err(missing(said.trim().lines().last().unwrap_or("the model's forms were not written")))
}

/// Runs `turns` turns; `frame` puts one picture through the whole line.
pub fn compare(
    model: &Path,
    picture: &Picture,
    turns: usize,
    mut frame: impl FnMut() -> Result<(), Failure>,
) -> Result<Value, Failure> {
    let mut stored = Detector::load(model, None)?;
    let options = LoadOptions { precision: Precision::Float, ..LoadOptions::default() };
    let mut float = Detector::load_as(model, &options)?;
    let stored_file = stored.file().to_owned();
    let folder = Folder::new()?;
    let place = |name: &str| folder.0.join(name);
    let write = |name: &str, bytes: &[u8]| {
        let path = place(name);
        std::fs::write(&path, bytes).map_err(|source| Failure::Write { path, source })
    };
    let planes = stored.planes(picture);
    write("input", &planes.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<_>>())?;
    let (float_file, early_file) = (place("float.onnx"), place("early.onnx"));
    write_forms(&stored_file, &float_file, &early_file)?;
    let is_int8 = early_file.exists();
    let mut files = vec![float_file.as_path()];
    if is_int8 {
        files.extend([stored_file.as_path(), &early_file]);
    }
    let (mut reference, version) = Reference::start(&place("input"), &files)?;
    let mut times: [Vec<f64>; 6] = Default::default();
    for turn in 0..WARM_UP + turns {
        let mut row = [f64::NAN; 6];
        stored.prepare(picture, 0);
        float.prepare(picture, 0);
        row[0] = time(|| Ok(stored.infer().map(drop)?))?;
        row[1] = time(|| Ok(float.infer().map(drop)?))?;
        row[2] = time(&mut frame)?;
        for model in 0..files.len() {
            row[3 + model] = reference.time(model)?;
        }
        if turn >= WARM_UP {
            times.iter_mut().zip(row).for_each(|(times, time)| times.push(time));
        }
    }
    let [int8, float_ms, frame, theirs_float, theirs_stored, theirs_early] = &times;
    let digits = |values: &[f64]| (median(values) * 1e3).round() / 1e3;
    let f32_ratio = ratio(float_ms, theirs_float);
    let mut report = json!({
        "onnxruntime": version,
        "runs_on": stored.runs_on(),
        "turns": turns,
        "f32_ms": digits(float_ms),
        "onnxruntime_f32_ms": digits(theirs_float),
        "f32_ratio": f32_ratio["ratio"],
        "f32_ratio_spread": f32_ratio["spread"],
    });
    if is_int8 {
        // Against the form that it is faster in.
        let best =
            if median(theirs_early) < median(theirs_stored) { theirs_early } else { theirs_stored };
        let (int8_ratio, frame_ratio) = (ratio(int8, best), ratio(frame, best));
        report["int8_ms"] = digits(int8).into();
        report["onnxruntime_int8_ms"] = digits(best).into();
        report["onnxruntime_int8_as_stored_ms"] = digits(theirs_stored).into();
        report["int8_ratio"] = int8_ratio["ratio"].clone();
        report["int8_ratio_spread"] = int8_ratio["spread"].clone();
        report["frame_processor_ms"] = digits(frame).into();
        report["frame_ratio"] = frame_ratio["ratio"].clone();
        report["frame_ratio_spread"] = frame_ratio["spread"].clone();
    }
    Ok(report)
}
