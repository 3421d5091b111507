//! Compaction: each window once, gaps, damage, sites that cannot be written.

use super::*;
use crate::message::tests::message;
use crate::store::{self, Row};
use std::collections::BTreeSet;

fn minute(site: &str, seq: u64) -> String {
    message(site, seq, &format!("2026-01-05T08:{:02}:00.000Z", seq - 1))
}

#[test]
fn each_window_stands_once_and_gaps_close_when_they_are_filled() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    let mut journal = Journal::open(&root.join("_journal/a")).unwrap();
    let mut archive = |messages: &[String]| {
        journal.append(messages.iter().map(String::as_bytes)).unwrap();
        journal.close_segment();
        compact(root, "a", &journal.closed().unwrap()).unwrap()
    };
    let done = archive(&[minute("a", 1), minute("a", 2), minute("a", 2), minute("a", 5)]);
    assert_eq!((done.windows, done.duplicates, done.rejected), (3, 1, 0));
    let gap =
        |missing| Gap { site: "a".into(), window_s: 60, after_ms: 1_767_600_060_000, missing };
    assert_eq!(done.gaps, [gap(2)]);
    let done = archive(&[minute("a", 4), minute("a", 1), "{}".into(), minute("b", 9)]);
    assert_eq!((done.windows, done.duplicates, done.rejected), (2, 1, 1));
    assert_eq!(done.gaps, [gap(1)]);
    let done = archive(&[minute("a", 3)]);
    assert_eq!((done.windows, done.duplicates, done.gaps), (1, 0, vec![]));
    let partitions = store::partitions(root).unwrap();
    assert_eq!(partitions.iter().map(|p| p.site.as_str()).collect::<Vec<_>>(), ["a", "b"]);
    assert_eq!(partitions[0].date(), "2026-01-05");
    let rows = store::read(&partitions[0].path(root)).unwrap();
    // Five windows of two lanes, with two cells and with four of which nothing is known.
    assert_eq!(rows.len(), 5 * 8);
    assert_eq!(rows.iter().filter(|row| row.cell.is_some()).count(), 5 * 6);
    let keys: BTreeSet<_> = rows.iter().map(Row::key).collect();
    assert_eq!(keys.len(), rows.len());
    assert_eq!(fs::read_dir(root.join("_rejected")).unwrap().count(), 1);
    assert!(journal.closed().unwrap().is_empty());
}

#[test]
fn a_gap_over_midnight_is_found_whichever_day_comes_first() {
    let at = |seq, time: &str| message("a", seq, &format!("2026-01-{time}:00.000Z"));
    let (evening, later) = (at(7, "05T23:58"), at(8, "05T23:59"));
    // A day without a file lies between; windows of 900 s and of 60 s are not neighbours.
    let (morning, other) = (at(11, "07T00:00"), at(40, "07T00:00").replace(":60,", ":900,"));
    let other = other.replace("07T00:01:00.000Z", "07T00:15:00.000Z");
    let second = at(12, "07T00:01");
    for order in [[&evening, &morning], [&morning, &evening]] {
        let folder = tempfile::tempdir().unwrap();
        let root = folder.path();
        let mut journal = Journal::open(&root.join("_journal/a")).unwrap();
        let mut missing = |messages: &[&String]| {
            journal.append(messages.iter().map(|message| message.as_bytes())).unwrap();
            journal.close_segment();
            let done = compact(root, "a", &journal.closed().unwrap()).unwrap();
            done.gaps.iter().map(|gap| gap.missing).collect::<Vec<_>>()
        };
        assert_eq!(missing(&order[..1]), [0; 0]);
        assert_eq!(missing(&order[1..]), [3]);
        assert_eq!(missing(&[&other]), [3], "the day has another first window");
        assert_eq!(missing(&[&second]), [0; 0], "that is not beside the gap");
        assert_eq!(missing(&[&later]), [2]);
    }
}

