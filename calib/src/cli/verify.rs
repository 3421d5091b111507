//! `mvcalib verify`: how far a calibration is from marks of known length.

use super::{CalibrationFile, print};
use mvcalib::error::{Error, Result};
use mvcalib::files::calibration::Calibration;
use mvcalib::files::stated::StatedErrors;
use mvcalib::road::marks::{Accuracy, Marks};
use mvcalib::trust::MAX_ACROSS_REL_ERR;
use std::path::PathBuf;

/// Arguments of `verify`.
#[derive(Debug, clap::Args)]
pub struct Arguments {
    #[command(flatten)]
    calibration: CalibrationFile,
    /// Marks of known length: {"marks":[{"points":[[u,v],...],"segment_length_m":6.0}]}, or
    /// labelme linestrips labelled with the metres of each segment.
    #[arg(long)]
    marks: PathBuf,
    /// Print one JSON object and no table.
    #[arg(long)]
    json: bool,
}

/// What is printed as JSON.
#[derive(Debug, serde::Serialize)]
struct Verified {
    #[serde(flatten)]
    accuracy: Accuracy,
    /// Standard errors across the road near, in the middle and far, as parts.
    #[serde(skip_serializing_if = "Option::is_none")]
    stated_across: Option<[f64; 3]>,
}

/// Two-sided 90 % interval of a normal distribution, in standard deviations.
const NINETY: f64 = 1.645;

/// Runs `verify`: one JSON object on standard output, and a table before the eyes of a person.
pub fn run(arguments: &Arguments) -> Result<()> {
    let calibration = arguments.calibration.read()?;
    let marks = Marks::read(&arguments.marks)?;
    let camera = calibration.camera();
    marks.require_within(camera.image_size, &arguments.marks)?;
    if marks.segments().next().is_none() {
        let path = arguments.marks.clone();
        let problem = "rectangles alone, and none with its sides: nothing to measure; label them \
                       'rectangle 12 x 3.5 m', or add a length";
        return Err(Error::MarksIn { path, problem: problem.into() });
    }
    let accuracy = marks.verify(&camera)?;
    let across = calibration.errors.as_ref().map(StatedErrors::across);
    let json = serde_json::to_string(&Verified { accuracy, stated_across: across })
        .expect("finite numbers are always JSON");
    if !arguments.json {
        eprint!("{}", table(&calibration, &marks)?);
    }
    print(&json);
    Ok(())
}

fn table(calibration: &Calibration, marks: &Marks) -> Result<String> {
    use std::fmt::Write;
    let (camera, known) = (calibration.camera(), calibration.known());
    let mut text = String::from("mark   true m   measured m   error m   error %   stated +- %\n");
    let mut stretches = Vec::new();
    let (mut logs, mut errors) = (Vec::new(), Vec::new());
    for segment in marks.segments() {
        let (measured, length) = (segment.measure(&camera)?, segment.length_m);
        let error = measured - length;
        let stated = known.as_ref().and_then(|k| k.of_stretches(&[segment.ends]));
        let stated = stated.map_or("-".into(), |e| format!("{:.1}", 100.0 * e.rel_sd));
        let name = format!("{}.{}", segment.mark, segment.point);
        let _ = writeln!(
            text,
            "{name:<6} {length:>6.2} {measured:>12.2} {error:>+9.2} {:>+9.1} {stated:>13}",
            100.0 * error / length,
        );
        stretches.push(segment.ends);
        logs.push((measured / length).ln());
        errors.push(100.0 * error / length);
    }
    let mean_of = |values: &[f64]| values.iter().sum::<f64>() / values.len().max(1) as f64;
    let (mean, bias_pct) = (mean_of(&logs), mean_of(&errors));
    let stated = known.and_then(|k| k.of_stretches(&stretches)).map(|e| e.rel_sd);
    let _ = match stated {
        Some(sd) if mean.abs() <= NINETY * sd => writeln!(
            text,
            "the mean length is off by {bias_pct:+.1} %: within the stated error (+- {:.1} %, 90 %)",
            100.0 * NINETY * sd,
        ),
        Some(sd) => writeln!(
            text,
            "the mean length is off by {bias_pct:+.1} %: MORE than the stated error allows (+- {:.1} %, \
             90 %); look at the marks, then add them to the calibration as --lengths",
            100.0 * NINETY * sd,
        ),
        None => writeln!(
            text,
            "the mean length is off by {bias_pct:+.1} %; {} states no error of its own",
            calibration.method,
        ),
    };
    if let Some([near, middle, far]) = calibration.errors.as_ref().map(StatedErrors::across) {
        let limit = 100.0 * MAX_ACROSS_REL_ERR;
        let verdict =
            if near.max(middle).max(far) > MAX_ACROSS_REL_ERR { "TOO MUCH" } else { "fine" };
        let [near, middle, far] = [near, middle, far].map(|e| 100.0 * e);
        let _ = writeln!(
            text,
            "across the road the stated error is {near:.1} % near, {middle:.1} % in the middle, \
             {far:.1} % far: {verdict} (limit {limit:.0} %)"
        );
    }
    Ok(text)
}
