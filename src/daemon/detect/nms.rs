//! Non-maximum suppression: of boxes on one vehicle the best stays.

use super::sidecar::Thresholds;
use crate::daemon::frame::Detection;
use std::cmp::Ordering;

/// Falling scores; equal ones by position, so that the same picture gives the same boxes.
pub(super) fn best_first(a: &Detection, b: &Detection) -> Ordering {
    let position = |d: &Detection| (d.bounds.y0, d.bounds.x0);
    b.score
        .total_cmp(&a.score)
        .then(position(a).0.total_cmp(&position(b).0))
        .then(position(a).1.total_cmp(&position(b).1))
}

/// Moves into `kept` the best of `candidates`, each overlapping no better one by more than
/// `thresholds` have it whatever its class. At most `limit` candidates are looked at, best first.
pub(super) fn suppress(
    candidates: &mut Vec<Detection>,
    thresholds: &Thresholds,
    limit: usize,
    kept: &mut Vec<Detection>,
) {
    candidates.sort_unstable_by(best_first);
    candidates.truncate(limit);
    for candidate in candidates {
        let bounds = &candidate.bounds;
        let is_other = |better: &Detection| {
            better.bounds.iou(bounds) <= thresholds.iou
                && better.bounds.ios(bounds) <= thresholds.ios
        };
        if kept.iter().all(is_other) {
            kept.push(*candidate);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::daemon::frame::PixelBox;
    use crate::units::VehicleClass;

    const THRESHOLDS: Thresholds = Thresholds { score: 0.3, iou: 0.6, ios: 0.7 };

    fn detection(x0: f32, score: f32, class: VehicleClass) -> Detection {
        let bounds = PixelBox { x0, y0: 0.0, x1: x0 + 10.0, y1: 10.0 };
        Detection { bounds, score, class }
    }

    #[test]
    fn the_best_of_overlapping_boxes_stays_whatever_its_class() {
        let mut candidates = vec![
            detection(0.0, 0.5, VehicleClass::Car),
            detection(1.0, 0.9, VehicleClass::Truck),
            detection(30.0, 0.4, VehicleClass::Car),
        ];
        let mut kept = Vec::new();
        suppress(&mut candidates, &THRESHOLDS, 100, &mut kept);
        let scores: Vec<_> = kept.iter().map(|d| d.score).collect();
        assert_eq!(scores, [0.9, 0.4]);
    }

    #[test]
    fn neighbours_in_a_queue_stay() {
        let mut candidates =
            vec![detection(0.0, 0.9, VehicleClass::Car), detection(4.0, 0.8, VehicleClass::Car)];
        let mut kept = Vec::new();
        suppress(&mut candidates, &THRESHOLDS, 100, &mut kept);
        assert_eq!(kept.len(), 2);
    }

    #[test]
    fn the_front_of_a_lorry_is_no_second_vehicle() {
        let mut front = detection(0.0, 0.8, VehicleClass::Car);
        front.bounds.y0 = 6.0;
        let mut candidates = vec![detection(0.0, 0.9, VehicleClass::Truck), front];
        assert!(candidates[0].bounds.iou(&front.bounds) < THRESHOLDS.iou);
        let mut kept = Vec::new();
        suppress(&mut candidates, &THRESHOLDS, 100, &mut kept);
        assert_eq!(kept.len(), 1);
    }
}
