//! Saving a site: calibration, lanes, lane table with its reference, drawing, `verge.toml`.
//!
//! Owns the list of files and that all of them are written or none. Does not own their
//! formats.

use super::audit;
use super::backdrop::{Backdrop, spread};
use super::drawing::{Drawing, Px};
use super::look;
use super::merged::merged;
use super::site::{POSE, SITE, Site, source};
use super::traffic::Traffic;
use crate::error::{Error, Result};
use crate::files::calibration::Sha256;
use crate::files::labelme::LabelFile;
use crate::road::lane_table::table;
use crate::road::scene_reference::reference_of;
use nalgebra::Vector2;
use serde::Serialize;
use std::fmt::Write;
use std::path::{Path, PathBuf};
use verge::lane::{DEFAULT_CELL_LENGTH_M, MAX_NAME};
use verge_desk::Batch;

/// Frames that the reference is made of, beside the backdrop.
const REFERENCE_FRAMES: usize = 8;
/// Time between two pictures where nothing tells it, s.
const INTERVAL_S: f64 = 5.0;
/// Lengths of the sensor's windows, s.
const WINDOWS_S: [u64; 2] = [60, 900];

/// Files that only some drawings have: known lengths, and lane lines.
const OPTIONAL: [&str; 2] = ["lengths.json", "lane_lines.json"];

const CONFIG: &str = "verge.toml";
/// What [`CONFIG`] is.
const OURS: &str = "the sensor's configuration";
const BY_HAND: &str = "the sensor's configuration, with what was changed in it by hand";

/// What was saved.
#[derive(Debug, Serialize)]
pub struct Saved {
    /// The site's folder.
    pub folder: String,
    /// Each file and what it is.
    pub files: Vec<(String, String)>,
}

/// Saves a drawing.
///
/// # Errors
/// What is wrong with it; nothing is written then.
pub fn save(
    drawing: &Drawing,
    site: &Site,
    backdrop: &Backdrop,
    traffic: &Traffic,
    model: Option<&Path>,
) -> Result<Saved> {
    if drawing.backdrop != backdrop.sha256 {
        return Err(Error::Usage(
            "the camera has moved since this was drawn: look at the points and confirm that they \
             are right"
                .into(),
        ));
    }
    name("site", &drawing.site)?;
    name("camera", &drawing.camera_id)?;
    let mut calibration = look::calibration(drawing, &traffic.cue())?;
    calibration.camera_id = Some(drawing.camera_id.clone());
    look::require_trust(&calibration)?;
    let lanes = look::lanes(drawing, &calibration)?;
    let json = calibration.to_json();
    let ignored: Vec<Vec<Vector2<f64>>> = drawing.ignored.iter().map(|p| points(p)).collect();
    let [width, height] = backdrop.image_size;
    let pose = (backdrop.rgb.clone(), width, height);
    let frames = spread(&backdrop.frames, REFERENCE_FRAMES);
    let (_, scene) = reference_of("the picture without traffic", pose, &frames, &ignored)?;
    let sha256 = Sha256::of(json.as_bytes());
    let table = table(
        &calibration,
        &lanes,
        sha256,
        &drawing.camera_id,
        Some(&scene),
        DEFAULT_CELL_LENGTH_M,
    )?;
    let mut config = toml(drawing, site, model)?;
    if audit::holds(site, &table) {
        config = audit::named(&config);
    }
    let (config, is_by_hand) = kept(config, site, model)?;
    let drawn = serde_json::to_string(drawing).expect("a drawing of finite numbers is JSON");
    let [lengths, lines] = drawing.labelme_lines();
    let mut files = vec![
        ("calibration.json", json.into_bytes(), "the camera, for `mvcalib verify` and `report`"),
        ("lanes.json", labelme(&drawing.labelme(&drawing.lanes)), "the lanes, for labelme too"),
        ("lanes.lut", table, "the lane table, for `verge run`"),
        (CONFIG, config.into_bytes(), if is_by_hand { BY_HAND } else { OURS }),
        (POSE, backdrop.png.clone(), "the picture that was drawn on"),
        (SITE, drawn.into_bytes(), "everything drawn: opened again by `mvcalib desk`"),
    ];
    if let Some(lengths) = lengths {
        files.push((OPTIONAL[0], labelme(&lengths), "the known lengths, for labelme too"));
    }
    if let Some(lines) = lines {
        files.push((OPTIONAL[1], labelme(&lines), "the lane lines, for labelme too"));
    }
    if !site.file(SITE).exists()
        && let Some((name, ..)) = files.iter().find(|(name, ..)| site.file(name).exists())
    {
        return Err(Error::Usage(format!(
            "{} was not made at a desk and would be lost; give another folder: --site DIR",
            site.file(name).display()
        )));
    }
    let was_saved = site.file(SITE).exists();
    let mut batch = Batch::default();
    for (name, bytes, _) in &files {
        batch.add(&site.file(name), bytes)?;
    }
    batch.commit()?;
    // Those of an earlier drawing would go on to speak for this one.
    let left = |name: &&str| was_saved && files.iter().all(|(kept, ..)| kept != name);
    for name in OPTIONAL.into_iter().filter(left) {
        match std::fs::remove_file(site.file(name)) {
            Err(source) if source.kind() != std::io::ErrorKind::NotFound => {
                return Err(verge_desk::Failure::Write { path: site.file(name), source }.into());
            }
            _ => {}
        }
    }
    let files = files.into_iter().map(|(name, _, what)| (name.into(), what.into())).collect();
    Ok(Saved { folder: site.folder.display().to_string(), files })
}

