//! The simulated street: recordings with exact truth, for tests, benchmarks and the demo.
//!
//! No recording anywhere has pictures, metric positions and dense traffic of one camera at once;
//! this crate makes them. A [`scene::Scene`] (a small TOML file) says everything but the seed.
//! [`simulation::Simulation`] runs its traffic, [`faults::View`] says which camera takes a frame,
//! [`render::Renderer`] draws it, [`truth`] says what is in it, [`recording`] writes all to disk.
//! The daemon never uses this crate.
//!
//! ```
//! # use street::{faults::View, render::Renderer, scene::Scene, simulation::Simulation, truth};
//! # fn main() -> street::error::Result<()> {
//! let text = include_str!("../scenes/tiny.toml");
//! let scene = Scene::parse(text, "tiny.toml", &[])?;
//! let mut street = Simulation::new(&scene, 7)?;
//! let mut renderer = Renderer::new(&street, 7);
//! street.step(2.0);
//! let snapshot = street.snapshot();
//! let view = View::at(&scene, 7, snapshot.time_s);
//! let picture = renderer.render(&street, &snapshot, &view);
//! let vehicles = truth::vehicles(&street, &snapshot, &view.camera());
//! let moved = street.take_moved();
//! let lanes = truth::lanes(street.measured(), &snapshot, &moved);
//! # assert_eq!(picture.data.len(), 160 * 120 * 3);
//! # assert_eq!(lanes.len(), 2);
//! # let _ = vehicles;
//! # Ok(())
//! # }
//! ```

pub mod camera;
pub mod error;
pub mod faults;
mod font;
pub mod measured;
mod order;
mod outline;
pub mod random;
pub mod recording;
pub mod render;
pub mod road;
pub mod scene;
pub mod score;
pub mod simulation;
mod solid;
pub mod traffic;
pub mod truth;
pub mod vehicle;
