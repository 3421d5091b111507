//! `verge check`: every part of a configuration is tried, one line per check.
//!
//! Two pictures are judged as the running line would judge them. What it would withhold for
//! longer than a moment fails the check, so that nobody leaves a camera that looks elsewhere.

pub mod aim;
pub(super) mod folders;
mod unit;

use crate::alarm::Alarm;
use crate::daemon::address::masked;
use crate::daemon::assemble::{broker, first_picture, open_line};
use crate::daemon::config::Config;
use crate::daemon::exit::Failure;
use crate::daemon::line::Line;
use crate::daemon::offset::Offset;
use crate::daemon::output::WholeFile;
use crate::daemon::publish::{self, payload::status_name};
use crate::daemon::serial::{SerialLine, SerialSettings};
use crate::daemon::station::{Pace, Station, advice};
use crate::health::Event;
use std::borrow::Cow;
use std::path::Path;
use std::time::{Duration, Instant};
use verge_desk::Exit;
use verge_desk::sysexits::{CONFIG, SOFTWARE};

/// Time between the two pictures: by then two of one scene that is not the table's count as
/// a move, and a camera that gives more than one in this time must give another.
const APART: Duration = Duration::from_secs(6);

/// Longest wait for a video's second key picture.
const KEYS: Duration = Duration::from_secs(12);
/// Longest wait for a camera that gives the same picture again and again.
const NEW: Duration = Duration::from_secs(70);
/// Longest interval whose pictures are waited for.
const LONGEST_WATCHED: Duration = Duration::from_secs(30);

/// Bytes that no window's message goes below: of the whole, and of each lane.
const WINDOW_BYTES: (usize, usize) = (400, 400);

/// How long a system that has just started has until all must pass: network, clock and camera
/// come one after the other.
const AFTER_UPDATE: Duration = Duration::from_secs(300);
/// Time between two tries of it.
const AGAIN: Duration = Duration::from_secs(10);

/// `overlay` is a PNG to be written: the picture with what was made of it.
pub fn run(path: &Path, after_update: bool, overlay: Option<&Path>) -> Result<(), Failure> {
    folders::become_the_units_user(path);
    let begun = Instant::now();
    loop {
        let outcome = once(path, overlay);
        // A configuration that is wrong stays so.
        let may_mend = outcome.as_ref().is_err_and(|failure| failure.exit_code() != CONFIG);
        if !after_update || !may_mend || begun.elapsed() + AGAIN > AFTER_UPDATE {
            return outcome;
        }
        say(&format!("again in {} s", AGAIN.as_secs()));
        std::thread::sleep(AGAIN);
    }
}

fn once(path: &Path, overlay: Option<&Path>) -> Result<(), Failure> {
    let mut report = Report::default();
    let Some(config) = report.line("config", Config::read(path), |config| {
        let lengths: Vec<_> = config.windows.lengths_s.iter().map(u64::to_string).collect();
        format!(
            "{}: site {}, windows of {} s, read {}",
            path.display(),
            config.site.id,
            lengths.join(", "),
            folders::who()
        )
    }) else {
        return report.finish();
    };
    let line = open_line(&config);
    let lanes = line.as_ref().map_or(1, |line| line.preset().table().lanes.len());
    let size = WINDOW_BYTES.0 + lanes * WINDOW_BYTES.1;
    let mut line = report.line("model and table", line, |line| {
        let (model, table) = line.describe();
        format!("{model}; {table}")
    });
    if let Some(line) = &mut line {
        report.line("net", line.describe_net(), String::clone);
        report.line("traffic", Ok::<_, Failure>(line.following()), |following| {
            let needs = line.needs(config.traffic.top_speed_kmh);
            if config.traffic.enabled {
                format!("{following} ({needs})")
            } else {
                following.to_string()
            }
        });
    }
    let picture = first_picture(&config, line.as_ref()).and_then(|(source, frame)| {
        source.settle(KEYS);
        match source.slow_keys() {
            Some(keys) => Err(Failure::Pace(advice(keys, source.interval()))),
            None => Ok((source, frame)),
        }
    });
    let picture = report.line("camera", picture, |(source, frame)| {
        let (width, height) = (frame.picture.width, frame.picture.height);
        let video = source.video().map_or(String::new(), |video| format!("; {video}"));
        format!("{}: {width}x{height} px{video}", masked(&config.camera.source))
    });
    if let (Some(line), Some((source, frame))) = (line, picture) {
        let mut station = Station::with(source, frame, line);
        let measured = measure(&mut station, config.interval());
        let withheld = match &measured {
            Err(Failure::Withheld { reason, .. }) => reason,
            _ => "",
        };
        let drawn = overlay.map(|file| draw(&station, withheld, file));
        report.line("measurement", measured, String::clone);
        if let Some(drawn) = drawn {
            report.line("overlay", drawn, String::clone);
        }
    }
    let sandbox = folders::sandbox(path);
    if let Some(sandbox) = &sandbox {
        report.line("unit", folders::seen(&config, sandbox), String::clone);
    }
    report.line("spool", folders::spool(&config, sandbox.as_ref()), String::clone);
    if let Some(metrics) = folders::metrics(&config, sandbox.as_ref()) {
        report.line("metrics", metrics, String::clone);
    }
    if let Some(SerialSettings { device, baud, .. }) = config.serial_settings() {
        let opened = SerialLine::open(&device, baud)
            .map_err(|source| Failure::Serial { device: device.clone(), source });
        report.line("serial", opened, |_| format!("{} opens at {baud} baud", device.display()));
    }
    let connected = broker(&config).and_then(|settings| {
        publish::probe(&settings, &config.window_lengths(), size).map_err(|reason| {
            Failure::Broker { host: settings.host.clone(), port: settings.port, reason }
        })
    });
    report.line("broker", connected, |said| {
        let (host, port) = (&config.mqtt.host, config.mqtt.port);
        format!("{host}:{port}, topics under {}: {said}", config.root_topic())
    });
    report.finish()
}

