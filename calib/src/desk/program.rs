//! The program `verge` beside this one: one task of it at a time, in the background.
//!
//! Owns starting it, what it has printed so far, and stopping it. Does not own what is asked of it.

use crate::error::{Error, Result};
use std::io::{BufRead, BufReader, Read, Write};
use std::path::PathBuf;
use std::process::{Child, Command, Stdio};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Instant;

/// The program, and the model with which it finds vehicles.
#[derive(Clone, Debug)]
pub struct Detector {
    /// The program `verge`.
    pub program: PathBuf,
    /// The model that it uses.
    pub model: PathBuf,
}

/// How far a task is.
#[derive(Debug)]
pub enum Progress<T> {
    /// It was not begun.
    Idle,
    /// It runs.
    Running {
        /// Since when.
        since: Instant,
        /// What it has printed.
        lines: Vec<String>,
        /// The last thing that it complained of.
        fault: Option<String>,
    },
    /// It has given this.
    Done(Arc<T>),
    /// It has failed, and why.
    Failed(String),
}

impl<T> Clone for Progress<T> {
    fn clone(&self) -> Self {
        match self {
            Self::Idle => Self::Idle,
            Self::Running { since, lines, fault } => {
                Self::Running { since: *since, lines: lines.clone(), fault: fault.clone() }
            }
            Self::Done(value) => Self::Done(Arc::clone(value)),
            Self::Failed(why) => Self::Failed(why.clone()),
        }
    }
}

impl<T> Progress<T> {
    /// Its name, for the page.
    pub fn name(&self) -> &'static str {
        match self {
            Self::Idle => "idle",
            Self::Running { .. } => "running",
            Self::Done(_) => "done",
            Self::Failed(_) => "failed",
        }
    }

    /// Time since it began, s; 0 where it does not run.
    pub fn running_s(&self) -> f64 {
        match self {
            Self::Running { since, .. } => since.elapsed().as_secs_f64(),
            _ => 0.0,
        }
    }

    /// Why it failed, or what it complains of while it goes on.
    pub fn problem(&self) -> Option<String> {
        match self {
            Self::Failed(why) => Some(why.clone()),
            Self::Running { fault, .. } => fault.clone(),
            _ => None,
        }
    }
}

/// A task of the program.
#[derive(Debug)]
pub struct Task<T> {
    progress: Arc<Mutex<Progress<T>>>,
    child: Arc<Mutex<Option<Child>>>,
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl<T: Send + Sync + 'static> Task<T> {
    /// One that is so far.
    pub fn new(progress: Progress<T>) -> Self {
        Task { progress: Arc::new(Mutex::new(progress)), child: Arc::default() }
    }

    /// How far it is.
    pub fn now(&self) -> Progress<T> {
        lock(&self.progress).clone()
    }

    /// Begins it, where it does not run yet: `input` goes to its standard input, and `finish` makes
    /// its result from the lines that it has printed.
    ///
    /// # Errors
    /// Where the program cannot be started.
    pub fn start(
        &self,
        mut command: Command,
        input: &str,
        finish: impl FnOnce(&[String]) -> Result<T> + Send + 'static,
    ) -> Result<()> {
        let mut progress = lock(&self.progress);
        if matches!(*progress, Progress::Running { .. }) {
            return Ok(());
        }
        let program = command.get_program().to_string_lossy().into_owned();
        command.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped());
        let mut child = command.spawn().map_err(|e| Error::Usage(format!("{program}: {e}")))?;
        let (stdout, stderr) = (child.stdout.take(), child.stderr.take());
        if let Some(mut stdin) = child.stdin.take() {
            // A program that has ended already says why by itself.
            let _ = writeln!(stdin, "{input}");
        }
        *lock(&self.child) = Some(child);
        *progress = Progress::Running { since: Instant::now(), lines: Vec::new(), fault: None };
        let (shared, child) = (Arc::clone(&self.progress), Arc::clone(&self.child));
        let complaints = follow(stderr, {
            let shared = Arc::clone(&shared);
            move |line| {
                if let Progress::Running { fault, .. } = &mut *lock(&shared) {
                    *fault = Some(line);
                }
            }
        });
        let printed = follow(stdout, {
            let shared = Arc::clone(&shared);
            move |line| {
                if let Progress::Running { lines, .. } = &mut *lock(&shared) {
                    lines.push(line);
                }
            }
        });
        std::thread::spawn(move || {
            // Both pipes end with the program.
            let _ = (printed.join(), complaints.join());
            let ended = lock(&child).take().map(|mut child| child.wait());
            let Progress::Running { lines, fault, .. } = lock(&shared).clone() else { return };
            let is_well = match ended {
                // It was stopped: what it has done counts.
                None => true,
                Some(status) => status.is_ok_and(|status| status.success()),
            };
            let outcome = match is_well.then(|| finish(&lines)) {
                Some(Ok(value)) => Progress::Done(Arc::new(value)),
                Some(Err(error)) => Progress::Failed(error.to_string()),
                None => {
                    let said = fault.unwrap_or_else(|| format!("{program} failed without a word"));
                    Progress::Failed(said.trim_start_matches("verge: ").to_owned())
                }
            };
            *lock(&shared) = outcome;
        });
        Ok(())
    }

    /// Ends it: what it has done so far is its result.
    pub fn stop(&self) {
        let child = lock(&self.child).take();
        if let Some(mut child) = child {
            let _ = child.kill();
            let _ = child.wait();
        }
    }
}

impl<T> Drop for Task<T> {
    fn drop(&mut self) {
        // What it has not finished is no result: nobody waits for it.
        *lock(&self.progress) = Progress::Idle;
        if let Some(mut child) = lock(&self.child).take() {
            let _ = child.kill();
            let _ = child.wait();
        }
    }
}

/// Hands on the lines of a pipe until it ends.
fn follow(
    pipe: Option<impl Read + Send + 'static>,
    mut on: impl FnMut(String) + Send + 'static,
) -> std::thread::JoinHandle<()> {
    std::thread::spawn(move || {
        let Some(pipe) = pipe else { return };
        BufReader::new(pipe).lines().map_while(std::result::Result::ok).for_each(&mut on);
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration;

    fn shell(script: &str) -> Command {
        let mut command = Command::new("sh");
        command.args(["-c", script]);
        command
    }

    fn outcome(task: &Task<Vec<String>>) -> Progress<Vec<String>> {
        while matches!(task.now(), Progress::Running { .. }) {
            std::thread::sleep(Duration::from_millis(5));
        }
        task.now()
    }

    fn task(script: &str, input: &str) -> Task<Vec<String>> {
        let task = Task::new(Progress::Idle);
        task.start(shell(script), input, |lines| Ok(lines.to_vec())).expect("a shell");
        task
    }

    #[test]
    fn what_is_printed_is_the_result_and_what_is_said_last_the_fault() {
        let done = outcome(&task("read a; echo \"$a\"; echo 2", "1"));
        assert!(matches!(&done, Progress::Done(lines) if **lines == ["1", "2"]), "{done:?}");
        let failed = outcome(&task("echo first >&2; echo 'verge: second' >&2; exit 3", ""));
        assert_eq!(failed.problem().as_deref(), Some("second"));
    }

    #[test]
    fn a_stopped_task_keeps_what_it_has_done() {
        let task = task("echo 1; sleep 60", "");
        while !matches!(task.now(), Progress::Running { lines, .. } if lines.len() == 1) {
            std::thread::sleep(Duration::from_millis(5));
        }
        task.stop();
        assert!(matches!(outcome(&task), Progress::Done(lines) if *lines == ["1"]));
    }
}
