//! Running means with their errors.
//!
//! Densities have 24 bits and are added up in 53: below 2^29 times the least of them their sums are
//! exact, and so the same in whatever order they were added.

/// Standard errors of a mean within which 90 % of it lies.
const Z90: f64 = 1.645;

/// A running mean, with its errors.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Mean {
    pub(super) sum: f64,
    /// Values in it.
    pub count: u64,
    /// Of those whose parts of error are known.
    pub(super) errors: Errors,
}

/// Sums over values of which sampling, calibration and counting errors are known.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Errors {
    pub(super) count: u64,
    /// Of the sampling errors' squares.
    pub(super) variance: f64,
    pub(super) calibration: f64,
    pub(super) counting: f64,
}

impl Mean {
    /// Takes in a value, and its errors from sampling, calibration and counting. The square has 24 bits
    /// as densities have, so that its sum is exact as well.
    pub(super) fn add_one(&mut self, value: f32, errors: Option<[f32; 3]>) {
        self.sum += f64::from(value);
        self.count += 1;
        if let Some([sampling, calibration, counting]) = errors {
            self.errors.count += 1;
            self.errors.variance += f64::from(sampling * sampling);
            self.errors.calibration += f64::from(calibration);
            self.errors.counting += f64::from(counting);
        }
    }

    pub(super) fn add(&mut self, other: Self) {
        self.sum += other.sum;
        self.count += other.count;
        let (errors, others) = (&mut self.errors, other.errors);
        errors.count += others.count;
        errors.variance += others.variance;
        errors.calibration += others.calibration;
        errors.counting += others.counting;
    }

    /// Takes in another mean's value as one, of which no error is known.
    pub fn add_mean(&mut self, other: Self) {
        if let Some(value) = other.value() {
            self.sum += value;
            self.count += 1;
        }
    }

    /// The mean; none of nothing.
    pub fn value(self) -> Option<f64> {
        (self.count > 0).then(|| self.sum / self.count as f64)
    }

    /// The interval that holds the mean with a probability of 90 %; none where an error of one of
    /// its values is not known.
    ///
    /// Sampling errors of windows are independent, and their mean is that much smaller; calibration
    /// and counting err alike in all of them, and their errors stay.
    pub fn interval(self) -> Option<[f64; 2]> {
        let (mean, Errors { count, variance, calibration, counting }) =
            (self.value()?, self.errors);
        let n = count as f64;
        let joint = (variance + calibration.powi(2) + counting.powi(2)).sqrt() / n;
        (count == self.count).then_some([(mean - Z90 * joint).max(0.0), mean + Z90 * joint])
    }
}
