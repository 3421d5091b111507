//! Checks of the box by `verge check`: the user that the unit runs as, the spool's folder, and
//! the metrics file.
//!
//! Owns that nothing of it is left behind: a folder that root had made would be closed to the
//! unit's user.

use crate::daemon::config::Config;
use crate::daemon::exit::Failure;
use crate::daemon::output::check_place;
use crate::daemon::spool;
use std::io;
use std::os::unix::fs::MetadataExt;
use std::os::unix::process::CommandExt;
use std::path::Path;
use std::process::Command;

/// The user of the unit, its configuration, and the folders that systemd makes for it.
const USER: &str = "verge";
const CONFIGURATION: &str = "/etc/verge/verge.toml";
const STATE: &str = "/var/lib/verge";
const RUNTIME: &str = "/run/verge";
/// Set where this is the unit's user already.
const DONE: &str = "VERGE_CHECK_AS_UNIT";

/// Whether this configuration is the unit's.
fn is_units(config: &Path) -> bool {
    config.canonicalize().is_ok_and(|path| path == Path::new(CONFIGURATION))
}

fn is_root() -> bool {
    // A process's folder belongs to the user that it runs as.
    std::fs::metadata("/proc/self").is_ok_and(|process| process.uid() == 0)
}

/// Begins again as the unit does, where root tries the unit's configuration: what root may read
/// and write says nothing. Returns only where that is not to be, or not possible.
pub(in crate::daemon::commands) fn become_the_units_user(config: &Path) {
    if !is_units(config) || std::env::var_os(DONE).is_some() || !is_root() {
        return;
    }
    let Ok(program) = std::env::current_exe() else { return };
    // Of util-linux, which every Debian has; it takes the user's groups too.
    let error = Command::new("setpriv")
        .args(["--reuid", USER, "--regid", USER, "--init-groups", "--"])
        .arg(program)
        .args(std::env::args_os().skip(1))
        .env(DONE, "1")
        .env("STATE_DIRECTORY", STATE)
        .exec();
    log::warn!("checked as root, not as {USER}, the unit's user: setpriv: {error}");
}

/// The user that checks, in words.
pub(super) fn who() -> &'static str {
    if std::env::var_os(DONE).is_some() { "as the unit's user" } else { "as this user" }
}

/// Tries the spool's folder.
pub(super) fn spool(config: &Config) -> Result<String, Failure> {
    let folder = config.spool_folder();
    let shown = folder.display();
    if !folder.exists() && folder.starts_with(STATE) && !Path::new(STATE).exists() {
        return Ok(format!("{shown}: systemd makes it at the first start"));
    }
    match spool::probe(folder) {
        Ok(true) => Ok(format!("{shown}: windows can be written there")),
        Ok(false) => Ok(format!("{shown}: a running verge has it")),
        Err(source) => Err(unwritable(folder, source)),
    }
}

/// Tries the metrics file's place; `None` where there is none.
pub(super) fn metrics(config: &Config) -> Option<Result<String, Failure>> {
    let file = config.metrics.file.as_deref()?;
    let folder = file.parent().unwrap_or(Path::new("."));
    if !folder.exists() && folder == Path::new(RUNTIME) {
        return Some(Ok(format!("{}: systemd makes the folder", file.display())));
    }
    let trial = check_place(file).and_then(|()| tempfile_beside(file));
    Some(match trial {
        Ok(()) => Ok(format!("{}: can be written", file.display())),
        Err(source) => Err(unwritable(file, source)),
    })
}

/// Writes and removes a file of another name in the same folder.
fn tempfile_beside(file: &Path) -> io::Result<()> {
    let mut name = file.file_name().ok_or(io::ErrorKind::InvalidFilename)?.to_owned();
    name.push(".check");
    let trial = file.with_file_name(name);
    let written = std::fs::write(&trial, "verge check\n");
    let _ = std::fs::remove_file(&trial);
    written
}

fn unwritable(path: &Path, source: io::Error) -> Failure {
    Failure::Write { path: path.to_owned(), source }
}
