//! The net inside the time that its camera leaves it.
//!
//! Owns what is given up first: the second look at far regions, then the size of the input.

use super::Line;
use crate::daemon::clock;
use crate::daemon::detect::regions::Parts;
use crate::daemon::detect::{Detector, LoadOptions};
use crate::daemon::exit::Failure;
use std::time::Duration;

/// Share of the time between two pictures that the net may take of the processor: the rest is
/// for the camera, the picture, and what else runs on the box.
const NET_SHARE: f64 = 0.5;
/// Share that one pass may take, before the net gets a smaller input.
const NET_MOST: f64 = 0.8;

/// A time as people write it: at most two places.
fn seconds(time: Duration) -> String {
    format!("{} s", (time.as_secs_f64() * 100.0).round() / 100.0)
}

impl Line {
    /// Keeps the net within the time between two pictures: each is searched once, and not its far
    /// part again, where two passes take more than half of it; and where one takes more than
    /// `NET_MOST`, the net gets the next smaller input of those that the model states. A box that
    /// falls behind its camera loses windows, which is worse than a few vehicles more or less.
    ///
    /// # Errors
    /// [`Failure::Detect`] where the net does not run, [`Failure::Model`] where it cannot be loaded
    /// again.
    pub fn keep_within(&mut self, interval: Duration) -> Result<(), Failure> {
        loop {
            // The first run brings the net's memory in.
            self.detector.infer()?;
            let begun = clock::processor_time();
            self.detector.infer()?;
            let took = clock::processor_time() - begun;
            let each = seconds(interval);
            let passes = self.parts.iter().map(Parts::count).max().unwrap_or(0);
            if passes > 1 && took.mul_f64(passes as f64) > interval.mul_f64(NET_SHARE) {
                log::warn!(
                    "the net takes {took:.0?}: with a picture each {each} their far part is \
                     not searched again (model.views)"
                );
                self.parts.iter_mut().for_each(Parts::keep_one);
            }
            if took <= interval.mul_f64(NET_MOST) {
                return Ok(());
            }
            let [width, height] = self.input_size();
            let Some(smaller) = self.smaller_input() else {
                log::warn!(
                    "the net takes {took:.0?} at {width}x{height}, with a picture each {each}: \
                     some will be left out (make camera.interval_s longer)"
                );
                return Ok(());
            };
            let [columns, rows] = smaller;
            log::warn!(
                "the net takes {took:.0?} at {width}x{height}, with a picture each {each}: it \
                 gets {columns}x{rows}, where small vehicles are found less often (make \
                 camera.interval_s longer, or set model.input)"
            );
            let options = LoadOptions { input_px: Some(smaller), ..self.options };
            self.detector = Detector::load_as(&self.file, &options)?;
            self.vehicles = self.vehicles.with_input(smaller);
        }
    }

    /// The model's next smaller input; `None` where the size is set, by the configuration or by an
    /// audit that was made with it.
    fn smaller_input(&self) -> Option<[usize; 2]> {
        if self.is_input_set || self.errors.site.is_some() {
            return None;
        }
        let [width, _] = self.input_size();
        let steps = self.detector.sidecar().step.iter().rev();
        steps.map(|step| [step.width_px, step.height_px]).find(|[columns, _]| *columns < width)
    }
}
