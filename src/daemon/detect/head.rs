//! The net's output into candidate boxes, in pixels of the input.
//!
//! Owns the decodings. Only cells whose score passes the threshold are decoded. A score or a box
//! that is not a number is a fault of the net, not an empty road.

use super::head_key::{HeadKind, HeadSpec};
use super::sidecar::Sidecar;
use crate::daemon::frame::{Detection, PixelBox};
use crate::units::VehicleClass;
use std::ops::Range;

/// Column, row and stride of a cell.
pub(super) type Cell = (f32, f32, f32);

/// How one model's output is read.
#[derive(Debug)]
pub(super) struct Head {
    kind: HeadKind,
    bins: usize,
    classes: usize,
    columns: Vec<(usize, VehicleClass)>,
    threshold: f32,
    /// Columns and rows of the input, px.
    input: [f32; 2],
    /// Cells of each level.
    levels: Vec<usize>,
    cells: Vec<Cell>,
    /// Whether outputs are read column by column.
    by_column: bool,
}

impl Head {
    /// For outputs of these shapes.
    ///
    /// # Errors
    /// The shapes that the head asks for, where these are others.
    pub(super) fn new(
        spec: &HeadSpec,
        sidecar: &Sidecar,
        outputs: &[Vec<usize>],
    ) -> Result<Self, Vec<Vec<usize>>> {
        let input = [sidecar.input.width_px, sidecar.input.height_px];
        let mut head = Self {
            kind: spec.kind,
            bins: spec.bins,
            classes: spec.classes,
            columns: sidecar.class.iter().map(|c| (c.index, c.name)).collect(),
            threshold: sidecar.thresholds.score,
            input: input.map(|side| side as f32),
            levels: Vec::new(),
            cells: Vec::new(),
            by_column: false,
        };
        if head.has_grid() {
            for &stride in &spec.strides {
                let [width, height] = input.map(|side| side.div_ceil(stride));
                head.levels.push(width * height);
                let row = |v: usize| (0..width).map(move |u| (u as f32, v as f32, stride as f32));
                head.cells.extend((0..height).flat_map(row));
            }
        }
        let rows = match (head.has_grid(), outputs) {
            (true, _) => head.cells.len(),
            (false, [shape]) if shape.len() == 3 => match head.kind {
                HeadKind::Yolov8 if shape[2] != head.row_len() => shape[2],
                _ => shape[1],
            },
            (false, _) => 0,
        };
        let columns = head.row_len();
        let expected = match head.kind {
            HeadKind::Picodet => {
                let part = |columns: usize| move |&count: &usize| vec![1, count, columns];
                let scores = head.levels.iter().map(part(head.classes));
                scores.chain(head.levels.iter().map(part(4 * head.bins))).collect()
            }
            HeadKind::Yolov8 if outputs != [vec![1, rows, columns]] => {
                head.by_column = true;
                vec![vec![1, columns, rows]]
            }
            _ => vec![vec![1, rows, columns]],
        };
        if outputs != expected || rows == 0 { Err(expected) } else { Ok(head) }
    }

    /// Whether a box is identified by the cell that yields it.
    fn has_grid(&self) -> bool {
        matches!(self.kind, HeadKind::NanodetPlus | HeadKind::Picodet | HeadKind::Yolox)
    }

    fn row_len(&self) -> usize {
        match self.kind {
            HeadKind::NanodetPlus | HeadKind::Picodet => self.classes + 4 * self.bins,
            HeadKind::Yolox | HeadKind::YoloxDecoded | HeadKind::Yolov5 => 5 + self.classes,
            HeadKind::Yolov8 => 4 + self.classes,
            HeadKind::End2end => 6,
        }
    }

    /// Columns of which one reaches the threshold wherever a score does.
    pub(super) fn gate(&self) -> Range<usize> {
        match self.kind {
            HeadKind::NanodetPlus | HeadKind::Picodet => 0..self.classes,
            HeadKind::Yolox | HeadKind::YoloxDecoded | HeadKind::Yolov5 => 4..5,
            HeadKind::Yolov8 => 4..4 + self.classes,
            HeadKind::End2end => 4..5,
        }
    }

