//! Recorded clips of other people: tracks against what is followed from their boxes without their
//! identities. Counts at the section, and speeds through a projection of our own.
//!
//! - London, camera 03601 of Transport for London, 352x288 px, 25 pictures a second: distances along
//!   the road by the lane line's dashes, 6 m from one to the next (fitted: the horizon lies in row 20).
//! - Dresden, test video of OpenTrafficCam, 800x600 px, 20 a second: the road plane by the five
//!   reference points that come with it, in metres (UTM), left over 0.26 m at most.

use super::super::*;
use crate::units::LaneId;
use serde_json::Value;
use std::collections::BTreeMap;
use std::path::Path;
use std::vec::Vec;

type Point = [f64; 2];

/// The middle of a box's lower edge in a picture, with the number of the track that it belongs to.
#[derive(Clone, Copy)]
struct Seen {
    picture: u32,
    track: u32,
    contact: Point,
}

/// A lane, and how far along it a point of the picture is, m.
struct Clip<'a> {
    direction: Direction,
    length_m: f64,
    s_m: &'a dyn Fn(Point) -> Option<f64>,
    pictures_per_s: f64,
}

/// Vehicles that passed the middle, and the space-mean speed of all, km/h.
#[derive(Debug)]
struct Told {
    passed: u32,
    kmh: f64,
}

impl Clip<'_> {
    /// By the tracks.
    fn by_tracks(&self, seen: &[Seen]) -> Told {
        let mut tracks: BTreeMap<u32, Vec<(u32, f64)>> = BTreeMap::new();
        for Seen { picture, track, contact } in seen {
            if let Some(s_m) = (self.s_m)(*contact) {
                tracks.entry(*track).or_default().push((*picture, s_m));
            }
        }
        let (mut passed, mut way_m, mut time_s) = (0, 0.0, 0.0);
        for track in tracks.values() {
            let [first, last] = [track[0], track[track.len() - 1]];
            way_m += last.1 - first.1;
            time_s += f64::from(last.0 - first.0) / self.pictures_per_s;
            let middle = self.length_m / 2.0;
            passed += u32::from(first.1 < middle && last.1 >= middle);
        }
        Told { passed, kmh: way_m / time_s * 3.6 }
    }

    /// By the stage, from each `every`th picture.
    fn by_following(&self, seen: &[Seen], every: u32) -> Told {
        let id = LaneId::new(1).expect("in range");
        let lane = Lane { id, direction: self.direction, length_m: self.length_m as f32 };
        let (mut tracker, mut sum, mut passed) = (LaneTracker::new(&lane), Moves::default(), 0);
        let last = seen.iter().map(|seen| seen.picture).max().expect("some");
        for picture in (0..=last).step_by(every as usize) {
            let mut sightings = Sightings::new();
            for Seen { contact: [u, v], .. } in seen.iter().filter(|s| s.picture == picture) {
                let (s_m, next_m) = ((self.s_m)([*u, *v]), (self.s_m)([*u, *v - 1.0]));
                let (Some(s_m), Some(next_m)) = (s_m, next_m) else { continue };
                let (s_m, span_m) = (s_m as f32, (next_m - s_m).abs() as f32);
                let _ = sightings.push(Sighting { s_m, span_m, class: VehicleClass::Car });
            }
            let moves = tracker.observe(every as f32 / self.pictures_per_s as f32, &mut sightings);
            passed += moves.passages.count();
            sum.add(moves.distance_m, moves.time_s, moves.occupied_s);
        }
        Told { passed, kmh: f64::from(sum.distance_m / sum.time_s * 3.6) }
    }

    /// Prints both, and returns the differences of counts and of speeds, km/h.
    fn compare(&self, name: &str, seen: &[Seen], every: u32) -> (u32, f64) {
        let (tracks, followed) = (self.by_tracks(seen), self.by_following(seen, every));
        let rate = self.pictures_per_s / f64::from(every);
        std::eprintln!(
            "| {name} | {rate} | {} | {} | {:.1} | {:.1} |",
            tracks.passed,
            followed.passed,
            tracks.kmh,
            followed.kmh
        );
        (tracks.passed.abs_diff(followed.passed), followed.kmh - tracks.kmh)
    }
}