/// The configuration with what people have changed in that of the last save, and whether they have.
fn kept(now: String, site: &Site, model: Option<&Path>) -> Result<(String, bool)> {
    let path = site.file(CONFIG);
    // Without a drawing beside it, it is another's.
    let drawing = std::fs::read(site.file(SITE)).ok().and_then(|json| Drawing::parse(&json).ok());
    let (Some(drawing), true) = (drawing, path.exists()) else { return Ok((now, false)) };
    let before = toml(&drawing, site, model).unwrap_or_default();
    let found = verge_desk::read_text(&path)?;
    let merged = merged(&found, &before, &now).map_err(|why| {
        Error::Usage(format!(
            "{}: {why}: it was changed by hand and would be lost; mend it, or move it away, and save \
             again",
            path.display()
        ))
    })?;
    let is_by_hand = merged != now;
    Ok((merged, is_by_hand))
}

fn points(polygon: &[Px]) -> Vec<Vector2<f64>> {
    polygon.iter().map(|&p| p.into()).collect()
}

/// A name as topics, lane tables and `verge check` take it.
fn name(what: &str, text: &str) -> Result<()> {
    // Controls, and marks that turn the direction of text or have no width.
    let is_hidden = |c: char| {
        c.is_control()
            || matches!(
                c,
                '\u{200b}'..='\u{200f}' | '\u{2028}'..='\u{202e}' | '\u{2060}'..='\u{2069}' | '\u{feff}'
            )
    };
    let wrong = if text.is_empty() {
        "it is empty"
    } else if text.len() > MAX_NAME {
        "it is too long"
    } else if text.contains(['/', '+', '#']) {
        "it has a / + or # in it"
    } else if text.contains(is_hidden) {
        "it holds characters that do not show"
    } else if text.trim() != text {
        "it has blanks at its ends"
    } else if matches!(text, "." | "..") {
        "it stands for a folder"
    } else if text.contains("${") || text.contains("{{") {
        "it is a placeholder that nobody has filled in"
    } else {
        return Ok(());
    };
    let longest = format!("give the {what} a name of 1 to {MAX_NAME} bytes without / + #");
    Err(Error::Usage(format!("{longest}: {wrong} ({text:?})")))
}

/// As labelme 5 writes it.
fn labelme(file: &LabelFile) -> Vec<u8> {
    let value = serde_json::json!({
        "version": "5.5.0",
        "flags": file.flags,
        "shapes": file.shapes,
        "imagePath": POSE,
        "imageData": null,
        "imageHeight": file.image_height,
        "imageWidth": file.image_width,
    });
    let mut text = serde_json::to_vec_pretty(&value).expect("finite numbers are JSON");
    text.push(b'\n');
    text
}

/// Those of the usual windows that a picture each `interval_s` fills.
fn windows_of(interval_s: f64) -> Result<Vec<u64>> {
    let filled = |length: &u64| (0.01..=*length as f64).contains(&interval_s);
    let lengths: Vec<u64> = WINDOWS_S.into_iter().filter(filled).collect();
    if lengths.is_empty() {
        return Err(Error::Usage(format!(
            "{interval_s} s between pictures: the sensor's windows need one each 0.01 to {} s",
            WINDOWS_S[WINDOWS_S.len() - 1]
        )));
    }
    Ok(lengths)
}

