//! Boxes of pictures, bound to what the pictures held when they were searched.
//!
//! Owns the file of boxes, the file beside it with the pictures' SHA-256, and which boxes still are
//! of these pictures. Boxes of others would lie beside the vehicles and bend the fit.

use super::super::backdrop::alike::alike;
use super::super::backdrop::{hexadecimal, name_of};
use super::super::site::Site;
use super::{DETECTIONS, FrameBoxes};
use crate::error::{Error, Result};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use verge_desk::Failure;

/// The file that binds the boxes to their pictures, in the site's folder.
pub const SOURCES: &str = "detections.sources.json";
/// Version of that file.
const VERSION: u32 = 1;

/// SHA-256 of pictures by their name.
pub type Pictures = BTreeMap<String, String>;

/// What was searched.
#[derive(Debug, Default)]
pub struct Searched {
    /// Boxes, picture by picture.
    pub frames: Vec<FrameBoxes>,
    /// What they were found in.
    pub pictures: Pictures,
}

/// What is to be said of boxes that were at hand.
#[derive(Debug, Default)]
pub struct Note {
    /// Pictures whose boxes were dropped.
    pub stale: usize,
    /// The same in words, or what else is wrong.
    pub said: Option<String>,
}

/// [`SOURCES`]
#[derive(Debug, Serialize, Deserialize)]
struct Sources {
    version: u32,
    /// SHA-256 of the file of boxes.
    detections: String,
    pictures: Pictures,
}

/// The pictures of one size in the site's folder.
pub fn pictures_of(site: &Site) -> Pictures {
    let listed = alike(&site.pictures().unwrap_or_default()).pictures;
    let print = |path: &PathBuf| Some((name_of(path), hexadecimal(&std::fs::read(path).ok()?)));
    listed.par_iter().filter_map(print).collect()
}

impl Searched {
    /// What a search of these pictures has written; binds it to them. They were looked at before
    /// the search: what was replaced during it does not pass.
    pub fn bound(site: &Site, pictures: Pictures) -> Result<Self> {
        let out = site.file(DETECTIONS);
        let bytes = verge_desk::read_bytes(&out)?;
        let sources = Sources { version: VERSION, detections: hexadecimal(&bytes), pictures };
        let text = serde_json::to_vec(&sources).expect("texts are JSON");
        verge_desk::write_whole(&site.file(SOURCES), &text)?;
        let mut frames = parse(&out, bytes)?;
        let pictures = sources.pictures;
        frames.retain(|f| pictures.contains_key(&f.name()));
        Ok(Searched { frames, pictures })
    }

    /// Boxes that a person names: those of pictures that are there.
    pub fn given(path: &Path, site: &Site) -> Result<(Self, Note)> {
        let mut frames = parse(path, verge_desk::read_bytes(path)?)?;
        let pictures = pictures_of(site);
        let all = frames.len();
        frames.retain(|f| pictures.contains_key(&f.name()));
        let stale = all - frames.len();
        let said = format!(
            "{}: boxes of {stale} of {all} pictures are left out: these are not in {}, or cannot be \
             used",
            path.display(),
            site.frames.display()
        );
        Ok((Searched { frames, pictures }, Note { stale, said: (stale > 0).then_some(said) }))
    }

    /// Boxes of an earlier search, as far as its pictures are there and the same. They can be found
    /// again: what is wrong with them stops nothing.
    pub fn saved(site: &Site) -> (Self, Note) {
        let path = site.file(DETECTIONS);
        if !path.is_file() {
            return (Self::default(), Note::default());
        }
        let read = verge_desk::read_bytes(&path).map_err(Error::from);
        let read = read.and_then(|b| Ok((hexadecimal(&b), parse(&path, b)?)));
        let (sha256, mut frames) = match read {
            Ok(read) => read,
            Err(why) => {
                let said = Some(format!("{why}; find the vehicles again"));
                return (Self::default(), Note { stale: 0, said });
            }
        };
        let Some(known) = sources(site, &sha256) else {
            let said = Some(format!(
                "{} does not tell in which pictures its boxes were found: find the vehicles again",
                path.display()
            ));
            return (Self::default(), Note { stale: frames.len(), said });
        };
        // What a search left out by itself is not missed.
        frames.retain(|f| known.contains_key(&f.name()));
        let (all, pictures) = (frames.len(), pictures_of(site));
        frames.retain(|f| known.get(&f.name()) == pictures.get(&f.name()));
        let stale = all - frames.len();
        let said = (stale > 0).then(|| {
            format!(
                "pictures that were searched and are gone or others now: {stale} of {all}; their \
                 boxes are left out: find the vehicles again"
            )
        });
        (Searched { frames, pictures }, Note { stale, said })
    }

    /// Whether a picture is still the one that was searched.
    pub fn holds(&self, name: &str, path: &Path) -> bool {
        let known = self.pictures.get(name);
        std::fs::read(path).is_ok_and(|bytes| known == Some(&hexadecimal(&bytes)))
    }
}

/// The pictures that were searched for the file of boxes with this SHA-256.
fn sources(site: &Site, detections: &str) -> Option<Pictures> {
    let bytes = std::fs::read(site.file(SOURCES)).ok()?;
    let sources: Sources = serde_json::from_slice(&bytes).ok()?;
    (sources.version == VERSION && sources.detections == detections).then_some(sources.pictures)
}

fn parse(path: &Path, bytes: Vec<u8>) -> Result<Vec<FrameBoxes>> {
    let text = verge_desk::text(path, bytes)?;
    let parse = |(k, line): (usize, &str)| {
        serde_json::from_str(line).map_err(|e| {
            // Its own line is always the first.
            let said = e.to_string();
            let why = said.split(" at line ").next().unwrap_or_default();
            let what = format!("{why}, at column {}", e.column());
            Error::from(Failure::content(path, k + 1, what))
        })
    };
    text.lines().enumerate().filter(|(_, l)| !l.trim().is_empty()).map(parse).collect()
}

#[cfg(test)]
#[path = "tests.rs"]
mod tests;
