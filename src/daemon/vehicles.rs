//! Choose: between detect and locate, which of the net's boxes are vehicles.
//!
//! Owns which weights, which least probability and which size of a car go into the core's choice
//! ([`crate::evidence`]). A model without weights has made the choice itself.

use super::frame::{Detection, PixelBox};
use crate::evidence::{CarSize, Evidence, Expected};

/// Least score of the net from which a box may be one of those that a recording's size of cars is
/// taken from.
const SURE: f32 = 0.45;
/// A box that overlaps one of an earlier picture by more (IoU) is the same thing again: a building, a
/// sign, a parked car. Each thing is one sample, however often it is seen.
const SAME_THING: f32 = 0.7;
/// Largest mean distance of such boxes from the plane through them, as a logarithm of the size: cars,
/// vans and lorries of one camera have 0.2 to 0.35, the pictures of several cameras 0.5.
const ONE_CAMERA: f32 = 0.45;

/// Chooses among boxes.
#[derive(Clone, Copy, Debug)]
pub struct Vehicles {
    evidence: Option<Evidence>,
    least: f32,
    input: [usize; 2],
}

impl Vehicles {
    /// For a net with that input; `least` takes the place of the probability that is stated with
    /// the weights.
    pub fn new(evidence: Option<Evidence>, least: Option<f32>, input: [usize; 2]) -> Self {
        let stated = evidence.as_ref().map_or(0.0, |evidence| evidence.least);
        Self { evidence, least: least.unwrap_or(stated), input }
    }

    /// The same with another least probability.
    pub fn with_least(&self, least: f32) -> Self {
        Self { least, ..*self }
    }

    /// The same for a net with another input.
    pub fn with_input(&self, input: [usize; 2]) -> Self {
        Self { input, ..*self }
    }

    /// Least probability that counts; 0 for a model without weights.
    pub const fn least(&self) -> f32 {
        self.least
    }

    /// Leaves the vehicles in `found`, best first, with probabilities as their scores. `size` is that
    /// of a car in pictures of this shape, `likeness` that of a box to the empty road.
    pub fn choose(
        &self,
        found: &mut Vec<Detection>,
        picture: (usize, usize),
        size: Option<CarSize>,
        likeness: impl Fn(&PixelBox) -> f32,
    ) {
        let Some(evidence) = &self.evidence else { return };
        let expected = size.map(|size| Expected {
            size,
            width: picture.0 as f32,
            input_px: scale(self.input, picture),
        });
        let count = evidence.select(found, expected.as_ref(), likeness, self.least);
        found.truncate(count);
    }
}

/// Pixels of the net's input a pixel of the whole picture.
pub fn scale(input: [usize; 2], (width, height): (usize, usize)) -> f32 {
    (input[0] as f32 / width as f32).min(input[1] as f32 / height as f32)
}

/// Boxes of a recording's pictures, to learn the size of its cars from.
#[derive(Clone, Debug, Default)]
pub struct Sample {
    picture: Option<(usize, usize)>,
    boxes: Vec<PixelBox>,
}

impl Sample {
    /// Adds what a picture's boxes, which have the net's scores, surely show: cars and vans, and
    /// vehicles of unknown kind. Lorries would make cars too large, and so would buildings, which are
    /// taken for lorries. Pictures of another size than the first are left out.
    pub fn add(&mut self, picture: (usize, usize), found: &[Detection]) {
        if *self.picture.get_or_insert(picture) != picture {
            return;
        }
        // Best first: of several boxes on one vehicle, whatever it is called, the best stays.
        let mut here: Vec<&Detection> = Vec::new();
        for detection in found.iter().filter(|detection| detection.score >= SURE) {
            if here.iter().all(|other| other.bounds.ios(&detection.bounds) <= 0.5) {
                here.push(detection);
            }
        }
        here.retain(|detection| {
            detection.class.is_car_sized()
                && self.boxes.iter().all(|other| other.iou(&detection.bounds) <= SAME_THING)
        });
        self.boxes.extend(here.iter().map(|detection| detection.bounds));
    }

