//! The pictures of a folder that are alike: those of its most common size.
//!
//! Owns which are left out before one is decoded, and why a picture cannot be read, in plain words.

use super::name_of;
use crate::files::picture::picture_size;
use image::ImageFormat;
use rayon::prelude::*;
use std::path::{Path, PathBuf};

/// Pictures of one size.
#[derive(Debug)]
pub struct Alike {
    /// They, in the order that they had.
    pub pictures: Vec<PathBuf>,
    /// The others, by name, and why.
    pub left_out: Vec<(String, String)>,
}

/// Tells pictures of the most common size from the others.
pub fn alike(frames: &[PathBuf]) -> Alike {
    let sizes: Vec<_> = frames.par_iter().map(|path| picture_size(path).ok()).collect();
    let many = |size: [u32; 2]| sizes.iter().flatten().filter(|s| **s == size).count();
    let mut kinds: Vec<[u32; 2]> = Vec::new();
    for size in sizes.iter().flatten() {
        if !kinds.contains(size) {
            kinds.push(*size);
        }
    }
    // The first of equally common ones: the sort is stable.
    kinds.sort_by_key(|size| std::cmp::Reverse(many(*size)));
    let mut found = Alike { pictures: Vec::new(), left_out: Vec::new() };
    for (path, size) in frames.iter().zip(&sizes) {
        let why = match (size, kinds.first()) {
            (Some(size), Some(common)) if size == common => {
                found.pictures.push(path.clone());
                continue;
            }
            (Some([w, h]), Some([width, height])) => {
                format!("it has {w} x {h} px, the others {width} x {height}")
            }
            _ => unreadable(path),
        };
        found.left_out.push((name_of(path), why));
    }
    found
}

/// Why a picture cannot be read.
pub fn unreadable(path: &Path) -> String {
    let bytes = match std::fs::read(path) {
        Ok(bytes) => bytes,
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => return "it is gone".into(),
        Err(e) => return e.to_string(),
    };
    let what = match image::guess_format(&bytes) {
        _ if bytes.is_empty() => "it is empty",
        Ok(ImageFormat::Jpeg | ImageFormat::Png) => "it is damaged or cut off",
        _ => "it is no JPEG or PNG picture",
    };
    what.into()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pictures_of_another_size_and_no_pictures_are_named_with_the_reason() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        for (name, width) in [("a.png", 64), ("b.png", 32), ("c.png", 32)] {
            image::RgbImage::new(width, 24).save(path(name)).unwrap();
        }
        std::fs::write(path("d.jpg"), "hello").unwrap();
        std::fs::write(path("e.jpg"), "").unwrap();
        std::fs::write(path("f.png"), &std::fs::read(path("a.png")).unwrap()[..12]).unwrap();
        let names = ["a.png", "b.png", "c.png", "d.jpg", "e.jpg", "f.png", "g.jpg"];
        let found = alike(&names.map(path));
        assert_eq!(found.pictures, [path("b.png"), path("c.png")]);
        let why: Vec<&str> = found.left_out.iter().map(|(_, why)| why.as_str()).collect();
        let expected = [
            "it has 64 x 24 px, the others 32 x 24",
            "it is no JPEG or PNG picture",
            "it is empty",
            "it is damaged or cut off",
            "it is gone",
        ];
        assert_eq!(why, expected);
    }
}
