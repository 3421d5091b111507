//! The files of the page, built into the program.
//!
//! Owns which there are and their types. Does not own who gets them (see `server`).

/// A file of the page: its name, its media type, its content.
type File = (&'static str, &'static str, &'static str);

const SCRIPT: &str = "text/javascript; charset=utf-8";

/// The page itself.
pub const INDEX: &str = include_str!("page/index.html");

/// Everything that it asks for.
const FILES: [File; 15] = [
    ("style.css", "text/css; charset=utf-8", include_str!("page/style.css")),
    ("main.js", SCRIPT, include_str!("page/main.js")),
    ("types.js", SCRIPT, include_str!("page/types.js")),
    ("server.js", SCRIPT, include_str!("page/server.js")),
    ("store.js", SCRIPT, include_str!("page/store.js")),
    ("stage.js", SCRIPT, include_str!("page/stage.js")),
    ("paint.js", SCRIPT, include_str!("page/paint.js")),
    ("tools.js", SCRIPT, include_str!("page/tools.js")),
    ("elements.js", SCRIPT, include_str!("page/elements.js")),
    ("pictures.js", SCRIPT, include_str!("page/pictures.js")),
    ("road.js", SCRIPT, include_str!("page/road.js")),
    ("lanes.js", SCRIPT, include_str!("page/lanes.js")),
    ("traffic.js", SCRIPT, include_str!("page/traffic.js")),
    ("car.js", SCRIPT, include_str!("page/car.js")),
    ("save.js", SCRIPT, include_str!("page/save.js")),
];

/// The file of this name.
pub fn find(name: &str) -> Option<(&'static str, &'static str)> {
    FILES.iter().find(|f| f.0 == name).map(|f| (f.1, f.2))
}
