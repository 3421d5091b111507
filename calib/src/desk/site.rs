//! The site's folder: where pictures come from and where the site is saved.
//!
//! Owns the names of its files, which pictures may be asked for, and opening a site that was
//! saved, moved to where the camera looks now. Does not own writing it (see `save`).

use super::backdrop::{Backdrop, Shift, name_of};
use super::drawing::Drawing;
use crate::error::{Error, Result};
use crate::road::scene_reference::{picture, pictures};
use std::path::{Path, PathBuf};

/// What was drawn.
pub const SITE: &str = "site.json";
/// The picture that it was drawn on.
pub const POSE: &str = "pose.png";
/// Displacement from which a camera has moved, px of a picture 320 px wide.
const MOVED_OF_320_PX: f64 = 0.5;

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
    /// Where there are no pictures.
    pub fn of(folder: &Path, site: Option<&Path>) -> Result<Self> {
        let inner = folder.join("frames");
        let frames = if inner.is_dir() { inner } else { folder.to_owned() };
        pictures(&frames)?;
        Ok(Self::at(folder, frames, site))
    }

    /// A folder whose `frames` will come from a camera.
    ///
    /// # Errors
    /// Where it cannot be made.
    pub fn of_camera(folder: &Path, site: Option<&Path>) -> Result<Self> {
        let frames = folder.join("frames");
        verge_desk::make_parent(&frames.join("picture"))?;
        Ok(Self::at(folder, frames, site))
    }

    fn at(folder: &Path, frames: PathBuf, site: Option<&Path>) -> Self {
        let folder = site.map_or_else(|| folder.join("site"), Path::to_owned);
        Site { frames, folder }
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
        let bytes = verge_desk::read_bytes(&path)?;
        let wrong = |detail: String| Error::Json { path: path.clone(), detail };
        let mut drawing = Drawing::parse(&bytes).map_err(wrong)?;
        if drawing.image_size != backdrop.image_size {
            return Err(Error::ImageSize {
                what: path.display().to_string(),
                actual: drawing.image_size,
                expected: backdrop.image_size,
            });
        }
        if drawing.backdrop == backdrop.sha256 {
            return Ok(Some(Opened { drawing, moved: None }));
        }
        let pose = self.file(POSE);
        let (old, width, height) = picture(&pose)?;
        if [width, height] != backdrop.image_size {
            let (what, expected) = (pose.display().to_string(), backdrop.image_size);
            return Err(Error::ImageSize { what, actual: [width, height], expected });
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
        let limit = MOVED_OF_320_PX * f64::from(backdrop.image_size[0]) / 320.0;
        if shift.displacement_px < limit {
            drawing.backdrop.clone_from(&backdrop.sha256);
            return Ok(Some(Opened { drawing, moved: None }));
        }
        drawing.map(|p| shift.apply(p, backdrop.image_size));
        Ok(Some(Opened { drawing, moved: Some(shift) }))
    }
}