#[test]
fn several_segments_become_one_day() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    let mut journal = Journal::open(&root.join("_journal/a")).unwrap();
    for seq in [2, 1, 2, 3] {
        journal.append([minute("a", seq).as_bytes()].into_iter()).unwrap();
        journal.close_segment();
    }
    let segments = journal.closed().unwrap();
    assert_eq!(segments.len(), 4);
    let done = compact(root, "a", &segments).unwrap();
    assert_eq!((done.windows, done.duplicates, done.gaps), (3, 1, vec![]));
    assert!(journal.closed().unwrap().is_empty());
}

#[test]
fn a_damaged_segment_gives_what_is_whole_in_it_and_is_kept() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    let mut journal = Journal::open(&root.join("_journal/a")).unwrap();
    let messages: Vec<String> = (1..=9).map(|seq| minute("a", seq)).collect();
    journal.append(messages.iter().map(String::as_bytes)).unwrap();
    journal.close_segment();
    let segment = journal.closed().unwrap().remove(0);
    let mut bytes = fs::read(&segment).unwrap();
    // A bit of the second record's length.
    let second = 8 + messages[0].len();
    bytes[second + 1] ^= 1;
    // After a restart another segment may have the same number.
    for (round, windows) in [(1, 8), (2, 0)] {
        fs::write(&segment, &bytes).unwrap();
        let done = compact(root, "a", std::slice::from_ref(&segment)).unwrap();
        assert_eq!((done.windows, done.duplicates, done.rejected), (windows, 8 - windows, 0));
        assert_eq!(done.gaps.len(), 1, "one window is missing, and that is told");
        let said = &done.told[0];
        assert!(said.contains("bytes of the journal could not be read"), "{said}");
        let kept = format!("_rejected/a-00000001-{round}.journal");
        assert_eq!(fs::read(root.join(kept)).unwrap(), bytes);
        assert!(journal.closed().unwrap().is_empty());
    }
}

#[test]
fn a_site_that_cannot_be_written_stops_no_other() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    let mut journal = Journal::open(&root.join("_journal/a")).unwrap();
    journal.append([minute("a", 1).as_bytes(), minute("b", 1).as_bytes()].into_iter()).unwrap();
    journal.close_segment();
    fs::write(root.join("site=a"), "in the way").unwrap();
    let segments = journal.closed().unwrap();
    let done = compact(root, "a", &segments).unwrap();
    assert_eq!(done.windows, 1);
    assert!(done.told[0].starts_with("a: not archived, tried again: "), "{:?}", done.told);
    assert_eq!(store::site_partitions(root, "b").unwrap().len(), 1);
    assert!(journal.closed().unwrap().is_empty());
    fs::remove_file(root.join("site=a")).unwrap();
    let waiting = Journal::open(&failed(root, "a")).unwrap().closed().unwrap();
    let done = compact(root, "a", &waiting).unwrap();
    assert_eq!((done.windows, done.duplicates), (1, 0));
}

#[test]
fn a_compaction_that_is_repeated_changes_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    let mut journal = Journal::open(&root.join("_journal/a")).unwrap();
    let messages: Vec<String> = (1..=9).map(|seq| minute("a", seq)).collect();
    journal.append(messages.iter().map(String::as_bytes)).unwrap();
    journal.close_segment();
    let segment = journal.closed().unwrap().remove(0);
    let kept = fs::read(&segment).unwrap();
    compact(root, "a", std::slice::from_ref(&segment)).unwrap();
    let path = store::partitions(root).unwrap()[0].path(root);
    let first = fs::read(&path).unwrap();
    // As after a crash before the segment was removed.
    fs::write(&segment, &kept).unwrap();
    let done = compact(root, "a", std::slice::from_ref(&segment)).unwrap();
    assert_eq!((done.windows, done.duplicates), (0, 9));
    assert_eq!(fs::read(&path).unwrap(), first);
}
