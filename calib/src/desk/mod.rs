//! The desk: a page in the browser on which a camera is calibrated and its lanes are drawn.
//!
//! ```text
//! site       the folder: pictures, what was saved, what is never left
//! backdrop   the picture without traffic, and how each frame lies against it
//! drawing    what the page has drawn, as cues and as labelme shapes
//! strips     lanes between neighbouring lines
//! look       a drawing measured: camera, errors, residuals, lanes and what is wrong with them
//! traffic    vehicles of the pictures in the lanes, found by the program `verge`
//! save       calibration, lanes, lane table, verge.toml: all of them or none
//! server     HTTP on loopback, and who is refused
//! page/      the page itself: HTML, CSS and JavaScript as browsers read it
//! ```
//!
//! Owns the way from a folder of pictures to a saved site. Does not own calibration, lanes or
//! their judgement (see `road`), nor pictures from a camera: a folder is all that it reads.

pub mod backdrop;
pub mod drawing;
pub mod look;
mod page;
pub mod save;
pub mod server;
pub mod site;
mod strips;
pub mod traffic;