/// Measures the picture that was taken and another one, and describes what was seen.
fn measure(station: &mut Station, interval: Duration) -> Result<String, Failure> {
    let measured = |station: &mut Station| station.measure(&mut |_| ()).map(|o| o.event());
    let first = measured(station)?;
    let (mut found, mut located) = station.line().latest();
    std::thread::sleep(APART);
    let is_new = station.capture()?;
    if let Some(advice) = station.slow_answers(1) {
        return Err(Failure::Pace(advice));
    }
    let mut second = if is_new { measured(station)? } else { Some(Event::Unchanged) };
    // By chance the one new picture in half a minute may have come just then.
    if is_new && station.may_stand_still() && interval <= LONGEST_WATCHED {
        std::thread::sleep(interval.mul_f64(1.5).max(Duration::from_secs(1)));
        if !station.capture()? {
            second = Some(Event::Unchanged);
        }
    }
    let event = match second {
        // A camera may give the same picture until its next is due.
        Some(Event::Unchanged) if interval > LONGEST_WATCHED => first,
        Some(Event::Unchanged) => match station.watch_pace(interval, NEW)? {
            Pace::Still => second,
            Pace::Slow(advice) => return Err(Failure::Pace(advice)),
            Pace::Even => first,
        },
        second => second,
    };
    if second == Some(Event::Measured) {
        (found, located) = station.line().latest();
    }
    let aim = station.line().scene().map_or("not checked", |scene| scene.aiming().name());
    match event {
        Some(Event::Withheld(alarm)) => Err(withheld(alarm, station.line())),
        Some(Event::PassedOver) => Err(withheld(Alarm::CameraMoved, station.line())),
        Some(Event::Unchanged) => Err(withheld(Alarm::FrozenPicture, station.line())),
        Some(Event::Measured | Event::Damaged | Event::Missing) | None => Ok(format!(
            "{found} vehicles found, {located} of them in the lanes; the camera's aim: {aim}"
        )),
    }
}

/// Draws the latest picture into `file`.
fn draw(station: &Station, withheld: &str, file: &Path) -> Result<String, Failure> {
    let drawn = station.line().overlay(station.frame(), withheld)?;
    let mut whole = WholeFile::create(file)?;
    whole.bytes(&drawn)?;
    whole.finish()?;
    Ok(format!("{}: lanes, boxes, contact points and counts", file.display()))
}

/// The failure for a picture that the running line would withhold.
pub(super) fn withheld(alarm: Alarm, line: &Line) -> Failure {
    let hint = match alarm {
        Alarm::CameraMoved => {
            let offset = line.scene().and_then(|scene| scene.offset());
            return Failure::Withheld {
                reason: alarm.name(),
                status: status_name(alarm.status()),
                hint: Cow::Owned(format!(
                    "{}. Turn the camera back (`verge check --aim` prints each second how far it is \
                     off), or make a lane table for where it looks now",
                    Offset::words(offset.as_ref())
                )),
            };
        }
        Alarm::FrozenPicture => "the camera gives the same picture again",
        Alarm::BlankPicture => {
            "it is black or of one colour: is the lens covered, is there a signal?"
        }
        Alarm::BlindedPicture => "sun, headlights or fog: try again in other light",
        Alarm::BlurredPicture => "nothing in it is sharp: clean the lens, or focus it",
        Alarm::NoPicture => "there is none",
        Alarm::Overheated => "the enclosure is too hot: shade it, air it",
        Alarm::BoardFault => "a part of the board fails",
        Alarm::CertificateExpires => "a certificate ends soon: renew it",
    };
    let (reason, status) = (alarm.name(), status_name(alarm.status()));
    Failure::Withheld { reason, status, hint: Cow::Borrowed(hint) }
}

/// Prints a line. Who no longer reads (`| head`) still gets the exit code.
fn say(line: &str) {
    let _ = verge_desk::print(&format!("{line}\n"));
}

#[derive(Default)]
struct Report {
    checks: usize,
    failed: usize,
    code: Option<u8>,
}

impl Report {
    /// Prints one check and passes its value on.
    fn line<T, E: Into<Failure>>(
        &mut self,
        name: &str,
        outcome: Result<T, E>,
        describe: impl FnOnce(&T) -> String,
    ) -> Option<T> {
        self.checks += 1;
        match outcome.map_err(Into::into) {
            Ok(value) => {
                say(&format!("ok    {name}: {}", describe(&value)));
                Some(value)
            }
            Err(failure) => {
                say(&format!("FAIL  {name}: {failure}"));
                self.failed += 1;
                self.code.get_or_insert(failure.exit_code());
                None
            }
        }
    }

    fn finish(self) -> Result<(), Failure> {
        let Self { checks, failed, code } = self;
        if failed == 0 {
            return Ok(());
        }
        Err(Failure::Checks { failed, checks, code: code.unwrap_or(SOFTWARE) })
    }
}
