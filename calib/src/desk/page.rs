//! The files of the page, built into the program.
//!
//! Owns which there are and their types. Does not own who gets them (see `server`).

use verge_desk::page::{File, SCRIPT};

/// The page itself.
pub const INDEX: &str = include_str!("page/index.html");

/// What it asks for, beside what all pages share.
const FILES: [File; 16] = [
    ("main.js", SCRIPT, include_str!("page/main.js")),
    ("types.js", SCRIPT, include_str!("page/types.js")),
    ("server.js", SCRIPT, include_str!("page/server.js")),
    ("store.js", SCRIPT, include_str!("page/store.js")),
    ("tools.js", SCRIPT, include_str!("page/tools.js")),
    ("fields.js", SCRIPT, include_str!("page/fields.js")),
    ("keys.js", SCRIPT, include_str!("page/keys.js")),
    ("pictures.js", SCRIPT, include_str!("page/pictures.js")),
    ("collect.js", SCRIPT, include_str!("page/collect.js")),
    ("road.js", SCRIPT, include_str!("page/road.js")),
    ("dashes.js", SCRIPT, include_str!("page/dashes.js")),
    ("lanes.js", SCRIPT, include_str!("page/lanes.js")),
    ("traffic.js", SCRIPT, include_str!("page/traffic.js")),
    ("car.js", SCRIPT, include_str!("page/car.js")),
    ("save.js", SCRIPT, include_str!("page/save.js")),
    ("audit.js", SCRIPT, include_str!("page/audit.js")),
];

/// The file of this name: its media type and its content.
pub fn find(name: &str) -> Option<(&'static str, &'static str)> {
    verge_desk::page::find(&FILES, name)
}