    /// Least score.
    pub(super) fn threshold(&self) -> f32 {
        self.threshold
    }

    /// From here on another least score.
    pub(super) fn set_threshold(&mut self, threshold: f32) {
        self.threshold = threshold;
    }

    /// Where cell `index` lies; boxes of heads without a grid do not ask.
    pub(super) fn cell(&self, index: usize) -> Cell {
        self.cells.get(index).copied().unwrap_or_default()
    }

    /// Adds the candidates of all outputs.
    ///
    /// # Errors
    /// A score or box that is not a number.
    pub(super) fn read(
        &self,
        outputs: &[&[f32]],
        candidates: &mut Vec<Detection>,
    ) -> Result<(), String> {
        let len = self.row_len();
        let Some(first) = outputs.first() else { return Err("the net gave nothing".to_owned()) };
        if self.kind == HeadKind::Picodet {
            let (scores, sides) = outputs.split_at(self.levels.len());
            let mut row = Vec::with_capacity(len);
            let mut index = 0;
            for (scores, sides) in scores.iter().zip(sides) {
                let sides = sides.chunks_exact(4 * self.bins);
                for (scores, sides) in scores.chunks_exact(self.classes).zip(sides) {
                    row.clear();
                    row.extend_from_slice(scores);
                    row.extend_from_slice(sides);
                    self.consider(&row, self.cell(index), candidates)?;
                    index += 1;
                }
            }
        } else if self.by_column {
            let count = first.len() / len;
            let mut row = vec![0.0; len];
            for i in 0..count {
                for (column, value) in row.iter_mut().enumerate() {
                    *value = first[column * count + i];
                }
                self.consider(&row, self.cell(i), candidates)?;
            }
        } else {
            for (index, row) in first.chunks_exact(len).enumerate() {
                self.consider(row, self.cell(index), candidates)?;
            }
        }
        Ok(())
    }

    /// Adds a cell whose score reaches the threshold.
    ///
    /// # Errors
    /// A score or box that is not a number.
    pub(super) fn consider(
        &self,
        row: &[f32],
        cell: Cell,
        candidates: &mut Vec<Detection>,
    ) -> Result<(), String> {
        let Some((score, class)) = self.best(row)? else { return Ok(()) };
        if score < self.threshold {
            return Ok(());
        }
        let bounds = match self.kind {
            HeadKind::NanodetPlus => self.distance_box(row, cell, 0.0),
            HeadKind::Picodet => self.distance_box(row, cell, 0.5),
            HeadKind::Yolox => yolox_box(row, cell),
            HeadKind::YoloxDecoded | HeadKind::Yolov5 | HeadKind::Yolov8 => centred_box(row),
            HeadKind::End2end => PixelBox { x0: row[0], y0: row[1], x1: row[2], y1: row[3] },
        };
        let PixelBox { x0, y0, x1, y1 } = bounds;
        if ![x0, y0, x1, y1].iter().all(|side| side.is_finite()) {
            return Err(format!("the net gave a box from {x0}, {y0} to {x1}, {y1}"));
        }
        // A box that lies beyond the input altogether, or has no area, is on no vehicle.
        let [width, height] = self.input;
        if x1.min(width) > x0.max(0.0) && y1.min(height) > y0.max(0.0) {
            candidates.push(Detection { bounds, score, class });
        }
        Ok(())
    }

