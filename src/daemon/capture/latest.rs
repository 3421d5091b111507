//! The latest picture of a stream, between the thread that reads it and the line.
//!
//! Owns the slot that both share, what counts as fresh, and how a stream is left.

use super::network::Fault;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

/// Shared by the thread and the line: the latest picture, or why there is none.
#[derive(Debug, Default)]
pub struct Latest<T> {
    slot: Mutex<Slot<T>>,
    changed: Condvar,
    left: AtomicBool,
}

#[derive(Debug, Default)]
struct Slot<T> {
    picture: T,
    arrived: Option<Instant>,
    ended: Option<Fault>,
}

impl<T> Latest<T> {
    fn slot(&self) -> MutexGuard<'_, Slot<T>> {
        self.slot.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Puts a picture in, and takes the older one's buffer out.
    pub fn put(&self, picture: &mut T) {
        let mut slot = self.slot();
        std::mem::swap(&mut slot.picture, picture);
        slot.arrived = Some(Instant::now());
        self.changed.notify_one();
    }

    /// Whether nobody waits for pictures any more.
    pub fn is_left(&self) -> bool {
        self.left.load(Ordering::Relaxed)
    }
}

/// The thread that reads one stream to its end.
#[derive(Debug)]
pub struct Worker<T> {
    latest: Arc<Latest<T>>,
    /// `None`: there was none to be had.
    thread: Option<JoinHandle<()>>,
}

impl<T: Default + Send + 'static> Worker<T> {
    /// Starts a thread that `read`s a stream and says how it ended.
    pub fn start(name: &str, read: impl FnOnce(&Latest<T>) -> Fault + Send + 'static) -> Self {
        let latest = Arc::<Latest<T>>::default();
        let theirs = Arc::clone(&latest);
        let thread = thread::Builder::new().name(name.to_owned()).spawn(move || {
            let fault = read(&theirs);
            theirs.slot().ended = Some(fault);
            theirs.changed.notify_one();
        });
        let thread = match thread {
            Ok(thread) => Some(thread),
            Err(error) => {
                latest.slot().ended = Some(Fault::Broken(format!("no thread for it: {error}")));
                None
            }
        };
        Self { latest, thread }
    }

    /// Whether the stream was left.
    pub fn is_left(&self) -> bool {
        self.latest.is_left()
    }

    /// Whether its thread has ended.
    pub fn is_finished(&self) -> bool {
        self.thread.as_ref().is_none_or(JoinHandle::is_finished)
    }

    /// Lets the thread end.
    pub fn leave(&self) {
        self.latest.left.store(true, Ordering::Relaxed);
    }

    /// Takes the latest picture, and waits for one where there is none that is `fresh`: younger
    /// than this.
    ///
    /// # Errors
    /// Why the stream ended, or [`Fault::Timeout`].
    pub fn take(&self, timeout: Duration, fresh: Duration, picture: &mut T) -> Result<(), Fault> {
        let begun = Instant::now();
        let mut slot = self.latest.slot();
        loop {
            if slot.arrived.is_some_and(|arrived| arrived.elapsed() < fresh) {
                slot.arrived = None;
                std::mem::swap(picture, &mut slot.picture);
                return Ok(());
            }
            if let Some(fault) = slot.ended.take() {
                return Err(fault);
            }
            let Some(rest) = timeout.checked_sub(begun.elapsed()) else {
                return Err(Fault::Timeout { what: "picture", waited: timeout });
            };
            let waited = self.latest.changed.wait_timeout(slot, rest);
            slot = waited.unwrap_or_else(PoisonError::into_inner).0;
        }
    }
}

impl<T> Drop for Worker<T> {
    fn drop(&mut self) {
        self.latest.left.store(true, Ordering::Relaxed);
    }
}
