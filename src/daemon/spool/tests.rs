//! The spool against crashes, damage and a disk that refuses. Damage to whole segments and what
//! does not belong in the folder is `damage_tests`'.

use super::record::tests::message;
use super::*;
use tempfile::TempDir;

pub(super) const WEEK: u64 = 7 * 1440;

pub(super) fn folder() -> TempDir {
    tempfile::tempdir().expect("a temporary folder")
}

pub(super) fn open(folder: &TempDir) -> Spool {
    Spool::open(folder.path(), WEEK).expect("nobody else has it")
}

pub(super) fn accept(spool: &mut Spool, window_s: u32) -> u64 {
    spool.accept(window_s, |seq| message(i64::from(window_s), seq)).0
}

/// Length and `seq` of everything that waits, from the oldest.
pub(super) fn arrears(spool: &mut Spool) -> Vec<(u64, u64)> {
    spool.rewind();
    std::iter::from_fn(|| spool.next_arrear())
        .map(|waiting| {
            let report = &waiting.message.report;
            (report.to.saturating_since(report.from).as_secs(), waiting.message.seq)
        })
        .collect()
}

pub(super) fn files(folder: &TempDir) -> Vec<PathBuf> {
    let mut paths: Vec<_> = std::fs::read_dir(folder.path())
        .expect("the folder")
        .map(|entry| entry.expect("an entry").path())
        .filter(|path| path.extension().is_some())
        .collect();
    paths.sort();
    paths
}

#[test]
fn windows_outlive_the_program_until_they_are_acknowledged() {
    let folder = folder();
    let mut spool = open(&folder);
    let keys: Vec<_> = [60, 60, 900, 60].map(|length| accept(&mut spool, length)).into();
    spool.acknowledge(keys[1]);
    spool.note_acknowledged();
    drop(spool);
    let mut spool = open(&folder);
    assert_eq!(arrears(&mut spool), [(60, 1), (900, 1), (60, 3)]);
    let (key, message) = spool.accept(60, |seq| message(60, seq));
    assert_eq!((key, message.seq), (5, 4));
}

#[test]
fn what_an_older_verge_has_left_is_delivered() {
    let folder = folder();
    let old = crate::wire::tests::format_1();
    let path = folder.path().join(format!("{:020}.spool", 7));
    let mut bytes = record::tests::segment_of(7, &old);
    bytes.resize(SEGMENT, 0);
    std::fs::write(path, bytes).expect("writing a segment");
    let mut spool = open(&folder);
    spool.rewind();
    let waiting = spool.next_arrear().expect("it waits");
    assert_eq!((waiting.key, &waiting.message), (7, &crate::wire::decode(&old).expect("right")));
    assert_eq!(waiting.message.report.lanes[0].cells, None);
    // The file goes on with windows of today, and the numbers with them.
    assert_eq!(accept(&mut spool, 60), 8);
    drop(spool);
    let mut spool = open(&folder);
    assert_eq!(arrears(&mut spool), [(60, 300), (60, 301)]);
    assert_eq!(spool.counts().damaged, 0);
}

#[test]
fn a_crash_forgets_no_window_and_at_most_some_acknowledgements() {
    let folder = folder();
    let mut spool = open(&folder);
    let first = accept(&mut spool, 60);
    spool.acknowledge(first);
    // The acknowledgement goes to the disk with the next window.
    let second = accept(&mut spool, 60);
    spool.acknowledge(second);
    drop(spool);
    assert_eq!(arrears(&mut open(&folder)), [(60, 2)]);
}

#[test]
fn the_numbers_go_on_when_all_is_delivered() {
    let folder = folder();
    for round in 0..3_u64 {
        let mut spool = open(&folder);
        for n in 1..=200 {
            let (key, message) = spool.accept(60, |seq| message(60, seq));
            assert_eq!(message.seq, round * 200 + n);
            spool.acknowledge(key);
        }
        spool.note_acknowledged();
        assert_eq!(spool.counts().waiting, 0);
        assert!(files(&folder).len() <= 2, "{:?}", files(&folder));
    }
}