/// Where a line through these points is in a row.
fn column(line: &[Point], row: f64) -> f64 {
    let pair = line.windows(2).find(|pair| row < pair[1][1]).unwrap_or(&line[line.len() - 2..]);
    let ([u0, v0], [u1, v1]) = (pair[0], pair[1]);
    u0 + (u1 - u0) * (row - v0) / (v1 - v0)
}

#[test]
fn london_is_counted_as_its_tracks() {
    let Some(folder) = verge_desk::shared("data/tfl_jamcam") else { return };
    let read = |name: &str| -> Vec<Seen> {
        let path = folder.join(std::format!("{name}_00001.03601.gt.csv"));
        let text = std::fs::read_to_string(path).expect("it is there");
        let row = |line: &str| {
            let fields: Vec<&str> = line.split(',').collect();
            let number = |index: usize| fields[index].parse::<f64>().expect("a number");
            let contact = [(number(2) + number(4)) / 2.0, number(5)];
            Seen { picture: number(0) as u32, track: number(1) as u32, contact }
        };
        text.lines().skip(1).map(row).collect()
    };
    let from_camera = |row: f64| 5418.0 / (row - 20.0);
    let (near_m, far_m) = (from_camera(278.0), from_camera(110.0));
    let length_m = far_m - near_m;
    // The line between the two lanes that come, and the kerb between them and the one that goes.
    let line = [[247.0, 88.0], [261.0, 150.0], [272.0, 203.0], [285.0, 288.0]];
    let away = |[u, v]: Point| {
        let s_m = from_camera(v) - near_m;
        (u < 205.0 && v < 278.0 && s_m < length_m).then_some(s_m)
    };
    let comes = |[u, v]: Point| {
        let s_m = far_m - from_camera(v);
        (u > column(&line, v) && v < 278.0 && s_m >= 0.0).then_some(s_m)
    };
    for (day, name) in
        [("28 June", "2019-06-28_13-02-35.503167"), ("2 July", "2019-07-02_09-01-45.122302")]
    {
        let seen = read(name);
        let lanes: [(_, _, &dyn Fn(Point) -> Option<f64>); 2] =
            [("goes", Direction::Away, &away), ("comes, right", Direction::Toward, &comes)];
        for (lane, direction, s_m) in lanes {
            let clip = Clip { direction, length_m, s_m, pictures_per_s: 25.0 };
            for every in [2, 5] {
                let name = std::format!("London, {day}, lane that {lane}");
                let (counts, kmh) = clip.compare(&name, &seen, every);
                assert!(counts <= 1 && kmh.abs() < 2.0, "{name}: {counts} {kmh:+.1}");
            }
        }
    }
}

/// A plane's metres from a picture's pixels, by least squares over points of both.
fn homography(points: &[(Point, Point)]) -> impl Fn(Point) -> Point + use<> {
    let mut normal = [[0.0; 9]; 8];
    for ([u, v], [x, y]) in points {
        for row in [
            [*u, *v, 1.0, 0.0, 0.0, 0.0, -u * x, -v * x, *x],
            [0.0, 0.0, 0.0, *u, *v, 1.0, -u * y, -v * y, *y],
        ] {
            for (line, by) in normal.iter_mut().zip(row) {
                line.iter_mut().zip(row).for_each(|(sum, value)| *sum += by * value);
            }
        }
    }
    for pivot in 0..8 {
        let largest =
            |a: &usize, b: &usize| normal[*a][pivot].abs().total_cmp(&normal[*b][pivot].abs());
        let best = (pivot..8).max_by(largest).expect("some");
        normal.swap(pivot, best);
        let line = normal[pivot].map(|value| value / normal[pivot][pivot]);
        normal[pivot] = line;
        for other in (0..8).filter(|other| *other != pivot) {
            let by = normal[other][pivot];
            normal[other].iter_mut().zip(line).for_each(|(value, of)| *value -= by * of);
        }
    }
    let h = normal.map(|line| line[8]);
    move |[u, v]| {
        let w = h[6] * u + h[7] * v + 1.0;
        [(h[0] * u + h[1] * v + h[2]) / w, (h[3] * u + h[4] * v + h[5]) / w]
    }
}

