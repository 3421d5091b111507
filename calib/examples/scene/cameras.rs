//! Pictures of real cameras against references made of them.

use mvcalib::road::scene_reference::{eye, picture, pictures, reference};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::Duration;
use verge::scene::{Aim, Grid, Guard, Reference, Sighting, search};

/// The camera of a file `NAME-time.jpg`.
fn camera_of(path: &Path) -> String {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    name.split('-').next().unwrap_or_default().to_owned()
}

/// Each camera's later pictures against the reference of its first three, and those of the
/// other cameras of the same picture size.
pub fn cameras(folder: &Path) {
    let mut by_camera: BTreeMap<String, Vec<PathBuf>> = BTreeMap::new();
    for path in pictures(folder).expect("pictures") {
        by_camera.entry(camera_of(&path)).or_default().push(path);
    }
    let mut known: BTreeMap<&str, (Grid, Reference)> = BTreeMap::new();
    for (name, files) in by_camera.iter().filter(|(_, files)| files.len() >= 20) {
        let size = picture(&files[0]).map(|(_, w, h)| (w, h)).ok();
        match reference(&files[..3], &[]) {
            Ok(made) => {
                known.insert(name.as_str(), made);
            }
            Err(error) => println!("{name} {size:?}: {error}"),
        }
    }
    println!(
        "| camera | pictures | in place | least significance | alarms | foreign sequences | flagged | most significance |"
    );
    println!("|---|---|---|---|---|---|---|---|");
    let mut sums = [0; 6];
    for (name, (grid, reference)) in &known {
        let own = watch(&by_camera[*name][3..], *grid, reference);
        let mut foreign = (0, 0, f32::MIN);
        for (other, files) in by_camera.iter().filter(|(other, _)| other != name) {
            if known.get(other.as_str()).is_none_or(|(other_grid, _)| other_grid != grid) {
                continue;
            }
            let seen = watch(&files[..files.len().min(13)], *grid, reference);
            foreign.0 += 1;
            foreign.1 += usize::from(seen.moved_within.is_some());
            foreign.2 = foreign.2.max(seen.most);
        }
        println!(
            "| {name} | {} | {} | {:.1} | {} | {} | {} | {:.1} |",
            own.frames, own.in_place, own.least, own.alarms, foreign.0, foreign.1, foreign.2
        );
        let row = [own.frames, own.in_place, own.alarms, foreign.0, foreign.1, 0];
        for (sum, value) in sums.iter_mut().zip(row) {
            *sum += value;
        }
    }
    println!(
        "{} pictures, {} in place, {} alarms; {} foreign sequences, {} flagged",
        sums[0], sums[1], sums[2], sums[3], sums[4]
    );
}

struct Watched {
    frames: usize,
    in_place: usize,
    least: f32,
    most: f32,
    alarms: usize,
    moved_within: Option<usize>,
}

/// A camera's pictures, ten seconds apart, against a reference.
fn watch(files: &[PathBuf], grid: Grid, reference: &Reference) -> Watched {
    let mut guard = Guard::new(1);
    let mut watched = Watched {
        frames: 0,
        in_place: 0,
        least: f32::MAX,
        most: f32::MIN,
        alarms: 0,
        moved_within: None,
    };
    for path in files {
        let (rgb, width, height) = picture(path).expect("a picture");
        let mut eye = eye(width, height);
        if eye.grid() != grid {
            continue;
        }
        eye.look(&rgb);
        let sighting = search(reference, &eye);
        watched.least = watched.least.min(sighting.significance);
        watched.most = watched.most.max(sighting.significance);
        let was = guard.aim();
        let now = Duration::from_secs(10 * watched.frames as u64);
        let judged = guard.judge(std::slice::from_ref(reference), &eye, now);
        watched.frames += 1;
        watched.in_place += usize::from(judged.shift.is_some());
        if judged.aim == Aim::Moved && was != Aim::Moved {
            watched.alarms += 1;
            watched.moved_within.get_or_insert(watched.frames);
        }
    }
    watched
}

/// One camera's pictures against the reference made of them all; `pose` is the one that
/// shows the pose of the calibration.
pub fn frames(folder: &Path, pose: Option<&str>) {
    let mut files = pictures(folder).expect("pictures");
    if let Some(pose) = pose {
        let at = files.iter().position(|f| f.file_name().is_some_and(|n| n == pose));
        files[..=at.expect("the named frame")].rotate_right(1);
    }
    let (_, reference) = reference(&files, &[]).expect("one scene");
    println!("| picture | shift, px | turn, degrees | zoom | significance | support | agreement |");
    println!("|---|---|---|---|---|---|---|");
    for file in &files {
        let (rgb, width, height) = picture(file).expect("a picture");
        let mut eye = eye(width, height);
        eye.look(&rgb);
        let Sighting { pose, significance, support, agreement } = search(&reference, &eye);
        let px = eye.grid().cell_px();
        println!(
            "| {} | {:+.2} {:+.2} | {:+.2} | {:.3} | {significance:.1} | {support:.2} | {agreement:.2} |",
            file.file_name().unwrap_or_default().to_string_lossy(),
            pose.dx * px,
            pose.dy * px,
            pose.turn.to_degrees(),
            pose.zoom
        );
    }
}
