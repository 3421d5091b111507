//! The empty road onto the disk, now and then and at the end.
//!
//! Owns when it is written, and the thread that does it: a card may take seconds.
//! `road_file` has the file.

use crate::daemon::clock;
use crate::daemon::line::Line;
use std::path::PathBuf;
use std::thread::JoinHandle;
use std::time::Duration;

/// Time between two writings: what is lost in a power cut, against 15 MB a day on the card.
const EACH: Duration = Duration::from_secs(3600);

/// Keeps the road.
pub(super) struct Keeper {
    file: PathBuf,
    due: Duration,
    writing: Option<JoinHandle<()>>,
}

impl Keeper {
    /// Keeps it in `file`.
    pub(super) fn new(file: PathBuf) -> Self {
        Self { file, due: EACH, writing: None }
    }

    /// Writes it where an hour has passed; to be called a few times a second.
    pub(super) fn tend(&mut self, line: &Line, since_start: Duration) {
        if since_start >= self.due && self.writing.as_ref().is_none_or(JoinHandle::is_finished) {
            self.due = since_start.saturating_add(EACH);
            self.begin(line);
        }
    }

    /// Writes it, and waits until it is on the disk.
    pub(super) fn finish(&mut self, line: &Line) {
        self.wait();
        self.begin(line);
        self.wait();
    }

    fn wait(&mut self) {
        // A panic of the thread was printed; the road is learned again.
        let _ = self.writing.take().map(JoinHandle::join);
    }

    fn begin(&mut self, line: &Line) {
        let Some((camera, road)) = line.road() else { return };
        let file = self.file.clone();
        let write = move || {
            if let Err(failure) = road.write(&file, &camera, clock::now()) {
                log::warn!("the empty road is not kept: {failure}");
            }
        };
        self.writing = std::thread::Builder::new().name("road".into()).spawn(write).ok();
    }
}
