//! Fuzzing on stable Rust: what comes from outside never makes the daemon panic, hang or
//! take memory without bound.
//!
//! As a test each target does a short run, always the same. A long one:
//! `VERGE_FUZZ_EXECUTIONS=1000000 VERGE_FUZZ_SEED=7 cargo test --test fuzz -- --nocapture`,
//! with a target's name behind `fuzz` for that one alone. What has been run:
//! `docs/measured/fuzzing.md`.
//!
//! Targets: `pictures`, `large_pictures`; `http_answers`, `streams`, `descriptions`, `packets`,
//! `h265` (where it is built in), `sessions` (camera); `models`, `configurations`, `lane_tables`, `spool_recovery` (files);
//! `wire_messages`, `json_messages` (messages read back). `hour` puts a camera that sends anything
//! in front of the whole program.

#[path = "../common/mod.rs"]
mod common;
#[path = "../common/fake_broker.rs"]
mod fake_broker;
mod files;
mod hour;
mod http;
mod messages;
mod mutate;
mod pictures;
mod rtsp;
mod runner;
mod streams;
#[path = "../common/windows.rs"]
mod windows;

use crc::{CRC_32_ISO_HDLC, Crc};
use fastrand::Rng;
use std::fs;
use std::path::Path;
use verge::lane::Name;

const CRC: Crc<u32> = Crc::<u32>::new(&CRC_32_ISO_HDLC);

/// Outcome of something that worked, in a way that `kind` tells from others, or said why
/// not.
fn outcome<T>(result: Result<T, impl std::fmt::Display>, kind: impl FnOnce(T) -> String) -> String {
    result.map_or_else(|error| error.to_string(), |value| format!("right {}", kind(value)))
}

/// A number as letters: its magnitude, for outcomes.
fn magnitude(number: usize) -> String {
    "i".repeat(number.checked_ilog2().map_or(0, |log| log as usize + 1))
}

/// Makes the last four bytes the checksum of those before, nine times in ten: a reader
/// that looks no further than the checksum is tested once in a while only.
fn mend_trailer(rng: &mut Rng, input: &mut [u8]) {
    if rng.u8(..10) > 0
        && let Some((body, trailer)) = input.split_last_chunk_mut::<4>()
    {
        *trailer = CRC.checksum(body).to_le_bytes();
    }
}

fn name(text: &str) -> Name {
    Name::try_from(text).expect("short")
}

/// The corpus is what the repository ships, and stays small.
#[test]
fn the_corpus_is_small() {
    let folder = Path::new("tests/data/fuzz");
    let bytes: u64 = fs::read_dir(folder)
        .expect("it ships")
        .map(|entry| entry.and_then(|entry| entry.metadata()).expect("a file").len())
        .sum();
    assert!(bytes < 64 << 10, "{bytes} bytes in {}", folder.display());
}
