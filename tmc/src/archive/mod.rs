//! `verge-tmc archive`: from the broker into Parquet, each window exactly once.
//!
//! Owns the command and its order of work: a message that the `door` lets in is acknowledged
//! when the journal has it on the disk, and compaction moves the journal into the archive in a
//! thread of its own. `journal` and `compact` are the two halves of the disk, `merge` and `events` what
//! goes into which table, `aside` keeps what is refused.

mod aside;
pub mod compact;
mod door;
mod events;
mod gaps;
pub mod journal;
mod merge;
mod rows;

use crate::broker::{Arrived, BrokerArguments, Settings, Subscriber};
use crate::failure::Failure;
use aside::Aside;
use compact::Done;
use door::{Door, Verdict};
use gaps::Gap;
use journal::{Journal, SEGMENT_BYTES};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};
use verge_messages::Utc;

/// Arguments of `archive`.
#[derive(clap::Args, Debug)]
pub struct Arguments {
    #[command(flatten)]
    broker: BrokerArguments,
    /// Group of archivers that share the load; empty: this one takes everything.
    #[arg(long, default_value = "archive")]
    group: String,
    /// Name of this archiver, each its own: its session at the broker and its journal.
    #[arg(long, default_value = "verge-tmc-1")]
    name: String,
    /// Folder of the archive.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Windows that began longer ago are refused.
    #[arg(long, value_name = "DAYS", default_value_t = 92)]
    oldest: u64,
    /// Seconds between two compactions.
    #[arg(long, value_name = "S", default_value_t = 300)]
    compact_every: u64,
    /// End when nothing has come for so many seconds (else at SIGTERM or SIGINT).
    #[arg(long, value_name = "S")]
    until_idle: Option<u64>,
}

/// Longest wait for messages before the clock is looked at.
const TICK: Duration = Duration::from_millis(100);

/// Runs `archive`.
///
/// # Errors
/// [`Failure`]: no broker at the start, a disk that does not take what arrives.
pub fn run(arguments: &Arguments) -> Result<(), Failure> {
    let stop = Arc::new(AtomicBool::new(false));
    for signal in [signal_hook::consts::SIGTERM, signal_hook::consts::SIGINT] {
        // Registering fails for signals that cannot be caught; these can.
        let _ = signal_hook::flag::register(signal, Arc::clone(&stop));
    }
    let plain = |name: &str| name.bytes().all(|b| b.is_ascii_alphanumeric() || b"-_.".contains(&b));
    if arguments.name.is_empty() || !plain(&arguments.name) || !plain(&arguments.group) {
        let hint = "--name and --group are made of letters, digits, '-', '_' and '.'";
        return Err(Failure::usage(hint));
    }
    Archiver::open(arguments)?.run(arguments, &stop)
}

/// The journals and what works on them.
struct Archiver {
    out: PathBuf,
    name: String,
    door: Door,
    aside: Aside,
    /// Messages for the next compaction.
    journal: Journal,
    /// Messages for later ones, a segment at a time.
    later: Journal,
    compactor: Compactor,
}

impl Archiver {
    fn open(arguments: &Arguments) -> Result<Self, Failure> {
        let (out, name) = (arguments.out.clone(), arguments.name.clone());
        let folder = out.join("_journal").join(&name);
        Ok(Self {
            door: Door::new(
                &arguments.broker.root,
                Duration::from_secs(arguments.oldest.saturating_mul(86_400)),
            ),
            aside: Aside::open(&out, &name)?,
            journal: Journal::open(&folder)?,
            later: Journal::open(&folder.join("later"))?,
            compactor: Compactor::default(),
            out,
            name,
        })
    }

    fn run(&mut self, arguments: &Arguments, stop: &AtomicBool) -> Result<(), Failure> {
        self.compact(false)?;
        let mut subscriber = Subscriber::connect(settings(arguments)?)?;
        let every = Duration::from_secs(arguments.compact_every.max(1));
        let idle = arguments.until_idle.map(Duration::from_secs);
        let (mut compacted, mut heard) = (Instant::now(), Instant::now());
        let (mut taken, mut first) = (0, None);
        while !stop.load(Ordering::Relaxed) && idle.is_none_or(|idle| heard.elapsed() < idle) {
            let messages = subscriber.receive(TICK);
            if !messages.is_empty() {
                first.get_or_insert_with(Instant::now);
                self.take(&messages)?;
                subscriber.acknowledge(&messages);
                heard = Instant::now();
                taken += messages.len();
            }
            if compacted.elapsed() > every && self.compactor.is_idle() {
                compacted = Instant::now();
                self.compact(false)?;
            }
        }
        subscriber.leave();
        // Messages that waited for others have none to wait for now.
        self.compact(false)?;
        self.compact(true)?;
        self.compactor.wait()?;
        let seconds = first.map_or(0.0, |first| heard.duration_since(first).as_secs_f64());
        eprintln!("verge-tmc: {taken} messages taken, the last {seconds:.1} s after the first");
        Ok(())
    }

