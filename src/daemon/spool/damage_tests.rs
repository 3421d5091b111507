//! The spool where the disk gives errors, whole segments are damaged, or the folder holds what is
//! none of ours: nothing is acknowledged that was not, and no number is used twice.

use super::record::{self, MIN_WINDOW};
use super::tests::{WEEK, accept, arrears, files, folder, open};
use super::*;
use tempfile::TempDir;

/// A spool with this many segments that are full, with the windows in them.
fn filled(folder: &TempDir, segments: usize) -> (Spool, u64) {
    let mut spool = open(folder);
    let mut windows = 0;
    while files(folder).len() <= segments {
        windows = accept(&mut spool, 60);
    }
    (spool, windows)
}

/// Flips a bit in every record of a segment.
fn ruin(path: &Path) {
    let mut bytes = std::fs::read(path).expect("a segment");
    for (offset, _) in record::scan(&bytes).records {
        bytes[offset + 7] ^= 4;
    }
    assert!(record::scan(&bytes).records.is_empty());
    std::fs::write(path, bytes).expect("writing it");
}

fn next_seq(folder: &TempDir) -> u64 {
    let (_, message) = open(folder).accept(60, |seq| record::tests::message(60, seq));
    message.seq
}

#[test]
fn an_error_of_the_disk_acknowledges_nothing() {
    let folder = folder();
    let (mut spool, windows) = filled(&folder, 2);
    let (first, away) = (files(&folder).remove(0), folder.path().join("away"));
    std::fs::rename(&first, &away).expect("renaming it");
    let readable = arrears(&mut spool);
    assert!(!readable.is_empty() && readable.len() < windows as usize);
    assert_eq!(spool.counts().waiting, windows, "those that cannot be read stay");
    assert!(spool.next_arrear().is_none());
    // The disk is back: they come, without a new session.
    std::fs::rename(&away, &first).expect("renaming it");
    spool.resume();
    let rest: Vec<_> = std::iter::from_fn(|| spool.next_arrear()).map(|w| w.message.seq).collect();
    assert_eq!(rest, (1..=windows - readable.len() as u64).collect::<Vec<_>>());
    assert_eq!(spool.counts().damaged, 0);
}

#[test]
fn numbers_that_nobody_can_have_counted_to_are_damage() {
    let folder = folder();
    let (mut spool, windows) = filled(&folder, 1);
    arrears(&mut spool);
    drop(spool);
    // With the right checksum: written, and not rotten.
    let huge = record::Checkpoint { next_key: u64::MAX, last_seq: vec![(60, u64::MAX)] };
    let mut bytes = Vec::new();
    record::Record::Checkpoint(huge).write(&mut bytes).expect("it fits");
    bytes.resize(8192, 0);
    std::fs::write(folder.path().join("numbers"), &bytes).expect("writing it");
    let path = files(&folder).remove(0);
    let mut segment = std::fs::read(&path).expect("a segment");
    let message = record::tests::message(60, u64::MAX - 1);
    let window = record::Record::Window { key: u64::MAX - 1, message: Box::new(message) };
    let mut bytes = Vec::new();
    window.write(&mut bytes).expect("it fits");
    let end = segment.len() - bytes.len();
    segment[end..].copy_from_slice(&bytes);
    std::fs::write(&path, segment).expect("writing it");
    let seq = next_seq(&folder);
    assert!(seq > windows && seq < windows + 10_000, "{seq} after {windows}");
}

#[test]
fn a_window_is_given_up_for_damage_alone_and_that_is_counted() {
    let folder = folder();
    let mut spool = open(&folder);
    (0..3).for_each(|_| _ = accept(&mut spool, 60));
    let path = files(&folder).remove(0);
    let mut bytes = std::fs::read(&path).expect("a segment");
    let (offset, _) = record::scan(&bytes).records[2];
    bytes[offset + 20] ^= 1;
    std::fs::write(&path, &bytes).expect("writing it");
    assert_eq!(arrears(&mut spool), [(60, 1), (60, 3)]);
    assert_eq!((spool.counts().damaged, spool.counts().waiting), (1, 2));
    spool.note_acknowledged();
    drop(spool);
    // Nothing says that it was taken: undamaged again, it is there.
    bytes[offset + 20] ^= 1;
    std::fs::write(&path, &bytes).expect("writing it");
    assert_eq!(arrears(&mut open(&folder)), [(60, 1), (60, 2), (60, 3)]);
}

#[test]
fn what_was_put_off_is_tried_by_one_of_each_length() {
    let mut spool = Spool::in_memory();
    let keys: Vec<_> = [60, 60, 900, 900].map(|length| accept(&mut spool, length)).into();
    let _ = arrears(&mut spool);
    keys.iter().for_each(|&key| spool.put_off(key));
    assert!(spool.next_arrear().is_none());
    spool.resume();
    let again: Vec<_> = std::iter::from_fn(|| spool.next_arrear()).map(|w| w.key).collect();
    assert_eq!(again, [keys[0], keys[2]]);
    spool.resume_like(keys[2]);
    let again: Vec<_> = std::iter::from_fn(|| spool.next_arrear()).map(|w| w.key).collect();
    assert_eq!(again, [keys[3]]);
}

