//! Labels: YOLO text beside the pictures, or the simulator's `truth.jsonl`.

use super::matching::{Frame, Labelled};
use crate::light;
use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};
use verge_desk::{Failure, read_text};

/// Frames by name.
pub(super) type Frames = BTreeMap<String, Frame>;

/// A frame of `truth.jsonl`.
#[derive(serde::Deserialize)]
struct Line {
    frame: String,
    vehicles: Vec<Vehicle>,
}

#[derive(serde::Deserialize)]
struct Vehicle {
    #[serde(rename = "box")]
    bounds: [f64; 4],
    #[serde(default)]
    crowd: bool,
}

/// File names of a list, a path or name a line.
pub(super) fn read_names(path: &Path) -> Result<BTreeSet<String>, Failure> {
    let names: BTreeSet<String> =
        read_text(path)?.lines().filter_map(|line| name_of(Path::new(line.trim()))).collect();
    if names.is_empty() {
        return Err(Failure::content(path, 0, "names no frame; write one file name a line"));
    }
    Ok(names)
}

fn name_of(path: &Path) -> Option<String> {
    path.file_name().map(|name| name.to_string_lossy().into_owned())
}

/// Every labelled frame of a folder, or those that are wanted.
pub(super) fn read(folder: &Path, wanted: Option<&BTreeSet<String>>) -> Result<Frames, Failure> {
    let recording = folder.join("truth.jsonl");
    let mut frames = if recording.is_file() {
        read_recording(folder, &recording, wanted)?
    } else {
        read_yolo(folder, wanted)?
    };
    if let Some(missing) =
        wanted.into_iter().flatten().find(|name| !frames.contains_key(name.as_str()))
    {
        let reason = format!("has no labelled picture {missing}, which --frames names");
        return Err(Failure::content(folder, 0, reason));
    }
    if frames.is_empty() {
        let reason = "has no labelled picture; expected NAME.jpg with NAME.txt, or truth.jsonl";
        return Err(Failure::content(folder, 0, reason));
    }
    for frame in frames.values_mut() {
        for labelled in &frame.truth {
            let [x0, y0, x1, y1] = labelled.bounds;
            if ![x0, y0, x1, y1].iter().all(|v| v.is_finite()) || x1 <= x0 || y1 <= y0 {
                let reason = format!("{}: box {:?} is empty", frame.name, labelled.bounds);
                return Err(Failure::content(folder, 0, reason));
            }
        }
    }
    Ok(frames)
}

fn read_recording(
    folder: &Path,
    path: &Path,
    wanted: Option<&BTreeSet<String>>,
) -> Result<Frames, Failure> {
    let mut frames = Frames::new();
    for (index, text) in read_text(path)?.lines().enumerate() {
        if text.trim().is_empty() {
            continue;
        }
        let line: Line = serde_json::from_str(text)
            .map_err(|error| Failure::content(path, index + 1, error.to_string()))?;
        if wanted.is_some_and(|names| !names.contains(&line.frame)) {
            continue;
        }
        let truth = line
            .vehicles
            .iter()
            .map(|vehicle| Labelled { bounds: vehicle.bounds, crowd: vehicle.crowd })
            .collect();
        let picture = [folder.join(&line.frame), folder.join("frames").join(&line.frame)]
            .into_iter()
            .find(|path| path.is_file())
            .unwrap_or_else(|| folder.join(&line.frame));
        let frame = open(&picture, truth)?;
        if frames.insert(line.frame.clone(), Frame { name: line.frame.clone(), ..frame }).is_some()
        {
            let reason = format!("{} stands twice; keep one line for it", line.frame);
            return Err(Failure::content(path, index + 1, reason));
        }
    }
    Ok(frames)
}

fn read_yolo(folder: &Path, wanted: Option<&BTreeSet<String>>) -> Result<Frames, Failure> {
    let mut frames = Frames::new();
    for picture in pictures(folder)? {
        let Some(name) = name_of(&picture) else { continue };
        if wanted.is_some_and(|names| !names.contains(&name)) {
            continue;
        }
        let Some(labels) = labels_of(&picture) else { continue };
        let mut frame = open(&picture, Vec::new())?;
        frame.truth = yolo(&labels, frame.size_px)?;
        if frames.insert(name.clone(), frame).is_some() {
            let reason = format!("has two pictures named {name}; score their folders apart");
            return Err(Failure::content(folder, 0, reason));
        }
    }
    Ok(frames)
}

/// Pictures of a folder, of its `images`, and of the same below `train`, `valid`, `test`.
fn pictures(folder: &Path) -> Result<Vec<PathBuf>, Failure> {
    fs::metadata(folder).map_err(|source| Failure::reading(folder, source))?;
    let mut found = Vec::new();
    for part in ["", "train", "valid", "test"] {
        for inner in ["", "images"] {
            let place = folder.join(part).join(inner);
            let Ok(entries) = fs::read_dir(&place) else { continue };
            for entry in entries {
                let path = entry.map_err(|source| Failure::reading(&place, source))?.path();
                if light::is_picture(&path) {
                    found.push(path);
                }
            }
        }
    }
    found.sort();
    Ok(found)
}

/// `NAME.txt` beside the picture, in `../labels`, or in `../outputs/labels`.
fn labels_of(picture: &Path) -> Option<PathBuf> {
    let beside = picture.with_extension("txt");
    let name = beside.file_name()?.to_owned();
    let above = picture.parent().and_then(Path::parent);
    let near = above.map(|above| above.join("labels").join(&name));
    let output = above.map(|above| above.join("outputs/labels").join(&name));
    [Some(beside), near, output].into_iter().flatten().find(|path| path.is_file())
}

fn yolo(path: &Path, [width, height]: [u32; 2]) -> Result<Vec<Labelled>, Failure> {
    let mut found = Vec::new();
    for (index, line) in read_text(path)?.lines().enumerate() {
        let fields: Vec<&str> = line.split_whitespace().collect();
        if fields.is_empty() {
            continue;
        }
        let numbers: Option<Vec<f64>> =
            fields.iter().take(5).map(|field| field.parse().ok()).collect();
        let Some([_, cx, cy, w, h]) = numbers.as_deref() else {
            let reason = format!("`{line}`: expected `class cx cy width height`, shares of 1");
            return Err(Failure::content(path, index + 1, reason));
        };
        let (width, height) = (f64::from(width), f64::from(height));
        let bounds = [
            (cx - w / 2.0) * width,
            (cy - h / 2.0) * height,
            (cx + w / 2.0) * width,
            (cy + h / 2.0) * height,
        ];
        found.push(Labelled { bounds, crowd: false });
    }
    Ok(found)
}

fn open(path: &Path, truth: Vec<Labelled>) -> Result<Frame, Failure> {
    let bytes = fs::read(path).map_err(|source| Failure::reading(path, source))?;
    let picture = image::load_from_memory(&bytes)
        .map_err(|error| Failure::content(path, 0, format!("is not a JPEG or PNG: {error}")))?
        .to_rgb8();
    let (width, height) = picture.dimensions();
    let light = light::of_pixels(picture.as_raw(), width as usize, height as usize);
    Ok(Frame {
        name: name_of(path).unwrap_or_default(),
        light,
        size_px: [width, height],
        truth,
        found: Vec::new(),
        ignored: Vec::new(),
    })
}
