//! Two passes over one picture: which box of which pass stands.
//!
//! Owns the rule. The close pass, which sees its part larger, answers for every vehicle that
//! is whole in its part; the wide one for all others. A box that the border of the close part
//! cuts off is therefore none of the close pass's, and a box of both that overlap is one
//! vehicle: where the two disagree about which of them it belongs to, the wide one keeps it.

use super::nms::best_first;
use crate::daemon::frame::{Detection, Picture, PixelBox, Region};

/// Boxes of two passes that overlap by more than this (IoU) are one vehicle. Less than within
/// a pass: the two see it at different scales, and neighbours in one pass are told apart there.
const SAME: f32 = 0.45;
/// A box that ends this close to the border of its part, px of the picture, is cut off there.
const CUT_PX: f32 = 0.5;
/// How far inside a box must lie to be whole in the close part, px of the picture. Larger than
/// [`CUT_PX`], so that a vehicle at the border is not refused by both passes.
const INSIDE_PX: f32 = 2.0;

/// Adds what the pass over `part` has found to what the wider pass before has, best first.
pub(super) fn merge(
    found: &mut Vec<Detection>,
    close: &[Detection],
    part: Region,
    picture: &Picture,
) {
    found.retain(|detection| !is_inside(&detection.bounds, part, picture, INSIDE_PX));
    let wide = found.len();
    for detection in close {
        let bounds = &detection.bounds;
        let is_new = || found[..wide].iter().all(|other| other.bounds.iou(bounds) <= SAME);
        if is_inside(bounds, part, picture, CUT_PX) && is_new() {
            found.push(*detection);
        }
    }
    found.sort_unstable_by(best_first);
}

/// Whether a box lies so far inside of `part`. At the picture's own edge a wider pass would see no
/// more of it.
fn is_inside(bounds: &PixelBox, part: Region, picture: &Picture, by: f32) -> bool {
    let low = |value: f32, first: usize| first == 0 || value >= first as f32 + by;
    let high = |value: f32, end: usize, all: usize| end >= all || value <= end as f32 - by;
    low(bounds.x0, part.x)
        && low(bounds.y0, part.y)
        && high(bounds.x1, part.x + part.width, picture.width)
        && high(bounds.y1, part.y + part.height, picture.height)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::units::VehicleClass;

    const PART: Region = Region { x: 100, y: 0, width: 100, height: 100 };

    fn picture() -> Picture {
        Picture { width: 320, height: 240, rgb: Vec::new() }
    }

    fn at(x0: f32, y0: f32, score: f32) -> Detection {
        let bounds = PixelBox { x0, y0, x1: x0 + 20.0, y1: y0 + 20.0 };
        Detection { bounds, score, class: VehicleClass::Car }
    }

    fn merged(wide: &[Detection], close: &[Detection]) -> Vec<f32> {
        let mut found = wide.to_vec();
        merge(&mut found, close, PART, &picture());
        found.iter().map(|detection| detection.score).collect()
    }

    #[test]
    fn the_close_pass_answers_for_its_part_and_the_wide_one_for_the_rest() {
        let wide = [at(140.0, 40.0, 0.9), at(10.0, 10.0, 0.6), at(150.0, 150.0, 0.5)];
        let close = [at(141.0, 40.0, 0.7), at(160.0, 60.0, 0.8)];
        assert_eq!(merged(&wide, &close), [0.8, 0.7, 0.6, 0.5]);
    }

    #[test]
    fn what_the_close_pass_does_not_see_in_its_part_is_none() {
        assert_eq!(merged(&[at(140.0, 40.0, 0.9)], &[]), [0.0; 0]);
    }

    #[test]
    fn a_vehicle_on_the_border_is_the_wide_passes() {
        // Cut off at the part's left and lower border, and seen whole by the wide pass.
        for (wide, cut) in [
            (at(90.0, 40.0, 0.5), PixelBox { x0: 100.0, y0: 40.0, x1: 110.0, y1: 60.0 }),
            (at(140.0, 90.0, 0.5), PixelBox { x0: 140.0, y0: 90.0, x1: 160.0, y1: 100.0 }),
        ] {
            let close = Detection { bounds: cut, score: 0.9, class: VehicleClass::Car };
            assert_eq!(merged(&[wide], &[close]), [0.5]);
        }
    }

    #[test]
    fn a_vehicle_beside_the_border_counts_once_wherever_the_passes_put_its_edge() {
        for wide_x0 in [98.0, 99.5, 100.0, 100.4, 101.0, 101.9, 102.1, 103.0] {
            for close_x0 in [100.0, 100.4, 100.6, 101.5, 102.5] {
                // Two passes agree to about a pixel.
                if f32::abs(wide_x0 - close_x0) > 1.5 {
                    continue;
                }
                let found = merged(&[at(wide_x0, 40.0, 0.5)], &[at(close_x0, 40.0, 0.9)]);
                assert_eq!(found.len(), 1, "{wide_x0} {close_x0}");
            }
        }
    }

    #[test]
    fn where_the_part_ends_with_the_picture_nothing_is_cut_off() {
        assert_eq!(merged(&[at(140.0, 0.0, 0.5)], &[at(140.0, 0.0, 0.9)]), [0.9]);
    }

    #[test]
    fn neighbours_that_one_pass_tells_apart_stay() {
        let close = [at(140.0, 40.0, 0.9), at(147.0, 40.0, 0.8)];
        assert!(close[0].bounds.iou(&close[1].bounds) > SAME);
        assert_eq!(merged(&[], &close), [0.9, 0.8]);
    }
}
