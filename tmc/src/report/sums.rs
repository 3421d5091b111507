//! Running means with their errors, and the sums that queries return.
//!
//! Densities have 24 bits and are added up in 53: below 2^29 times the least of them their sums are
//! exact, and so the same in whatever order they were added.

use datafusion::arrow::array::{Array, AsArray, PrimitiveArray, RecordBatch};
use datafusion::arrow::datatypes::{ArrowPrimitiveType, Float64Type, Int64Type};

/// Standard errors of a mean within which 90 % of it lies.
const Z90: f64 = 1.645;

/// A running mean, with its errors.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Mean {
    pub(super) sum: f64,
    /// Values in it.
    pub count: u64,
    /// Of those whose parts of error are known.
    errors: Errors,
}

/// Sums over values of which sampling, calibration and counting errors are known.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Errors {
    count: u64,
    /// Of the sampling errors' squares.
    variance: f64,
    calibration: f64,
    counting: f64,
}

impl Mean {
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

/// Sums of densities and their counts, and of their errors where the query asks for them.
pub(super) struct Sums<'a> {
    density: &'a PrimitiveArray<Float64Type>,
    known: &'a PrimitiveArray<Int64Type>,
    errors: Option<(&'a PrimitiveArray<Int64Type>, [&'a PrimitiveArray<Float64Type>; 3])>,
}

impl<'a> Sums<'a> {
    pub(super) fn of(batch: &'a RecordBatch) -> Self {
        let errors = batch.column_by_name("stated").is_some().then(|| {
            let parts = ["variance", "calibration", "counting"].map(|name| column(batch, name));
            (column(batch, "stated"), parts)
        });
        Self { density: column(batch, "density"), known: column(batch, "known"), errors }
    }

    pub(super) fn get(&self, row: usize) -> Mean {
        // A sum of nothing is null, and 0 below that.
        let sum = |of: &PrimitiveArray<Float64Type>| {
            if of.is_null(row) { 0.0 } else { of.value(row) }
        };
        let errors = self.errors.map_or_else(Errors::default, |(count, parts)| {
            let [variance, calibration, counting] = parts.map(sum);
            Errors { count: count.value(row) as u64, variance, calibration, counting }
        });
        Mean { sum: sum(self.density), count: self.known.value(row) as u64, errors }
    }
}

pub(super) fn column<'a, T: ArrowPrimitiveType>(
    batch: &'a RecordBatch,
    name: &str,
) -> &'a PrimitiveArray<T> {
    batch.column_by_name(name).expect("the queries name it").as_primitive()
}
