//! `verge view`: what the sensor sees, on a page of this box that changes nothing.
//!
//! Owns the loop of pictures and the table of addresses. Asks the camera by itself, as `check`
//! does, and only while a page is open: it is a second session at the camera where `verge run`
//! has one, and its counts go nowhere.

use super::check::{folders, withheld};
use super::print;
use crate::daemon::address::masked;
use crate::daemon::assemble::{camera, open_line};
use crate::daemon::capture::jpeg;
use crate::daemon::clock;
use crate::daemon::config::Config;
use crate::daemon::exit::Failure;
use crate::daemon::station::Station;
use crate::daemon::view::{INDEX, Outlines, Seen, Totals, find};
use crate::health::Event;
use serde::Serialize;
use std::path::Path;
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};
use verge_desk::loopback::{Asked, Loopback, Reply};

/// Quality of the pictures that are shown.
const QUALITY: u8 = 85;
/// Time since the page last asked from which on nobody looks.
const AWAY: Duration = Duration::from_secs(10);
/// How often it is seen whether somebody looks.
const TICK: Duration = Duration::from_millis(100);

/// Content of the page now.
#[derive(Debug, Default)]
struct Shown {
    /// Number of the picture; 0 before the first.
    number: u64,
    jpeg: Vec<u8>,
    /// Pixels of the lanes in it.
    lanes: Outlines,
    /// Where the lanes were drawn for.
    lanes_of: Option<([i32; 2], (usize, usize))>,
    time: String,
    seen: Option<Seen>,
    /// Why the latest picture was not measured, or is not there.
    problem: Option<String>,
    totals: Totals,
    measured: u64,
    failed: u64,
    took: Duration,
    asked: Option<Instant>,
}

/// The same for the page.
#[derive(Serialize)]
struct Answer<'a> {
    site: &'a str,
    camera: &'a str,
    source: &'a str,
    interval_s: f64,
    number: u64,
    time: &'a str,
    seen: &'a Option<Seen>,
    problem: &'a Option<String>,
    measured: u64,
    failed: u64,
    took_ms: u128,
}

pub fn run(path: &Path, port: u16) -> Result<(), Failure> {
    folders::become_the_units_user(path);
    let config = Config::read(path)?;
    let line = open_line(&config)?;
    let camera = camera(&config, Some(&line))?;
    let station = Station::open(camera, line)?;
    let loopback = Loopback::bind(port).map_err(Failure::Page)?;
    let shown = Mutex::new(Shown::default());
    print(&loopback.address())?;
    verge_desk::say(
        "open this address in a browser; elsewhere, go through `ssh -L PORT:127.0.0.1:PORT`. The \
         camera is asked a second time beside `verge run`, while the page is open; nothing is \
         published. Ctrl-C ends the view",
    );
    let source = masked(&config.camera.source);
    std::thread::scope(|scope| {
        scope.spawn(|| look(station, config.interval(), &shown));
        loopback.serve(|asked| match asked {
            Asked::Get(path) => get(path, &config, &source, &mut lock(&shown)),
            Asked::Post(..) => Reply::text(405, "the view changes nothing"),
        });
    });
    Ok(())
}

fn lock(shown: &Mutex<Shown>) -> MutexGuard<'_, Shown> {
    shown.lock().unwrap_or_else(PoisonError::into_inner)
}

fn get(path: &str, config: &Config, source: &str, shown: &mut Shown) -> Reply {
    match path {
        "" => Reply::of("text/html; charset=utf-8", INDEX),
        "api/picture.jpg" if shown.number > 0 => Reply::of("image/jpeg", shown.jpeg.clone()),
        "api/lanes" => Reply::json(json(&shown.lanes)),
        "api/seen" => {
            shown.asked = Some(Instant::now());
            Reply::json(json(&Answer {
                site: &config.site.id,
                camera: &config.camera.id,
                source,
                interval_s: config.interval().as_secs_f64(),
                number: shown.number,
                time: &shown.time,
                seen: &shown.seen,
                problem: &shown.problem,
                measured: shown.measured,
                failed: shown.failed,
                took_ms: shown.took.as_millis(),
            }))
        }
        _ => match path.strip_prefix("page/").and_then(find) {
            Some((media, text)) => Reply::of(media, text),
            None => Reply::missing(),
        },
    }
}

fn json(value: &impl Serialize) -> Vec<u8> {
    serde_json::to_vec(value).expect("the view's values are finite numbers and text")
}

/// Takes picture after picture while somebody looks.
fn look(mut station: Station, interval: Duration, shown: &Mutex<Shown>) {
    let mut next = Instant::now();
    loop {
        let is_looked_at = lock(shown).asked.is_some_and(|asked| asked.elapsed() < AWAY);
        if !is_looked_at || Instant::now() < next {
            std::thread::sleep(TICK);
            continue;
        }
        next = Instant::now() + interval;
        let begun = Instant::now();
        match measured(&mut station) {
            Ok(None) => {}
            Ok(Some(problem)) => show(&station, problem, begun.elapsed(), shown),
            Err(failure) => {
                let mut shown = lock(shown);
                shown.failed += 1;
                shown.problem = Some(failure.to_string());
            }
        }
    }
}

/// Takes a picture and measures it: nothing where it is the one before, else what keeps it from
/// being counted.
fn measured(station: &mut Station) -> Result<Option<Option<String>>, Failure> {
    if !station.capture()? {
        return Ok(None);
    }
    let event = station.measure(&mut |_| ())?.event();
    Ok(Some(match event {
        Some(Event::Withheld(alarm)) => Some(withheld(alarm, station.line()).to_string()),
        Some(Event::PassedOver) => {
            Some("this picture shows another scene than the lane table's".to_owned())
        }
        _ => None,
    }))
}

fn show(station: &Station, problem: Option<String>, took: Duration, shown: &Mutex<Shown>) {
    let (frame, line) = (station.frame(), station.line());
    let size = (frame.picture.width, frame.picture.height);
    let encoded = jpeg(&frame.picture, QUALITY);
    let shift = line.preset().shift();
    let place = ([shift.u.round() as i32, shift.v.round() as i32], size);
    let lanes = (lock(shown).lanes_of != Some(place)).then(|| Outlines::of(line.preset(), size, 2));
    let mut shown = lock(shown);
    match encoded {
        Ok(bytes) => shown.jpeg = bytes,
        Err(reason) => shown.problem = Some(reason),
    }
    if let Some(lanes) = lanes {
        (shown.lanes, shown.lanes_of) = (lanes, Some(place));
    }
    shown.number += 1;
    shown.time = clock::rfc3339(frame.time);
    shown.took = took;
    if problem.is_none() {
        shown.seen = Some(Seen::of(line, size, &mut shown.totals));
        shown.measured += 1;
    } else {
        shown.failed += 1;
    }
    shown.problem = problem;
}