fn toml(drawing: &Drawing, site: &Site, model: Option<&Path>) -> Result<String> {
    let absolute = |path: &Path| path.canonicalize().unwrap_or_else(|_| path.to_owned());
    // JSON's texts are TOML's basic ones, but for DEL, which TOML wants written out.
    let text = |text: &str| {
        serde_json::to_string(text).expect("a text is JSON").replace('\u{7f}', "\\u007f")
    };
    let path = |path: &PathBuf| text(&path.to_string_lossy());
    let source = match drawing.source.trim() {
        "" => path(&absolute(&site.frames)),
        given => {
            source::saved(given, &site.folder)
                .map_err(|why| Error::Usage(format!("the camera's address: {why}")))?;
            text(given)
        }
    };
    let interval_s = drawing.interval_s.or_else(|| interval_of(site)).unwrap_or(INTERVAL_S);
    let mut toml = String::from(
        "# Made by `mvcalib desk`; boards/linux/verge.toml explains every key. Try it with\n\
         # `verge check --config verge.toml`.\n",
    );
    let _ = writeln!(toml, "site = {}\n\n[camera]", text(&drawing.site));
    let _ = writeln!(toml, "id = {}", text(&drawing.camera_id));
    if drawing.source.trim().is_empty() {
        toml.push_str("# The folder of pictures at the desk. On the box: the camera's address.\n");
    }
    let _ = writeln!(toml, "source = {source}\ninterval_s = {interval_s:?}");
    if let Some(model) = model {
        toml.push_str("\n# The model at the desk. On the box: without this section, its own.\n");
        let _ = writeln!(toml, "[model]\nfile = {}", path(&absolute(model)));
    }
    let _ = writeln!(toml, "\n[lane_table]\nfile = \"lanes.lut\"");
    let _ = writeln!(toml, "\n[windows]\nlengths_s = {:?}", windows_of(interval_s)?);
    Ok(toml)
}

/// Median time between pictures whose names tell their time as `20260105T153000`, s.
pub fn interval_of(site: &Site) -> Option<f64> {
    let names = site.pictures().ok()?;
    let mut times: Vec<f64> =
        names.iter().filter_map(|p| time_of(&p.file_stem()?.to_string_lossy())).collect();
    times.sort_by(f64::total_cmp);
    let mut gaps: Vec<f64> = times.windows(2).map(|w| w[1] - w[0]).filter(|g| *g > 0.0).collect();
    gaps.sort_by(f64::total_cmp);
    gaps.get(gaps.len() / 2).copied().filter(|&s| windows_of(s).is_ok())
}

/// Seconds since a fixed day of a name such as `20260105T153000.250Z`; months count 31 days,
/// which cancels within a day.
fn time_of(stem: &str) -> Option<f64> {
    let (day, time) = stem.split_once('T')?;
    let number = |text: &str| text.parse::<f64>().ok();
    let part = |text: &str, at: usize, len: usize| number(text.get(at..at + len)?);
    let days = 372.0 * part(day, 0, 4)? + 31.0 * part(day, 4, 2)? + part(day, 6, 2)?;
    let rest = time.trim_end_matches('Z');
    let seconds = number(rest.get(4..)?)?;
    Some(86400.0 * days + 3600.0 * part(rest, 0, 2)? + 60.0 * part(rest, 2, 2)? + seconds)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_tell_the_time() {
        let apart = time_of("20260105T153004.500Z").unwrap() - time_of("20260105T152956Z").unwrap();
        assert!((apart - 8.5).abs() < 1e-6);
        assert_eq!(time_of("frame_0001"), None);
    }

    #[test]
    fn windows_are_those_that_the_pictures_fill() {
        assert_eq!(windows_of(5.0).unwrap(), [60, 900]);
        assert_eq!(windows_of(120.0).unwrap(), [900], "the paper's cameras");
        for wrong in [0.0, 1000.0, f64::NAN] {
            let said = windows_of(wrong).unwrap_err().to_string();
            assert!(said.contains("one each 0.01 to 900 s"), "{said}");
        }
    }

    #[test]
    fn names_of_topics_are_plain() {
        assert!(name("site", "bridge 7").is_ok() && name("site", "道路 Süd").is_ok());
        let long = "ä".repeat(25);
        for (wrong, why) in [
            ("", "empty"),
            (" ", "blanks at its ends"),
            ("a ", "blanks at its ends"),
            ("a/b", "a / + or #"),
            ("a#", "a / + or #"),
            (&long, "too long"),
            ("a\tb", "do not show"),
            ("a\u{7f}", "do not show"),
            ("a\u{202e}b", "do not show"),
            ("..", "stands for a folder"),
            ("${SITE}", "placeholder"),
        ] {
            let said = name("site", wrong).unwrap_err().to_string();
            assert!(said.contains(why), "{wrong:?}: {said}");
        }
    }

    #[test]
    fn a_configuration_names_a_source_that_the_sensor_opens() {
        let site = Site { frames: "/nowhere/a\u{7f}".into(), folder: "/nowhere/site".into() };
        let mut drawing = Drawing::empty([320, 240], String::new());
        let frames = toml(&drawing, &site, None).unwrap();
        assert!(frames.contains(r#"source = "/nowhere/a\u007f""#), "{frames}");
        drawing.source = "rtsp://cam/s".into();
        assert!(toml(&drawing, &site, None).unwrap().contains("source = \"rtsp://cam/s\""));
        for (source, why) in [
            ("not an address", "the camera's address: it is neither an address nor a folder"),
            ("rtsp://u:secret@cam/s", "camera.user and camera.password_file of verge.toml"),
        ] {
            drawing.source = source.into();
            let said = toml(&drawing, &site, None).unwrap_err().to_string();
            assert!(said.contains(why) && !said.contains("secret"), "{said}");
        }
    }
}
