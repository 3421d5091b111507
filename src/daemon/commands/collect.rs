//! `verge collect`: pictures of a camera into a folder, as the sensor would take them.
//!
//! Owns how long it goes on, the files' names (the time in UTC, which recordings are read by),
//! and what ends it: a camera that gives no first picture does, later faults are printed and
//! waited out.

use crate::daemon::assemble::camera_at;
use crate::daemon::capture::{Captured, Source, jpeg};
use crate::daemon::clock;
use crate::daemon::exit::Failure;
use crate::daemon::frame::Frame;
use crate::daemon::output::WholeFile;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// Quality of the pictures' JPEG.
const QUALITY: u8 = 95;
/// Longest interval, s: an hour.
const LONGEST_INTERVAL_S: f64 = 3600.0;
/// Longest collection, s: a week.
const LONGEST_S: f64 = 7.0 * 86400.0;

/// Its arguments.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// The camera: http://, mjpeg+http://, rtsp:// (with s for TLS), a device under /dev, or - to
    /// read it from standard input, where no list of processes shows its password
    #[arg(long, value_name = "ADDRESS")]
    camera: String,
    /// Where the pictures go
    #[arg(long, value_name = "DIR")]
    frames: PathBuf,
    /// Time between two pictures, s
    #[arg(long, value_name = "S", default_value = "10", value_parser = interval)]
    interval: Duration,
    /// How long to go on, s
    #[arg(long = "for", value_name = "S", default_value = "300", value_parser = length)]
    length: Duration,
}

fn interval(text: &str) -> Result<Duration, String> {
    seconds(text, 0.1, LONGEST_INTERVAL_S)
}

fn length(text: &str) -> Result<Duration, String> {
    seconds(text, 1.0, LONGEST_S)
}

fn seconds(text: &str, least: f64, most: f64) -> Result<Duration, String> {
    let number = text.parse::<f64>().ok().filter(|s| (least..=most).contains(s));
    number.map(Duration::from_secs_f64).ok_or(format!("give {least} to {most} s"))
}

pub fn run(args: &Args) -> Result<(), Failure> {
    let address = match args.camera.as_str() {
        "-" => std::io::stdin().lines().next().and_then(Result::ok).unwrap_or_default(),
        address => address.to_owned(),
    };
    let failed = |source| Failure::Write { path: args.frames.clone(), source };
    let mut source = Source::open(camera_at(address.trim(), args.interval)?)?;
    std::fs::create_dir_all(&args.frames).map_err(failed)?;
    let (begun, mut frame) = (Instant::now(), Frame::default());
    let (mut next, mut collected) = (begun, 0_usize);
    let (mut unchanged, mut failed, mut said) = (0_usize, 0_usize, String::new());
    while begun.elapsed() <= args.length {
        match source.next(&mut frame) {
            Ok(Captured::New) => {
                said.clear();
                let name = save(&frame, &args.frames)?;
                collected += 1;
                // Whoever began the collection and went away needs no more pictures.
                if writeln!(std::io::stdout(), "{name}").is_err() {
                    return Ok(());
                }
            }
            Ok(Captured::Unchanged) => unchanged += 1,
            Ok(Captured::End) => break,
            Err(fault) if collected == 0 => return Err(fault.into()),
            Err(fault) => {
                failed += 1;
                let fault = fault.to_string();
                if fault != said {
                    eprintln!("verge: {fault}");
                    said = fault;
                }
            }
        }
        next = (next + args.interval).max(Instant::now());
        let end = begun + args.length;
        std::thread::sleep(next.min(end).saturating_duration_since(Instant::now()));
        if next > end {
            break;
        }
    }
    if unchanged + failed > 0 {
        eprintln!(
            "verge: {collected} pictures saved to {} from {} requests; {unchanged} repeated the previous \
             picture, {failed} failed",
            args.frames.display(),
            collected + unchanged + failed
        );
    }
    Ok(())
}

/// Saves a picture under its time; returns the name.
fn save(frame: &Frame, folder: &Path) -> Result<String, Failure> {
    let name = format!("{}.jpg", clock::rfc3339(frame.time).replace(['-', ':'], ""));
    let path = folder.join(&name);
    let bytes = jpeg(&frame.picture, QUALITY)
        .map_err(|error| Failure::Internal(format!("{}: {error}", path.display())))?;
    let mut file = WholeFile::create(&path)?;
    file.bytes(&bytes)?;
    file.finish()?;
    Ok(name)
}
