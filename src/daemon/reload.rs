//! A new configuration beside the running one: loaded and checked.
//!
//! Owns when files are read again, and what cannot change while the daemon runs. Everything is
//! loaded in a thread of its own while the line goes on measuring, and nothing of the running
//! line is touched before all of it is right. When it takes over is decided by
//! [`crate::sensor`].

use super::assemble::Assembly;
use super::config::{Config, ConfigError};
use super::exit::Failure;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{self, Receiver, TryRecvError};
use std::time::{Duration, Instant};

/// All that a configuration asks for, loaded and checked.
pub struct Candidate {
    pub config: Config,
    pub assembly: Assembly,
}

impl Candidate {
    /// Loads the file, to take over from `running`.
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

/// Refuses changes of keys whose state cannot move to a new configuration.
fn check_fixed(path: &Path, running: &Config, new: &Config) -> Result<(), ConfigError> {
    let spools = [running, new].map(|config| config.spool_folder().display().to_string());
    let topics = [running, new].map(Config::root_topic);
    let sites = [running, new].map(|config| config.site.id.clone());
    for (key, [is, asked], reason) in [
        ("spool.folder", spools, "windows that wait lie there"),
        ("site", sites, "windows that wait carry it"),
        ("mqtt.root", topics, "presence, alarms and the numbers of windows stand under it"),
    ] {
        if is != asked {
            let reason = format!(
                "\"{asked}\" cannot replace \"{is}\" while verge runs, for {reason}: restart verge"
            );
            return Err(ConfigError::Value { path: path.to_owned(), line: None, key, reason });
        }
    }
    Ok(())
}

/// Progress of a request to read the configuration again.
pub enum Outcome {
    /// It is being loaded.
    Begun,
    /// It can take over.
    Loaded(Box<Candidate>),
    /// It cannot.
    Refused(Failure),
}

/// A thread that reads, and since when.
struct Loading {
    outcome: Receiver<Result<Candidate, Failure>>,
    since: Instant,
}

/// Longest time that reading may take: a model is planned in seconds. Then the thread is left
/// behind: a file of it may be a device, or a share that is away.
const LONGEST: Duration = Duration::from_secs(300);

/// Reads the configuration again when it is asked to.
pub struct Reload {
    path: PathBuf,
    asked: Arc<AtomicBool>,
    loading: Option<Loading>,
}

impl Reload {
    /// Reads `path` when `asked` is set.
    pub fn new(path: &Path, asked: Arc<AtomicBool>) -> Self {
        Self { path: path.to_owned(), asked, loading: None }
    }

    /// The news since the last call; call it a few times a second. Requests that came while a
    /// configuration was being loaded are merged: the files are read once more, and the result of
    /// the earlier load is dropped.
    pub fn outcome(&mut self, running: &Config) -> Option<Outcome> {
        let loaded = match self.loading.as_ref().map(|loading| loading.outcome.try_recv()) {
            Some(Err(TryRecvError::Empty)) if !self.is_late() => return None,
            Some(Err(TryRecvError::Empty)) => Some(Err(Failure::Internal(format!(
                "reading it has taken {} s: is one of its files a device, or on a share that is away?",
                LONGEST.as_secs()
            )))),
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

    fn is_late(&self) -> bool {
        self.loading.as_ref().is_some_and(|loading| loading.since.elapsed() > LONGEST)
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
                self.loading = Some(Loading { outcome: receiver, since: Instant::now() });
                Outcome::Begun
            }
            Err(error) => Outcome::Refused(Failure::Internal(format!("no thread: {error}"))),
        }
    }
}

#[cfg(test)]
mod tests;
