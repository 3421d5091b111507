//! A new configuration beside the running one: loaded, checked, and kept until it takes over.
//!
//! Owns when files are read again, what cannot change while the daemon runs, and the instant
//! of the change. Everything is loaded in a thread of its own while the line goes on
//! measuring, and nothing of the running line is touched before all of it is right.
//!
//! The change comes at the next instant at which all windows end together, by the clock:
//! every window is whole, measured by the old configuration or by the new one. Where each
//! length divides the longest, that is the end of the longest running window.

use super::assemble::Assembly;
use super::config::{Config, ConfigError};
use super::exit::Failure;
use crate::units::UtcMs;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{self, Receiver, TryRecvError};
use std::time::Duration;

/// All that a configuration asks for, loaded and checked.
pub struct Candidate {
    pub config: Config,
    pub assembly: Assembly,
}

impl Candidate {
    /// Loads what stands in the file, to take over from `running`.
    ///
    /// # Errors
    /// [`Failure`] says what cannot be used, or cannot change while the daemon runs.
    pub fn load(path: &Path, running: &Config) -> Result<Self, Failure> {
        let config = Config::read(path)?;
        check_fixed(path, running, &config)?;
        let assembly = Assembly::of(&config)?;
        Ok(Self { config, assembly })
    }
}

/// What has a state that a new configuration cannot take along.
fn check_fixed(path: &Path, running: &Config, new: &Config) -> Result<(), ConfigError> {
    let spools = [running, new].map(|config| config.spool_folder().display().to_string());
    let topics = [running, new].map(Config::root_topic);
    let sites = [running, new].map(|config| config.site.clone());
    for (key, [is, asked], reason) in [
        ("spool.folder", spools, "windows that wait lie there"),
        ("site", sites, "windows that wait carry it"),
        ("mqtt.root", topics, "presence, alarms and the numbers of windows stand under it"),
    ] {
        if is != asked {
            let reason = format!(
                "{asked:?} cannot replace {is:?} while verge runs, for {reason}: restart verge"
            );
            return Err(ConfigError::Value { path: path.to_owned(), key, reason });
        }
    }
    Ok(())
}

/// What has become of a request to read the configuration again.
pub enum Outcome {
    /// It is being loaded.
    Begun,
    /// It can take over.
    Loaded(Box<Candidate>),
    /// It cannot.
    Refused(Failure),
}

/// Reads the configuration again when it is asked to.
pub struct Reload {
    path: PathBuf,
    asked: Arc<AtomicBool>,
    loading: Option<Receiver<Result<Candidate, Failure>>>,
}

impl Reload {
    /// Reads `path` when `asked` is set.
    pub fn new(path: &Path, asked: Arc<AtomicBool>) -> Self {
        Self { path: path.to_owned(), asked, loading: None }
    }

    /// What has happened since it was asked last; to be called a few times a second. However
    /// often a new configuration was asked for while one was loaded: the files are read once
    /// more, and what was loaded before counts no longer.
    pub fn outcome(&mut self, running: &Config) -> Option<Outcome> {
        let loaded = match self.loading.as_ref().map(Receiver::try_recv) {
            Some(Err(TryRecvError::Empty)) => return None,
            Some(Err(TryRecvError::Disconnected)) => Some(Err(Failure::Stage(
                "loading the configuration panicked; the message stands above".to_owned(),
            ))),
            Some(Ok(loaded)) => Some(loaded),
            None => None,
        };
        self.loading = None;
        if self.asked.swap(false, Ordering::Relaxed) {
            return Some(self.begin(running.clone()));
        }
        Some(match loaded? {
            Ok(candidate) => Outcome::Loaded(Box::new(candidate)),
            Err(failure) => Outcome::Refused(failure),
        })
    }

    fn begin(&mut self, running: Config) -> Outcome {
        let (sender, receiver) = mpsc::channel();
        let path = self.path.clone();
        log::info!("reading {} again", path.display());
        let thread = std::thread::Builder::new().name("reload".into()).spawn(move || {
            // Nobody waits for it when the daemon stops.
            let _ = sender.send(Candidate::load(&path, &running));
        });
        match thread {
            Ok(_) => {
                self.loading = Some(receiver);
                Outcome::Begun
            }
            Err(error) => Outcome::Refused(Failure::Internal(format!("no thread: {error}"))),
        }
    }
}

/// A candidate that waits for the running windows to end.
pub struct Pending {
    candidate: Box<Candidate>,
    /// All running windows end at its multiples.
    period: Duration,
    at: UtcMs,
}

impl Pending {
    /// Takes over from `running` at the next end of all its windows.
    pub fn new(candidate: Box<Candidate>, running: &Config, now: UtcMs) -> Self {
        let period = common_period(&running.windows.lengths_s);
        Self { candidate, period, at: now.floor_to(period).saturating_add(period) }
    }

    /// When it takes over.
    pub fn at(&self) -> UtcMs {
        self.at
    }

    /// Whether it takes over at `time`.
    pub fn is_due(&mut self, time: UtcMs) -> bool {
        let latest = time.floor_to(self.period).saturating_add(self.period);
        if self.at > latest {
            // The clock was set back.
            self.at = latest;
        }
        if time < self.at {
            return false;
        }
        // It may have been set forward, too.
        self.at = self.at.max(time.floor_to(self.period));
        true
    }

    /// The candidate, and the instant from which on its windows run.
    pub fn begin(self) -> (Box<Candidate>, UtcMs) {
        (self.candidate, self.at)
    }
}

/// The least common multiple of the windows' lengths. Each divides a day, and so does it.
fn common_period(lengths_s: &[u64]) -> Duration {
    let gcd = |mut a: u64, mut b: u64| {
        while b != 0 {
            (a, b) = (b, a % b);
        }
        a
    };
    Duration::from_secs(lengths_s.iter().fold(1, |lcm, &s| lcm / gcd(lcm, s).max(1) * s.max(1)))
}

#[cfg(test)]
mod tests;
