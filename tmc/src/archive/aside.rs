//! Refused messages: kept aside in `_rejected`, as much of each as is of use, and logged.
//!
//! Owns the files there: some messages of each site with their reasons, cut, so that no site
//! fills the disk with what it may not send; damaged parts of the journal, whole.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use verge_desk::{Failure, make_parent, write_whole};

/// Messages of a site that are kept between two compactions.
const KEPT: usize = 20;
/// Of each of them, bytes: the rest tells nothing more.
const KEPT_BYTES: usize = 16 << 10;
/// Sites that are named between two compactions.
const MOST_SITES: usize = 1000;
/// Bytes of the folder; beyond it messages are counted and not kept.
const MOST_BYTES: u64 = 256 << 20;
/// Longest reason that is logged, characters: a part of it is the sender's.
const LONGEST_REASON: usize = 300;

/// Refusals of a site since the last log line.
#[derive(Debug, Default)]
struct Refused {
    count: u64,
    reason: String,
    kept: Vec<u8>,
    kept_count: usize,
}

/// Keeps what is refused.
#[derive(Debug)]
pub struct Aside {
    folder: PathBuf,
    name: String,
    number: u64,
    bytes: u64,
    sites: BTreeMap<String, Refused>,
    /// Of sites beyond those that are named.
    others: u64,
}

impl Aside {
    /// Opens the folder `_rejected` of the archive under `root`, for an archiver of that name.
    ///
    /// # Errors
    /// [`Failure`] where it cannot be read.
    pub fn open(root: &Path, name: &str) -> Result<Self, Failure> {
        let folder = root.join("_rejected");
        let (mut bytes, mut number) = (0, 0);
        if folder.exists() {
            let failed = |source| Failure::reading(&folder, source);
            for entry in std::fs::read_dir(&folder).map_err(failed)? {
                let entry = entry.map_err(failed)?;
                bytes += entry.metadata().map_err(failed)?.len();
                let file = entry.file_name().to_string_lossy().into_owned();
                let own = file.strip_prefix(name).and_then(|rest| rest.strip_prefix('-'));
                let used = own.and_then(|rest| rest.strip_suffix(".txt")?.parse().ok());
                number = number.max(used.unwrap_or(0));
            }
        }
        Ok(Self { folder, name: name.to_owned(), number, bytes, sites: BTreeMap::new(), others: 0 })
    }

    /// How many more messages of a site would be kept.
    pub fn room(&self, site: &str) -> usize {
        let kept = self.sites.get(&shown(site)).map_or(0, |refused| refused.kept_count);
        if self.bytes < MOST_BYTES { KEPT.saturating_sub(kept) } else { 0 }
    }

    /// Keeps a message that a site may not send, and why.
    pub fn refuse(&mut self, site: &str, reason: &str, payload: &[u8]) {
        let site = shown(site);
        if self.sites.len() >= MOST_SITES && !self.sites.contains_key(&site) {
            self.others += 1;
            return;
        }
        let refused = self.sites.entry(site).or_default();
        refused.count += 1;
        if refused.count == 1 {
            refused.reason = shown(reason);
        }
        if refused.kept_count < KEPT && self.bytes < MOST_BYTES {
            refused.kept_count += 1;
            refused.kept.extend(shown(reason).as_bytes());
            refused.kept.push(b'\n');
            refused.kept.extend(&payload[..payload.len().min(KEPT_BYTES)]);
            refused.kept.push(b'\n');
        }
    }

    /// Writes what was kept and says, one line a site, what was refused since the last time.
    ///
    /// # Errors
    /// [`Failure::Write`].
    pub fn tell(&mut self) -> Result<Vec<String>, Failure> {
        let mut kept = Vec::new();
        for (site, refused) in &mut self.sites {
            if !refused.kept.is_empty() {
                kept.extend(format!("site {site}\n").bytes());
                kept.append(&mut refused.kept);
            }
        }
        if !kept.is_empty() {
            self.number += 1;
            self.bytes += kept.len() as u64;
            let file = format!("{}-{:08}.txt", self.name, self.number);
            let path = self.folder.join(file);
            make_parent(&path)?;
            write_whole(&path, &kept)?;
        }
        Ok(self.told())
    }

    /// The lines alone.
    pub(super) fn told(&mut self) -> Vec<String> {
        let line = |(site, Refused { count, reason, .. })| {
            format!("{site}: {count} messages refused, the first: {reason}")
        };
        let mut lines: Vec<String> =
            std::mem::take(&mut self.sites).into_iter().map(line).collect();
        let others = std::mem::take(&mut self.others);
        if others > 0 {
            lines.push(format!("{others} messages of other sites refused"));
        }
        lines
    }
}

/// Moves a file into a folder under a name that no other has: `NAME-1.ENDING` and so on; where
/// to.
///
/// # Errors
/// [`Failure::Write`].
pub fn move_into(folder: &Path, file: &Path, name: &str, ending: &str) -> Result<PathBuf, Failure> {
    let free = (1..)
        .map(|number| folder.join(format!("{name}-{number}.{ending}")))
        .find(|path| !path.exists())
        .expect("there is always another number");
    std::fs::create_dir_all(folder)
        .and_then(|()| std::fs::rename(file, &free))
        .map_err(|source| Failure::writing(&free, source))?;
    Ok(free)
}

/// Foreign text for people: without control characters, cut.
pub(super) fn shown(text: &str) -> String {
    let mut shown: String =
        text.chars().take(LONGEST_REASON).flat_map(char::escape_debug).collect();
    if shown.len() < text.len() && text.chars().count() > LONGEST_REASON {
        shown.push_str("...");
    }
    // As `escape_debug` does for literals: quotes are harmless here.
    shown.replace("\\\"", "\"").replace("\\'", "'")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn some_of_what_is_refused_is_kept_and_all_is_counted() {
        let folder = tempfile::tempdir().unwrap();
        let mut aside = Aside::open(folder.path(), "a").unwrap();
        for _ in 0..1000 {
            aside.refuse("evil", "has \u{1b}[31m\nfor a name", &[b'x'; 1 << 20]);
        }
        for site in 0..2000 {
            aside.refuse(&site.to_string(), "is not a message", b"{}");
        }
        let lines = aside.tell().unwrap();
        assert_eq!(lines.len(), MOST_SITES + 1);
        let of_evil = "evil: 1000 messages refused, the first: has \\u{1b}[31m\\nfor a name";
        assert!(lines.contains(&of_evil.to_owned()), "{lines:?}");
        assert_eq!(lines.last().unwrap(), "1001 messages of other sites refused");
        let files: Vec<_> = std::fs::read_dir(folder.path().join("_rejected")).unwrap().collect();
        assert_eq!(files.len(), 1);
        let size = files[0].as_ref().unwrap().metadata().unwrap().len() as usize;
        assert!(size < KEPT * (KEPT_BYTES + 100) + MOST_SITES * 100, "{size} bytes");
        assert!(aside.tell().unwrap().is_empty());
        // After a restart another file is written.
        let mut aside = Aside::open(folder.path(), "a").unwrap();
        aside.refuse("evil", "again", b"{}");
        aside.tell().unwrap();
        assert_eq!(std::fs::read_dir(folder.path().join("_rejected")).unwrap().count(), 2);
    }
}
