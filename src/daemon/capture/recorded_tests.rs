use super::*;

/// A recording of empty files with these names.
fn recording(names: &[&str]) -> (tempfile::TempDir, Recorded) {
    let folder = tempfile::tempdir().expect("a temporary folder");
    for name in names {
        let path = folder.path().join(name);
        fs::create_dir_all(path.parent().expect("a folder")).expect("a folder");
        fs::write(path, b"").expect("a file");
    }
    let recorded = Recorded::open(folder.path(), None).expect("a recording");
    (folder, recorded)
}

fn seconds(recorded: &Recorded) -> Vec<(String, f64)> {
    let first = recorded.files[0].2;
    let since = |time: UtcMs| time.saturating_since(first).as_secs_f64();
    recorded.files.iter().map(|(_, name, time)| (name.clone(), since(*time))).collect()
}

#[test]
fn a_stray_file_changes_no_other_file_s_time() {
    let frames = ["20260105T080000Z.jpg", "20260105T080010Z.jpg", "20260105T080020Z.jpg"];
    let (_folder, plain) = recording(&frames);
    let (_folder, with_stray) = recording(&[&frames[..], &["0_map.png"]].concat());
    assert_eq!(seconds(&plain), seconds(&with_stray));
    assert!(with_stray.tells_time());
    assert_eq!((with_stray.interval(), with_stray.frames()), (Duration::from_secs(10), 3));
    // Hidden files are shadows of others, and not of the recording.
    let (_folder, with_shadow) = recording(&[&frames[..], &["._20260105T080010Z.jpg"]].concat());
    assert_eq!(seconds(&plain), seconds(&with_shadow));
    let step = Some(Duration::from_secs(2));
    let folder = tempfile::tempdir().expect("a temporary folder");
    for name in [
        "20260105T080000Z.jpg",
        "20260105T080010Z.jpg",
        "20260105T08_map.jpg",
        "20260105T080020Z.jpg",
    ] {
        fs::write(folder.path().join(name), b"").expect("a file");
    }
    let paced = Recorded::open(folder.path(), step).expect("a recording");
    let times: Vec<_> = seconds(&paced).into_iter().map(|(_, time)| time).collect();
    assert_eq!(times, [0.0, 2.0, 4.0]);
}

#[test]
fn folders_by_day_are_one_recording() {
    let (_folder, recorded) = recording(&[
        "2026-01-06/00-00-05.jpg",
        "2026-01-05/23-59-55.jpg",
        "2026-01-06/00-00-00.jpg",
        ".cache/2026-01-01_00-00-00.jpg",
        "thumbs/2026-01-06_00-00-10.jpg",
    ]);
    // Nothing lies in the folder itself: all of its folders count but the hidden one.
    assert_eq!(recorded.frames(), 4);
    let (_folder, recorded) = recording(&[
        "2026-01-05_08-00-00.jpg",
        "2026-01-05_08-00-10.jpg",
        "thumbs/2026-01-05_08-00-00.jpg",
    ]);
    assert_eq!(recorded.frames(), 2);
}

#[test]
fn frames_of_one_second_share_it() {
    let (_folder, recorded) = recording(&[
        "20260105T080000Z-1.jpg",
        "20260105T080000Z-2.jpg",
        "20260105T080001Z-1.jpg",
        "20260105T080001Z-2.jpg",
    ]);
    let times: Vec<_> = seconds(&recorded).into_iter().map(|(_, time)| time).collect();
    assert_eq!(times, [0.0, 0.5, 1.0, 1.5]);
}

#[test]
fn of_frames_of_one_instant_the_first_counts() {
    // Several of one second are a stream's where others come as fast; here one comes each 10 s.
    let (_folder, recorded) = recording(&[
        "20260105T080000Z.jpg",
        "20260105T080000Z_copy.jpg",
        "20260105T080010Z.jpg",
        "20260105T080020Z.jpg",
        "b/20260105T080020Z.jpg",
        "20260105T080020Z_2.jpg",
    ]);
    let times: Vec<_> = seconds(&recorded).into_iter().map(|(_, time)| time).collect();
    assert_eq!(times, [0.0, 10.0, 20.0]);
    // A name that tells fractions of a second tells the instant.
    let (_folder, recorded) = recording(&[
        "20260105T080000.250Z.jpg",
        "20260105T080000.250Z_copy.jpg",
        "20260105T080000.750Z.jpg",
        "20260105T080001.250Z.jpg",
    ]);
    let times: Vec<_> = seconds(&recorded).into_iter().map(|(_, time)| time).collect();
    assert_eq!(times, [0.0, 0.5, 1.0]);
    assert_eq!(recorded.interval(), Duration::from_millis(500));
}

#[test]
fn of_file_times_the_rising_ones_count() {
    let time = |seconds| Some(UtcMs(seconds));
    let mut times = vec![time(90), time(10), time(20), time(5), time(30), None];
    keep_rising(&mut times);
    assert_eq!(times, [None, time(10), time(20), None, time(30), None]);
}

#[test]
fn a_folder_tells_how_its_dates_are_read_or_is_refused() {
    let first_day = |names: &[&str], dates| {
        let folder = tempfile::tempdir().expect("a temporary folder");
        for name in names {
            fs::write(folder.path().join(name), b"").expect("a file");
        }
        let recorded = Recorded::open_local(folder.path(), None, 0, dates);
        recorded.map(|recorded| day(Some(recorded.files[0].2)))
    };
    let at = |date: &str| format!("{date}_08-00-00.jpg");
    let (one, two) = (at("05-01-2026"), "05-01-2026_08-00-10.jpg");
    let error = first_day(&[&one, two], None).expect_err("nothing tells").to_string();
    for word in ["5 January 2026", "1 May 2026", "--dates day-first"] {
        assert!(error.contains(word), "{error}");
    }
    for (dates, expected) in
        [(Dates::DayFirst, "5 January 2026"), (Dates::MonthFirst, "1 May 2026")]
    {
        assert_eq!(first_day(&[&one, two], Some(dates)).expect("told"), expected);
    }
    // A day that no month has, anywhere in the folder.
    let (names, day_first) = ([&*one, &at("13-01-2026")], "5 January 2026");
    assert_eq!(first_day(&names, None).expect("one way"), day_first);
    let names = [&*at("01-05-2026"), &at("01-13-2026")];
    assert_eq!(first_day(&names, None).expect("one way"), day_first);
    // Days that follow one another.
    let names = [&*one, &at("06-01-2026"), &at("07-01-2026")];
    assert_eq!(first_day(&names, None).expect("one way"), day_first);
    // The same either way.
    let (one, two) = (at("05-05-2026"), "05-05-2026_08-00-10.jpg");
    assert_eq!(first_day(&[&one, two], None).expect("one day"), "5 May 2026");
    // Two digits of the year: no camera wrote in 2005.
    let names = ["image26-01-05_08-00-00-25.jpg", "image26-01-05_08-00-10-25.jpg"];
    assert_eq!(first_day(&names, None).expect("one way"), day_first);
    let names = [&*at("26-01-12"), "26-01-12_08-00-10.jpg"];
    assert!(first_day(&names, None).is_err(), "of 2026, or of 2012");
    // Who needs no day gets the frames all the same.
    let (_folder, recorded) = recording(&["05-01-2026_08-00-00.jpg", "05-01-2026_08-00-10.jpg"]);
    assert_eq!((recorded.interval(), recorded.frames()), (Duration::from_secs(10), 2));
}
