//! Checks of the box by `verge check`: the user that the unit runs as, the spool's folder, and
//! the metrics file.
//!
//! Owns that nothing of it is left behind: a folder that root had made would be closed to the
//! unit's user.

use super::unit::Sandbox;
use crate::daemon::config::Config;
use crate::daemon::exit::Failure;
use crate::daemon::metrics;
use crate::daemon::output::{check_place, real_place};
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
/// In such a folder, as /tmp is, nobody replaces another user's file.
const STICKY: u32 = 0o1000;
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

/// The unit's sandbox, where this configuration is the unit's.
pub(super) fn sandbox(config: &Path) -> Option<Sandbox> {
    is_units(config).then(|| Sandbox::read(Path::new("/"))).flatten()
}

/// Whether the service sees every file that the configuration names.
pub(super) fn seen(config: &Config, sandbox: &Sandbox) -> Result<String, Failure> {
    let hidden = config.files().into_iter().find_map(|file| Some((sandbox.hides(&file)?, file)));
    match hidden {
        None => Ok("the service sees every file that is named".to_owned()),
        Some((reason, path)) => {
            Err(Failure::Input { path, source: io::Error::new(io::ErrorKind::NotFound, reason) })
        }
    }
}

/// Tries the spool's folder.
pub(super) fn spool(config: &Config, sandbox: Option<&Sandbox>) -> Result<String, Failure> {
    let folder = config.spool_folder();
    let shown = folder.display();
    forbidden(folder, sandbox)?;
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
pub(super) fn metrics(
    config: &Config,
    sandbox: Option<&Sandbox>,
) -> Option<Result<String, Failure>> {
    let file = config.metrics.file.as_deref()?;
    let real = real_place(file);
    if let Err(failure) = forbidden(&real, sandbox) {
        return Some(Err(failure));
    }
    let unseen = metrics::unseen(&real).map_or(String::new(), |why| format!("; but {why}"));
    let folder = parent(&real);
    if !folder.exists() && folder == Path::new(RUNTIME) {
        return Some(Ok(format!("{}: systemd makes the folder{unseen}", file.display())));
    }
    let trial = check_place(&real).and_then(|()| replaceable(&real));
    Some(match trial {
        Ok(()) => Ok(format!("{}: can be written{unseen}", file.display())),
        Err(source) => Err(unwritable(file, source)),
    })
}

/// The folder of a file; that of a name alone is the present one.
fn parent(file: &Path) -> &Path {
    file.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

/// Whether this user may put another file in the place of this one.
fn replaceable(file: &Path) -> io::Result<()> {
    let beside = |ending: &str| -> io::Result<_> {
        let mut name = file.file_name().ok_or(io::ErrorKind::InvalidFilename)?.to_owned();
        name.push(ending);
        Ok(file.with_file_name(name))
    };
    let trial = beside(".check")?;
    let written = std::fs::write(&trial, "verge check\n");
    let trial = std::fs::remove_file(&trial).and(written);
    trial?;
    // What a power cut has left of it may be another user's.
    let partial = beside(".partial")?;
    if partial.exists() {
        std::fs::OpenOptions::new().write(true).open(&partial)?;
    }
    let user = std::fs::metadata("/proc/self")?.uid();
    let folder = std::fs::metadata(parent(file))?;
    let is_others = std::fs::metadata(file).is_ok_and(|there| there.uid() != user);
    if is_others && folder.mode() & STICKY != 0 && folder.uid() != user && user != 0 {
        return Err(io::ErrorKind::PermissionDenied.into());
    }
    Ok(())
}

fn forbidden(path: &Path, sandbox: Option<&Sandbox>) -> Result<(), Failure> {
    match sandbox.and_then(|sandbox| sandbox.forbids(path)) {
        None => Ok(()),
        Some(reason) => {
            Err(unwritable(path, io::Error::new(io::ErrorKind::PermissionDenied, reason)))
        }
    }
}

fn unwritable(path: &Path, source: io::Error) -> Failure {
    Failure::Write { path: path.to_owned(), source }
}