#[test]
fn a_segment_of_damage_alone_is_told_and_numbers_never_begin_again() {
    for without_numbers in [false, true] {
        for cut in [false, true] {
            for segments in [0, 1] {
                let folder = folder();
                let (spool, windows) = filled(&folder, segments);
                drop(spool);
                let last = files(&folder).pop().expect("the newest");
                if cut {
                    let len = std::fs::metadata(&last).expect("there").len();
                    let file = File::options().write(true).open(&last).expect("ours");
                    // The newest holds one window: it is cut behind its head.
                    file.set_len(if segments == 0 { 6 } else { len / 2 }).expect("cut");
                } else {
                    ruin(&last);
                }
                if without_numbers {
                    std::fs::remove_file(folder.path().join("numbers")).expect("removed");
                }
                let what = format!("cut {cut}, {segments} more, without {without_numbers}");
                let damaged = open(&folder).counts().damaged;
                assert!(damaged > 0, "{what}");
                let next = next_seq(&folder);
                assert!(next > windows, "{what}: {next} after {windows}");
                let most = (SEGMENT / MIN_WINDOW) as u64;
                assert!(next <= windows + 2 * most + 1, "{what}: {next} after {windows}");
            }
        }
    }
}

#[test]
fn a_number_that_damage_hides_in_the_middle_is_not_used_again() {
    let folder = folder();
    let mut spool = open(&folder);
    for length in [60, 900, 60] {
        accept(&mut spool, length);
    }
    drop(spool);
    let path = files(&folder).remove(0);
    let mut bytes = std::fs::read(&path).expect("a segment");
    let (offset, _) = record::scan(&bytes).records[2];
    bytes[offset + 20] ^= 1;
    std::fs::write(&path, &bytes).expect("writing it");
    let mut spool = open(&folder);
    let mut seq = |length| spool.accept(length, |seq| record::tests::message(60, seq)).1.seq;
    assert_eq!(seq(60), 3, "what follows is known");
    assert!(seq(900) > 1);
}

#[test]
fn numbers_that_went_out_from_memory_are_not_used_again() {
    let folder = folder();
    let mut spool = open(&folder);
    let key = accept(&mut spool, 60);
    // The disk takes nothing more: no append, and no new segment.
    spool.writable = false;
    let in_the_way = |n: u64| folder.path().join(format!("{:020}.spool", key + n));
    (1..=7).for_each(|n| std::fs::create_dir(in_the_way(n)).expect("in the way"));
    for _ in 0..7 {
        let key = accept(&mut spool, 60);
        spool.acknowledge(key);
    }
    assert_eq!(spool.counts().waiting, 1, "delivered from memory");
    // Killed: no destructor runs. The disk is well again.
    drop(spool);
    (1..=7).for_each(|n| std::fs::remove_dir(in_the_way(n)).expect("nothing is in it"));
    assert_eq!(next_seq(&folder), 9);
}

#[test]
fn what_is_none_of_ours_neither_hangs_nor_fills_the_memory() {
    let folder = folder();
    let mut spool = open(&folder);
    accept(&mut spool, 60);
    drop(spool);
    let path = |number: u64| folder.path().join(format!("{number:020}.spool"));
    std::os::unix::fs::symlink("/dev/zero", path(50)).expect("a link");
    let (mode, kind) = (rustix::fs::Mode::RUSR, rustix::fs::FileType::Fifo);
    rustix::fs::mknodat(rustix::fs::CWD, path(51), kind, mode, 0).expect("a FIFO");
    let sparse = File::create(path(52)).expect("a file");
    sparse.set_len(4 << 30).expect("sparse");
    let mut spool = open(&folder);
    assert_eq!(spool.counts().damaged, 3, "each is counted");
    assert_eq!(arrears(&mut spool), [(60, 1)]);
    assert!(path(50).is_symlink() && path(52).exists(), "and left alone");
    std::fs::create_dir(folder.path().join("other")).expect("a folder");
    let error =
        Spool::open(folder.path(), WEEK).expect_err("the folder is taken, whatever is in it");
    assert!(matches!(error, SpoolError::InUse(_)));
}

#[test]
fn descriptors_do_not_grow_with_the_segments() {
    let folder = folder();
    let descriptors = || {
        let open = std::fs::read_dir("/proc/self/fd").expect("Linux");
        let is_ours = |path: PathBuf| path.starts_with(folder.path());
        let targets = open.filter_map(|entry| std::fs::read_link(entry.ok()?.path()).ok());
        targets.filter(|target| is_ours(target.clone())).count()
    };
    let (mut spool, windows) = filled(&folder, 30);
    assert_eq!(arrears(&mut spool).len() as u64, windows);
    // The folder, the numbers, the newest segment.
    assert_eq!(descriptors(), 3);
    drop(spool);
    let mut spool = open(&folder);
    assert_eq!(arrears(&mut spool).len() as u64, windows);
    assert_eq!(descriptors(), 3);
}
