//! The site's own file: what an audit has found, and for which model and table it holds.
//!
//! Owns the file and when it may be used. Read at the start and at each reload, as the lane table
//! is.

use crate::daemon::config::Views;
use crate::daemon::disk;
use crate::daemon::output::{WholeFile, WriteError};
use crate::daemon::plain;
use crate::daemon::toml_file;
use crate::density::SiteCorrection;
use crate::wire::hex;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// The format that this program writes and reads.
pub const FORMAT: u32 = 1;
/// Most bytes of a file.
const MAX_BYTES: u64 = 1 << 20;

/// Why a site's file cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum SiteError {
    /// It cannot be read.
    #[error("audit {}: {}", path.display(), disk::unread(source))]
    Read {
        /// The file.
        path: PathBuf,
        /// The system's error.
        source: std::io::Error,
    },
    /// It is damaged, or of another site, model or table.
    #[error("audit {}: {reason}", path.display())]
    Wrong {
        /// The file.
        path: PathBuf,
        /// The fault, and what to do.
        reason: String,
    },
}

/// Result of an audit.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SiteFile {
    /// Version of the format.
    pub format: u32,
    /// The camera.
    pub camera: String,
    /// SHA-256 of the calibration behind the lane table.
    pub calibration_sha256: String,
    /// SHA-256 of the model.
    pub model_sha256: String,
    /// Columns and rows of the net's input.
    pub input_px: [usize; 2],
    /// Parts of a picture that were searched; all of it in files that do not say.
    #[serde(default)]
    pub views: Views,
    /// Frames that were counted.
    pub frames: usize,
    /// Vehicles that people counted in them.
    pub vehicles: u32,
    /// The correction that follows from it.
    pub correction: SiteCorrection,
}

/// Parts that a line measures with: a file made with other parts does not hold for it.
#[derive(Clone, Debug, PartialEq)]
pub struct MadeWith<'a> {
    /// The camera of the lane table.
    pub camera: &'a str,
    /// SHA-256 of the calibrations behind the line's tables.
    pub calibrations: &'a [[u8; 32]],
    /// SHA-256 of the model.
    pub model: [u8; 32],
    /// Columns and rows of the net's input.
    pub input_px: [usize; 2],
    /// Searched parts of a picture.
    pub views: Views,
}

impl SiteFile {
    /// Reads a file and checks that it holds for this line.
    ///
    /// # Errors
    /// [`SiteError`] says what is wrong, and what to do.
    pub fn read(path: &Path, line: &MadeWith<'_>) -> Result<Self, SiteError> {
        let text = plain::read_text(path, MAX_BYTES)
            .map_err(|source| SiteError::Read { path: path.to_owned(), source })?;
        let wrong = |reason: String| SiteError::Wrong { path: path.to_owned(), reason };
        let file: Self = toml_file::parse(&text, &[])
            .map_err(|fault| wrong(format!("{fault}; is it a file of `verge audit`?")))?;
        file.check(line).map_err(wrong)?;
        Ok(file)
    }

    fn check(&self, line: &MadeWith<'_>) -> Result<(), String> {
        if self.format != FORMAT {
            return Err(format!(
                "it has format {}, this program reads {FORMAT}: update verge, or count the site again",
                self.format
            ));
        }
        let again = "count the site again with `verge audit`";
        if self.camera != line.camera {
            return Err(format!(
                "it belongs to camera {:?}, the lane table to {:?}: give the audit of this camera",
                self.camera, line.camera
            ));
        }
        if self.model_sha256 != hex(&line.model).as_str() {
            return Err(format!("another model counted when it was made: {again}"));
        }
        if self.input_px != line.input_px {
            let [[w, h], [columns, rows]] = [self.input_px, line.input_px];
            return Err(format!(
                "the net's input was {w}x{h} when it was made and is {columns}x{rows}: {again}"
            ));
        }
        if self.views != line.views {
            return Err(format!(
                "other parts of the picture were searched when it was made (views): {again}"
            ));
        }
        let known = |calibration: &[u8; 32]| self.calibration_sha256 == hex(calibration).as_str();
        if !line.calibrations.iter().any(known) {
            return Err(format!("it was made with a lane table of another calibration: {again}"));
        }
        let SiteCorrection { score, by_load, vehicles_se } = &self.correction;
        let loads_rise = by_load.windows(2).all(|pair| pair[0].counted < pair[1].counted);
        let sane = |x: f32, most: f32| x.is_finite() && (0.0..=most).contains(&x);
        let are_sane = by_load.iter().all(|load| {
            sane(load.counted, 1e4)
                && sane(load.factor, 10.0)
                && load.factor > 0.1
                && sane(load.factor_se, 10.0)
        });
        let score_is_sane = score.is_none_or(|score| sane(score, 1.0));
        if !(loads_rise && are_sane && score_is_sane && sane(*vehicles_se, 1e3)) {
            return Err(
                "numbers of [correction] are out of their range, or loads do not rise".into()
            );
        }
        Ok(())
    }

    /// Writes the file, whole or not at all, and over none of `inputs`.
    ///
    /// # Errors
    /// `WriteError`.
    pub fn write(&self, path: &Path, inputs: &[&Path]) -> Result<(), WriteError> {
        let failed =
            |error| WriteError { path: path.to_owned(), source: std::io::Error::other(error) };
        let text = toml::to_string(self).map_err(failed)?;
        let mut file = WholeFile::beside(path, inputs)?;
        file.line("# Made by `verge audit`. Holds for this model, input and lane table only.")?;
        file.line(text.trim_end())?;
        file.finish()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::density::LoadBias;

    const LINE: MadeWith<'_> = MadeWith {
        camera: "curve",
        calibrations: &[[7; 32]],
        model: [3; 32],
        input_px: [800, 608],
        views: Views::Whole,
    };

    fn file() -> SiteFile {
        let bias = |counted, factor| LoadBias { counted, factor, factor_se: 0.04 };
        SiteFile {
            format: FORMAT,
            camera: "curve".into(),
            calibration_sha256: hex(&[7; 32]).as_str().into(),
            model_sha256: hex(&[3; 32]).as_str().into(),
            input_px: [800, 608],
            views: Views::Whole,
            frames: 10,
            vehicles: 93,
            correction: SiteCorrection {
                score: Some(0.45),
                by_load: [bias(3.0, 0.98), bias(12.5, 1.1)].into_iter().collect(),
                vehicles_se: 0.2,
            },
        }
    }

    #[test]
    fn what_is_written_is_read_again() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("site.toml");
        file().write(&path, &[]).expect("writes");
        assert_eq!(SiteFile::read(&path, &LINE).expect("reads"), file());
    }

    #[test]
    fn another_camera_model_input_or_table_is_refused_with_its_reason() {
        for (line, said) in [
            (MadeWith { camera: "b", ..LINE }, "belongs to camera \"curve\""),
            (MadeWith { model: [4; 32], ..LINE }, "another model"),
            (MadeWith { input_px: [640, 480], ..LINE }, "800x608"),
            (MadeWith { views: Views::Auto, ..LINE }, "other parts of the picture"),
            (MadeWith { calibrations: &[[8; 32]], ..LINE }, "another calibration"),
        ] {
            let reason = file().check(&line).expect_err(said);
            assert!(reason.contains(said), "{reason}");
        }
        let mut odd = file();
        odd.correction.by_load[1].counted = 1.0;
        assert!(odd.check(&LINE).expect_err("loads fall").contains("rise"));
        let later = SiteFile { format: 2, ..file() };
        assert!(later.check(&LINE).expect_err("a later format").contains("format 2"));
    }
}
