//! The net's output into candidate boxes, in pixels of the input.
//!
//! Owns the decodings. Only cells whose score passes the threshold are decoded.

use super::sidecar::{HeadKind, Sidecar};
use crate::daemon::frame::{Detection, PixelBox};
use crate::units::VehicleClass;

/// How one model's output is read.
#[derive(Debug)]
pub(super) struct Head {
    kind: HeadKind,
    bins: usize,
    classes: usize,
    columns: Vec<(usize, VehicleClass)>,
    threshold: f32,
    /// Stride, columns and rows of each level.
    levels: Vec<(usize, usize, usize)>,
}

impl Head {
    pub(super) fn new(sidecar: &Sidecar) -> Self {
        let level = |&stride: &usize| {
            let cells = |length: usize| length.div_ceil(stride);
            (stride, cells(sidecar.input.width_px), cells(sidecar.input.height_px))
        };
        Self {
            kind: sidecar.head.kind,
            bins: sidecar.head.bins,
            classes: sidecar.head.classes,
            columns: sidecar.class.iter().map(|c| (c.index, c.name)).collect(),
            threshold: sidecar.thresholds.score,
            levels: sidecar.head.strides.iter().map(level).collect(),
        }
    }

    /// The shape `[1, cells, columns]` that the output must have.
    pub(super) fn output_shape(&self) -> [usize; 3] {
        let cells = self.levels.iter().map(|(_, columns, rows)| columns * rows).sum();
        [1, cells, self.row_len()]
    }

    fn row_len(&self) -> usize {
        match self.kind {
            HeadKind::NanodetPlus => self.classes + 4 * self.bins,
            HeadKind::Yolox => 5 + self.classes,
        }
    }

    /// Levels of cells.
    pub(super) fn levels(&self) -> usize {
        self.levels.len()
    }

    /// Columns of a cell that are scores.
    pub(super) fn scores(&self) -> usize {
        self.classes
    }

    /// Adds the candidates of an output, its cells row by row and level by level.
    pub(super) fn read(&self, output: &[f32], candidates: &mut Vec<Detection>) {
        let cells = (0..self.levels.len()).flat_map(|level| self.cells(level));
        for (cell, row) in cells.zip(output.chunks_exact(self.row_len())) {
            self.consider(row, cell, candidates);
        }
    }

    /// Column, row and stride of each cell of a level.
    pub(super) fn cells(&self, level: usize) -> impl Iterator<Item = (f32, f32, f32)> + use<> {
        let (stride, columns, rows) = self.levels[level];
        (0..rows).flat_map(move |v| (0..columns).map(move |u| (u as f32, v as f32, stride as f32)))
    }

    /// Adds a cell whose score reaches the threshold.
    pub(super) fn consider(
        &self,
        row: &[f32],
        cell: (f32, f32, f32),
        candidates: &mut Vec<Detection>,
    ) {
        let (score, class) = self.best(row);
        // Written so that a NaN score is no vehicle.
        if score >= self.threshold {
            let bounds = match self.kind {
                HeadKind::NanodetPlus => self.nanodet_box(row, cell),
                HeadKind::Yolox => yolox_box(row, cell),
            };
            candidates.push(Detection { bounds, score, class });
        }
    }

    /// The best vehicle class of a cell.
    fn best(&self, row: &[f32]) -> (f32, VehicleClass) {
        let (scores, factor) = match self.kind {
            HeadKind::NanodetPlus => (&row[..self.classes], 1.0),
            HeadKind::Yolox => (&row[5..], row[4]),
        };
        let mut best = (f32::NEG_INFINITY, VehicleClass::Vehicle);
        for &(column, class) in &self.columns {
            if scores[column] > best.0 {
                best = (scores[column], class);
            }
        }
        (best.0 * factor, best.1)
    }

    /// Distribution focal loss (Li et al. 2020, "Generalized Focal Loss"): each side's
    /// distance from the cell's point is the mean of a distribution over bins, in strides.
    fn nanodet_box(&self, row: &[f32], (u, v, stride): (f32, f32, f32)) -> PixelBox {
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
        let (x, y) = (u * stride, v * stride);
        PixelBox { x0: x - left, y0: y - top, x1: x + right, y1: y + bottom }
    }
}

/// YOLOX (Ge et al. 2021): centre as an offset from the cell, size as a logarithm, both in
/// strides.
fn yolox_box(row: &[f32], (u, v, stride): (f32, f32, f32)) -> PixelBox {
    let (x, y) = ((row[0] + u) * stride, (row[1] + v) * stride);
    let (width, height) = (row[2].exp() * stride, row[3].exp() * stride);
    let (half_width, half_height) = (width / 2.0, height / 2.0);
    PixelBox { x0: x - half_width, y0: y - half_height, x1: x + half_width, y1: y + half_height }
}
