//! `verge-tmc archive`: from the broker into Parquet, each window exactly once.
//!
//! Owns the command and its order of work: a message is acknowledged when the journal has it
//! on the disk, and compaction moves the journal into the archive in a thread of its own.
//! `subscriber` is the door to the broker, `journal` and `compact` the two halves of the disk.

pub mod compact;
mod gaps;
pub mod journal;
mod subscriber;
mod tls;

use crate::failure::Failure;
use compact::Done;
use gaps::Gap;
use journal::{Journal, SEGMENT_BYTES};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};
use subscriber::{Settings, Subscriber};

/// Arguments of `archive`.
#[derive(clap::Args, Debug)]
pub struct Arguments {
    /// The broker.
    #[arg(long, value_name = "HOST:PORT", default_value = "127.0.0.1:1883")]
    broker: String,
    /// Topic above the sites' own.
    #[arg(long, default_value = "verge")]
    root: String,
    /// Group of archivers that share the load; empty: this one takes everything.
    #[arg(long, default_value = "archive")]
    group: String,
    /// Name of this archiver, each its own: its session at the broker and its journal.
    #[arg(long, default_value = "verge-tmc-1")]
    name: String,
    /// User at the broker; the password stands in the file.
    #[arg(long, requires = "password_file")]
    user: Option<String>,
    /// File with the password.
    #[arg(long, value_name = "FILE", requires = "user")]
    password_file: Option<PathBuf>,
    /// TLS to the broker, whose certificate an authority in this PEM file has signed.
    #[arg(long, value_name = "FILE")]
    ca: Option<PathBuf>,
    /// Folder of the archive.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
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
        return Err(Failure::Usage(hint.into()));
    }
    let out = &arguments.out;
    let mut journal = Journal::open(&out.join("_journal").join(&arguments.name))?;
    let mut compactor = Compactor::default();
    compactor.begin(out, &journal)?;
    let mut subscriber = Subscriber::connect(settings(arguments)?)?;
    let every = Duration::from_secs(arguments.compact_every.max(1));
    let idle = arguments.until_idle.map(Duration::from_secs);
    let (mut compacted, mut heard) = (Instant::now(), Instant::now());
    let (mut taken, mut first) = (0, None);
    while !stop.load(Ordering::Relaxed) && idle.is_none_or(|idle| heard.elapsed() < idle) {
        let messages = subscriber.receive(TICK);
        if !messages.is_empty() {
            first.get_or_insert_with(Instant::now);
            // An empty one ends a replay of compact messages.
            let payloads = messages.iter().map(|message| &message.payload[..]);
            journal.append(payloads.filter(|payload| !payload.is_empty()))?;
            subscriber.acknowledge(&messages);
            heard = Instant::now();
            taken += messages.len();
        }
        if journal.written() > SEGMENT_BYTES {
            journal.close_segment();
        }
        if compacted.elapsed() > every && compactor.is_idle() {
            compacted = Instant::now();
            journal.close_segment();
            compactor.begin(out, &journal)?;
        }
    }
    subscriber.leave();
    compactor.wait()?;
    journal.close_segment();
    compactor.begin(out, &journal)?;
    compactor.wait()?;
    let seconds = first.map_or(0.0, |first| heard.duration_since(first).as_secs_f64());
    eprintln!("verge-tmc: {taken} messages taken, the last {seconds:.1} s after the first");
    Ok(())
}

fn settings(arguments: &Arguments) -> Result<Settings, Failure> {
    let address = &arguments.broker;
    let (host, port) = address
        .rsplit_once(':')
        .and_then(|(host, port)| Some((host.to_owned(), port.parse().ok()?)))
        .ok_or_else(|| Failure::Usage(format!("--broker {address:?}: give HOST:PORT")))?;
    let credentials = match (&arguments.user, &arguments.password_file) {
        (Some(user), Some(path)) => {
            let text = crate::failure::read_text(path)?;
            Some((user.clone(), text.trim_end_matches(['\r', '\n']).to_owned()))
        }
        _ => None,
    };
    let shared = if arguments.group.is_empty() {
        String::new()
    } else {
        format!("$share/{}/", arguments.group)
    };
    let filters =
        ["density", "replay/density"].map(|kind| format!("{shared}{}/+/{kind}/+", arguments.root));
    let tls = arguments.ca.as_deref().map(tls::load).transpose()?;
    Ok(Settings { host, port, name: arguments.name.clone(), credentials, tls, filters })
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

    /// Compacts what is closed.
    fn begin(&mut self, root: &Path, journal: &Journal) -> Result<(), Failure> {
        self.wait()?;
        let segments = journal.closed()?;
        if segments.is_empty() {
            return Ok(());
        }
        let root = root.to_owned();
        let work = move || match compact::compact(&root, &segments) {
            Ok(done) => say(&done),
            // The segments stay; the next run takes them up again.
            Err(failure) => eprintln!("verge-tmc: compaction failed, tried again later: {failure}"),
        };
        let thread = std::thread::Builder::new().name("compact".into()).spawn(work);
        let failed = |source| Failure::writing(Path::new("a thread"), source);
        self.running = Some(thread.map_err(failed)?);
        Ok(())
    }

    fn wait(&mut self) -> Result<(), Failure> {
        match self.running.take().map(JoinHandle::join) {
            None | Some(Ok(())) => Ok(()),
            Some(Err(_)) => Err(Failure::Print(std::io::Error::other("compaction panicked"))),
        }
    }
}

/// At most so many gaps are named.
const NAMED_GAPS: usize = 10;

fn say(done: &Done) {
    let Done { windows, duplicates, rejected, gaps, .. } = done;
    let missing: i64 = gaps.iter().map(|gap| gap.missing).sum();
    eprintln!(
        "verge-tmc: {windows} windows archived, {duplicates} duplicates, {rejected} rejected, \
         {missing} missing"
    );
    for Gap { site, window_s, after_ms, missing } in gaps.iter().take(NAMED_GAPS) {
        let after = jiff::Timestamp::from_millisecond(*after_ms).unwrap_or_default();
        eprintln!("verge-tmc: {site}: {missing} windows of {window_s} s missing after {after}");
    }
}
