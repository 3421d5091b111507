//! The view: what a sensor sees, for a browser on the box or behind `ssh -L`.
//!
//! Owns what is shown of a picture that was measured, and the files of the page. Changes nothing:
//! neither the sensor's settings nor its counts, and nothing of it is published.

mod seen;

pub use seen::{Outlines, Seen, Totals};

use verge_desk::page::{File, SCRIPT};

/// The page itself.
pub const INDEX: &str = include_str!("page/index.html");

/// Files of the page, beside those that all pages share.
const FILES: [File; 1] = [("view.js", SCRIPT, include_str!("page/view.js"))];

/// The file of this name: its media type and its content.
pub fn find(name: &str) -> Option<(&'static str, &'static str)> {
    verge_desk::page::find(&FILES, name)
}
