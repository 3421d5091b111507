//! Output files that are written whole or not at all.

use crate::failure::Failure;
use std::fs;
use std::path::{Path, PathBuf};

/// Files to be written together: each is staged beside its place, then all are renamed.
///
/// A failure before the renames leaves no trace, and old files as they were.
#[derive(Debug, Default)]
pub struct Batch {
    staged: Vec<(PathBuf, PathBuf)>,
}

impl Batch {
    /// Stages `bytes` for `path`; makes the folder.
    pub fn add(&mut self, path: &Path, bytes: &[u8]) -> Result<(), Failure> {
        let write = |source| Failure::Write { path: path.to_owned(), source };
        if let Some(folder) = path.parent().filter(|folder| !folder.as_os_str().is_empty()) {
            fs::create_dir_all(folder).map_err(write)?;
        }
        let mut staged = path.as_os_str().to_owned();
        staged.push(".part");
        let staged = PathBuf::from(staged);
        self.staged.push((staged.clone(), path.to_owned()));
        fs::write(&staged, bytes).map_err(write)
    }

    /// Puts every staged file in its place.
    pub fn commit(mut self) -> Result<(), Failure> {
        while let Some((staged, path)) = self.staged.first() {
            fs::rename(staged, path)
                .map_err(|source| Failure::Write { path: path.clone(), source })?;
            self.staged.remove(0);
        }
        Ok(())
    }
}

impl Drop for Batch {
    fn drop(&mut self) {
        for (staged, _) in &self.staged {
            // What was not committed goes away; a file that is not there is fine too.
            let _ = fs::remove_file(staged);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nothing_stays_of_a_batch_that_fails() {
        let folder = std::env::temp_dir().join(format!("verge-whole-{}", std::process::id()));
        fs::create_dir_all(folder.join("taken")).unwrap();
        let mut batch = Batch::default();
        batch.add(&folder.join("a.txt"), b"a").unwrap();
        // The staged name of the second file is taken by a folder.
        fs::create_dir_all(folder.join("b.txt.part")).unwrap();
        assert!(matches!(batch.add(&folder.join("b.txt"), b"b"), Err(Failure::Write { .. })));
        drop(batch);
        assert!(!folder.join("a.txt").exists() && !folder.join("a.txt.part").exists());
        fs::remove_dir_all(folder).unwrap();
    }

    #[test]
    fn a_batch_is_written() {
        let folder = std::env::temp_dir().join(format!("verge-batch-{}", std::process::id()));
        let mut batch = Batch::default();
        batch.add(&folder.join("deep/a.txt"), b"a").unwrap();
        batch.commit().unwrap();
        assert_eq!(fs::read(folder.join("deep/a.txt")).unwrap(), b"a");
        fs::remove_dir_all(folder).unwrap();
    }
}
