//! `mvcalib verify`: how far a calibration is from marks of known length.

use super::{CalibrationFile, print};
use mvcalib::error::{Error, Result};
use mvcalib::files::calibration::Calibration;
use mvcalib::road::marks::Marks;
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

/// Two-sided 90 % interval of a normal distribution, in standard deviations.
const NINETY: f64 = 1.645;

/// Runs `verify`: one JSON object on standard output, and a table before the eyes of a person.
pub fn run(arguments: &Arguments) -> Result<()> {
    let calibration = arguments.calibration.read()?;
    let marks = Marks::read(&arguments.marks)?;
    if marks.segments().next().is_none() {
        return Err(Error::Marks(
            "rectangles alone, and none with its sides: nothing to measure; label them \
             'rectangle 12 x 3.5 m', or add a length"
                .into(),
        ));
    }
    let accuracy = marks.verify(&calibration.camera())?;
    let json = serde_json::to_string(&accuracy).expect("five finite numbers are always JSON");
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
    let mut logs = Vec::new();
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
    }
    let mean = logs.iter().sum::<f64>() / logs.len().max(1) as f64;
    let stated = known.and_then(|k| k.of_stretches(&stretches)).map(|e| e.rel_sd);
    let _ = match stated {
        Some(sd) if mean.abs() <= NINETY * sd => writeln!(
            text,
            "the mean length is off by {:+.1} %: within the stated error (+- {:.1} %, 90 %)",
            100.0 * mean.exp_m1(),
            100.0 * NINETY * sd,
        ),
        Some(sd) => writeln!(
            text,
            "the mean length is off by {:+.1} %: MORE than the stated error allows (+- {:.1} %, \
             90 %); look at the marks, then add them to the calibration as --lengths",
            100.0 * mean.exp_m1(),
            100.0 * NINETY * sd,
        ),
        None => writeln!(
            text,
            "the mean length is off by {:+.1} %; {} states no error of its own",
            100.0 * mean.exp_m1(),
            calibration.method,
        ),
    };
    Ok(text)
}
