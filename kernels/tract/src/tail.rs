//! The part of a net behind its last convolutions, cell by cell.
//!
//! Owns turning a cell's raw values into the row that the model describes; of most cells no
//! score can reach the threshold, and their rows are never made.

use std::ops::Range;

/// Some columns of the output, from columns of the raw values.
#[derive(Clone, Debug, PartialEq)]
pub enum Part {
    /// As they are.
    Raw(Range<usize>),
    /// `1 / (1 + exp(-x))`.
    Sigmoid(Range<usize>),
    /// The largest of them.
    Max(Range<usize>),
    /// Less the largest of them.
    SubMax(Range<usize>),
    /// `exp(x - largest)`: a softmax before it is divided by its sum.
    SoftmaxNumerator(Range<usize>),
    /// The same times the sigmoid of column `gate`.
    ScaledByObjectness {
        /// Objectness.
        gate: usize,
        /// Classes.
        share: Range<usize>,
    },
}

impl Part {
    /// How many columns it makes.
    pub fn columns(&self) -> usize {
        match self {
            Self::Max(_) => 1,
            Self::Raw(of) | Self::Sigmoid(of) | Self::SubMax(of) | Self::SoftmaxNumerator(of) => {
                of.len()
            }
            Self::ScaledByObjectness { share, .. } => share.len(),
        }
    }

    /// The same operation on columns `part` of its output.
    pub(crate) fn slice(&self, part: Range<usize>) -> Option<Self> {
        if part.end > self.columns() {
            return None;
        }
        let of = |whole: &Range<usize>| whole.start + part.start..whole.start + part.end;
        match self {
            Self::Raw(whole) => Some(Self::Raw(of(whole))),
            Self::Sigmoid(whole) => Some(Self::Sigmoid(of(whole))),
            _ => (part == (0..self.columns())).then(|| self.clone()),
        }
    }

    /// The same with raw columns that begin `by` later.
    pub(crate) fn shifted(&self, by: usize) -> Self {
        let of = |range: &Range<usize>| range.start + by..range.end + by;
        match self {
            Self::Raw(range) => Self::Raw(of(range)),
            Self::Sigmoid(range) => Self::Sigmoid(of(range)),
            Self::Max(range) => Self::Max(of(range)),
            Self::SubMax(range) => Self::SubMax(of(range)),
            Self::SoftmaxNumerator(range) => Self::SoftmaxNumerator(of(range)),
            Self::ScaledByObjectness { gate, share } => {
                Self::ScaledByObjectness { gate: gate + by, share: of(share) }
            }
        }
    }
}

fn sigmoid(x: f32) -> f32 {
    1.0 / (1.0 + (-x).exp())
}

fn largest(values: &[f32]) -> f32 {
    values.iter().fold(f32::NEG_INFINITY, |most, &value| most.max(value))
}

/// Fills `row` with what `parts` make of `raw`.
pub(crate) fn complete(parts: &[Part], raw: &[f32], row: &mut Vec<f32>) {
    row.clear();
    for part in parts {
        match part {
            Part::Raw(of) => row.extend_from_slice(&raw[of.clone()]),
            Part::Sigmoid(of) => row.extend(raw[of.clone()].iter().map(|&x| sigmoid(x))),
            Part::Max(of) => row.push(largest(&raw[of.clone()])),
            Part::SubMax(of) => {
                let most = largest(&raw[of.clone()]);
                row.extend(raw[of.clone()].iter().map(|x| x - most));
            }
            Part::SoftmaxNumerator(of) => {
                let most = largest(&raw[of.clone()]);
                row.extend(raw[of.clone()].iter().map(|x| (x - most).exp()));
            }
            Part::ScaledByObjectness { gate, share } => {
                let (most, gate) = (largest(&raw[share.clone()]), sigmoid(raw[*gate]));
                row.extend(raw[share.clone()].iter().map(|x| (x - most).exp() * gate));
            }
        }
    }
}

/// A test of a cell's raw values: can any of its columns reach a threshold?
#[derive(Clone, Debug, PartialEq)]
pub struct Gate {
    /// Raw columns one of which must reach `least`.
    columns: Range<usize>,
    least: f32,
}

impl Gate {
    /// For rows that are looked at only where one of `columns` reaches `threshold`.
    pub fn new(parts: &[Part], columns: &Range<usize>, threshold: f32) -> Self {
        // A little lower, so that rounding never decides.
        let least = (threshold / (1.0 - threshold)).ln() - 1e-3;
        let mut at = 0;
        for part in parts {
            let inside = at <= columns.start && columns.end <= at + part.columns();
            let local = columns.start.wrapping_sub(at)..columns.end.wrapping_sub(at);
            at += part.columns();
            match part {
                Part::ScaledByObjectness { gate, .. } if inside => {
                    return Self { columns: *gate..*gate + 1, least };
                }
                Part::Sigmoid(of) if inside => {
                    let columns = of.start + local.start..of.start + local.end;
                    return Self { columns, least };
                }
                _ => {}
            }
        }
        Self { columns: 0..0, least: f32::NEG_INFINITY }
    }

    /// Whether a cell's row may reach the threshold. A raw value that is not a number passes,
    /// so that the row shows it.
    #[inline]
    pub fn passes(&self, raw: &[f32]) -> bool {
        self.least == f32::NEG_INFINITY
            || raw[self.columns.clone()].iter().any(|&x| x >= self.least || x.is_nan())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn scaled_shares_rank_by_the_gate_and_name_the_largest() {
        let parts = [Part::ScaledByObjectness { gate: 0, share: 1..3 }, Part::Raw(3..4)];
        let mut row = Vec::new();
        complete(&parts, &[0.0, 1.0, 1.0 + 2f32.ln(), 7.0], &mut row);
        let near = |a: f32, b: f32| (a - b).abs() < 1e-6;
        assert!(near(row[0], 0.25) && near(row[1], 0.5) && near(row[2], 7.0), "{row:?}");
        let gate = Gate::new(&parts, &(0..2), 0.5);
        assert!(gate.passes(&[0.0, 9.0, 9.0, 9.0]));
        assert!(!gate.passes(&[-0.1, 9.0, 9.0, 9.0]));
        assert!(gate.passes(&[f32::NAN, 9.0, 9.0, 9.0]), "NaN must show");
    }

    #[test]
    fn objectness_in_the_middle_of_a_row_is_found() {
        let parts = [Part::Raw(0..4), Part::Sigmoid(4..5), Part::Sigmoid(5..7)];
        let gate = Gate::new(&parts, &(4..5), 0.5);
        assert!(gate.passes(&[-9.0, -9.0, -9.0, -9.0, 0.1, -9.0, -9.0]));
        assert!(!gate.passes(&[9.0, 9.0, 9.0, 9.0, -0.1, 9.0, 9.0]));
    }

    #[test]
    fn unknown_forms_let_every_cell_through() {
        let gate = Gate::new(&[Part::Raw(0..3)], &(0..2), 0.5);
        assert!(gate.passes(&[-50.0, -50.0, 0.0]));
        let all = Gate::new(&[Part::Sigmoid(0..2)], &(0..2), 0.0);
        assert!(all.passes(&[-50.0, -50.0]));
    }
}
