//! Boxes in a picture, and what a detector says of them.

use crate::units::{ImagePoint, VehicleClass};
use core::cmp::Ordering;

/// An axis-aligned box in the picture, px.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PixelBox {
    /// Left edge.
    pub x0: f32,
    /// Upper edge.
    pub y0: f32,
    /// Right edge.
    pub x1: f32,
    /// Lower edge.
    pub y1: f32,
}

impl PixelBox {
    /// Its area, px².
    pub fn area(&self) -> f32 {
        (self.x1 - self.x0).max(0.0) * (self.y1 - self.y0).max(0.0)
    }

    /// The root of its area, 1 px at least: what is compared with the side of a car.
    pub fn side(&self) -> f32 {
        libm::sqrtf(self.area().max(1.0))
    }

    /// Intersection over union with `other`, 0 to 1.
    pub fn iou(&self, other: &Self) -> f32 {
        let intersection = self.intersection(other);
        let union = self.area() + other.area() - intersection;
        if union > 0.0 { intersection / union } else { 0.0 }
    }

    /// Intersection over the smaller of this and `other`, 0 to 1: 1 where one lies in the other.
    pub fn ios(&self, other: &Self) -> f32 {
        let smaller = self.area().min(other.area());
        if smaller > 0.0 { self.intersection(other) / smaller } else { 0.0 }
    }

    /// Where a vehicle in this box meets the road: the middle of the lower edge.
    pub fn contact(&self) -> ImagePoint {
        ImagePoint { u: (self.x0 + self.x1) / 2.0, v: self.y1 }
    }

    fn intersection(&self, other: &Self) -> f32 {
        let width = self.x1.min(other.x1) - self.x0.max(other.x0);
        let height = self.y1.min(other.y1) - self.y0.max(other.y0);
        width.max(0.0) * height.max(0.0)
    }
}

/// One vehicle found in a picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Detection {
    /// Where, in pixels of the picture.
    pub bounds: PixelBox,
    /// How sure it is, 0 to 1.
    pub score: f32,
    /// Kind of vehicle.
    pub class: VehicleClass,
}

impl Detection {
    /// Falling scores; equal ones by position, so that the same picture gives the same boxes.
    pub fn best_first(a: &Self, b: &Self) -> Ordering {
        let position = |d: &Self| (d.bounds.y0, d.bounds.x0);
        b.score
            .total_cmp(&a.score)
            .then(position(a).0.total_cmp(&position(b).0))
            .then(position(a).1.total_cmp(&position(b).1))
    }
}
