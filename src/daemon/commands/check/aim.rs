//! `verge check --aim`: for whoever turns the camera, how far it is off, each second.
//!
//! Owns the pace and the end. Asks for camera and lane table alone: neither broker nor spool.

use crate::daemon::assemble::{camera, open_line};
use crate::daemon::capture::Source;
use crate::daemon::commands::print;
use crate::daemon::config::Config;
use crate::daemon::exit::Failure;
use crate::daemon::offset::Offset;
use crate::daemon::station::Station;
use std::io::Write;
use std::path::Path;
use std::time::{Duration, Instant};

/// Time between two lines.
const EACH: Duration = Duration::from_secs(1);
/// So many pictures in a row must stand in place: a hand is still at the camera before.
const STEADY: u32 = 10;

/// Prints until the camera has stood in place for [`STEADY`] new pictures.
///
/// # Errors
/// [`Failure`] where configuration, model or table cannot be used, or there is nothing to aim by. A
/// camera that gives no picture is reported and asked again.
pub fn run(path: &Path) -> Result<(), Failure> {
    let mut config = Config::read(path)?;
    let line = open_line(&config)?;
    let is_aimed = line.scene().is_some_and(|scene| scene.is_aimed());
    if !is_aimed {
        return Err(Failure::NothingToAimBy);
    }
    // Pictures as often as they are wanted now.
    config.camera.interval_s = config.camera.interval_s.min(EACH.as_secs_f64());
    let source = Source::open(camera(&config, Some(&line))?)?;
    let mut station = Station::with(source, crate::daemon::frame::Frame::default(), line);
    print(&format!("until the camera has stood in place for {STEADY} pictures, or Ctrl-C:"))?;
    let mut steady = 0;
    while steady < STEADY {
        let begun = Instant::now();
        let said = match station.aim() {
            Ok(None) => "the same picture as before".to_owned(),
            Ok(Some(flaw)) if !flaw.is_empty() => format!("the picture cannot be judged: {flaw}"),
            Ok(Some(_)) => {
                let offset = station.line().scene().and_then(|scene| scene.offset());
                steady = if offset.is_some_and(|o| o.is_in_place()) { steady + 1 } else { 0 };
                Offset::words(offset.as_ref())
            }
            Err(fault) => {
                steady = 0;
                format!("no picture: {fault}")
            }
        };
        let mut out = std::io::stdout();
        // A reader that has gone away has seen enough.
        if writeln!(out, "{said}").and_then(|()| out.flush()).is_err() {
            return Ok(());
        }
        std::thread::sleep(EACH.saturating_sub(begun.elapsed()));
    }
    print("the camera looks where it was calibrated")
}
