//! Marks: they change the picture and never the truth, and scenes without them stay as they were.

mod support;

use street::recording::{Frame, Recorder};
use street::scene::Scene;
use street::simulation::Simulation;
use street::traffic::Vehicle;
use street::vehicle::Class;

/// The first frame of the tiny scene with marks, under a clear sun without noise.
fn frame(changes: &[&str]) -> Frame {
    let clear = ["light.cloud=0.0", "light.sun_azimuth_deg=90.0", "imaging.noise_levels=0.0"];
    let scene = support::tiny(&[&clear[..], changes].concat());
    Recorder::new(&scene, 5).expect("a recorder").next_frame()
}

/// Pixels whose levels differ by more than `least` in one colour, as (column, row).
fn changed(a: &Frame, b: &Frame, least: u8) -> Vec<(u32, u32)> {
    let pixels = a.picture.data.chunks_exact(3).zip(b.picture.data.chunks_exact(3));
    let differ = |(a, b): (&[u8], &[u8])| a.iter().zip(b).any(|(a, b)| a.abs_diff(*b) > least);
    let width = a.picture.width;
    let places = pixels.enumerate().filter(|(_, pair)| differ(*pair));
    places.map(|(i, _)| (i as u32 % width, i as u32 / width)).collect()
}

fn truth(frame: &Frame) -> String {
    serde_json::to_string(&frame.truth).expect("JSON")
}

/// Pictures depend on the platform's sine: held where the committed recordings were made.
#[cfg(all(target_arch = "x86_64", target_env = "gnu"))]
#[test]
fn scenes_without_marks_give_the_committed_pictures() {
    let root = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    for (name, seed) in [("curve", 3), ("freeway", 1)] {
        let path = root.join(format!("street/scenes/{name}.toml"));
        let scene = Scene::read(&path, &[]).expect("a shipped scene");
        let mut recorder = Recorder::new(&scene, seed).expect("a recorder");
        for _ in 0..2 {
            let made = recorder.next_frame();
            let name = root.join("tests/data").join(name).join("frames").join(&made.truth.frame);
            let committed = std::fs::read(&name).expect("committed");
            let bytes = made.picture.jpeg(scene.imaging.jpeg_quality, "made").expect("a JPEG");
            assert!(
                bytes == committed,
                "{} has changed: measured figures rest on it",
                name.display()
            );
        }
    }
}

#[test]
fn keys_that_say_what_is_so_anyway_change_nothing() {
    let plain = frame(&[]);
    let same =
        frame(&["painted=[]", "overlay=[]", "fleet.trailer_share=0.0", "fleet.truck_run=1.0"]);
    assert_eq!(plain.picture, same.picture);
    assert_eq!(truth(&plain), truth(&same));
}