    /// The best vehicle class of a cell, and its score; `None` where it is of another class.
    fn best(&self, row: &[f32]) -> Result<Option<(f32, VehicleClass)>, String> {
        let not_a_number = || "the net gave a score that is not a number".to_owned();
        if self.kind == HeadKind::End2end {
            if !row[4].is_finite() || !row[5].is_finite() {
                return Err(not_a_number());
            }
            let index = row[5].round();
            let is_it = |(column, _): &&(usize, VehicleClass)| *column as f32 == index;
            return Ok(self.columns.iter().find(is_it).map(|(_, class)| (row[4], *class)));
        }
        let (scores, factor) = match self.kind {
            HeadKind::Yolox | HeadKind::YoloxDecoded | HeadKind::Yolov5 => (&row[5..], row[4]),
            HeadKind::Yolov8 => (&row[4..], 1.0),
            _ => (&row[..self.classes], 1.0),
        };
        let mut best = (f32::NEG_INFINITY, VehicleClass::Vehicle);
        let mut sum = factor;
        for &(column, class) in &self.columns {
            sum += scores[column];
            if scores[column] > best.0 {
                best = (scores[column], class);
            }
        }
        // A sum with something in it that is not finite is not finite.
        if sum.is_finite() { Ok(Some((best.0 * factor, best.1))) } else { Err(not_a_number()) }
    }

    /// Distribution focal loss (Li et al. 2020, "Generalized Focal Loss"): each side's
    /// distance from the cell's point is the mean of a distribution over bins, in strides.
    fn distance_box(&self, row: &[f32], (u, v, stride): Cell, centre: f32) -> PixelBox {
        let mut sides = row[self.classes..].chunks_exact(self.bins).map(|bins| {
            let most = bins.iter().fold(f32::NEG_INFINITY, |most, &bin| most.max(bin));
            let (mut total, mut mean) = (0.0, 0.0);
            for (distance, &bin) in bins.iter().enumerate() {
                let weight = (bin - most).exp();
                total += weight;
                mean += weight * distance as f32;
            }
            mean / total * stride
        });
        let mut side = || sides.next().unwrap_or(0.0);
        let (left, top, right, bottom) = (side(), side(), side(), side());
        let (x, y) = ((u + centre) * stride, (v + centre) * stride);
        PixelBox { x0: x - left, y0: y - top, x1: x + right, y1: y + bottom }
    }
}

/// YOLOX (Ge et al. 2021): centre as an offset from the cell, size as a logarithm, both in
/// strides.
fn yolox_box(row: &[f32], (u, v, stride): Cell) -> PixelBox {
    let (x, y) = ((row[0] + u) * stride, (row[1] + v) * stride);
    let (width, height) = (row[2].exp() * stride, row[3].exp() * stride);
    let (half_width, half_height) = (width / 2.0, height / 2.0);
    PixelBox { x0: x - half_width, y0: y - half_height, x1: x + half_width, y1: y + half_height }
}

/// Centre, width and height, px.
fn centred_box(row: &[f32]) -> PixelBox {
    let (half_width, half_height) = (row[2] / 2.0, row[3] / 2.0);
    PixelBox {
        x0: row[0] - half_width,
        y0: row[1] - half_height,
        x1: row[0] + half_width,
        y1: row[1] + half_height,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_score_that_is_not_a_number_is_a_fault_and_no_empty_road() {
        use HeadKind::{End2end, NanodetPlus, Picodet, Yolov5, Yolov8, Yolox, YoloxDecoded};
        for kind in [NanodetPlus, Picodet, Yolox, YoloxDecoded, Yolov5, Yolov8, End2end] {
            let head = Head {
                kind,
                bins: 8,
                classes: 2,
                columns: vec![(0, VehicleClass::Vehicle), (1, VehicleClass::Bus)],
                threshold: 0.3,
                input: [64.0; 2],
                levels: Vec::new(),
                cells: Vec::new(),
                by_column: false,
            };
            let row = vec![0.25; head.row_len()];
            head.best(&row).expect("numbers");
            // Where the scores of each kind lie.
            let (first, last) = match kind {
                NanodetPlus | Picodet => (0, 1),
                Yolov8 | End2end => (4, 5),
                _ => (4, 6),
            };
            for (at, wrong) in (first..=last).flat_map(|at| {
                [f32::NAN, f32::INFINITY, f32::NEG_INFINITY].map(|wrong| (at, wrong))
            }) {
                let mut row = row.clone();
                row[at] = wrong;
                assert!(head.best(&row).is_err(), "{kind:?}: {wrong} at {at}");
            }
        }
    }
}
