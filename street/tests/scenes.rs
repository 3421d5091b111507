//! Scene files: every mistake is named with its key, and the shipped scenes are valid.

mod support;

use street::error::Error;
use street::scene::Scene;
use street::simulation::Simulation;
use verge_desk::Exit;

const TINY: &str = include_str!("../scenes/tiny.toml");

#[test]
fn unknown_keys_are_refused_by_name() {
    for (text, key) in [
        (TINY.replace("height_m = 10.0", "height_m = 10.0\nfocus_px = 3"), "focus_px"),
        (TINY.replace("warmup_s", "warm_up_s"), "warm_up_s"),
    ] {
        let fault = Scene::parse(&text, "bad.toml", &[]).expect_err(key);
        assert!(matches!(fault, Error::SceneSyntax { .. }));
        assert_eq!(fault.exit_code(), 65);
        let message = fault.to_string();
        assert!(message.contains("bad.toml") && message.contains(key), "{message}");
    }
}

#[test]
fn values_out_of_range_are_refused_with_key_and_range() {
    for (change, key) in [
        ("camera.focal_px=-1.0", "camera.focal_px"),
        ("camera.k1=-5.0", "camera.k1"),
        ("camera.tilt_deg=nan", "camera.tilt_deg"),
        ("interval_s=0.0", "interval_s"),
        ("start=yesterday", "start"),
        ("start=2026-02-29T00:00:00Z", "start"),
        ("start=2026-01-05T08:00:00", "start"),
        ("start=2026-01-05T08:00:00.0001Z", "start"),
        ("start=9999-12-31T00:00:00Z", "start"),
        ("name=a/b", "name"),
        ("light.rain=2.0", "light.rain"),
        ("imaging.jpeg_quality=0", "imaging.jpeg_quality"),
        ("fleet.car=-1.0", "fleet.car"),
        ("faults.shake_px=99.0", "faults.shake_px"),
        ("lane.2.width_m=1.0", "lane.2.width_m"),
    ] {
        let fault = Scene::parse(TINY, "bad.toml", &[change.to_owned()]).expect_err(change);
        let message = fault.to_string();
        assert!(matches!(fault, Error::SceneValue { .. }), "{message}");
        assert!(message.contains(&format!("{key} = ")), "{message}");
    }
}

#[test]
fn a_list_is_changed_by_the_number_of_its_entry() {
    let changed = |change: &str| Scene::parse(TINY, "tiny.toml", &[change.to_owned()]);
    let scene = changed("lane.2.speed_km_h=31.0").expect("a scene");
    assert!(scene.lanes[1].speed_km_h == 31.0 && scene.lanes[0].speed_km_h != 31.0);
    for change in ["lane.0.speed_km_h=31.0", "lane.9.speed_km_h=31.0", "lane.speed_km_h=31.0"] {
        let message = changed(change).expect_err(change).to_string();
        assert!(message.contains("lane is a list of 2: write lane.1.key=value"), "{message}");
    }
}

#[test]
fn a_section_must_be_on_the_measured_stretch() {
    for change in ["lane.1.section_m=100.0", "lane.1.section_m=-1.0"] {
        let message = Simulation::new(&support::tiny(&[change]), 1).expect_err(change).to_string();
        assert!(
            message.contains("lane.1.section_m = ") && message.contains("stretch of"),
            "{message}"
        );
    }
}

#[test]
fn a_frames_time_is_counted_from_the_start_to_the_millisecond() {
    let scene = support::tiny(&["start=2024-02-29T23:59:59.999Z", "interval_s=0.0333"]);
    let times = [0, 1, 30].map(|frame| scene.frame_time(frame).to_string());
    let expected =
        ["2024-02-29T23:59:59.999Z", "2024-03-01T00:00:00.032Z", "2024-03-01T00:00:00.998Z"];
    assert_eq!(times, expected);
}

#[test]
fn a_lane_out_of_sight_is_refused_with_the_length_found() {
    let scene = support::tiny(&["measure.min_car_height_px=60.0"]);
    let fault = Simulation::new(&scene, 1).expect_err("no lane is so near");
    assert!(matches!(fault, Error::LaneNotVisible { lane: 1, .. }), "{fault}");
}

#[test]
fn a_missing_scene_is_no_input() {
    let fault = Scene::read(std::path::Path::new("no/such.toml"), &[]).expect_err("missing");
    assert_eq!(fault.exit_code(), 66);
}

#[test]
fn the_shipped_scenes_are_valid_and_their_lanes_are_seen() {
    let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes");
    let mut seen = 0;
    for entry in std::fs::read_dir(folder).expect("scenes/") {
        let scene = Scene::read(&entry.expect("an entry").path(), &[]).expect("a valid scene");
        Simulation::new(&scene, 1).expect("lanes in sight");
        seen += 1;
    }
    assert!(seen >= 3);
}
