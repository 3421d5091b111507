//! Pictures of a camera, collected by the program `verge` as the sensor would take them.
//!
//! Owns which camera is asked, how long and how often, and how far the collection is. Does not own
//! the way to a camera.

use super::program::{Progress, Task};
use super::site::Site;
use crate::error::{Error, Result};
use serde::{Deserialize, Serialize};
use std::path::PathBuf;
use std::process::Command;
use std::sync::Mutex;
use std::sync::PoisonError;

/// A camera that can be asked.
#[derive(Clone, Debug)]
pub struct Camera {
    /// The program `verge`.
    pub program: PathBuf,
    /// Its address; it may hold a login.
    pub address: String,
}

impl Camera {
    /// Its address without login and query, for either may hold a password.
    pub fn shown(&self) -> String {
        let Some((scheme, rest)) = self.address.split_once("://") else {
            return self.address.clone();
        };
        let end = rest.find(['/', '?']).unwrap_or(rest.len());
        let host = rest[..end].rsplit_once('@').map_or(&rest[..end], |(_, host)| host);
        let path = rest[end..].split('?').next().unwrap_or_default();
        format!("{scheme}://{host}{path}")
    }
}

/// How long and how often.
#[derive(Clone, Copy, Debug, Deserialize, Serialize)]
pub struct Pace {
    /// Time between two pictures, s.
    pub interval_s: f64,
    /// Time that all of it takes, s.
    pub for_s: f64,
}

/// A collection.
#[derive(Debug)]
pub struct Collection {
    camera: Option<Camera>,
    pace: Mutex<Pace>,
    task: Task<usize>,
}

/// How far it is, for the page.
#[derive(Debug, Serialize)]
pub struct CollectionState {
    /// The camera without login and query; `None` where pictures come from a folder alone.
    pub camera: Option<String>,
    /// `idle`, `running`, `done` or `failed`.
    pub state: &'static str,
    /// Time since it began, s.
    pub running_s: f64,
    /// What was asked for.
    #[serde(flatten)]
    pub pace: Pace,
    /// Pictures that were taken by it.
    pub collected: usize,
    /// The latest of them.
    pub latest: Option<String>,
    /// Pictures in the folder.
    pub pictures: usize,
    /// Why it ended, or what goes wrong now and then.
    pub problem: Option<String>,
}

impl Collection {
    /// Of a camera, or of none.
    pub fn new(camera: Option<Camera>) -> Self {
        let pace = Mutex::new(Pace { interval_s: 5.0, for_s: 300.0 });
        Collection { camera, pace, task: Task::new(Progress::Idle) }
    }

    /// The camera's address, without login and query.
    pub fn camera(&self) -> Option<String> {
        self.camera.as_ref().map(Camera::shown)
    }

    /// The same where it is whole without them.
    pub fn source(&self) -> Option<String> {
        self.camera().filter(|shown| self.camera.as_ref().is_some_and(|c| c.address == *shown))
    }

    /// Begins; one at a time.
    ///
    /// # Errors
    /// Where there is no camera, or the program cannot be started.
    pub fn start(&self, site: &Site, pace: Pace) -> Result<()> {
        let camera = self.camera.as_ref().ok_or_else(|| {
            Error::Usage("there is no camera: start `mvcalib desk` with --camera ADDRESS".into())
        })?;
        let mut command = Command::new(&camera.program);
        command.args(["collect", "--camera", "-", "--frames"]).arg(&site.frames);
        command.args(["--interval", &pace.interval_s.to_string()]);
        command.args(["--for", &pace.for_s.to_string()]);
        let folder = site.frames.clone();
        self.task.start(command, &camera.address, move |lines| {
            // What a stopped program has not finished.
            for entry in std::fs::read_dir(&folder).into_iter().flatten().flatten() {
                if entry.path().extension().is_some_and(|e| e == "partial") {
                    let _ = std::fs::remove_file(entry.path());
                }
            }
            match lines.len() {
                0 => Err(Error::Usage("the camera gave no picture in this time".into())),
                many => Ok(many),
            }
        })?;
        *self.pace.lock().unwrap_or_else(PoisonError::into_inner) = pace;
        Ok(())
    }

    /// Ends it: what was collected stays.
    pub fn stop(&self) {
        self.task.stop();
    }

    /// For the page.
    pub fn state(&self, site: &Site) -> CollectionState {
        let now = self.task.now();
        let (collected, latest) = match &now {
            Progress::Running { lines, .. } => (lines.len(), lines.last().cloned()),
            Progress::Done(many) => (**many, None),
            _ => (0, None),
        };
        CollectionState {
            camera: self.camera(),
            state: now.name(),
            running_s: now.running_s(),
            pace: *self.pace.lock().unwrap_or_else(PoisonError::into_inner),
            collected,
            latest,
            pictures: site.pictures().map_or(0, |pictures| pictures.len()),
            problem: now.problem(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_login_is_never_shown() {
        let shown =
            |address: &str| Camera { program: "verge".into(), address: address.into() }.shown();
        assert_eq!(shown("rtsp://a:p@ss@10.0.0.1/s?x=@y"), "rtsp://10.0.0.1/s");
        assert_eq!(shown("http://cam/snap.jpg"), "http://cam/snap.jpg");
        assert_eq!(shown("/dev/video0"), "/dev/video0");
    }
}