    /// Brings messages to the disk, each where it belongs.
    fn take(&mut self, messages: &[Arrived]) -> Result<(), Failure> {
        let now = (now(), Instant::now());
        let (mut soon, mut later) = (Vec::new(), Vec::new());
        for message in messages {
            let payload = &message.payload[..];
            match self.door.judge((&message.topic, payload), now, &mut self.aside) {
                Verdict::Soon => soon.push(payload),
                Verdict::Later => later.push(payload),
                Verdict::Refused | Verdict::Empty => {}
            }
        }
        for (journal, payloads) in [(&mut self.journal, soon), (&mut self.later, later)] {
            if !payloads.is_empty() {
                journal.append(payloads.into_iter())?;
            }
            if journal.written() > SEGMENT_BYTES {
                journal.close_segment();
            }
        }
        Ok(())
    }

    /// Archives what is closed: the journal, and of the later one the oldest segment or, at the
    /// end, all.
    fn compact(&mut self, all: bool) -> Result<(), Failure> {
        self.compactor.wait()?;
        for line in self.aside.tell()? {
            eprintln!("verge-tmc: {line}");
        }
        self.journal.close_segment();
        self.later.close_segment();
        let soon = self.journal.closed()?;
        let mut later = self.later.closed()?;
        if later.is_empty() {
            self.door.later_is_done();
        }
        later.truncate(if all { later.len() } else { 1 });
        let mut segments = Journal::open(&compact::failed(&self.out, &self.name))?.closed()?;
        segments.extend(soon);
        self.compactor.begin(&self.out, &self.name, segments, later)
    }
}

/// The time, for times in messages.
fn now() -> Utc {
    Utc(jiff::Timestamp::now().as_millisecond())
}

/// Settings of this archiver's session with the broker.
fn settings(arguments: &Arguments) -> Result<Settings, Failure> {
    let shared = if arguments.group.is_empty() {
        String::new()
    } else {
        format!("$share/{}/", arguments.group)
    };
    let root = &arguments.broker.root;
    let filters = ["density/+", "replay/density/+", "health", "alarm/+"]
        .map(|kind| format!("{shared}{root}/+/{kind}"));
    arguments.broker.settings(&arguments.name, filters.to_vec(), true)
}

/// The thread that compacts, one run at a time.
#[derive(Default)]
struct Compactor {
    running: Option<JoinHandle<()>>,
}

impl Compactor {
    fn is_idle(&self) -> bool {
        self.running.as_ref().is_none_or(JoinHandle::is_finished)
    }

    /// Compacts segments: first all of the one journal, then those of the other.
    fn begin(
        &mut self,
        root: &Path,
        name: &str,
        soon: Vec<PathBuf>,
        later: Vec<PathBuf>,
    ) -> Result<(), Failure> {
        if soon.is_empty() && later.is_empty() {
            return Ok(());
        }
        let (root, name) = (root.to_owned(), name.to_owned());
        let work = move || {
            for (which, segments) in [("", soon), ("later ones: ", later)] {
                if segments.is_empty() {
                    continue;
                }
                match compact::compact(&root, &name, &segments) {
                    Ok(done) => say(which, &done),
                    // The segments stay; the next run takes them up again.
                    Err(failure) => {
                        eprintln!("verge-tmc: compaction failed, tried again later: {failure}");
                    }
                }
            }
        };
        let thread = std::thread::Builder::new().name("compact".into()).spawn(work);
        let failed = |source| verge_desk::Failure::writing(Path::new("a thread"), source);
        self.running = Some(thread.map_err(failed)?);
        Ok(())
    }

    fn wait(&mut self) -> Result<(), Failure> {
        match self.running.take().map(JoinHandle::join) {
            None | Some(Ok(())) => Ok(()),
            Some(Err(_)) => {
                let fault = std::io::Error::other("compaction panicked");
                Err(verge_desk::Failure::Print(fault).into())
            }
        }
    }
}

/// At most so many gaps are named.
const NAMED_GAPS: usize = 10;

fn say(which: &str, done: &Done) {
    let Done { windows, duplicates, rejected, gaps, .. } = done;
    let missing = gaps.iter().fold(0i64, |sum, gap| sum.saturating_add(gap.missing));
    for line in &done.told {
        eprintln!("verge-tmc: {line}");
    }
    eprintln!(
        "verge-tmc: {which}{windows} windows archived, {duplicates} duplicates, {rejected} rejected, \
         {missing} missing"
    );
    for Gap { site, window_s, after_ms, missing } in gaps.iter().take(NAMED_GAPS) {
        let after = jiff::Timestamp::from_millisecond(*after_ms).unwrap_or_default();
        eprintln!("verge-tmc: {site}: {missing} windows of {window_s} s missing after {after}");
    }
}
