//! `--dashes`: the dashes of the lane lines, found in a picture, as lengths of the road fit.
//!
//! Owns the order (a camera from the other cues, the dashes by it, and both again) and what is
//! printed. Does not own finding them (see `road::dashes`) nor the fit.

use mvcalib::error::{Error, Result};
use mvcalib::road::dashes::{Picture, find};
use mvcalib::road::fit::{Cues, MEASURED_REL_SD, MarkCue, fit};
use mvcalib::road::scene_reference::picture;
use mvcalib::road::standards;
use nalgebra::Vector2;
use std::path::Path;
use verge_desk::say;

/// From the start of a dash to the start of the next, m, as a standard or a person states it.
struct Pitch {
    metres: f64,
    rel_sd: f64,
    standard: Option<String>,
}

impl Pitch {
    fn of(text: &str) -> Result<Self> {
        let number = text.trim().trim_end_matches('m').trim_end().parse::<f64>();
        if let Ok(metres) = number {
            if metres > 0.5 && metres < 100.0 {
                return Ok(Pitch { metres, rel_sd: MEASURED_REL_SD, standard: None });
            }
            return Err(Error::Usage(format!(
                "--dashes {text}: from one dash to the next are 0.5 to 100 m"
            )));
        }
        let standard = standards::find(text).map_err(|e| Error::Usage(format!("--dashes: {e}")))?;
        let (metres, rel_sd) = (standard.pitch_m(), standard.tolerance);
        Ok(Pitch { metres, rel_sd, standard: Some(standard.name.clone()) })
    }
}

/// Adds the dashes that the lane lines of these cues show in a picture.
///
/// # Errors
/// Names each line and why it shows none, where none does.
pub fn add(cues: &mut Cues, path: &Path, pitch: &str, size: [u32; 2]) -> Result<()> {
    let pitch = Pitch::of(pitch)?;
    let (rgb, width, height) = picture(path)?;
    if [width, height] != size {
        let what = path.display().to_string();
        return Err(Error::ImageSize { what, actual: [width, height], expected: size });
    }
    let picture = Picture { rgb: &rgb, size };
    let mut lines: Vec<&Vec<Vector2<f64>>> = Vec::new();
    for line in cues.lanes.iter().flat_map(|l| [&l.right, &l.left]) {
        if !lines.contains(&line) {
            lines.push(line);
        }
    }
    let mut with = cues.clone();
    // Once by a camera without them, which stretches the far end, and once by the better one.
    for is_last in [false, true] {
        let known = fit(&with, size)?;
        let mut said = Vec::new();
        with.marks.clone_from(&cues.marks);
        for (k, line) in lines.iter().enumerate() {
            let number = k + 1;
            match find(&picture, line, known.camera()) {
                Ok(dashes) => {
                    let (n, metres) = (dashes.middles.len(), dashes.pitch_m);
                    said.push(format!(
                        "lane line {number}: {n} dashes, {metres:.2} m from one to the next"
                    ));
                    let named = pitch.standard.as_deref().unwrap_or("dashes");
                    let name = format!("dashes of lane line {number} ({named})");
                    let cue = dashes.cue(name, pitch.metres, pitch.rel_sd);
                    with.marks.push(MarkCue { standard: pitch.standard.clone(), ..cue });
                }
                Err(why) => said.push(format!("lane line {number}: {why}")),
            }
        }
        if with.marks.len() == cues.marks.len() {
            return Err(Error::Marks(format!("--dashes: {}", said.join("; "))));
        }
        if is_last {
            said.iter().for_each(|line| say(line));
        }
    }
    *cues = with;
    Ok(())
}
