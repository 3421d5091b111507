//! That boxes count only in the pictures in which they were found.

use super::super::super::program::Detector;
use super::super::Traffic;
use super::*;

const BOXES: &str = "[[1.0, 2.0, 3.0, 4.0, 0.9, \"car\"]]";

fn line(name: &str) -> String {
    format!("{{\"frame\": \"{name}\", \"boxes\": {BOXES}}}\n")
}

fn draw(path: &Path, width: u32, shade: u8) {
    image::RgbImage::from_pixel(width, 24, image::Rgb([shade; 3])).save(path).unwrap();
}

/// A folder with pictures a, b and c.
fn site() -> (tempfile::TempDir, Site) {
    let folder = tempfile::tempdir().unwrap();
    for (k, name) in ["a.png", "b.png", "c.png"].iter().enumerate() {
        draw(&folder.path().join(name), 32, k as u8);
    }
    let site = Site::of(folder.path(), None).unwrap();
    std::fs::create_dir(&site.folder).unwrap();
    (folder, site)
}

/// The same, searched.
fn searched() -> (tempfile::TempDir, Site) {
    let (folder, site) = site();
    let text = ["a.png", "b.png", "c.png"].map(line).concat();
    std::fs::write(site.file(DETECTIONS), text).unwrap();
    assert_eq!(Searched::bound(&site, pictures_of(&site)).unwrap().frames.len(), 3);
    (folder, site)
}

#[test]
fn boxes_of_replaced_or_missing_pictures_are_dropped() {
    let (folder, site) = searched();
    let (same, note) = Searched::saved(&site);
    assert_eq!((same.frames.len(), note.stale, note.said), (3, 0, None));
    draw(&folder.path().join("a.png"), 32, 99);
    std::fs::remove_file(folder.path().join("b.png")).unwrap();
    let traffic = Traffic::new(None, &site, None).unwrap();
    let state = traffic.state();
    assert_eq!((state.state, state.frames, state.stale), ("done", 1, 2));
    assert!(state.problem.unwrap().contains("2 of 3"));
    assert_eq!(traffic.cue().len(), 1);
    draw(&folder.path().join("c.png"), 32, 98);
    let state = Traffic::new(None, &site, None).unwrap().state();
    assert_eq!((state.state, state.frames, state.stale), ("idle", 0, 3));
}

#[test]
fn boxes_of_unknown_pictures_are_not_taken() {
    let (_folder, site) = searched();
    std::fs::remove_file(site.file(SOURCES)).unwrap();
    let (none, note) = Searched::saved(&site);
    assert_eq!((none.frames.len(), note.stale), (0, 3));
    let (_folder, site) = searched();
    std::fs::write(site.file(DETECTIONS), line("a.png")).unwrap();
    assert!(Searched::saved(&site).0.frames.is_empty(), "it is not the file that was bound");
}

#[test]
fn pictures_of_another_size_have_no_boxes() {
    let (folder, site) = site();
    draw(&folder.path().join("b.png"), 64, 1);
    std::fs::write(site.file(DETECTIONS), ["a.png", "b.png"].map(line).concat()).unwrap();
    assert_eq!(Searched::bound(&site, pictures_of(&site)).unwrap().frames.len(), 1);
    let (again, note) = Searched::saved(&site);
    assert_eq!((again.frames.len(), note.stale), (1, 0), "they were never taken");
}

#[test]
fn damaged_boxes_stop_nothing_unless_they_were_asked_for() {
    let (_folder, site) = searched();
    let path = site.file(DETECTIONS);
    std::fs::write(&path, line("a.png") + "{\"frame\": \"b.png\", \"boxes\": [[1.0, ").unwrap();
    let state = Traffic::new(None, &site, None).unwrap().state();
    let said = state.problem.unwrap();
    assert_eq!(state.state, "idle");
    assert!(said.contains("detections.jsonl line 2: EOF") && said.contains("again"), "{said}");
    assert_eq!(said.matches("line").count(), 1, "{said}");
    assert!(Traffic::new(None, &site, Some(&path)).is_err());
}

#[test]
fn given_boxes_are_those_of_pictures_that_are_there() {
    let (folder, site) = site();
    let path = folder.path().join("given.jsonl");
    std::fs::write(&path, ["a.png", "x.png"].map(line).concat()).unwrap();
    let (given, note) = Searched::given(&path, &site).unwrap();
    assert_eq!((given.frames.len(), note.stale), (1, 1));
    assert!(given.holds("a.png", &folder.path().join("a.png")));
    draw(&folder.path().join("a.png"), 32, 77);
    assert!(!given.holds("a.png", &folder.path().join("a.png")));
}

#[cfg(unix)]
#[test]
fn a_search_can_be_made_again() {
    use std::os::unix::fs::PermissionsExt;
    let (folder, site) = searched();
    let program = folder.path().join("verge");
    let script = format!("#!/bin/sh\nprintf '%s' '{}' > \"$6\"\n", line("b.png"));
    std::fs::write(&program, script).unwrap();
    std::fs::set_permissions(&program, PermissionsExt::from_mode(0o755)).unwrap();
    draw(&folder.path().join("a.png"), 32, 99);
    let detector = Detector { program, model: "model".into() };
    let traffic = Traffic::new(Some(detector), &site, None).unwrap();
    assert_eq!((traffic.state().frames, traffic.state().stale), (2, 1));
    traffic.start(&site).unwrap();
    while traffic.state().state == "running" {
        std::thread::sleep(std::time::Duration::from_millis(5));
    }
    let state = traffic.state();
    assert_eq!((state.state, state.frames, state.stale), ("done", 1, 0), "{:?}", state.problem);
    assert_eq!(Searched::saved(&site).0.frames.len(), 1);
}