#[test]
fn arrears_come_from_the_oldest_and_the_last_of_each_length_is_marked() {
    let mut spool = Spool::in_memory();
    for length in [60, 900, 60, 60] {
        accept(&mut spool, length);
    }
    let live = accept(&mut spool, 60);
    spool.give(live);
    let order: Vec<_> = std::iter::from_fn(|| spool.next_arrear())
        .map(|waiting| (waiting.key, waiting.is_last))
        .collect();
    assert_eq!(order, [(1, false), (2, true), (3, false), (4, true)]);
}

#[test]
fn what_was_asked_for_fits_and_then_the_oldest_go() {
    let folder = folder();
    let windows = 40;
    let mut spool = Spool::open(folder.path(), windows).expect("nobody else has it");
    while spool.counts().dropped == 0 {
        accept(&mut spool, 60);
    }
    let counts = spool.counts();
    assert!(counts.waiting >= windows, "{counts:?}");
    let first = counts.dropped + 1;
    let expected: Vec<_> = (first..first + counts.waiting).map(|seq| (60, seq)).collect();
    assert_eq!(arrears(&mut spool), expected);
    drop(spool);
    assert_eq!(arrears(&mut open(&folder)), expected);
}

#[test]
fn damage_at_any_byte_of_the_last_record_loses_that_record_at_most() {
    let source = folder();
    let mut spool = open(&source);
    (0..3).for_each(|_| _ = accept(&mut spool, 60));
    drop(spool);
    let path = files(&source).remove(0);
    let good = std::fs::read(&path).expect("a segment");
    let scan = record::scan(&good);
    let last = scan.records.last().expect("three windows").0;
    for at in last..scan.end {
        for cut in [false, true] {
            let folder = folder();
            let mut bytes = good.clone();
            if cut {
                bytes[at..].fill(0);
            } else {
                bytes[at] ^= 0x10;
            }
            let name = path.file_name().expect("it has one");
            std::fs::write(folder.path().join(name), &bytes).expect("writing a segment");
            let mut spool = open(&folder);
            assert_eq!(arrears(&mut spool), [(60, 1), (60, 2)], "byte {at}, cut {cut}");
            accept(&mut spool, 60);
            drop(spool);
            assert_eq!(arrears(&mut open(&folder)), [(60, 1), (60, 2), (60, 3)], "byte {at}");
        }
    }
}

#[test]
fn random_lives_lose_nothing_and_number_without_gaps() {
    for seed in 0..20 {
        let folder = folder();
        let mut random = fastrand::Rng::with_seed(seed);
        let (mut accepted, mut acknowledged) = (0_u64, BTreeSet::new());
        let mut spool = open(&folder);
        for _ in 0..300 {
            match random.u8(..) {
                0..150 => {
                    let (key, message) = spool.accept(60, |seq| message(60, seq));
                    accepted += 1;
                    assert_eq!((key, message.seq), (accepted, accepted), "seed {seed}");
                }
                150..240 => {
                    if let Some(waiting) = spool.next_arrear() {
                        spool.acknowledge(waiting.key);
                        acknowledged.insert(waiting.message.seq);
                    }
                }
                _ => {
                    drop(spool);
                    spool = open(&folder);
                }
            }
        }
        let waiting: BTreeSet<_> = arrears(&mut spool).into_iter().map(|(_, seq)| seq).collect();
        for seq in 1..=accepted {
            let known = waiting.contains(&seq) || acknowledged.contains(&seq);
            assert!(known, "seed {seed}: window {seq} is lost");
        }
    }
}

