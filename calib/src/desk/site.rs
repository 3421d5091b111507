//! The site's folder: where pictures come from and where the site is saved.
//!
//! Owns the names of its files, which pictures may be asked for, and opening a site that was
//! saved, moved to where the camera looks now. Does not own writing it (see `save`).

pub mod source;

use super::backdrop::alike::unreadable;
use super::backdrop::{Backdrop, Shift, name_of};
use super::drawing::{Drawing, VERSION};
use crate::error::{Error, Result};
use crate::road::scene_reference::{picture, pictures};
use serde::Deserialize;
use std::path::{Path, PathBuf};

/// What was drawn.
pub const SITE: &str = "site.json";
/// The picture that it was drawn on.
pub const POSE: &str = "pose.png";

/// A site at the desk.
#[derive(Clone, Debug)]
pub struct Site {
    /// Folder of the pictures.
    pub frames: PathBuf,
    /// Folder of what is saved.
    pub folder: PathBuf,
}

/// What was saved before, as it lies on the pictures of now.
#[derive(Debug)]
pub struct Opened {
    /// The drawing, where its camera looks now.
    pub drawing: Drawing,
    /// How the camera moved since, where it did.
    pub moved: Option<Shift>,
}

impl Site {
    /// A folder with pictures, or with a folder `frames` of them. The site is saved in its
    /// folder `site` unless another is given.
    ///
    /// # Errors
    /// Where there are no pictures, or the site's folder is a file.
    pub fn of(folder: &Path, site: Option<&Path>) -> Result<Self> {
        let inner = folder.join("frames");
        let frames = if inner.is_dir() { inner } else { folder.to_owned() };
        pictures(&frames)?;
        Self::at(folder, frames, site)
    }

    /// A folder whose `frames` will come from a camera.
    ///
    /// # Errors
    /// Where it cannot be made.
    pub fn of_camera(folder: &Path, site: Option<&Path>) -> Result<Self> {
        let site = Self::at(folder, folder.join("frames"), site)?;
        verge_desk::make_parent(&site.frames.join("picture"))?;
        Ok(site)
    }

    fn at(folder: &Path, frames: PathBuf, site: Option<&Path>) -> Result<Self> {
        let folder = site.map_or_else(|| folder.join("site"), Path::to_owned);
        if let Some(file) = folder.ancestors().find(|p| p.exists()).filter(|p| !p.is_dir()) {
            return Err(Error::Usage(format!(
                "the site is saved in a folder, and {} is a file: give another one, --site DIR",
                file.display()
            )));
        }
        Ok(Site { frames, folder })
    }

    /// The pictures, by name.
    ///
    /// # Errors
    /// Where the folder cannot be listed.
    pub fn pictures(&self) -> Result<Vec<PathBuf>> {
        pictures(&self.frames)
    }

    /// The picture of this name. Only names that the folder lists lead anywhere.
    pub fn picture(&self, name: &str) -> Option<PathBuf> {
        let listed = self.pictures().ok()?.into_iter().find(|p| name_of(p) == name)?;
        // A link may lead out of the folder.
        let (real, frames) = (listed.canonicalize().ok()?, self.frames.canonicalize().ok()?);
        real.starts_with(frames).then_some(real)
    }

    /// Where a file of the site lies.
    pub fn file(&self, name: &str) -> PathBuf {
        self.folder.join(name)
    }

    /// What was saved before; `None` where nothing was.
    ///
    /// # Errors
    /// Where it cannot be read, or shows another scene than the pictures.
    pub fn open(&self, backdrop: &Backdrop) -> Result<Option<Opened>> {
        let path = self.file(SITE);
        if !path.exists() {
            return Ok(None);
        }
        let mut drawing = drawn(&path, &verge_desk::read_bytes(&path)?)?;
        if drawing.image_size != backdrop.image_size {
            return Err(self.other_size(drawing.image_size, backdrop));
        }
        if drawing.backdrop == backdrop.sha256 {
            return Ok(Some(Opened { drawing, moved: None }));
        }
        let pose = self.file(POSE);
        let (old, width, height) = picture(&pose).map_err(|_| lost(&pose, &unreadable(&pose)))?;
        if [width, height] != backdrop.image_size {
            return Err(self.other_size([width, height], backdrop));
        }
        let shift = backdrop.against(&old)?;
        if !shift.sure {
            return Err(Error::Usage(format!(
                "the pictures in {} do not show the scene that the site in {} was drawn on; give \
                 pictures of that camera, or another --site for this one",
                self.frames.display(),
                self.folder.display()
            )));
        }
        if shift.is_none(backdrop.image_size) {
            drawing.backdrop.clone_from(&backdrop.sha256);
            return Ok(Some(Opened { drawing, moved: None }));
        }
        drawing.map(|p| shift.apply(p, backdrop.image_size));
        Ok(Some(Opened { drawing, moved: Some(shift) }))
    }

    fn other_size(&self, [w, h]: [u32; 2], backdrop: &Backdrop) -> Error {
        let [width, height] = backdrop.image_size;
        Error::Usage(format!(
            "the pictures have {width} x {height} px now, the site in {} was drawn on {w} x {h}: \
             give another folder with --site DIR",
            self.folder.display()
        ))
    }
}

/// A saved drawing. A newer one may hold what this program does not know: its version comes first.
fn drawn(path: &Path, bytes: &[u8]) -> Result<Drawing> {
    #[derive(Deserialize)]
    struct Head {
        version: u32,
    }
    if let Ok(Head { version }) = serde_json::from_slice(bytes)
        && version > VERSION
    {
        return Err(Error::Usage(format!(
            "{} was made by a newer mvcalib (version {version} of its format; this one reads up to \
             {VERSION}): open it with that one, or give another folder: --site DIR",
            path.display()
        )));
    }
    if bytes.trim_ascii().is_empty() {
        return Err(lost(path, "it is empty"));
    }
    Drawing::parse(bytes).map_err(|why| lost(path, &why))
}

fn lost(path: &Path, why: &str) -> Error {
    Error::Usage(format!(
        "{}: {why}; restore it from a copy, or give another folder: --site DIR",
        path.display()
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_damaged_or_newer_drawing_says_what_to_do() {
        let said =
            |text: &str| drawn(Path::new("site.json"), text.as_bytes()).unwrap_err().to_string();
        let empty = said(" ");
        assert!(empty.starts_with("site.json: it is empty; restore it from a copy"), "{empty}");
        assert!(said("{\"format\":").contains("restore it from a copy"));
        let newer = said("{\"format\":\"verge-desk\",\"version\":2,\"unknown\":1}");
        assert!(newer.contains("a newer mvcalib") && newer.contains("reads up to 1"), "{newer}");
    }

    #[test]
    fn a_site_is_no_file() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("a.png");
        image::RgbImage::new(8, 8).save(&file).unwrap();
        for site in [file.clone(), file.join("deep")] {
            let said = Site::of(folder.path(), Some(&site)).unwrap_err().to_string();
            assert!(said.contains("a.png is a file"), "{said}");
        }
        assert!(Site::of(folder.path(), None).is_ok());
    }
}