fn unpacked(path: &Path) -> Value {
    let output = std::process::Command::new("bzip2").arg("-dc").arg(path).output();
    let text = output.expect("bzip2").stdout;
    serde_json::from_slice(&text).expect("JSON")
}

#[test]
fn dresden_is_counted_as_its_tracks_and_its_events() {
    if std::process::Command::new("bzip2").arg("--version").output().is_err() {
        return verge_desk::skip("bzip2 is missing");
    }
    let Some(folder) = verge_desk::shared("data/opentrafficcam") else { return };
    let points = std::fs::read(folder.join("otvision/tests/data/Testvideo_FR20.otrfpts"));
    let points: Value = serde_json::from_slice(&points.expect("it is there")).expect("JSON");
    let points: Vec<(Point, Point)> = points
        .as_object()
        .expect("points")
        .values()
        .map(|point| {
            let number = |name: &str| point[name].as_f64().expect("a number");
            (
                [number("x_px"), number("y_px")],
                [number("lon_utm") - 844_080.0, number("lat_utm") - 5_673_190.0],
            )
        })
        .collect();
    let plane = homography(&points);
    let mut seen = Vec::new();
    for (clip, first) in [("00", 0), ("10", 200)] {
        let name = std::format!("Testvideo_von_OTAnalytics_FR20_2020-02-20_13-11-{clip}.ottrk");
        let tracks = unpacked(&folder.join("otgt/tests/data/verify_OTAnalytics").join(name));
        for found in tracks["data"]["detections"].as_array().expect("boxes") {
            let number = |name: &str| found[name].as_f64().expect("a number");
            let class: &str = found["class"].as_str().expect("a class");
            // A vehicle that the picture cuts off meets the road outside it.
            let is_whole = number("x") > 2.0 && number("y") + number("h") < 598.0;
            if is_whole && !["pedestrian", "bicyclist"].contains(&class) {
                let contact = [number("x") + number("w") / 2.0, number("y") + number("h")];
                let (picture, track) =
                    (number("frame") as u32 + first, number("track-id") as u32 + 1000 * first);
                seen.push(Seen { picture, track, contact });
            }
        }
    }
    // The two lanes of the street along x, and how many vehicles by the events that people noted
    // crossed both of its lines, section 2 at the far end and section 4 at the near one.
    let (far_m, near_m) = (-25.0, 14.0);
    let comes = |point: Point| {
        let [x, y] = plane(point);
        ((-2.5..0.9).contains(&y) && (far_m..near_m).contains(&x)).then_some(x - far_m)
    };
    let goes = |point: Point| {
        let [x, y] = plane(point);
        ((0.9..6.5).contains(&y) && (far_m..near_m).contains(&x)).then_some(near_m - x)
    };
    let lanes: [(_, _, &dyn Fn(Point) -> Option<f64>, _); 2] =
        [("comes", Direction::Toward, &comes, 5), ("goes", Direction::Away, &goes, 2)];
    for (lane, direction, s_m, events) in lanes {
        let clip = Clip { direction, length_m: near_m - far_m, s_m, pictures_per_s: 20.0 };
        for every in [2, 4] {
            let name = std::format!("Dresden, lane that {lane} ({events} by events)");
            let (counts, kmh) = clip.compare(&name, &seen, every);
            assert!(counts <= 1 && kmh.abs() < 3.0, "{name}: {counts} {kmh:+.1}");
        }
    }
}
