//! The shipped net over larger and smaller pictures: the same weights, another input size.

mod common;

use std::path::Path;
use verge::daemon::capture::decode;
use verge::daemon::detect::{Detector, LoadOptions, Precision};
use verge::daemon::frame::{Detection, Picture, PixelBox};

fn load(input_px: Option<[usize; 2]>, precision: Precision) -> Detector {
    let options = LoadOptions { input_px, precision, ..LoadOptions::default() };
    Detector::load_as(Path::new(common::MODEL), &options).expect("it ships")
}

fn frame() -> Picture {
    let mut frames: Vec<_> = std::fs::read_dir("tests/data/freeway/frames")
        .expect("it ships")
        .map(|entry| entry.expect("an entry").path())
        .collect();
    frames.sort();
    let mut picture = Picture::default();
    decode(&std::fs::read(&frames[0]).expect("it ships"), &mut picture).expect("a whole frame");
    picture
}

fn found(detector: &mut Detector, picture: &Picture) -> Vec<Detection> {
    let mut found = Vec::new();
    detector.detect(picture, &mut found).expect("inference");
    found
}

/// Share of `these` that a box of `those` covers by more than half.
fn covered(these: &[Detection], those: &[Detection]) -> f64 {
    let is = |bounds: &PixelBox| those.iter().any(|other| other.bounds.iou(bounds) > 0.5);
    these.iter().filter(|found| is(&found.bounds)).count() as f64 / these.len() as f64
}

#[test]
fn other_sizes_find_the_same_vehicles() {
    let picture = frame();
    let stored = found(&mut load(None, Precision::AsStored), &picture);
    assert!(stored.len() > 10, "{}", stored.len());
    for size in [[960, 736], [800, 608], [640, 480], [416, 320]] {
        let mut detector = load(Some(size), Precision::AsStored);
        assert_eq!(detector.input_size(), size);
        let other = found(&mut detector, &picture);
        println!("{size:?}: {} boxes, stored {}", other.len(), stored.len());
        // The smallest input leaves far vehicles too small to be found.
        let least = if size[0] < 640 { 0.5 } else { 0.8 };
        assert!(covered(&stored, &other) > least, "{size:?}: {other:?}");
        assert!(covered(&other, &stored) > least, "{size:?}: {other:?}");
        if size == [640, 480] {
            assert_eq!(other, stored);
        }
    }
}

#[test]
fn other_sizes_give_the_same_boxes_on_the_portable_kernels() {
    let (size, picture) = (Some([416, 320]), frame());
    let fast = found(&mut load(size, Precision::AsStored), &picture);
    assert_eq!(fast, found(&mut load(size, Precision::Portable), &picture));
}

#[test]
fn a_size_that_is_no_multiple_of_the_strides_is_refused() {
    for size in [[641, 480], [0, 480], [640, 8192]] {
        let options = LoadOptions { input_px: Some(size), ..LoadOptions::default() };
        let error = Detector::load_as(Path::new(common::MODEL), &options).expect_err("refused");
        let error = error.to_string();
        assert!(error.contains("multiple of 32") && error.contains("px is asked for"), "{error}");
    }
}

#[test]
fn a_box_that_is_too_slow_for_its_camera_gets_a_smaller_input() {
    use std::time::Duration;
    use verge::daemon::config::NetInput;
    use verge::daemon::line::{Line, LineSettings};
    let settings = |input| LineSettings {
        input,
        ..LineSettings::recorded(Path::new(common::STREET_TABLE), Path::new(common::MODEL))
    };
    let mut line = Line::open(&settings(NetInput::Auto)).expect("it ships");
    assert_eq!(line.input_size(), [800, 608]);
    line.keep_within(Duration::from_secs(3600)).expect("the net runs");
    assert_eq!(line.input_size(), [800, 608], "there is time");
    line.keep_within(Duration::from_nanos(1)).expect("the net runs");
    assert_eq!(line.input_size(), [640, 480], "the smallest that the model states");
    let mut set = Line::open(&settings(NetInput::Px([800, 608]))).expect("it ships");
    set.keep_within(Duration::from_nanos(1)).expect("the net runs");
    assert_eq!(set.input_size(), [800, 608], "what is asked for stays");
}
