//! What a net does behind its last convolutions, cell by cell.
//!
//! Owns turning a cell's raw values into the row that the model file describes; only cells
//! that can reach the threshold are worth it.

use std::ops::Range;

/// Some columns of the output, from columns of the raw values.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Part {
    /// As they are.
    Raw(Range<usize>),
    /// `1 / (1 + exp(-x))`.
    Sigmoid(Range<usize>),
    /// The largest of them.
    Most(Range<usize>),
    /// Less the largest of them.
    Lowered(Range<usize>),
    /// `exp(x - largest)`.
    Share(Range<usize>),
    /// `exp(x - largest)` times the sigmoid of column `gate`.
    Gated { gate: usize, share: Range<usize> },
}

impl Part {
    pub(super) fn columns(&self) -> usize {
        match self {
            Self::Most(_) => 1,
            Self::Raw(of) | Self::Sigmoid(of) | Self::Lowered(of) | Self::Share(of) => of.len(),
            Self::Gated { share, .. } => share.len(),
        }
    }

    /// The same operation on columns `part` of its output.
    pub(super) fn slice(&self, part: Range<usize>) -> Option<Self> {
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
}

fn sigmoid(x: f32) -> f32 {
    1.0 / (1.0 + (-x).exp())
}

/// How rows come from raw values.
#[derive(Clone, Debug)]
pub(super) struct Tail {
    parts: Vec<Part>,
    /// Raw columns one of which must reach `least` for any score to reach the threshold.
    gates: Range<usize>,
    least: f32,
}

impl Tail {
    /// For rows whose first `scores` columns are compared with `threshold`.
    pub(super) fn new(parts: Vec<Part>, scores: usize, threshold: f32) -> Self {
        // A little lower, so that rounding never decides.
        let least = (threshold / (1.0 - threshold)).ln() - 1e-3;
        let (gates, least) = match parts.first() {
            Some(Part::Gated { gate, share }) if share.len() == scores => (*gate..*gate + 1, least),
            Some(Part::Sigmoid(of)) if of.len() >= scores => (of.clone(), least),
            _ => (0..1, f32::NEG_INFINITY),
        };
        Self { parts, gates, least }
    }

    /// Whether a cell's score may reach the threshold.
    #[inline]
    pub(super) fn may_count(&self, raw: &[f32]) -> bool {
        self.least == f32::NEG_INFINITY || raw[self.gates.clone()].iter().any(|&x| x >= self.least)
    }

    /// Fills `row`.
    pub(super) fn complete(&self, raw: &[f32], row: &mut Vec<f32>) {
        row.clear();
        for part in &self.parts {
            match part {
                Part::Raw(of) => row.extend_from_slice(&raw[of.clone()]),
                Part::Sigmoid(of) => row.extend(raw[of.clone()].iter().map(|&x| sigmoid(x))),
                Part::Most(of) => row.push(most(&raw[of.clone()])),
                Part::Lowered(of) => {
                    let most = most(&raw[of.clone()]);
                    row.extend(raw[of.clone()].iter().map(|x| x - most));
                }
                Part::Share(of) => {
                    let most = most(&raw[of.clone()]);
                    row.extend(raw[of.clone()].iter().map(|x| (x - most).exp()));
                }
                Part::Gated { gate, share } => {
                    let (most, gate) = (most(&raw[share.clone()]), sigmoid(raw[*gate]));
                    row.extend(raw[share.clone()].iter().map(|x| (x - most).exp() * gate));
                }
            }
        }
    }
}

fn most(values: &[f32]) -> f32 {
    values.iter().fold(f32::NEG_INFINITY, |most, &value| most.max(value))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gated_shares_rank_by_the_gate_and_name_the_largest() {
        let tail = Tail::new(vec![Part::Gated { gate: 0, share: 1..3 }, Part::Raw(3..4)], 2, 0.5);
        let mut row = Vec::new();
        tail.complete(&[0.0, 1.0, 1.0 + 2f32.ln(), 7.0], &mut row);
        let near = |a: f32, b: f32| (a - b).abs() < 1e-6;
        assert!(near(row[0], 0.25) && near(row[1], 0.5) && near(row[2], 7.0), "{row:?}");
        assert!(tail.may_count(&[0.0, 9.0, 9.0, 9.0]));
        assert!(!tail.may_count(&[-0.1, 9.0, 9.0, 9.0]));
    }

    #[test]
    fn unknown_forms_let_every_cell_through() {
        let tail = Tail::new(vec![Part::Raw(0..3)], 2, 0.5);
        assert!(tail.may_count(&[-50.0, -50.0, 0.0]));
        let all = Tail::new(vec![Part::Sigmoid(0..2)], 2, 0.0);
        assert!(all.may_count(&[-50.0, -50.0]));
    }
}
