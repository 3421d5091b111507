//! Files that are there whole or not at all, also after a power cut.
//!
//! A file is written beside its place under a name of its own (`.NAME.RANDOM.partial`), flushed
//! to the disk and renamed; then its folder is flushed, which makes the new name last. Only a
//! crash leaves the partial file behind.

use crate::failure::Failure;
use std::ffi::OsString;
use std::fs::{self, File};
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use tempfile::{NamedTempFile, TempPath};

/// Writes `bytes` to `path`, which is replaced where it is there already.
///
/// # Errors
/// [`Failure::Write`]; an old file is then as it was.
pub fn write_whole(path: &Path, bytes: &[u8]) -> Result<(), Failure> {
    write_whole_with(path, |file| file.write_all(bytes))
}

/// The same, where the output may not be one of the `inputs` from which it was made.
///
/// # Errors
/// [`Failure::Lost`] where it is, and [`Failure::Write`]; an old file is then as it was.
pub fn write_whole_beside(
    path: &Path,
    bytes: &[u8],
    inputs: &[Option<&Path>],
) -> Result<(), Failure> {
    let is_output = |input: &&&Path| {
        input.canonicalize().is_ok_and(|input| path.canonicalize().is_ok_and(|path| path == input))
    };
    match inputs.iter().flatten().find(is_output) {
        Some(input) => Err(Failure::Lost { path: input.to_path_buf() }),
        None => write_whole(path, bytes),
    }
}

/// The same with a function that writes the content.
///
/// # Errors
/// [`Failure::Write`]; an old file is then as it was.
pub fn write_whole_with(
    path: &Path,
    content: impl FnOnce(&mut File) -> io::Result<()>,
) -> Result<(), Failure> {
    let written = stage(path, content).and_then(|file| put(file, path));
    written.map_err(|source| Failure::writing(path, source))
}

/// Makes the folder that `path` lies in.
///
/// # Errors
/// [`Failure::Write`].
pub fn make_parent(path: &Path) -> Result<(), Failure> {
    fs::create_dir_all(parent(path)).map_err(|source| Failure::writing(path, source))
}

/// Files to be written together: all are staged before the first takes its place.
///
/// Files that appear together, at the commit. Dropped before it, it leaves old files as they were
/// and nothing else behind.
#[derive(Debug, Default)]
pub struct Batch {
    staged: Vec<(TempPath, PathBuf)>,
}

impl Batch {
    /// Stages `bytes` for `path`; makes its folder.
    ///
    /// # Errors
    /// [`Failure::Write`].
    pub fn add(&mut self, path: &Path, bytes: &[u8]) -> Result<(), Failure> {
        make_parent(path)?;
        let file = stage(path, |file| file.write_all(bytes))
            .map_err(|source| Failure::writing(path, source))?;
        self.staged.push((file, path.to_owned()));
        Ok(())
    }

    /// Puts every staged file in its place.
    ///
    /// # Errors
    /// [`Failure::Write`]; the files before that one are then in their places.
    pub fn commit(self) -> Result<(), Failure> {
        for (file, path) in self.staged {
            put(file, &path).map_err(|source| Failure::writing(&path, source))?;
        }
        Ok(())
    }
}

/// The folder that `path` lies in.
pub(crate) fn parent(path: &Path) -> &Path {
    path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

/// A builder of partial names beside `path`. The crate makes them for their owner alone, by
/// default; what comes of them is an output like any other, under the umask.
pub(crate) fn partial<T>(
    path: &Path,
    #[cfg_attr(not(unix), expect(unused_variables, reason = "there is no mode"))] mode: u32,
    make: impl FnOnce(&tempfile::Builder<'_, '_>, &Path) -> io::Result<T>,
) -> io::Result<T> {
    let name = path.file_name().ok_or(io::ErrorKind::InvalidFilename)?;
    let mut prefix = OsString::from(".");
    prefix.push(name);
    prefix.push(".");
    let mut builder = tempfile::Builder::new();
    builder.prefix(&prefix).suffix(".partial");
    #[cfg(unix)]
    builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(mode));
    make(&builder, parent(path))
}

