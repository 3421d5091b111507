//! Tests of the choice among boxes, with weights as the shipped model has them in kind.

use super::*;
use crate::units::ImagePoint;
use std::vec::Vec;

const WEIGHTS: Evidence = Evidence {
    floor: 0.12,
    same: 0.75,
    least: 0.5,
    bias: 1.5,
    score: 2.5,
    car_px: 0.0,
    car: ClassWeights { class: 0.0, size: 0.5, size_squared: -4.0, small: -3.0 },
    large: ClassWeights { class: -0.5, size: 0.5, size_squared: 0.0, small: 0.0 },
    motorcycle: ClassWeights { class: 0.0, size: 0.0, size_squared: 0.0, small: 0.0 },
    inside: -1.0,
    inside_squared: -2.0,
    overlap: -2.0,
    beside: 1.0,
    apart: 0.5,
    behind: 0.5,
    empty: -6.0,
    chain: 0.0,
    chain_inside: 0.0,
};

fn detection(x0: f32, y0: f32, x1: f32, y1: f32, score: f32) -> Detection {
    Detection { bounds: PixelBox { x0, y0, x1, y1 }, score, class: VehicleClass::Car }
}

/// Cars of 20 px everywhere.
fn expected() -> Expected {
    let places = (0..40).map(|i| ImagePoint { u: (i * 37 % 320) as f32, v: (i * 53 % 240) as f32 });
    let size = CarSize::fit(places.map(|p| (p, 20.0)), 320.0).expect("enough samples");
    Expected { size, width: 320.0, input_px: 2.0 }
}

fn selected(mut boxes: Vec<Detection>) -> Vec<Detection> {
    let count = WEIGHTS.select(&mut boxes, Some(&expected()), |_| 0.0, 0.5);
    boxes.truncate(count);
    boxes
}

#[test]
fn a_box_over_two_places_gives_way_to_the_two_inside_it() {
    let both = detection(100.0, 100.0, 140.0, 120.0, 0.5);
    let (left, right) =
        (detection(100.0, 100.0, 119.0, 120.0, 0.5), detection(121.0, 100.0, 140.0, 120.0, 0.5));
    let found = selected(std::vec![both, left, right]);
    let bounds: Vec<_> = found.iter().map(|d| d.bounds).collect();
    assert_eq!(bounds, [left.bounds, right.bounds]);
}

#[test]
fn a_part_of_a_car_is_no_car() {
    let car = detection(100.0, 100.0, 120.0, 120.0, 0.7);
    let roof = detection(104.0, 101.0, 114.0, 109.0, 0.4);
    assert_eq!(selected(std::vec![roof, car]).len(), 1);
    assert_eq!(selected(std::vec![roof]).len(), 0, "nor alone: nothing of its size stands here");
}

#[test]
fn a_box_of_an_impossible_size_needs_a_better_score() {
    let sized = |side: f32| std::vec![detection(100.0, 100.0, 100.0 + side, 100.0 + side, 0.4)];
    assert_eq!(selected(sized(20.0)).len(), 1);
    for side in [6.0, 90.0] {
        assert_eq!(selected(sized(side)).len(), 0, "{side} px");
    }
}

#[test]
fn scores_are_probabilities_that_fall() {
    let boxes: Vec<_> = (0..6)
        .map(|i| {
            detection(40.0 * i as f32, 100.0, 40.0 * i as f32 + 20.0, 120.0, 0.9 - 0.1 * i as f32)
        })
        .collect();
    let found = selected(boxes);
    assert!(found.len() >= 4);
    assert!(found.iter().all(|d| (0.5..=1.0).contains(&d.score)));
    assert!(found.is_sorted_by(|a, b| a.score >= b.score));
}

#[test]
fn scores_of_0_and_1_and_no_boxes_are_harmless() {
    assert_eq!(WEIGHTS.select(&mut [], None, |_| 0.0, 0.5), 0);
    let boxes = std::vec![
        detection(0.0, 0.0, 20.0, 20.0, 0.0),
        detection(40.0, 0.0, 60.0, 20.0, 1.0),
        detection(80.0, 9.0, 80.0, 9.0, f32::NAN),
    ];
    let found = selected(boxes);
    assert_eq!(found.len(), 1);
    assert!(found[0].score > 0.9);
}

#[test]
fn what_looks_like_the_empty_road_is_no_vehicle() {
    let arrow = detection(100.0, 100.0, 120.0, 120.0, 0.5);
    let counted =
        |likeness: f32| WEIGHTS.select(&mut [arrow], Some(&expected()), |_| likeness, 0.5);
    assert_eq!((counted(0.0), counted(0.1), counted(0.8)), (1, 1, 0));
}

#[test]
fn in_a_queue_less_of_a_vehicle_is_enough() {
    // The visible strip of a car behind a van is a weak box; alone it does not count.
    let weak = detection(102.0, 84.0, 120.0, 104.0, 0.34);
    let queue = [[100.0, 100.0], [101.0, 122.0], [99.0, 142.0], [103.0, 62.0], [102.0, 42.0]];
    let mut boxes: Vec<_> =
        queue.iter().map(|&[x, y]| detection(x, y, x + 20.0, y + 20.0, 0.7)).collect();
    boxes.push(weak);
    let with = |chain, boxes: &[Detection]| {
        let weights = Evidence { bias: 0.5, chain, ..WEIGHTS };
        let mut boxes = boxes.to_vec();
        weights.select(&mut boxes, Some(&expected()), |_| 0.0, 0.5)
    };
    assert_eq!(with(0.0, &boxes), 5);
    assert_eq!(with(3.0, &boxes), 6);
    assert_eq!(with(3.0, &[weak]), 0, "alone it is none");
    // A queue in another lane, six cars' widths away, says nothing.
    let mut away = boxes.clone();
    away.truncate(5);
    away.push(detection(222.0, 84.0, 240.0, 104.0, 0.34));
    assert_eq!(with(3.0, &away), 5);
}