    /// The size of cars; `None` where there are too few, or where they do not agree, as in pictures
    /// of several cameras.
    pub fn size(&self) -> Option<CarSize> {
        let width = self.picture?.0 as f32;
        let samples = self.boxes.iter().map(|bounds| (bounds.contact(), bounds.side()));
        let size = CarSize::fit(samples.clone(), width)?;
        let apart = |(point, side): (_, f32)| (side / size.at(point, width)).ln().abs();
        let mean = samples.map(apart).sum::<f32>() / self.boxes.len() as f32;
        (mean <= ONE_CAMERA).then_some(size)
    }

    /// Median side of a car where these boxes stand, px of the input of a net.
    pub fn car_px(&self, input: [usize; 2]) -> Option<f32> {
        let (picture, size) = (self.picture?, self.size()?);
        let side = |bounds: &PixelBox| size.at(bounds.contact(), picture.0 as f32);
        let mut sides: Vec<f32> = self.boxes.iter().map(side).collect();
        sides.sort_by(f32::total_cmp);
        sides.get(sides.len() / 2).map(|side| side * scale(input, picture))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::units::VehicleClass;

    fn car(u: f32, v: f32, side: f32) -> Detection {
        let bounds = PixelBox { x0: u - side / 2.0, y0: v - side, x1: u + side / 2.0, y1: v };
        Detection { bounds, score: 0.6, class: VehicleClass::Car }
    }

    /// Pictures with three cars each under a level camera whose cars have `per_row` px a row.
    fn sample(pictures: usize, per_row: impl Fn(usize) -> f32) -> Sample {
        let mut sample = Sample::default();
        for i in 0..pictures {
            let at = |j: usize| {
                let v = 80.0 + ((i * 37 + j * 53) % 150) as f32;
                car(60.0 + 90.0 * j as f32, v, per_row(i) * (v - 40.0))
            };
            sample.add((320, 240), &[at(0), at(1), at(2)]);
        }
        sample
    }

    #[test]
    fn a_recording_tells_the_size_of_its_cars() {
        let sample = sample(10, |_| 0.2);
        let size = sample.size().expect("30 cars");
        let at = size.at(crate::units::ImagePoint { u: 100.0, v: 140.0 }, 320.0);
        assert!((at / 20.0 - 1.0).abs() < 0.05, "{at}");
        let [small, large] = [[640, 480], [960, 736]].map(|input| sample.car_px(input));
        assert!((large.expect("known") / small.expect("known") - 1.5).abs() < 0.01);
    }

    #[test]
    fn lorries_and_a_building_that_is_taken_for_cars_do_not_change_it() {
        let alone = sample(30, |_| 0.2).size().expect("90 cars");
        let mut sample = Sample::default();
        for i in 0..30 {
            let at = |j: usize| {
                let v = 80.0 + ((i * 37 + j * 53) % 150) as f32;
                car(60.0 + 90.0 * j as f32, v, 0.2 * (v - 40.0))
            };
            let lorry = Detection { class: VehicleClass::Truck, ..car(160.0, 120.0, 60.0) };
            let building = car(300.0 + (i % 3) as f32, 60.0, 50.0);
            sample.add((320, 240), &[lorry, building, at(0), at(1), at(2)]);
        }
        let size = sample.size().expect("90 cars");
        for v in [80.0, 140.0, 220.0] {
            let at = |size: &CarSize| size.at(crate::units::ImagePoint { u: 100.0, v }, 320.0);
            assert!((at(&size) / at(&alone) - 1.0).abs() < 0.1, "{} at {v}", at(&size));
        }
    }

    #[test]
    fn few_cars_or_several_cameras_tell_none() {
        assert_eq!(sample(3, |_| 0.2).size(), None);
        assert_eq!(sample(30, |i| if i % 2 == 0 { 0.05 } else { 0.4 }).size(), None);
        assert_eq!(Sample::default().car_px([640, 480]), None);
    }

    #[test]
    fn a_model_without_weights_has_chosen_itself() {
        let mut found = vec![car(100.0, 100.0, 20.0), car(101.0, 100.0, 20.0)];
        let vehicles = Vehicles::new(None, Some(0.9), [640, 480]);
        vehicles.choose(&mut found, (320, 240), None, |_| 1.0);
        assert_eq!(found.len(), 2);
    }
}
