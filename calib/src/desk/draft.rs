//! What is drawn and not saved: a file in the site's folder, by which it outlives the program.
//!
//! Owns that no drawing is lost for one on other pictures: it is set aside under another name. Does
//! not own when it is written (see `server`).

use super::backdrop::{Backdrop, hexadecimal};
use super::drawing::Drawing;
use super::site::{Site, source};
use crate::road::scene_reference::picture;
use std::path::Path;

/// The file.
pub const DRAFT: &str = "draft.json";
/// The picture that it was drawn on, by which it is found again on others of the scene.
const PICTURE: &str = "draft.png";
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

/// Looks for the drawing of an earlier page. It goes on on pictures that show its scene where it was;
/// one that does not lie on this picture is set aside.
pub fn find(site: &Site, backdrop: &Backdrop) -> Draft {
    let file = site.file(DRAFT);
    let Ok(json) = verge_desk::read_bytes(&file) else { return Draft::None };
    let why = match Drawing::parse(&json) {
        Ok(mut drawing) if lies_on(&drawing, &site.file(PICTURE), backdrop) => {
            drawing.backdrop.clone_from(&backdrop.sha256);
            return Draft::Here(Box::new(drawing));
        }
        Ok(_) => "was drawn on other pictures, or before the camera moved".to_owned(),
        Err(why) => format!("cannot be read ({why})"),
    };
    let free = (1..MOST_ASIDE).map(|n| site.file(&format!("draft-{n}.json"))).find(|p| !p.exists());
    let moved = free.filter(|to| std::fs::rename(&file, to).is_ok());
    let Some(to) = moved else { return Draft::None };
    let _ = std::fs::rename(site.file(PICTURE), to.with_extension("png"));
    Draft::Aside(format!("What was not saved before {why}. It is kept as {}.", to.display()))
}

/// Whether a drawing lies on a picture as it lay on its own.
fn lies_on(drawing: &Drawing, own: &Path, backdrop: &Backdrop) -> bool {
    if drawing.backdrop == backdrop.sha256 {
        return true;
    }
    let Ok((rgb, width, height)) = picture(own) else { return false };
    let is_own = hexadecimal(&rgb) == drawing.backdrop;
    let sizes = [drawing.image_size, [width, height]];
    is_own
        && sizes.iter().all(|size| *size == backdrop.image_size)
        && backdrop.against(&rgb).is_ok_and(|s| s.sure && s.is_none(backdrop.image_size))
}

/// Writes it, and the picture that it is drawn on. Where that cannot be, saving says so.
pub fn keep(site: &Site, drawing: &Drawing, backdrop: &Backdrop) {
    let mut drawing = drawing.clone();
    // A password is written nowhere.
    if source::saved(&drawing.source, &site.folder).is_err() {
        drawing.source.clear();
    }
    let (file, own) = (site.file(DRAFT), site.file(PICTURE));
    let json = serde_json::to_vec(&drawing).expect("a drawing of finite numbers is JSON");
    let _ = verge_desk::make_parent(&file).and_then(|()| verge_desk::write_whole(&file, &json));
    let is_there = std::fs::read(&own).is_ok_and(|png| png == backdrop.png);
    if drawing.backdrop == backdrop.sha256 && !is_there {
        let _ = verge_desk::write_whole(&own, &backdrop.png);
    }
}

/// Removes it: it is saved, or given up.
pub fn drop(site: &Site) {
    for name in [DRAFT, PICTURE] {
        let _ = std::fs::remove_file(site.file(name));
    }
}
