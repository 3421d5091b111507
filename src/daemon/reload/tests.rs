//! Loading beside the running configuration, and refusals.

use super::*;
use crate::daemon::assemble::open_line;
use crate::daemon::line::Line;
use crate::lane::{self, LaneTable, Name};
use crate::units::ImagePoint;
use std::fs;
use std::time::{Duration, Instant};
use tempfile::TempDir;

const PATIENCE: Duration = Duration::from_secs(60);
const TABLE: &str = "tests/data/curve.lut";

/// A folder with a configuration and its lane table, and the configuration.
fn written(more: &str) -> (TempDir, PathBuf, Config) {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("verge.toml");
    fs::copy(TABLE, folder.path().join("table.lut")).expect("it ships");
    let here = std::env::current_dir().expect("a working directory");
    let here = here.display();
    let text = format!(
        "site = \"bench\"\n[camera]\nid = \"curve\"\ninterval_s = 5\n\
         source = \"{here}/tests/data/curve/frames\"\n\
         [model]\n{more}file = \"{here}/models/verge_nanodet_640x480.toml\"\n\
         [lane_table]\nfile = \"table.lut\"\n[windows]\nlengths_s = [20, 60]\n[mqtt]\n"
    );
    fs::write(&path, text).expect("writing it");
    let config = Config::read(&path).expect("a right configuration");
    (folder, path, config)
}

/// The table of the recording under another calibration's name, without lanes above that row.
fn other_table_from(row: u16) -> Vec<u8> {
    let table = LaneTable::parse(fs::read(TABLE).expect("it ships")).expect("a right table");
    let mut description = table.description().clone();
    description.calibration_id = Name::try_from("second").expect("short");
    let mut bytes = vec![0; lane::encoded_len(&description, None)];
    let cell = |u: u16, v: u16| {
        let point = ImagePoint { u: f32::from(u) + 0.5, v: f32::from(v) + 0.5 };
        table.place(point).filter(|_| v >= row)
    };
    let len = lane::encode(&description, None, cell, &mut bytes).expect("a right table");
    bytes.truncate(len);
    bytes
}

#[test]
fn what_is_broken_is_refused_with_the_reason() {
    let (folder, path, running) = written("");
    let table = folder.path().join("table.lut");
    let right = fs::read_to_string(&path).expect("it was written");
    let mut damaged = fs::read(&table).expect("it was written");
    let middle = damaged.len() / 2;
    damaged[middle] ^= 1;
    let changed = |from: &str, to: &str| {
        let text = right.replacen(from, to, 1);
        assert_ne!(text, right, "{from}");
        text
    };
    for (text, bytes, expected) in [
        (changed("[camera]", "[camera"), None, "verge.toml"),
        (changed("lengths_s = [20, 60]", "lengths_s = [7]"), None, "windows.lengths_s"),
        (changed("id = \"curve\"", "id = \"other\""), None, "give the table of this camera"),
        (changed("640x480.toml", "1x1.toml"), None, "1x1.toml"),
        (changed("table.lut", "none.lut"), None, "none.lut"),
        (changed("curve/frames", "curve/nothing"), None, "curve/nothing"),
        (changed("\"bench\"", "\"other\""), None, "restart verge"),
        (changed("[mqtt]", "[mqtt]\nroot = \"a/b\""), None, "mqtt.root"),
        (changed("[mqtt]", "[spool]\nfolder = \"b\"\n[mqtt]"), None, "spool.folder"),
        (changed("[mqtt]", "[mqtt]\ntls = true\nca_file = \"ca.pem\""), None, "ca.pem"),
        (right.clone(), Some(damaged), "table.lut"),
    ] {
        fs::write(&path, text).expect("writing it");
        if let Some(bytes) = bytes {
            fs::write(&table, bytes).expect("writing it");
        }
        let reason = Candidate::load(&path, &running).err().expect(expected).to_string();
        assert!(reason.contains(expected), "{expected}: {reason}");
    }
    fs::copy(TABLE, &table).expect("it ships");
    assert!(Candidate::load(&path, &running).is_ok(), "fixed");
}

#[test]
fn a_new_table_brings_new_views_and_its_own_windows() {
    let (folder, path, config) = written("views = \"auto\"\n");
    let load = || Candidate::load(&path, &config).expect("it can take over").assembly;
    let before = load();
    fs::write(folder.path().join("table.lut"), other_table_from(185)).expect("writing it");
    let after = load();
    let regions = |line: &Line| line.parts().of((320, 240));
    let (old, new) = (regions(&before.line), regions(&after.line));
    assert_eq!((old.len(), new.len()), (2, 1), "{new:?}: no far part is left");
    assert!(new[0].y > old[0].y, "{old:?} {new:?}");
    assert_eq!(after.presets[0].calibration().id.as_str(), "second");
}

#[test]
fn views_that_are_too_slow_for_the_interval_become_one() {
    let (_folder, _, config) = written("views = \"auto\"\n");
    let mut line = open_line(&config).expect("what it names is there");
    line.keep_within(Duration::from_secs(3600)).expect("inference");
    assert_eq!(line.parts().count(), 2);
    line.keep_within(Duration::from_micros(10)).expect("inference");
    assert_eq!(line.parts().count(), 1);
}

/// Waits for what becomes of a request. Returns how often loading has begun.
fn outcome(reload: &mut Reload, running: &Config) -> (usize, Result<(), String>) {
    let until = Instant::now() + PATIENCE;
    let mut begun = 0;
    while Instant::now() < until {
        match reload.outcome(running) {
            Some(Outcome::Begun) => begun += 1,
            Some(Outcome::Loaded(_)) => return (begun, Ok(())),
            Some(Outcome::Refused(failure)) => return (begun, Err(failure.to_string())),
            None => std::thread::sleep(Duration::from_millis(5)),
        }
    }
    panic!("nothing was loaded");
}

#[test]
fn a_storm_of_requests_is_one_reload() {
    let (_folder, path, config) = written("");
    let asked = Arc::new(AtomicBool::new(true));
    let mut reload = Reload::new(&path, Arc::clone(&asked));
    assert!(matches!(reload.outcome(&config), Some(Outcome::Begun)));
    (0..9).for_each(|_| asked.store(true, Ordering::Relaxed));
    let more = outcome(&mut reload, &config);
    assert_eq!(more, (1, Ok(())), "the files may have changed in between");
    assert!(reload.outcome(&config).is_none());
    fs::write(&path, "nonsense").expect("writing it");
    asked.store(true, Ordering::Relaxed);
    assert!(outcome(&mut reload, &config).1.is_err());
}
