//! One fuzz run: inputs, limits on time and memory, and what is kept of a failure.
//!
//! An input whose outcome (the error's words without numbers and quotations) was not seen
//! before joins the corpus; half of the later inputs start from such ones.

use super::mutate::mutated;
use fastrand::Rng;
use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;
use std::collections::HashSet;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::time::{Duration, Instant};

/// Most CPU time for one input. The slowest right one, a 4K picture, takes a tenth of it.
const TIME: Duration = Duration::from_secs(5);
/// Most memory that one input may take: ten 4K pictures.
const MEMORY: isize = 256 << 20;
/// Most inputs in the corpus of a run.
const CORPUS: usize = 512;
/// Seed where `VERGE_FUZZ_SEED` does not give one.
const SEED: u64 = 20_260_105;

/// One fuzz target.
pub struct Target<'a> {
    /// Its name in reports.
    pub name: &'a str,
    /// Executions where `VERGE_FUZZ_EXECUTIONS` does not say.
    pub executions: u64,
    /// Inputs to begin with.
    pub corpus: Vec<Vec<u8>>,
    /// Words of the format.
    pub tokens: &'a [&'a [u8]],
    /// Longest input, bytes.
    pub longest: usize,
}

impl Target<'_> {
    /// Runs `execute` on mutated inputs. It gets the generator too, to correct checksums now
    /// and then, and returns what became of the input.
    ///
    /// Panics, with the path of the failing input, where an input makes `execute` panic or
    /// breaks a limit.
    pub fn run(mut self, mut execute: impl FnMut(&mut Rng, &mut Vec<u8>) -> String) {
        let executions = number("VERGE_FUZZ_EXECUTIONS").unwrap_or(self.executions);
        let seed = number("VERGE_FUZZ_SEED").unwrap_or(SEED);
        let mut rng = Rng::with_seed(seed);
        let mut outcomes = HashSet::new();
        let first = self.corpus.len();
        let (mut slowest, mut largest) = (Duration::ZERO, 0);
        let begun = Instant::now();
        for execution in 0..executions {
            let known = if rng.bool() { first } else { self.corpus.len() };
            let corpus = &self.corpus[..known];
            let mut input = mutated(&mut rng, corpus, self.tokens, self.longest);
            let (time, memory) = (cpu_time(), begin_peak());
            let outcome = catch_unwind(AssertUnwindSafe(|| execute(&mut rng, &mut input)));
            let (time, memory) = (cpu_time() - time, end_peak(memory));
            (slowest, largest) = (slowest.max(time), largest.max(memory));
            let fault = match &outcome {
                Err(_) => Some("it panics".to_owned()),
                Ok(_) if time > TIME => Some(format!("it takes {time:?}")),
                Ok(_) if memory > MEMORY => Some(format!("it takes {} MB", memory >> 20)),
                Ok(_) => None,
            };
            if let Some(fault) = fault {
                let path = std::env::temp_dir().join(format!("verge-fuzz-{}", self.name));
                std::fs::write(&path, &input).expect("writing the failing input");
                panic!(
                    "{}: {fault} on {} ({} bytes, execution {execution}, seed {seed})",
                    self.name,
                    path.display(),
                    input.len(),
                );
            }
            let words = words(&outcome.unwrap_or_default());
            if outcomes.insert(words) && self.corpus.len() < CORPUS {
                self.corpus.push(input);
            }
        }
        eprintln!(
            "{}: {executions} executions, seed {seed}, {:.0} s, {} outcomes, slowest {:.1} ms, \
             most memory {:.1} MB",
            self.name,
            begun.elapsed().as_secs_f64(),
            outcomes.len(),
            slowest.as_secs_f64() * 1e3,
            largest as f64 / 1e6,
        );
    }
}

/// A message without what differs from input to input: quotations, what stands in braces,
/// and words with digits.
fn words(outcome: &str) -> String {
    let unquoted = outcome.split(['`', '"', '\'']).step_by(2);
    let plain: String = unquoted.flat_map(|part| part.split(['{', '}']).step_by(2)).collect();
    let words = plain.split_whitespace();
    words.filter(|word| !word.contains(|c: char| c.is_ascii_digit())).collect()
}

fn number(variable: &str) -> Option<u64> {
    let text = std::env::var(variable).ok()?;
    Some(text.parse().unwrap_or_else(|_| panic!("{variable}={text}: give a whole number")))
}

/// CPU time of this thread: other work on the machine does not count.
fn cpu_time() -> Duration {
    let mut time = libc::timespec { tv_sec: 0, tv_nsec: 0 };
    // SAFETY: `time` is a live, exclusive `timespec`.
    let outcome = unsafe { libc::clock_gettime(libc::CLOCK_THREAD_CPUTIME_ID, &mut time) };
    assert_eq!(outcome, 0, "every thread has a CPU clock");
    Duration::new(time.tv_sec as u64, time.tv_nsec as u32)
}

thread_local! {
    /// Bytes that this thread holds, and the most that it held.
    static HELD: Cell<(isize, isize)> = const { Cell::new((0, 0)) };
}

fn begin_peak() -> isize {
    HELD.with(|held| {
        let (now, _) = held.get();
        held.set((now, now));
        now
    })
}

fn end_peak(begin: isize) -> isize {
    HELD.with(|held| held.get().1 - begin)
}

/// The system's allocator, counting what this thread holds.
struct Counted;

fn count(bytes: isize) {
    // A thread that ends frees its last memory when its counters are gone.
    let _ = HELD.try_with(|held| {
        let (now, most) = held.get();
        held.set((now + bytes, most.max(now + bytes)));
    });
}

// SAFETY: every call is passed on unchanged to the system's allocator.
unsafe impl GlobalAlloc for Counted {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        count(layout.size() as isize);
        // SAFETY: the caller keeps `alloc`'s contract.
        unsafe { System.alloc(layout) }
    }

    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        count(layout.size() as isize);
        // SAFETY: the caller keeps `alloc_zeroed`'s contract.
        unsafe { System.alloc_zeroed(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        count(-(layout.size() as isize));
        // SAFETY: the caller keeps `dealloc`'s contract.
        unsafe { System.dealloc(pointer, layout) }
    }

    unsafe fn realloc(&self, pointer: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        count(size as isize - layout.size() as isize);
        // SAFETY: the caller keeps `realloc`'s contract.
        unsafe { System.realloc(pointer, layout, size) }
    }
}

#[global_allocator]
static ALLOCATOR: Counted = Counted;
