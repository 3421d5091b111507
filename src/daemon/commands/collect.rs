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
use verge_desk::sysexits::USAGE;
use verge_desk::{Exit, say};

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
    let camera = camera_at(address.trim(), args.interval).map_err(reworded)?;
    let mut source = Source::open(camera)?;
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
            Err(fault) if collected == 0 => return Err(reworded(fault.into())),
            Err(fault) => {
                failed += 1;
                let fault = without_keys(&fault.to_string());
                if fault != said {
                    say(&format!("verge: {fault}"));
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
        say(&format!(
            "verge: {collected} pictures saved to {} from {} requests; {unchanged} repeated the previous \
             picture, {failed} failed",
            args.frames.display(),
            collected + unchanged + failed
        ));
    }
    Ok(())
}

/// Keys of a configuration in what cameras and addresses have wrong, and what stands for them where
/// there is none.
const WITHOUT_KEYS: [(&str, &str); 7] = [
    (
        "go into camera.user and camera.password_file, or, in the address, with",
        "stand in front of the host (user:password@host), with",
    ),
    (", or use camera.user and camera.password_file", ""),
    (
        "set camera.user and camera.password_file",
        "write it into the address, as user:password@ in front of the host",
    ),
    ("check camera.user and camera.password_file", "check user:password@ in the address"),
    (", or allow the host in camera.redirect_hosts", ""),
    ("camera.interval_s", "--interval"),
    (
        "write it into camera.fingerprint, or save the certificate and name it in camera.ca_file",
        "`verge run` takes it (fingerprint or ca_file under [camera]); collect by an address without \
         TLS",
    ),
];

/// A fault in words without keys of a configuration.
fn without_keys(fault: &str) -> String {
    WITHOUT_KEYS.iter().fold(fault.to_owned(), |text, (key, plain)| text.replace(key, plain))
}

fn reworded(failure: Failure) -> Failure {
    let code = match &failure {
        // The address is an argument.
        Failure::Config(_) => USAGE,
        other => other.exit_code(),
    };
    Failure::Reworded { reason: without_keys(&failure.to_string()), code }
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::daemon::address::AddressError;
    use crate::daemon::capture::Fault;

    #[test]
    fn no_fault_names_a_key_that_the_command_does_not_have() {
        let status = |status| Fault::Status { protocol: "HTTP", status };
        for fault in [
            Fault::LoginWanted,
            Fault::LoginRefused { user: "box".into() },
            Fault::RedirectedAway { host: "elsewhere".into() },
            status(401),
            status(403),
            status(429),
        ] {
            let said = without_keys(&fault.to_string());
            assert!(!said.contains("camera."), "{said}");
        }
        for error in [AddressError::Port, AddressError::Fragment] {
            let said = without_keys(&error.to_string());
            assert!(!said.contains("camera.") && said.contains("%23"), "{said}");
        }
    }
}
