//! `verge run`: measures and publishes until it is stopped.
//!
//! Owns the loop and the signals; `running` does the work of a turn.

use crate::daemon::assemble::Assembly;
use crate::daemon::board::Driven;
use crate::daemon::config::Config;
use crate::daemon::exit::Failure;
use crate::daemon::notify::Notify;
use crate::daemon::reload::{Outcome, Reload};
use crate::daemon::running::{Publishing, Running};
use crate::hal::{Board, Switch, Thermometer, Watchdog};
use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// Longest sleep of the loop: windows close, lamps blink, stops and reloads are heard this
/// late.
const TICK: Duration = Duration::from_millis(250);

pub fn run<L, R, W, T>(config: &Path, board: Board<L, R, W, T>) -> Result<(), Failure>
where
    L: Switch,
    R: Switch,
    W: Watchdog,
    T: Thermometer,
{
    let stop = flag(&[SIGTERM, SIGINT])?;
    let mut reload = Reload::new(config, flag(&[SIGHUP])?);
    let config = Config::read(config)?;
    let mut notify = Notify::from_environment();
    let mut board = Driven::new(board);
    let opened = Assembly::of(&config)?.open(&config)?;
    log::info!("site {}: measuring every {} s", config.site.id, config.camera.interval_s);
    let mut running = Running::new(config, opened);
    let (mut next, mut ready) = (Instant::now(), false);
    let mut outcome = Ok(());
    while outcome.is_ok() && !stop.load(Ordering::Relaxed) {
        match reload.outcome(running.config()) {
            Some(Outcome::Begun) => notify.reloading(),
            Some(Outcome::Loaded(candidate)) => {
                running.prepare(candidate);
                notify.status(&running.describe());
                notify.ready();
            }
            Some(Outcome::Refused(failure)) => {
                running.refuse(&failure);
                notify.status(&running.describe());
                notify.ready();
            }
            None => {}
        }
        running.set_pace(board.pace(running.since_start()));
        // A new configuration may ask for pictures more often.
        next = next.min(Instant::now() + running.interval());
        if Instant::now() >= next {
            outcome = running.turn();
            next = (next + running.interval()).max(Instant::now());
        }
        let actions = running.settle(&board);
        let now = running.since_start();
        board.drive(actions, now);
        notify.status(&running.describe());
        if !ready {
            notify.ready();
            ready = true;
        }
        // The end of the line: a stage that hangs is never followed by these.
        match running.publishing() {
            Publishing::Turning => {
                notify.alive();
                board.feed(now);
            }
            Publishing::Stalled => {}
            Publishing::Lost => {
                // Nothing is waited for: what has not arrived is on the disk.
                return Err(Failure::Internal(
                    "the publishing thread has ended or hangs; the next start delivers what waits"
                        .to_owned(),
                ));
            }
        }
        std::thread::sleep(next.saturating_duration_since(Instant::now()).min(TICK));
    }
    log::info!("stopping");
    notify.stopping();
    running.stop();
    if outcome.is_ok() {
        board.stop();
    }
    outcome
}

/// Set by each of these signals.
fn flag(signals: &[i32]) -> Result<Arc<AtomicBool>, Failure> {
    let flag = Arc::new(AtomicBool::new(false));
    for &signal in signals {
        signal_hook::flag::register(signal, Arc::clone(&flag))
            .map_err(|error| Failure::Internal(format!("signals cannot be heard: {error}")))?;
    }
    Ok(flag)
}
