//! The desk: a page in the browser on which a camera is calibrated and its lanes are drawn.
//!
//! ```text
//! site       the folder: pictures, what was saved, what is never left
//! backdrop   the picture without traffic, and how each frame lies against it
//! drawing    what the page has drawn, as cues and as labelme shapes
//! strips     lanes between neighbouring lines
//! answer     what the page shows of a measured drawing
//! look       a drawing measured: camera, errors, residuals, lanes and what is wrong with them
//! dashes     the dashes of the drawn lines in the picture without traffic
//! program    the program `verge` beside this one, one task at a time
//! collect    pictures of a camera, collected by it
//! traffic    vehicles of the pictures in the lanes, found by it
//! audit      pictures that a person counts, compared by it with what the sensor counts
//! save       calibration, lanes, lane table, verge.toml: all of them or none
//! server     what is answered to the page
//! page/      the page itself: HTML, CSS and JavaScript as browsers read it
//! ```
//!
//! Owns the way from a folder of pictures to a saved site. Does not own calibration, lanes or
//! their judgement (see `road`), nor cameras, detectors and what an audit says: the sensor's own
//! program does these.

pub mod answer;
pub mod audit;
pub mod backdrop;
pub mod collect;
pub mod dashes;
mod draft;
pub mod drawing;
pub mod look;
mod merged;
mod page;
pub mod program;
pub mod save;
pub mod server;
pub mod site;
mod strips;
pub mod traffic;