#[test]
fn a_disk_that_refuses_costs_nothing_until_it_is_back() {
    let parent = folder();
    let path = parent.path().join("spool");
    // A file where the folder should be: nothing can be made in it.
    std::fs::write(&path, "in the way").expect("writing a file");
    let mut spool = Spool::open(&path, WEEK).expect("nobody else has it");
    let said = |spool: &Spool| spool.fault().is_some_and(|fault| fault.contains("in its way"));
    assert!(said(&spool), "before the first window: {:?}", spool.fault());
    accept(&mut spool, 60);
    accept(&mut spool, 60);
    assert_eq!((spool.counts().in_memory, spool.counts().waiting), (2, 2));
    assert!(said(&spool), "{:?}", spool.fault());
    std::fs::remove_file(&path).expect("removing it");
    accept(&mut spool, 60);
    assert_eq!(spool.fault(), None);
    assert_eq!((spool.counts().in_memory, spool.counts().waiting), (0, 3));
    drop(spool);
    let mut spool = Spool::open(&path, WEEK).expect("nobody else has it");
    assert_eq!(arrears(&mut spool), [(60, 1), (60, 2), (60, 3)]);
}

#[test]
fn a_folder_that_is_removed_costs_nothing() {
    let parent = folder();
    let path = parent.path().join("spool");
    let mut spool = Spool::open(&path, WEEK).expect("nobody else has it");
    accept(&mut spool, 60);
    accept(&mut spool, 60);
    std::fs::remove_dir_all(&path).expect("removing it");
    accept(&mut spool, 60);
    assert_eq!((spool.counts().in_memory, spool.counts().waiting), (0, 3));
    std::fs::remove_dir_all(&path).expect("removing it");
    // The program ends before the next window.
    spool.note_acknowledged();
    assert!(Spool::open(&path, WEEK).is_err(), "the new folder has its lock");
    drop(spool);
    let mut spool = Spool::open(&path, WEEK).expect("nobody else has it");
    assert_eq!(arrears(&mut spool), [(60, 1), (60, 2), (60, 3)]);
    assert_eq!(accept(&mut spool, 60), 4, "the numbers go on");
}

#[test]
fn what_cannot_be_read_of_a_removed_folder_takes_nothing_along() {
    let parent = folder();
    let path = parent.path().join("spool");
    let mut spool = Spool::open(&path, WEEK).expect("nobody else has it");
    // Several segments; only the newest has a descriptor.
    (0..200).for_each(|_| _ = accept(&mut spool, 60));
    std::fs::remove_dir_all(&path).expect("removing it");
    (0..200).for_each(|_| _ = accept(&mut spool, 60));
    let counts = spool.counts();
    assert_eq!((counts.in_memory, counts.waiting + counts.damaged), (0, 400));
    assert!(counts.damaged > 0 && counts.waiting > 200, "{counts:?}");
    let kept = arrears(&mut spool);
    assert_eq!(kept.len() as u64, counts.waiting);
    assert_eq!(kept.last(), Some(&(60, 400)));
}

#[test]
fn a_newest_file_that_is_removed_leaves_the_others() {
    let folder = folder();
    let mut spool = open(&folder);
    (0..200).for_each(|_| _ = accept(&mut spool, 60));
    let newest =
        files(&folder).into_iter().rfind(|file| file.extension().is_some_and(|e| e == "spool"));
    std::fs::remove_file(newest.expect("segments")).expect("removing it");
    accept(&mut spool, 60);
    assert_eq!((spool.counts().in_memory, spool.counts().waiting), (0, 201));
    drop(spool);
    assert_eq!(arrears(&mut open(&folder)).len(), 201);
}

#[test]
fn memory_is_bounded() {
    let mut spool = Spool::in_memory();
    (0..=MAX_IN_MEMORY).for_each(|_| _ = accept(&mut spool, 60));
    assert_eq!(spool.counts().dropped, 1);
    assert_eq!(arrears(&mut spool)[0], (60, 2));
}

#[test]
fn one_folder_serves_one_daemon() {
    let folder = folder();
    let _spool = open(&folder);
    let error = Spool::open(folder.path(), WEEK).expect_err("it is in use").to_string();
    assert!(error.contains("in use"), "{error}");
}

#[test]
fn a_later_version_is_left_alone() {
    let folder = folder();
    let path = folder.path().join("00000000000000000001.spool");
    std::fs::write(&path, b"VSP\x02from the future").expect("writing a file");
    let error = Spool::open(folder.path(), WEEK).expect_err("unknown").to_string();
    assert!(error.contains("another version"), "{error}");
    assert!(path.exists());
}
