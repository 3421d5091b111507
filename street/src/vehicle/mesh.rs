//! The mesh of a vehicle: flat faces with a material, decals, and convex parts.
//!
//! Owns the data that the renderer and the truth share, so that boxes and pictures are of the
//! same body. Shapes are made in `bodies.rs`.

use std::sync::OnceLock;

use nalgebra::Vector3;

use super::{MODELS, bodies};

/// Material of a face; colours come from the vehicle's livery and the light.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Material {
    /// Body paint.
    Paint,
    /// Paint of the roof (taxis, trucks' loads).
    Roof,
    /// Window glass.
    Glass,
    /// Black plastic.
    Trim,
    /// Gaps, arches and grilles.
    Shade,
    /// Rubber.
    Tyre,
    /// Wheel rims, bright metal.
    Rim,
    /// Headlight.
    Headlight,
    /// Tail and brake light.
    Taillight,
    /// Number plate.
    Plate,
    /// A lit sign, such as a bus's destination.
    Sign,
    /// A rider's clothes.
    Cloth,
    /// A rider's helmet.
    Helmet,
}

/// A flat convex polygon, counter-clockwise seen from outside.
#[derive(Debug, Clone)]
pub struct Face {
    /// Corners in the model frame, m.
    pub corners: Vec<[f64; 3]>,
    /// Outward unit normal (Newell's method, so slightly bent faces are fine).
    pub normal: Vector3<f64>,
    /// Middle of the corners, m.
    pub middle: [f64; 3],
    /// Material.
    pub material: Material,
}

impl Face {
    /// A face with its normal from its corners.
    pub fn new(corners: Vec<[f64; 3]>, material: Material) -> Self {
        let n = corners.len();
        let mut normal = Vector3::zeros();
        let mut middle = [0.0; 3];
        for i in 0..n {
            let (a, b) = (corners[i], corners[(i + 1) % n]);
            normal.x += (a[1] - b[1]) * (a[2] + b[2]);
            normal.y += (a[2] - b[2]) * (a[0] + b[0]);
            normal.z += (a[0] - b[0]) * (a[1] + b[1]);
            for k in 0..3 {
                middle[k] += a[k] / n as f64;
            }
        }
        let normal = normal.try_normalize(1e-12).unwrap_or_else(Vector3::z);
        Face { corners, normal, middle, material }
    }

    /// A face of a convex part around the point `inside`, turned outwards if need be.
    pub fn around(mut corners: Vec<[f64; 3]>, inside: [f64; 3], material: Material) -> Self {
        let face = Face::new(corners.clone(), material);
        let outward = Vector3::new(
            face.middle[0] - inside[0],
            face.middle[1] - inside[1],
            face.middle[2] - inside[2],
        );
        if face.normal.dot(&outward) >= 0.0 {
            return face;
        }
        corners.reverse();
        Face::new(corners, material)
    }
}

/// The shape of a vehicle model.
#[derive(Debug, Clone, Default)]
pub struct Mesh {
    /// The body's faces.
    pub faces: Vec<Face>,
    /// Faces painted over the body, in this order.
    pub decals: Vec<Face>,
    /// Convex parts as point clouds, m; the silhouette is the union of their hulls.
    pub parts: Vec<Vec<[f64; 3]>>,
}

/// The mesh of a model by its index in [`MODELS`].
pub fn mesh_of(model_index: usize) -> &'static Mesh {
    static MESHES: OnceLock<Vec<Mesh>> = OnceLock::new();
    &MESHES.get_or_init(|| MODELS.iter().map(bodies::build).collect())[model_index]
}

#[cfg(test)]
mod tests {
    use super::{MODELS, mesh_of};

    #[test]
    fn a_mesh_fills_its_models_footprint_and_height() {
        for (index, model) in MODELS.iter().enumerate() {
            let mut low = [f64::MAX; 3];
            let mut high = [f64::MIN; 3];
            for point in mesh_of(index).parts.iter().flatten() {
                for k in 0..3 {
                    low[k] = low[k].min(point[k]);
                    high[k] = high[k].max(point[k]);
                }
            }
            let near = |a: f64, b: f64, slack: f64| (a - b).abs() <= slack;
            assert!(near(low[1], model.ends_m[0], 0.03), "{} front {low:?}", model.name);
            assert!(near(high[1], model.ends_m[1], 0.03), "{} rear {high:?}", model.name);
            assert!(near(high[2], model.height_m, 0.05), "{} top {high:?}", model.name);
            assert!(near(low[2], 0.0, 0.01), "{} ground {low:?}", model.name);
            assert!(low[0] >= model.sides_m[0] - 0.25 && high[0] <= model.sides_m[1] + 0.25);
        }
    }
}
