//! The files that all pages share, built into the program.
//!
//! Owns style, elements, the canvas with its zoom, and what is drawn over a picture. Each
//! program has the content of its page.

/// A file of a page: its name, its media type, its content.
pub type File = (&'static str, &'static str, &'static str);

/// The media type of scripts.
pub const SCRIPT: &str = "text/javascript; charset=utf-8";

/// The files, by the names under which scripts import them.
pub const SHARED: [File; 4] = [
    ("style.css", "text/css; charset=utf-8", include_str!("../page/style.css")),
    ("elements.js", SCRIPT, include_str!("../page/elements.js")),
    ("paint.js", SCRIPT, include_str!("../page/paint.js")),
    ("stage.js", SCRIPT, include_str!("../page/stage.js")),
];

/// Media type and content of the file of this name, of a page's own or the shared ones.
pub fn find(own: &[File], name: &str) -> Option<(&'static str, &'static str)> {
    own.iter().chain(&SHARED).find(|file| file.0 == name).map(|file| (file.1, file.2))
}
