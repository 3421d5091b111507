//! Lofted bodies: rings of points along a vehicle, joined by flat faces.
//!
//! Owns how faces, decals and convex parts of a mesh are made. The shapes themselves are
//! `bodies.rs`; nothing here knows a camera.

use super::mesh::{Face, Material, Mesh};

/// Points of one half ring, from sill to roof edge.
pub const RING: usize = 5;

/// One cross section of a body, symmetric about its middle.
#[derive(Debug, Clone, Copy)]
pub struct Ring {
    /// Place along the vehicle, m.
    pub y: f64,
    /// Half widths from sill to roof edge, m.
    pub half: [f64; RING],
    /// Heights of the same points, m.
    pub z: [f64; RING],
    /// Height of the roof's middle, m.
    pub crown: f64,
}

/// Materials of the strip between two rings.
#[derive(Debug, Clone, Copy)]
pub struct Strip {
    /// Sill to mid, mid to belt.
    pub side: Material,
    /// Belt to top of the window.
    pub window: Material,
    /// Top of the window to roof edge.
    pub rail: Material,
    /// Hood, windscreen or roof.
    pub top: Material,
}

/// Builds a mesh in a model frame whose middle is at `centre_x`.
pub struct Builder {
    mesh: Mesh,
    centre_x: f64,
}

impl Builder {
    /// An empty mesh about the plane X = `centre_x`.
    pub fn new(centre_x: f64) -> Self {
        Builder { mesh: Mesh::default(), centre_x }
    }

    /// The finished mesh.
    pub fn finish(self) -> Mesh {
        self.mesh
    }

    /// A body of rings from front to rear, `strips[i]` between rings i and i + 1, with caps.
    pub fn loft(&mut self, rings: &[Ring], strips: &[Strip], front: Material, rear: Material) {
        for (pair, strip) in rings.windows(2).zip(strips) {
            let (a, b) = (self.outline(&pair[0]), self.outline(&pair[1]));
            let n = a.len();
            let inside = self.inside(&pair[0], &pair[1]);
            for i in 0..n - 1 {
                let material = match i.min(n - 2 - i) {
                    0 | 1 => strip.side,
                    2 => strip.window,
                    3 => strip.rail,
                    _ => strip.top,
                };
                let corners = vec![a[i], a[i + 1], b[i + 1], b[i]];
                self.mesh.faces.push(Face::around(corners, inside, material));
            }
            self.mesh.parts.push(a.iter().chain(&b).copied().collect());
        }
        let n = rings.len();
        let nose = self.inside(&rings[0], &rings[1]);
        self.mesh.faces.push(Face::around(self.outline(&rings[0]), nose, front));
        let tail = self.inside(&rings[n - 2], &rings[n - 1]);
        self.mesh.faces.push(Face::around(self.outline(&rings[n - 1]), tail, rear));
    }

    /// A box, for mirrors, loads and the like.
    pub fn cuboid(&mut self, x: [f64; 2], y: [f64; 2], z: [f64; 2], material: Material) {
        let p = |i: usize, j: usize, k: usize| [x[i], y[j], z[k]];
        let sides = [
            [p(0, 0, 0), p(1, 0, 0), p(1, 0, 1), p(0, 0, 1)],
            [p(1, 1, 0), p(0, 1, 0), p(0, 1, 1), p(1, 1, 1)],
            [p(0, 1, 0), p(0, 0, 0), p(0, 0, 1), p(0, 1, 1)],
            [p(1, 0, 0), p(1, 1, 0), p(1, 1, 1), p(1, 0, 1)],
            [p(0, 0, 1), p(1, 0, 1), p(1, 1, 1), p(0, 1, 1)],
        ];
        for side in sides {
            self.mesh.faces.push(Face::new(side.to_vec(), material));
        }
        self.mesh.parts.push(sides[0].iter().chain(&sides[1]).copied().collect());
    }

