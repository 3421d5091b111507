//! The vehicle that each pixel shows: outlines filled from far to near at the picture's resolution.
//!
//! Owns occlusion. An outline is the union of the convex hulls of a mesh's parts, so it is that
//! of the body drawn. Barriers hide too. Owns no colours.

use std::collections::BTreeMap;

use crate::camera::Camera;
use crate::order::{self, Item};
use crate::simulation::{Placed, Simulation, Snapshot};
use crate::solid::barrier_blocks;
use crate::vehicle::mesh::mesh_of;

/// Pixel owner: nothing.
const NONE: u64 = 0;
/// Pixel owner: a barrier.
const BARRIER: u64 = u64::MAX;

/// A convex polygon in the picture, px.
type Polygon = Vec<[f64; 2]>;

/// The owner of each pixel, and how many pixels each vehicle would own alone.
pub struct OutlineMap {
    width: usize,
    height: usize,
    owner: Vec<u64>,
    whole: BTreeMap<u64, usize>,
    shown: BTreeMap<u64, usize>,
}

impl OutlineMap {
    /// Fills all outlines of a snapshot as a camera sees it.
    pub fn draw(street: &Simulation, snapshot: &Snapshot, camera: &Camera) -> Self {
        let (width, height) = (camera.width as usize, camera.height as usize);
        let mut map = OutlineMap {
            width,
            height,
            owner: vec![NONE; width * height],
            whole: BTreeMap::new(),
            shown: BTreeMap::new(),
        };
        let eye = camera.position();
        let mut items: Vec<Item<(u64, Vec<Polygon>)>> = Vec::new();
        for vehicle in &snapshot.vehicles {
            if let Some(hulls) = hulls(vehicle, camera) {
                items.push(Item::vehicle(vehicle, &eye, (vehicle.id, hulls)));
            }
        }
        for block in barrier_blocks(street) {
            let image: Option<Vec<_>> = block.corners().iter().map(|p| camera.project(p)).collect();
            if let Some(image) = image {
                items.push(Item::block(&block, &eye, (BARRIER, vec![hull(image)])));
            }
        }
        let items = order::far_to_near(items, &snapshot.vehicles, &eye);
        let mut stamp = vec![0u32; width * height];
        for (number, Item { what: (id, hulls), .. }) in items.iter().enumerate() {
            let mut whole = 0;
            for polygon in hulls {
                fill(polygon, width, height, |pixel| {
                    if stamp[pixel] != number as u32 + 1 {
                        stamp[pixel] = number as u32 + 1;
                        map.owner[pixel] = *id;
                        whole += 1;
                    }
                });
            }
            if *id != BARRIER {
                map.whole.insert(*id, whole);
            }
        }
        // Runs of one owner are long, so that a look-up per run is cheap.
        for run in map.owner.chunk_by(|a, b| a == b) {
            *map.shown.entry(run[0]).or_insert(0) += run.len();
        }
        map
    }

    /// The hidden share of a vehicle, 0 to 1; `None` when none of it is in the picture.
    pub fn occlusion(&self, id: u64) -> Option<f64> {
        let whole = *self.whole.get(&id)?;
        let shown = self.shown.get(&id).copied().unwrap_or(0);
        (whole > 0).then(|| 1.0 - shown as f64 / whole as f64)
    }

    /// True when an image point lies in the picture and shows this vehicle, or lies beside every
    /// outline within a pixel of this one's edge.
    pub fn shows(&self, id: u64, image: [f64; 2]) -> bool {
        let (x, y) = (image[0].floor(), image[1].floor());
        if x < 0.0 || y < 0.0 || x >= self.width as f64 || y >= self.height as f64 {
            return false;
        }
        let owner = self.owner[y as usize * self.width + x as usize];
        owner == id || owner == NONE
    }
}