#[test]
fn every_painted_kind_changes_the_road_where_it_lies_and_never_the_truth() {
    let empty = ["lane.1.inflow_veh_h=0.0", "lane.2.inflow_veh_h=0.0"];
    let plain = frame(&empty);
    let camera = support::tiny(&[]).camera();
    for kind in ["arrow", "cycle", "hatching", "stop_line", "give_way", "zebra", "word"] {
        let text = if kind == "word" { r#", text = "SLOW""# } else { "" };
        let change = format!(r#"painted=[{{ kind = "{kind}", at_m = 25.0, lane = 1{text} }}]"#);
        let painted = frame(&[&empty[..], &[change.as_str()]].concat());
        let pixels = changed(&plain, &painted, 25);
        assert!(pixels.len() > 8, "{kind} covers {} px", pixels.len());
        for (column, row) in pixels {
            let at = [f64::from(column) + 0.5, f64::from(row) + 0.5];
            let [x, y] = camera.ground(at).expect("a place on the road");
            assert!(x.abs() < 9.0 && (10.0..60.0).contains(&y), "{kind} at {x} {y}");
        }
        assert_eq!(truth(&plain), truth(&painted), "{kind}");
    }
    let worn = |worn: f64| {
        let mark =
            format!(r#"painted=[{{ kind = "hatching", at_m = 25.0, lane = 1, worn = {worn} }}]"#);
        changed(&plain, &frame(&[&empty[..], &[mark.as_str()]].concat()), 25).len()
    };
    assert!(worn(0.9) < worn(0.0) / 2, "{} px of {}", worn(0.9), worn(0.0));
}

#[test]
fn an_overlay_is_in_the_picture_and_not_in_the_truth_and_tells_the_time() {
    let plain = frame(&[]);
    let bar = frame(&[
        r#"overlay=[{ kind = "bar", x = 0.25, y = 0.5, size_px = 12.0, width = 0.5, colour = "red" }]"#,
    ]);
    let pixels = changed(&plain, &bar, 0);
    assert_eq!(pixels.len(), 80 * 12);
    assert!(pixels.iter().all(|(x, y)| (40..120).contains(x) && (60..72).contains(y)));
    assert_eq!(&bar.picture.data[(66 * 160 + 80) * 3..][..3], &[215, 25, 25]);
    assert_eq!(truth(&plain), truth(&bar));
    let scene = support::tiny(&[
        r#"overlay=[{ kind = "text", text = "{time}", x = 0.02, y = 0.02, size_px = 8.0, behind = "black" }]"#,
    ]);
    let mut recorder = Recorder::new(&scene, 5).expect("a recorder");
    let (first, second) = (recorder.next_frame(), recorder.next_frame());
    let corner = |frame: &Frame| frame.picture.data[..160 * 3 * 10].to_vec();
    assert_ne!(corner(&first), corner(&second), "a second has passed");
}

#[test]
fn a_shadow_needs_the_sun_and_goes_where_the_sun_sends_it() {
    let empty = ["lane.1.inflow_veh_h=0.0", "lane.2.inflow_veh_h=0.0"];
    let cast = r#"roadside.shadow=[{ kind = "gantry", at_m = 30.0, offset_m = 9.0, to_offset_m = -9.0, height_m = 6.0, width_m = 2.0 }, { kind = "leaves", at_m = 22.0, offset_m = 5.0, height_m = 8.0 }, { kind = "mast", at_m = 40.0, offset_m = 6.0, height_m = 9.0, width_m = 0.6 }]"#;
    let pixels = |light: &[&str]| {
        let plain = [&empty[..], light].concat();
        changed(&frame(&plain), &frame(&[&plain[..], &[cast]].concat()), 8)
    };
    let sun = pixels(&[]);
    assert!(sun.len() > 100, "{} px", sun.len());
    assert_ne!(sun, pixels(&["light.sun_azimuth_deg=270.0"]));
    for light in
        ["light.cloud=1.0", "light.rain=1.0", "light.daylight=night", "light.daylight=dusk"]
    {
        assert_eq!(pixels(&[light]), [], "{light}");
    }
}

#[test]
fn a_closure_hides_what_is_behind_it_and_is_no_vehicle() {
    // The camera looks over the row, between the lanes, at the farther one.
    let aside = ["road.start_x_m=7.0", "camera.pan_deg=8.0", "camera.height_m=7.0"];
    let plain = frame(&aside);
    let hidden = |frame: &Frame| frame.truth.vehicles.iter().map(|v| v.occlusion).sum::<f64>();
    let boxes = |frame: &Frame| {
        let vehicles = &frame.truth.vehicles;
        vehicles.iter().map(|v| (v.id, v.bounds.map(f64::to_bits))).collect::<Vec<_>>()
    };
    for kind in ["water", "concrete", "cone"] {
        let row = format!(
            r#"roadside.closure=[{{ kind = "{kind}", from_m = 12.0, to_m = 90.0, offset_m = 0.0, gap_m = 1.0 }}]"#
        );
        let closed = frame(&[&aside[..], &[row.as_str()]].concat());
        assert!(changed(&plain, &closed, 25).len() > 15, "{kind}");
        assert_eq!(boxes(&plain), boxes(&closed), "{kind}");
        // A cone is narrower than a pixel here.
        assert!(kind == "cone" || hidden(&closed) > hidden(&plain), "{kind}");
    }
}

fn lorries(share: f64, run: f64) -> Simulation {
    let share = format!("fleet.trailer_share={share}");
    let run = format!("fleet.truck_run={run}");
    let scene = support::tiny(&[
        "fleet.truck=0.3",
        &share,
        &run,
        "measure.min_car_height_px=2.0",
        "camera.tilt_deg=14.0",
        "warmup_s=200.0",
    ]);
    Simulation::new(&scene, 4).expect("a street")
}

/// The vehicles of both lanes that were first seen in half an hour, each lane in its order.
fn passed(street: &mut Simulation) -> Vec<Vehicle> {
    let mut seen: Vec<Vehicle> = Vec::new();
    let mut all = Vec::new();
    for lane in 0..2 {
        let mut copy = street.clone();
        for _ in 0..1800 {
            copy.step(1.0);
            for vehicle in copy.lanes()[lane].vehicles() {
                if seen.iter().rev().take(60).all(|known| known.id != vehicle.id) {
                    seen.push(vehicle.clone());
                }
            }
        }
        all.append(&mut seen);
    }
    all
}

#[test]
fn a_lorry_with_a_trailer_is_one_truck_with_its_length_and_a_box_around_it() {
    let mut street = lorries(1.0, 1.0);
    let camera = street.scene().camera();
    let mut seen = 0;
    for _ in 0..120 {
        street.step(2.0);
        let snapshot = street.snapshot();
        let vehicles = street::truth::vehicles(&street, &snapshot, &camera);
        for found in vehicles.iter().filter(|v| v.class == Class::Truck) {
            assert_eq!(found.model, "Articulated_Lorry");
            let placed: Vec<_> = snapshot.vehicles.iter().filter(|v| v.id == found.id).collect();
            assert_eq!(placed.len(), 1);
            assert_eq!(placed[0].model().length_m(), 16.5);
            let [x0, y0, x1, y1] = found.bounds;
            for point in [[0.2, -16.4, 0.5], [2.5, -0.1, 1.2], [0.0, 0.0, 4.0], [2.55, -13.6, 4.0]]
            {
                let image = camera.project(&placed[0].world(point)).expect("in front");
                let inside = |v: f64, low: f64, high: f64, end: u32| {
                    let v = v.clamp(0.0, f64::from(end));
                    (low - 0.6..=high + 0.6).contains(&v)
                };
                assert!(
                    inside(image[0], x0, x1, camera.width)
                        && inside(image[1], y0, y1, camera.height),
                    "{image:?} is outside {found:?}"
                );
            }
            seen += 1;
        }
    }
    assert!(seen > 50, "{seen} lorries");
}

#[test]
fn trucks_run_nose_to_tail_with_their_share_and_the_flow_kept() {
    let count = |run: f64| {
        let vehicles = passed(&mut lorries(0.5, run));
        let truck = |v: &Vehicle| v.model().class == Class::Truck;
        let trucks = vehicles.iter().filter(|v| truck(v)).count();
        let starts = vehicles.windows(2).filter(|pair| !truck(&pair[0]) && truck(&pair[1])).count();
        (vehicles.len(), trucks, trucks as f64 / starts as f64)
    };
    let (all, trucks, by_chance) = count(1.0);
    let (all_runs, trucks_runs, in_runs) = count(5.0);
    assert!(by_chance < 2.0 && (3.5..7.0).contains(&in_runs), "runs of {by_chance}, {in_runs}");
    assert!((all_runs as f64 / all as f64 - 1.0).abs() < 0.12, "{all_runs} instead of {all}");
    let share = |trucks: usize, all: usize| trucks as f64 / all as f64;
    let drift = share(trucks_runs, all_runs) - share(trucks, all);
    assert!(drift.abs() < 0.08, "the share of trucks moves by {drift}");
}

#[test]
fn trucks_of_a_run_stand_nearer_to_one_another_than_others_do() {
    let mut street = lorries(0.5, 5.0);
    let mut gaps: [Vec<f64>; 2] = [vec![], vec![]];
    for _ in 0..600 {
        street.step(3.0);
        for lane in street.lanes() {
            let vehicles: Vec<_> = lane.vehicles().collect();
            for pair in vehicles.windows(2) {
                let gap = pair[0].front_m - pair[0].model().length_m() - pair[1].front_m;
                assert!(gap > 0.0, "a collision: {gap} m");
                let trucks = pair.iter().all(|v| v.model().class == Class::Truck);
                gaps[usize::from(trucks)].push(gap);
            }
        }
    }
    let [others, trucks] = gaps.map(|mut gaps| {
        gaps.sort_by(f64::total_cmp);
        gaps[gaps.len() / 2]
    });
    assert!(trucks < 0.6 * others && trucks < 18.0, "{trucks} m between trucks, {others} m else");
}

#[test]
fn bad_marks_are_refused_with_key_and_what_may_stand_there() {
    for (change, key, expected) in [
        (r#"painted=[{ kind = "arrow", at_m = 9.0, lane = 7 }]"#, "painted.1.lane = 7", "1 to 2"),
        (
            r#"painted=[{ kind = "arrow", at_m = 9.0 }]"#,
            "painted.1.lane",
            "either lane or offset_m",
        ),
        (
            r#"painted=[{ kind = "arrow", at_m = 9.0, lane = 1, offset_m = 0.0 }]"#,
            "painted.1.lane",
            "either",
        ),
        (r#"painted=[{ kind = "arrow", at_m = -9.0, lane = 1 }]"#, "painted.1.at_m", "from 0"),
        (r#"painted=[{ kind = "word", at_m = 9.0, lane = 1 }]"#, "painted.1.text", "words of"),
        (
            r#"painted=[{ kind = "word", at_m = 9.0, lane = 1, text = "SLÖW" }]"#,
            "painted.1.text",
            "words of",
        ),
        (
            r#"painted=[{ kind = "cycle", at_m = 9.0, lane = 1, text = "A" }]"#,
            "painted.1.text",
            "word",
        ),
        (
            r#"painted=[{ kind = "cycle", at_m = 9.0, lane = 1, worn = 2.0 }]"#,
            "painted.1.worn",
            "to 1",
        ),
        (
            r#"overlay=[{ kind = "text", x = 0.0, y = 0.0, size_px = 8.0 }]"#,
            "overlay.1.text",
            "{time}",
        ),
        (r#"overlay=[{ kind = "bar", x = 2.0, y = 0.0, size_px = 8.0 }]"#, "overlay.1.x", "to 1"),
        (
            r#"overlay=[{ kind = "bar", x = 0.0, y = 0.0, size_px = 800.0 }]"#,
            "overlay.1.size_px",
            "to 120",
        ),
        (
            r#"roadside.closure=[{ kind = "water", from_m = 9.0, to_m = 30.0, offset_m = 1.8 }]"#,
            "roadside.closure.1.offset_m",
            "which has traffic",
        ),
        (
            r#"roadside.closure=[{ kind = "cone", from_m = 9.0, to_m = 30.0, offset_m = 5.0, gap_m = 0.0 }]"#,
            "roadside.closure.1.gap_m",
            "from 0.5",
        ),
        (
            r#"roadside.shadow=[{ kind = "mast", at_m = 9.0, offset_m = 5.0, height_m = 0.0 }]"#,
            "roadside.shadow.1.height_m",
            "from 1",
        ),
        ("fleet.trailer_share=1.5", "fleet.trailer_share", "to 1"),
        ("fleet.truck_run=0.5", "fleet.truck_run", "from 1"),
    ] {
        let text = include_str!("../scenes/tiny.toml");
        let fault = Scene::parse(text, "bad.toml", &[change.to_owned()]).expect_err(change);
        let message = fault.to_string();
        assert!(message.contains(key) && message.contains(expected), "{change}: {message}");
    }
    for (change, key) in [
        (r#"painted=[{ kind = "arrow", at_m = 9.0, lane = 1, colour = "red" }]"#, "colour"),
        (r#"painted=[{ kind = "circle", at_m = 9.0, lane = 1 }]"#, "circle"),
        (r#"overlay=[{ kind = "text", text = "A", x = 0.0, y = 0.0, size = 8.0 }]"#, "size"),
        (
            r#"roadside.shadow=[{ kind = "cloud", at_m = 9.0, offset_m = 5.0, height_m = 9.0 }]"#,
            "cloud",
        ),
    ] {
        let text = include_str!("../scenes/tiny.toml");
        let fault = Scene::parse(text, "bad.toml", &[change.to_owned()]).expect_err(change);
        assert!(fault.to_string().contains(key), "{change}: {fault}");
    }
}
