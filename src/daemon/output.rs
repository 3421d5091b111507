//! Output files that are there whole or not at all, written line by line.
//!
//! Not `verge_desk`'s, which has a new name for each partial file: the metrics are written every
//! few seconds for years, and power cuts would leave one such file each on the box's flash. Here
//! the next one takes the place of what a power cut left.

use super::disk;
use std::fs::{self, File};
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};

/// A file that could not be written.
#[derive(Debug, thiserror::Error)]
#[error("cannot write {}: {}", path.display(), disk::unwritten(source))]
pub struct WriteError {
    /// The file.
    pub path: PathBuf,
    /// The system's error.
    pub source: std::io::Error,
}

/// Whether a file may take the place of what stands at `path`: of nothing, or of a plain file. It would
/// replace a device as well, and cannot replace a folder.
///
/// # Errors
/// The kind of file at that place.
pub fn check_place(path: &Path) -> io::Result<()> {
    match fs::metadata(path) {
        Ok(there) if there.is_dir() => Err(io::ErrorKind::IsADirectory.into()),
        Ok(there) if !there.is_file() => {
            let reason = "something that is not a plain file stands there: name another place";
            Err(io::Error::new(io::ErrorKind::InvalidInput, reason))
        }
        _ => Ok(()),
    }
}

/// The place of a file of this name: behind a link, which stays.
pub fn real_place(path: &Path) -> PathBuf {
    let Ok(target) = fs::read_link(path) else { return path.to_owned() };
    let target = path.parent().unwrap_or(Path::new("")).join(target);
    fs::canonicalize(path).unwrap_or(target)
}

/// A file that appears under its name when it is finished.
#[derive(Debug)]
pub struct WholeFile {
    path: PathBuf,
    partial: PathBuf,
    writer: BufWriter<File>,
    finished: bool,
}

impl WholeFile {
    /// Begins a file that will be `path`.
    ///
    /// # Errors
    /// [`WriteError`], as all that follow.
    pub fn create(path: &Path) -> Result<Self, WriteError> {
        let path = &real_place(path);
        check_place(path).map_err(|source| WriteError { path: path.to_owned(), source })?;
        let mut name = path.file_name().unwrap_or_default().to_owned();
        name.push(".partial");
        let partial = path.with_file_name(name);
        let file = File::create(&partial)
            .map_err(|source| WriteError { path: path.to_owned(), source })?;
        let writer = BufWriter::new(file);
        Ok(Self { path: path.to_owned(), partial, writer, finished: false })
    }

    /// The same, where the output may not be one of these files.
    ///
    /// # Errors
    /// [`WriteError`] says so.
    pub fn beside(path: &Path, inputs: &[&Path]) -> Result<Self, WriteError> {
        let is_output = |input: &&Path| {
            input.canonicalize().is_ok_and(|input| path.canonicalize().is_ok_and(|p| p == input))
        };
        if inputs.iter().any(is_output) {
            let source = io::Error::other("it is an input, which would be lost: give another file");
            return Err(WriteError { path: path.to_owned(), source });
        }
        Self::create(path)
    }

    /// Everybody may read it, whatever the umask: it is made for another program's user.
    ///
    /// # Errors
    /// [`WriteError`].
    pub fn for_everybody(self) -> Result<Self, WriteError> {
        use std::os::unix::fs::PermissionsExt;
        let mode = fs::Permissions::from_mode(0o644);
        match self.writer.get_ref().set_permissions(mode) {
            Ok(()) => Ok(self),
            Err(source) => Err(self.failed(source)),
        }
    }

    /// Adds a line.
    ///
    /// # Errors
    /// [`WriteError`].
    pub fn line(&mut self, line: &str) -> Result<(), WriteError> {
        writeln!(self.writer, "{line}").map_err(|source| self.failed(source))
    }

    /// Adds bytes.
    ///
    /// # Errors
    /// [`WriteError`].
    pub fn bytes(&mut self, bytes: &[u8]) -> Result<(), WriteError> {
        self.writer.write_all(bytes).map_err(|source| self.failed(source))
    }

    /// Puts the file in its place.
    ///
    /// # Errors
    /// [`WriteError`].
    pub fn finish(mut self) -> Result<(), WriteError> {
        let synced = self.writer.flush().and_then(|()| self.writer.get_ref().sync_all());
        synced
            .and_then(|()| fs::rename(&self.partial, &self.path))
            .map_err(|source| self.failed(source))?;
        self.finished = true;
        Ok(())
    }

    fn failed(&self, source: std::io::Error) -> WriteError {
        WriteError { path: self.path.clone(), source }
    }
}

impl Drop for WholeFile {
    fn drop(&mut self) {
        if !self.finished {
            let _ = fs::remove_file(&self.partial);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn neither_devices_nor_folders_are_replaced() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        for (place, expected) in [
            (Path::new("/dev/null"), "not a plain file"),
            (folder.path(), "a folder has this name"),
            (&folder.path().join("none/x"), "make its folder"),
        ] {
            let error = WholeFile::create(place).expect_err("no file").to_string();
            assert!(error.contains(expected), "{error}");
        }
        let file = folder.path().join("x");
        for text in ["one", "two"] {
            let mut whole = WholeFile::create(&file).expect("a file");
            whole.line(text).and_then(|()| whole.finish()).expect("written");
            assert_eq!(fs::read_to_string(&file).expect("there"), format!("{text}\n"));
        }
    }
}
