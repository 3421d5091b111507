//! The audit of a saved site: pictures that a person counts, and what follows for the counts.
//!
//! Owns running `verge audit` on the saved lane table, the file of answers, and naming the result
//! in `verge.toml`. Which pictures are counted and what follows is decided by the sensor's own code.

use super::merged::{AUDITED, LANES, audits, with_audit};
use super::program::{Detector, Progress, Task};
use super::site::Site;
use crate::error::{Error, Result};
use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::fmt::Write;
use std::path::Path;
use std::process::Command;
use verge::lane::LaneTable;

/// What was counted.
pub const COUNTS: &str = "audit_counts.csv";
/// The saved configuration.
const CONFIG: &str = "verge.toml";
/// Pictures that a person counts.
const FRAMES: usize = 10;

/// What a person has counted in one picture.
#[derive(Debug, Deserialize)]
pub struct Answer {
    /// The picture's name.
    pub frame: String,
    /// Number of the lane, vehicles in it.
    pub counts: Vec<(u8, u32)>,
}

/// The audit of this desk.
#[derive(Debug)]
pub struct Audit {
    detector: Option<Detector>,
    choice: Task<Vec<String>>,
    result: Task<Value>,
}

/// How far it is, for the page.
#[derive(Debug, Serialize)]
pub struct AuditState {
    /// Whether there is a detector.
    pub detector: bool,
    /// Lanes of the saved table; empty where nothing is saved.
    pub lanes: Vec<u8>,
    /// Whether the saved configuration names an audit.
    pub audited: bool,
    /// `idle`, `running`, `done` or `failed`: choosing the pictures.
    pub choosing: &'static str,
    /// The chosen ones.
    pub frames: Vec<String>,
    /// The same of comparing the answers.
    pub comparing: &'static str,
    /// Time since what runs has begun, s.
    pub running_s: f64,
    /// What follows.
    pub result: Option<Value>,
    /// What is wrong.
    pub problem: Option<String>,
}

impl Audit {
    /// One that was not begun.
    pub fn new(detector: Option<Detector>) -> Self {
        Audit { detector, choice: Task::new(Progress::Idle), result: Task::new(Progress::Idle) }
    }

    /// For the page.
    pub fn state(&self, site: &Site) -> AuditState {
        let (choice, result) = (self.choice.now(), self.result.now());
        AuditState {
            detector: self.detector.is_some(),
            lanes: lanes(site).unwrap_or_default(),
            audited: std::fs::read_to_string(site.file(CONFIG)).is_ok_and(|text| audits(&text).0),
            choosing: choice.name(),
            frames: match &choice {
                Progress::Done(frames) => frames.to_vec(),
                _ => Vec::new(),
            },
            comparing: result.name(),
            running_s: choice.running_s().max(result.running_s()),
            problem: match (&choice, &result) {
                (Progress::Failed(why), _) | (_, Progress::Failed(why)) => Some(why.clone()),
                _ => None,
            },
            result: match &result {
                Progress::Done(value) => Some(Value::clone(value)),
                _ => None,
            },
        }
    }

    /// Chooses the pictures to count.
    ///
    /// # Errors
    /// Where nothing is saved, or there is no detector.
    pub fn choose(&self, site: &Site) -> Result<()> {
        let mut command = self.command(site)?;
        command.args(["--choose", &FRAMES.to_string()]);
        self.choice.start(command, "", |lines| Ok(lines.to_vec()))
    }

    /// Compares answers with what the sensor counts; what follows is saved beside the lane table,
    /// and named in the configuration.
    ///
    /// # Errors
    /// As [`Self::choose`]; the state shows contradictions.
    pub fn compare(&self, site: &Site, answers: &[Answer]) -> Result<()> {
        let mut command = self.command(site)?;
        let config = site.file(CONFIG);
        // Before a minute of counting what cannot be named then.
        named(&config)?;
        let mut text = String::from("frame,lane,vehicles\n");
        for Answer { frame, counts } in answers {
            if site.picture(frame).is_none() {
                return Err(Error::Usage(format!("there is no picture {frame:?}")));
            }
            for (lane, vehicles) in counts {
                let _ = writeln!(text, "{frame},{lane},{vehicles}");
            }
        }
        verge_desk::write_whole(&site.file(COUNTS), text.as_bytes())?;
        command.arg("--counts").arg(site.file(COUNTS));
        command.arg("--out").arg(site.file(AUDITED)).arg("--json");
        self.result.start(command, "", move |lines| {
            let text = lines.last().map_or("", String::as_str);
            let result = serde_json::from_str(text)
                .map_err(|e| Error::Json { path: "verge audit".into(), detail: e.to_string() })?;
            verge_desk::write_whole(&config, named(&config)?.as_bytes())?;
            Ok(result)
        })
    }

    fn command(&self, site: &Site) -> Result<Command> {
        let detector = self.detector.as_ref().ok_or_else(|| {
            Error::Usage("there is no detector: start `mvcalib desk` with --model".into())
        })?;
        if !site.file(LANES).is_file() {
            return Err(Error::Usage("save the site first: what is saved is audited".into()));
        }
        let mut command = Command::new(&detector.program);
        command.arg("audit").arg("--frames").arg(&site.frames);
        command.arg("--table").arg(site.file(LANES)).arg("--model").arg(&detector.model);
        Ok(command)
    }
}

/// The lanes of the saved table.
fn lanes(site: &Site) -> Option<Vec<u8>> {
    let bytes = std::fs::read(site.file(LANES)).ok()?;
    let table = LaneTable::parse(&bytes[..]).ok()?;
    Some(table.description().lanes.iter().map(|lane| lane.id.get()).collect())
}

/// Whether an audit of this lane table is there: one of another table does not hold.
pub fn holds(site: &Site, table: &[u8]) -> bool {
    let config = std::fs::read_to_string(site.file(CONFIG)).unwrap_or_default();
    audits(&config).1
        && site.file(AUDITED).is_file()
        && std::fs::read(site.file(LANES)).is_ok_and(|saved| saved == table)
}

/// The configuration with the audit in it.
fn named(config: &Path) -> Result<String> {
    with_audit(&verge_desk::read_text(config)?).map_err(|why| {
        Error::Usage(format!("{}: {why}: the audit cannot be named in it", config.display()))
    })
}
