//! What is drawn and not saved: a file in the site's folder, by which it outlives the program.
//!
//! Owns that no drawing is lost for one on other pictures: it is set aside under another name. Does
//! not own when it is written (see `server`).

use super::drawing::Drawing;
use super::site::{Site, source};

/// The file.
pub const DRAFT: &str = "draft.json";
/// Most drawings that lie aside.
const MOST_ASIDE: usize = 1000;

/// The drawing that was not saved.
pub enum Draft {
    /// There is none.
    None,
    /// It lies on the pictures of now.
    Here(Box<Drawing>),
    /// It does not, and was set aside: in words.
    Aside(String),
}

/// Looks for the drawing of an earlier page. One that is not on the picture with this digest is set
/// aside.
pub fn find(site: &Site, backdrop: &str) -> Draft {
    let file = site.file(DRAFT);
    let Ok(json) = verge_desk::read_bytes(&file) else { return Draft::None };
    let why = match Drawing::parse(&json) {
        Ok(drawing) if drawing.backdrop == backdrop => return Draft::Here(Box::new(drawing)),
        Ok(_) => "was drawn on other pictures, or before the camera moved".to_owned(),
        Err(why) => format!("cannot be read ({why})"),
    };
    let free = (1..MOST_ASIDE).map(|n| site.file(&format!("draft-{n}.json"))).find(|p| !p.exists());
    let moved = free.filter(|to| std::fs::rename(&file, to).is_ok());
    let Some(to) = moved else { return Draft::None };
    Draft::Aside(format!(
        "What was not saved before {why}. It is kept as {}: to go on with it, open its pictures again \
         with that file named {DRAFT}.",
        to.display()
    ))
}

/// Writes it. Where that cannot be, saving says so.
pub fn keep(site: &Site, drawing: &Drawing) {
    let mut drawing = drawing.clone();
    // A password is written nowhere.
    if source::saved(&drawing.source, &site.folder).is_err() {
        drawing.source.clear();
    }
    let file = site.file(DRAFT);
    let json = serde_json::to_vec(&drawing).expect("a drawing of finite numbers is JSON");
    let _ = verge_desk::make_parent(&file).and_then(|()| verge_desk::write_whole(&file, &json));
}

/// Removes it: it is saved, or given up.
pub fn drop(site: &Site) {
    let _ = std::fs::remove_file(site.file(DRAFT));
}