    /// A rectangle on the front, facing forward, painted over the faces.
    pub fn on_front(&mut self, x: [f64; 2], z: [f64; 2], y: f64, material: Material) {
        let corners = vec![[x[0], y, z[0]], [x[1], y, z[0]], [x[1], y, z[1]], [x[0], y, z[1]]];
        self.mesh.decals.push(Face::new(corners, material));
    }

    /// A rectangle on the rear, facing backward.
    pub fn on_rear(&mut self, x: [f64; 2], z: [f64; 2], y: f64, material: Material) {
        let corners = vec![[x[1], y, z[0]], [x[0], y, z[0]], [x[0], y, z[1]], [x[1], y, z[1]]];
        self.mesh.decals.push(Face::new(corners, material));
    }

    /// A rectangle on both flanks at `half` metres from the middle.
    pub fn on_flanks(&mut self, half: f64, y: [f64; 2], z: [f64; 2], material: Material) {
        for side in [-1.0, 1.0] {
            let x = self.centre_x + side * half;
            let mut corners =
                vec![[x, y[0], z[0]], [x, y[1], z[0]], [x, y[1], z[1]], [x, y[0], z[1]]];
            if side < 0.0 {
                corners.reverse();
            }
            self.mesh.decals.push(Face::new(corners, material));
        }
    }

    /// A wheel on both flanks: tyre in its dark arch, and rim.
    pub fn wheels(&mut self, half: f64, y: f64, radius: f64) {
        for side in [-1.0, 1.0] {
            let x = self.centre_x + side * (half + 0.005);
            for (scale, material) in
                [(1.12, Material::Shade), (1.0, Material::Tyre), (0.62, Material::Rim)]
            {
                let lift = if material == Material::Shade { 0.04 } else { 0.0 };
                let mut corners: Vec<[f64; 3]> = (0..12)
                    .map(|i| {
                        let (sin, cos) = (f64::from(i) * std::f64::consts::TAU / 12.0).sin_cos();
                        let z = (radius + lift + scale * radius * sin).max(0.0);
                        [x, y + scale * radius * cos, z]
                    })
                    .collect();
                if side < 0.0 {
                    corners.reverse();
                }
                self.mesh.decals.push(Face::new(corners, material));
            }
            let hub = self.centre_x + side * (half - 0.2);
            let ring = |x: f64| {
                [
                    [x, y - radius, radius * 0.3],
                    [x, y, 0.0],
                    [x, y + radius, radius * 0.3],
                    [x, y, radius],
                ]
            };
            self.mesh.parts.push(ring(x).into_iter().chain(ring(hub)).collect());
            // The tread, seen under the body from front and rear.
            let (x0, x1) = (x.min(hub), x.max(hub));
            self.mesh.faces.push(Face::new(
                vec![
                    [x0, y - radius * 0.8, 0.0],
                    [x1, y - radius * 0.8, 0.0],
                    [x1, y - radius, radius],
                    [x0, y - radius, radius],
                ],
                Material::Tyre,
            ));
            self.mesh.faces.push(Face::new(
                vec![
                    [x1, y + radius * 0.8, 0.0],
                    [x0, y + radius * 0.8, 0.0],
                    [x0, y + radius, radius],
                    [x1, y + radius, radius],
                ],
                Material::Tyre,
            ));
        }
    }

    fn outline(&self, ring: &Ring) -> Vec<[f64; 3]> {
        let left = (0..RING).map(|i| [self.centre_x - ring.half[i], ring.y, ring.z[i]]);
        let crown = std::iter::once([self.centre_x, ring.y, ring.crown]);
        let right = (0..RING).rev().map(|i| [self.centre_x + ring.half[i], ring.y, ring.z[i]]);
        left.chain(crown).chain(right).collect()
    }

    /// A point within the body between two rings.
    fn inside(&self, a: &Ring, b: &Ring) -> [f64; 3] {
        let low = (a.z[0] + b.z[0]) / 2.0;
        let high = (a.crown + b.crown) / 2.0;
        [self.centre_x, (a.y + b.y) / 2.0, (low + high) / 2.0]
    }
}
