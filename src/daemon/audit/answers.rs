//! Counts by people: lines `frame,lane,vehicles`.
//!
//! Owns the file, its empty form, and its faults by itself. `fit` decides whether the answers fit
//! the frames.

use crate::daemon::foreign::shown;
use crate::daemon::{disk, plain};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Name of the file on a sheet.
pub const SHEET: &str = "counts.csv";
/// Heading of the file.
pub const HEADING: &str = "frame,lane,vehicles";
/// More vehicles than any lane holds in one picture: a slip of the pen.
const MOST: u32 = 200;
/// Most bytes of a file.
const MAX_BYTES: u64 = 16 << 20;

/// Why answers cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum AnswersError {
    /// The file cannot be read.
    #[error("answers {}: {}", path.display(), disk::unread(source))]
    Read {
        /// The file.
        path: PathBuf,
        /// The system's error.
        source: std::io::Error,
    },
    /// Something in it is wrong.
    #[error("answers {}, line {line}: {reason}", path.display())]
    Line {
        /// The file.
        path: PathBuf,
        /// The line's number.
        line: usize,
        /// The fault, and what would be right.
        reason: String,
    },
    /// It says too little.
    #[error("answers {}: {reason}", path.display())]
    Missing {
        /// The file.
        path: PathBuf,
        /// The missing part.
        reason: String,
    },
}

/// Vehicles by lane, by the frame's name.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Answers {
    path: PathBuf,
    frames: BTreeMap<String, Answer>,
}

/// Vehicles by lane in one frame.
#[derive(Clone, Debug, Default, PartialEq)]
struct Answer {
    /// The first line about the frame.
    line: usize,
    lanes: BTreeMap<u8, u32>,
}

impl Answers {
    /// Reads a file about a table with these lanes. Frames without any number are left out: the
    /// person has not counted them. A frame with some lanes counted and others not is refused.
    ///
    /// # Errors
    /// [`AnswersError`] names the line.
    pub fn read(path: &Path, lanes: &[u8]) -> Result<Self, AnswersError> {
        let text = plain::read_text(path, MAX_BYTES)
            .map_err(|source| AnswersError::Read { path: path.to_owned(), source })?;
        Self::parse(&text, path, lanes)
    }

    fn parse(text: &str, path: &Path, lanes: &[u8]) -> Result<Self, AnswersError> {
        let mut frames: BTreeMap<String, Answer> = BTreeMap::new();
        let mut heading = false;
        for (number, line) in text.trim_start_matches('\u{feff}').lines().enumerate() {
            let wrong = |reason: String| AnswersError::Line {
                path: path.to_owned(),
                line: number + 1,
                reason,
            };
            let line = line.trim();
            if line.is_empty() || line.starts_with('#') {
                continue;
            }
            // Spreadsheets of some countries write semicolons.
            let cells: Vec<&str> =
                line.split([',', ';']).map(|cell| cell.trim().trim_matches('"')).collect();
            if !heading {
                if cells.join(",") != HEADING {
                    return Err(wrong(format!(
                        "the first line must be {HEADING}, not \"{}\"",
                        shown(line)
                    )));
                }
                heading = true;
                continue;
            }
            let &[frame, lane, vehicles] = cells.as_slice() else {
                return Err(wrong(format!(
                    "\"{}\" has not the three fields {HEADING}",
                    shown(line)
                )));
            };
            let known = lane.parse().ok().filter(|lane| lanes.contains(lane));
            let Some(lane) = known else {
                let all: Vec<_> = lanes.iter().map(u8::to_string).collect();
                return Err(wrong(format!(
                    "lane \"{}\" is none of the table's lanes {}",
                    shown(lane),
                    all.join(", ")
                )));
            };
            if vehicles.is_empty() {
                continue;
            }
            let count = vehicles.parse().ok().filter(|&count| count <= MOST);
            let Some(count) = count else {
                return Err(wrong(format!(
                    "\"{}\" vehicles: give a whole number up to {MOST}",
                    shown(vehicles)
                )));
            };
            let answer = frames
                .entry(frame.to_owned())
                .or_insert_with(|| Answer { line: number + 1, ..Answer::default() });
            if answer.lanes.insert(lane, count).is_some() {
                return Err(wrong(format!("lane {lane} of {frame} was given before")));
            }
        }
        let missing = |reason| AnswersError::Missing { path: path.to_owned(), reason };
        for (frame, counted) in &frames {
            if let Some(lane) = lanes.iter().find(|lane| !counted.lanes.contains_key(lane)) {
                let reason = format!(
                    "{frame} has no count of lane {lane}: count all of its lanes (0 where none \
                     stands), or none of them"
                );
                return Err(missing(reason));
            }
        }
        if frames.is_empty() {
            return Err(missing("no frame is counted".to_owned()));
        }
        Ok(Self { path: path.to_owned(), frames })
    }

