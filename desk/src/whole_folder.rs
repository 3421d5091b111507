//! An output folder that is there whole or not at all.

use crate::failure::Failure;
use crate::whole::{parent, partial, sync};
use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};
use tempfile::TempDir;

/// A hidden folder beside an output folder, which it becomes; removed unless published.
#[derive(Debug)]
pub struct WholeFolder {
    staging: TempDir,
    out: PathBuf,
}

impl WholeFolder {
    /// Begins the folder `out`, which must be new or empty.
    ///
    /// # Errors
    /// [`Failure::Occupied`], [`Failure::Write`].
    pub fn beside(out: &Path) -> Result<Self, Failure> {
        let refuse = |source| Failure::writing(out, source);
        match fs::read_dir(out) {
            Ok(mut entries) => {
                if entries.next().is_some() {
                    return Err(Failure::Occupied { path: out.to_owned() });
                }
            }
            Err(fault) if fault.kind() == io::ErrorKind::NotFound => {}
            Err(fault) => return Err(refuse(fault)),
        }
        let staging = partial(out, 0o777, |builder, folder| builder.tempdir_in(folder));
        Ok(Self { staging: staging.map_err(refuse)?, out: out.to_owned() })
    }

    /// Where its files are written until it is published.
    pub fn path(&self) -> &Path {
        self.staging.path()
    }

    /// Flushes all that is in it to the disk and puts it in its place.
    ///
    /// # Errors
    /// [`Failure::Write`]; nothing is left then.
    pub fn publish(self) -> Result<(), Failure> {
        let Self { staging, out } = self;
        // On Unix, rename replaces an empty folder.
        sync_tree(staging.path())
            .and_then(|()| fs::rename(staging.path(), &out))
            .map_err(|source| Failure::writing(&out, source))?;
        // It has another name now: nothing is left to remove.
        let _ = staging.keep();
        sync(parent(&out)).map_err(|source| Failure::writing(&out, source))
    }
}

fn sync_tree(folder: &Path) -> io::Result<()> {
    for entry in fs::read_dir(folder)? {
        let entry = entry?;
        if entry.file_type()?.is_dir() {
            sync_tree(&entry.path())?;
        } else {
            File::open(entry.path())?.sync_all()?;
        }
    }
    sync(folder)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_folder_is_published_whole_and_an_occupied_one_is_refused() {
        let root = tempfile::tempdir().unwrap();
        let out = root.path().join("out");
        let count = || fs::read_dir(root.path()).unwrap().count();
        let begun = WholeFolder::beside(&out).unwrap();
        fs::write(begun.path().join("a.txt"), b"a").unwrap();
        drop(begun);
        assert_eq!(count(), 0, "a folder that is dropped leaves no trace");
        fs::create_dir(&out).unwrap();
        let begun = WholeFolder::beside(&out).unwrap();
        fs::create_dir(begun.path().join("deep")).unwrap();
        fs::write(begun.path().join("deep/a.txt"), b"a").unwrap();
        begun.publish().unwrap();
        assert_eq!(fs::read(out.join("deep/a.txt")).unwrap(), b"a");
        assert!(matches!(WholeFolder::beside(&out), Err(Failure::Occupied { .. })));
        let file = out.join("deep/a.txt");
        assert!(matches!(WholeFolder::beside(&file), Err(Failure::Write { .. })));
        assert_eq!(count(), 1);
    }
}