/// The bounding box of a vehicle's outline, not clipped, px; `None` when part of it is behind
/// the camera, or part of a long lorry where the lens model ends: that one is not drawn either.
pub fn hull_boxes(vehicle: &Placed, camera: &Camera) -> Option<[f64; 4]> {
    let long = order::is_long(vehicle);
    let mut bounds = [f64::MAX, f64::MAX, f64::MIN, f64::MIN];
    let parts = mesh_of(vehicle.model_index).parts.iter().flatten();
    for point in parts.chain(&vehicle.model().key_points) {
        let world = vehicle.world(*point);
        if long && !camera.images(&world) {
            return None;
        }
        let p = camera.project(&world)?;
        bounds[0] = bounds[0].min(p[0]);
        bounds[1] = bounds[1].min(p[1]);
        bounds[2] = bounds[2].max(p[0]);
        bounds[3] = bounds[3].max(p[1]);
    }
    Some(bounds)
}

fn hulls(vehicle: &Placed, camera: &Camera) -> Option<Vec<Polygon>> {
    let [x0, y0, x1, y1] = hull_boxes(vehicle, camera)?;
    if x1 < 0.0 || y1 < 0.0 || x0 > f64::from(camera.width) || y0 > f64::from(camera.height) {
        return None;
    }
    let parts = mesh_of(vehicle.model_index).parts.iter();
    parts
        .map(|part| {
            let image: Option<Vec<_>> =
                part.iter().map(|point| camera.project(&vehicle.world(*point))).collect();
            image.map(hull)
        })
        .collect()
}

/// The convex hull of image points, counter-clockwise in y-up terms (Andrew's monotone chain).
pub fn hull(mut points: Polygon) -> Polygon {
    points.sort_by(|a, b| a[0].total_cmp(&b[0]).then(a[1].total_cmp(&b[1])));
    points.dedup();
    if points.len() < 3 {
        return points;
    }
    let cross = |o: [f64; 2], a: [f64; 2], b: [f64; 2]| {
        (a[0] - o[0]) * (b[1] - o[1]) - (a[1] - o[1]) * (b[0] - o[0])
    };
    let mut hull: Polygon = Vec::with_capacity(points.len() + 1);
    for pass in 0..2 {
        let floor = hull.len() + 1;
        let step = |hull: &mut Polygon, p: [f64; 2]| {
            while hull.len() > floor && cross(hull[hull.len() - 2], hull[hull.len() - 1], p) <= 0.0
            {
                hull.pop();
            }
            hull.push(p);
        };
        if pass == 0 {
            points.iter().for_each(|p| step(&mut hull, *p));
        } else {
            points.iter().rev().for_each(|p| step(&mut hull, *p));
        }
        hull.pop();
    }
    hull
}

/// Calls `paint` for each pixel whose centre lies in a convex polygon.
fn fill(polygon: &[[f64; 2]], width: usize, height: usize, mut paint: impl FnMut(usize)) {
    let (mut top, mut bottom) = (f64::MAX, f64::MIN);
    for p in polygon {
        top = top.min(p[1]);
        bottom = bottom.max(p[1]);
    }
    let first = (top - 0.5).ceil().max(0.0) as usize;
    let last = (bottom - 0.5).floor().min(height as f64 - 1.0);
    if last < 0.0 {
        return;
    }
    for row in first..=last as usize {
        let y = row as f64 + 0.5;
        let (mut left, mut right) = (f64::MAX, f64::MIN);
        for (i, a) in polygon.iter().enumerate() {
            let b = polygon[(i + 1) % polygon.len()];
            if (a[1] <= y) != (b[1] <= y) {
                let x = a[0] + (y - a[1]) / (b[1] - a[1]) * (b[0] - a[0]);
                left = left.min(x);
                right = right.max(x);
            }
        }
        let from = (left - 0.5).ceil().max(0.0);
        let to = (right - 0.5).floor().min(width as f64 - 1.0);
        if from <= to {
            for column in from as usize..=to as usize {
                paint(row * width + column);
            }
        }
    }
}