    /// Names of the frames.
    pub fn frames(&self) -> impl Iterator<Item = &str> {
        self.frames.keys().map(String::as_str)
    }

    /// Vehicles in each of these lanes of a frame; `None` where it was not counted.
    pub fn of(&self, frame: &str, lanes: &[u8]) -> Option<Vec<u32>> {
        let counted = &self.frames.get(frame)?.lanes;
        Some(lanes.iter().map(|lane| counted.get(lane).copied().unwrap_or(0)).collect())
    }

    /// Why a frame's answer is of no use, with the place where it stands.
    pub fn wrong(&self, frame: &str, reason: &str) -> AnswersError {
        AnswersError::Line {
            path: self.path.clone(),
            line: self.frames.get(frame).map_or(0, |answer| answer.line),
            reason: format!("frame {} {reason}", shown(frame)),
        }
    }
}

/// The file to fill in: a line a frame and lane, its number left out.
pub fn template<'a>(frames: impl Iterator<Item = &'a str>, lanes: &[u8]) -> String {
    let mut text = format!(
        "# How many vehicles stand in each lane? Each has the middle of its lower edge between the\n\
         # lane's lines. Motorcycles count, bicycles do not; of a vehicle a third must be seen.\n\
         # Leave all lanes of a frame empty that you cannot count.\n{HEADING}\n"
    );
    for frame in frames {
        for lane in lanes {
            text.push_str(&format!("{frame},{lane},\n"));
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parse(text: &str) -> Result<Answers, AnswersError> {
        Answers::parse(text, Path::new("counts.csv"), &[1, 2])
    }

    #[test]
    fn frames_are_counted_lane_by_lane_or_not_at_all() {
        let text = "# curve\nframe,lane,vehicles\na.jpg,1,3\na.jpg,2,0\nb.jpg,1,\nb.jpg,2,\n";
        let answers = parse(text).expect("right");
        assert_eq!(answers.frames().collect::<Vec<_>>(), ["a.jpg"]);
        assert_eq!(answers.of("a.jpg", &[1, 2]), Some(vec![3, 0]));
        assert_eq!(answers.of("b.jpg", &[1, 2]), None);
        let spreadsheet =
            "\u{feff}# curve\r\nframe;lane;vehicles\r\n\"a.jpg\";1;3\r\na.jpg;2;0\r\n";
        assert_eq!(parse(spreadsheet).expect("right"), answers);
    }

    #[test]
    fn what_is_wrong_is_named_with_its_line() {
        for (text, said) in [
            ("a.jpg,1,3\n", "line 1: the first line must be"),
            ("frame,lane,vehicles\na.jpg,1\n", "line 2"),
            ("frame,lane,vehicles\na.jpg,7,1\n", "none of the table's lanes 1, 2"),
            ("frame,lane,vehicles\na.jpg,1,-2\n", "give a whole number"),
            ("frame,lane,vehicles\na.jpg,1,2.5\n", "give a whole number"),
            ("frame,lane,vehicles\na.jpg,1,9999\n", "give a whole number"),
            ("frame,lane,vehicles\na.jpg,1,1\na.jpg,1,1\n", "line 3: lane 1 of a.jpg was given"),
            ("frame,lane,vehicles\na.jpg,1,1\n", "no count of lane 2"),
            ("frame,lane,vehicles\na.jpg,1,\n", "no frame is counted"),
        ] {
            let error = parse(text).expect_err(text).to_string();
            assert!(error.contains(said), "{text:?}: {error}");
        }
    }

    #[test]
    fn a_sheet_without_answers_has_none() {
        let text = template(["a.jpg", "b.jpg"].into_iter(), &[1, 2]);
        assert!(text.ends_with("frame,lane,vehicles\na.jpg,1,\na.jpg,2,\nb.jpg,1,\nb.jpg,2,\n"));
        assert!(parse(&text).is_err(), "nothing is counted yet");
    }
}
