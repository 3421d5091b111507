//! Guess of a model's head, from the shapes of its outputs.

use super::error::sizes;
use super::head_key::{HeadKind, HeadSpec};
use super::sidecar::Sidecar;

/// Strides of detectors with three levels, and with four.
const THREE: [usize; 3] = [8, 16, 32];
const FOUR: [usize; 4] = [8, 16, 32, 64];

/// Bins of a side's distance in NanoDet-Plus and PicoDet.
const BINS: usize = 8;

/// Most boxes of an export that suppresses by itself.
const MOST_BOXES: usize = 1000;

/// The head of outputs of these shapes, over an input of `size`, columns and rows; `None` where
/// none of the known ones gives such outputs.
pub(super) fn guess(size: [usize; 2], outputs: &[Vec<usize>]) -> Option<HeadSpec> {
    let cells = |strides: &[usize]| -> Vec<usize> {
        let level = |&stride: &usize| size[0].div_ceil(stride) * size[1].div_ceil(stride);
        strides.iter().map(level).collect()
    };
    let sum = |strides: &[usize]| cells(strides).iter().sum::<usize>();
    let three = |kind, classes| HeadSpec { kind, strides: THREE.to_vec(), bins: 0, classes };
    let four = |kind, classes| HeadSpec { kind, strides: FOUR.to_vec(), bins: BINS, classes };
    match outputs {
        [shape] => match shape[..] {
            [1, rows, 6] if rows <= MOST_BOXES && rows != sum(&THREE) && rows != sum(&FOUR) => {
                Some(three(HeadKind::End2end, 0))
            }
            [1, rows, columns] if rows == sum(&FOUR) && columns > 4 * BINS => {
                Some(four(HeadKind::NanodetPlus, columns - 4 * BINS))
            }
            [1, rows, columns] if rows == sum(&THREE) && columns > 5 => {
                Some(three(HeadKind::Yolox, columns - 5))
            }
            [1, rows, columns] if rows == 3 * sum(&THREE) && columns > 5 => {
                Some(three(HeadKind::Yolov5, columns - 5))
            }
            [1, columns, rows] if rows == sum(&THREE) && columns > 4 => {
                Some(three(HeadKind::Yolov8, columns - 4))
            }
            _ => None,
        },
        _ => {
            let levels = cells(&FOUR);
            let (scores, sides) = outputs.split_at_checked(FOUR.len())?;
            let classes = *scores[0].get(2)?;
            let is = |shapes: &[Vec<usize>], columns: usize| {
                let wanted: Vec<Vec<usize>> =
                    levels.iter().map(|&count| vec![1, count, columns]).collect();
                shapes == wanted
            };
            (is(scores, classes) && is(sides, 4 * BINS)).then(|| four(HeadKind::Picodet, classes))
        }
    }
}

/// The head that `sidecar` names, filled up from the outputs, or the one that they seem to
/// have, and whether that was guessed.
///
/// # Errors
/// Where nothing is named and nothing fits.
pub(super) fn resolve(
    sidecar: &Sidecar,
    outputs: &[Vec<usize>],
) -> Result<(HeadSpec, bool), String> {
    let size = [sidecar.input.width_px, sidecar.input.height_px];
    let guessed = guess(size, outputs);
    match (&sidecar.head, guessed) {
        (Some(named), _) => Ok((named.spec(outputs), false)),
        (None, Some(spec)) => Ok((spec, true)),
        (None, None) => Err(format!(
            "its outputs ({}) are of no head that verge knows; name it in the sidecar \
             (head = \"yolov8\", say)",
            sizes(outputs)
        )),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shapes_tell_the_head() {
        let size = [640, 480];
        for (shapes, kind, classes) in [
            (vec![vec![1, 6380, 37]], HeadKind::NanodetPlus, 5),
            (vec![vec![1, 6300, 85]], HeadKind::Yolox, 80),
            (vec![vec![1, 84, 6300]], HeadKind::Yolov8, 80),
            (vec![vec![1, 18900, 85]], HeadKind::Yolov5, 80),
            (vec![vec![1, 300, 6]], HeadKind::End2end, 0),
        ] {
            let spec = guess(size, &shapes).expect("a known head");
            assert_eq!((spec.kind, spec.classes), (kind, classes), "{shapes:?}");
        }
        let levels = [4800, 1200, 300, 80];
        let part = |columns| levels.map(|count| vec![1, count, columns]);
        let spec = guess(size, &[part(80), part(32)].concat()).expect("a known head");
        assert_eq!((spec.kind, spec.classes), (HeadKind::Picodet, 80));
        assert_eq!(guess(size, &[vec![1, 99, 7]]), None);
    }
}