/// A partial file with its content on the disk.
fn stage(path: &Path, content: impl FnOnce(&mut File) -> io::Result<()>) -> io::Result<TempPath> {
    let mut file: NamedTempFile =
        partial(path, 0o666, |builder, folder| builder.tempfile_in(folder))?;
    content(file.as_file_mut())?;
    file.as_file().sync_all()?;
    Ok(file.into_temp_path())
}

fn put(file: TempPath, path: &Path) -> io::Result<()> {
    file.persist(path).map_err(|error| error.error)?;
    sync(parent(path))
}

/// Makes the names in a folder last.
pub(crate) fn sync(folder: &Path) -> io::Result<()> {
    // Elsewhere a folder cannot be opened.
    if cfg!(unix) { File::open(folder)?.sync_all() } else { Ok(()) }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(folder: &Path) -> Vec<OsString> {
        let mut names: Vec<_> =
            fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().file_name()).collect();
        names.sort();
        names
    }

    #[test]
    fn a_file_is_replaced_whole_and_a_failure_leaves_the_old_one() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.txt");
        write_whole(&path, b"first").unwrap();
        write_whole(&path, b"second").unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"second");
        let broken = write_whole_with(&path, |file| {
            file.write_all(b"half")?;
            Err(io::Error::other("no room"))
        });
        assert!(matches!(broken, Err(Failure::Write { .. })));
        assert_eq!(fs::read(&path).unwrap(), b"second");
        assert_eq!(names(folder.path()), ["a.txt"]);
    }

    /// Nobody makes a file in `/sys`, root included.
    #[cfg(target_os = "linux")]
    #[test]
    fn a_place_that_cannot_be_written_is_named_once_and_in_plain_words() {
        let mut batch = Batch::default();
        let path = Path::new("/sys/kernel/verge.toml");
        for failed in [write_whole(path, b"x"), batch.add(path, b"x")] {
            let said = failed.unwrap_err().to_string();
            assert_eq!(said.matches("/sys").count(), 1, "{said}");
            assert!(!said.contains("os error") && !said.contains("partial"), "{said}");
        }
    }

    #[test]
    fn a_folder_is_made_only_where_that_is_asked_for() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("deep/a.txt");
        assert!(matches!(write_whole(&path, b"x"), Err(Failure::Write { .. })));
        assert!(names(folder.path()).is_empty());
        make_parent(&path).unwrap();
        write_whole(&path, b"x").unwrap();
        assert!(matches!(write_whole(Path::new("/"), b"x"), Err(Failure::Write { .. })));
    }

    #[cfg(unix)]
    #[test]
    fn an_output_has_the_mode_of_any_file() {
        use std::os::unix::fs::PermissionsExt;
        let folder = tempfile::tempdir().unwrap();
        let mode =
            |name: &str| fs::metadata(folder.path().join(name)).unwrap().permissions().mode();
        write_whole(&folder.path().join("ours"), b"x").unwrap();
        fs::write(folder.path().join("plain"), b"x").unwrap();
        assert_eq!(mode("ours"), mode("plain"));
    }

    #[test]
    fn a_batch_is_written_or_leaves_no_trace() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        let mut batch = Batch::default();
        batch.add(&path("deep/a.txt"), b"a").unwrap();
        batch.add(&path("b.txt"), b"b").unwrap();
        batch.commit().unwrap();
        assert_eq!(fs::read(path("deep/a.txt")).unwrap(), b"a");
        let mut batch = Batch::default();
        batch.add(&path("c.txt"), b"c").unwrap();
        // Where a folder should be there is a file.
        assert!(matches!(batch.add(&path("b.txt/d.txt"), b"d"), Err(Failure::Write { .. })));
        drop(batch);
        assert_eq!(names(folder.path()), ["b.txt", "deep"]);
    }
}
