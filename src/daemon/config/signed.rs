//! Signatures over configuration, lane tables, audit and model: minisign's, beside each file.
//!
//! Owns when they are asked for: where the environment names a public key, and not the
//! configuration, which who changes it could leave out. The unit is the place for it
//! (`Environment=VERGE_TRUSTED_KEY=/usr/share/verge/site.pub`). The door of the crate
//! `minisign-verify`.

use super::ConfigError;
use crate::daemon::{disk, plain};
use minisign_verify::{PublicKey, Signature};
use std::ffi::OsString;
use std::path::{Path, PathBuf};

/// Names the file of the public key.
const VARIABLE: &str = "VERGE_TRUSTED_KEY";

/// Most bytes of a key or a signature.
const MAX_BYTES: u64 = 1 << 16;
/// Most bytes of a signed file: lane tables are the largest.
const MAX_SIGNED: u64 = 256 << 20;

/// The key that files must be signed with.
pub(super) struct Trusted {
    key: PublicKey,
}

impl Trusted {
    /// The key that the environment names; `None` where it names none.
    pub(super) fn from_environment() -> Result<Option<Self>, ConfigError> {
        Self::named(std::env::var_os(VARIABLE))
    }

    fn named(file: Option<OsString>) -> Result<Option<Self>, ConfigError> {
        let Some(path) = file.map(PathBuf::from) else { return Ok(None) };
        let wrong = |reason: String| ConfigError::Signature {
            path: path.clone(),
            reason: format!("{reason}; {VARIABLE} must name a public key of minisign"),
        };
        let text = plain::read_text(&path, MAX_BYTES)
            .map_err(|error| wrong(disk::unread(&error).to_string()))?;
        let key = PublicKey::decode(text.trim())
            .or_else(|_| PublicKey::from_base64(text.trim()))
            .map_err(|_| wrong("it is no such key".to_owned()))?;
        Ok(Some(Self { key }))
    }

    /// Whether a file is as it was signed.
    pub(super) fn check_file(&self, path: &Path) -> Result<(), ConfigError> {
        let read = plain::read(path, MAX_SIGNED).map_err(|error| ConfigError::Signature {
            path: path.to_owned(),
            reason: disk::unread(&error).to_string(),
        })?;
        self.check(path, &read)
    }

    /// Whether these bytes are what was signed of a file.
    pub(super) fn check(&self, path: &Path, bytes: &[u8]) -> Result<(), ConfigError> {
        let mut name = path.as_os_str().to_owned();
        name.push(".minisig");
        let beside = PathBuf::from(name);
        let wrong = |reason: String| ConfigError::Signature { path: path.to_owned(), reason };
        let signature = plain::read_text(&beside, MAX_BYTES).map_err(|error| {
            wrong(format!(
                "no signature, {}: {}; sign it with `minisign -Sm`",
                beside.display(),
                disk::unread(&error)
            ))
        })?;
        let signature = Signature::decode(signature.trim_end()).map_err(|_| {
            wrong(format!(
                "{} is no signature of minisign: sign it again with `minisign -Sm`",
                beside.display()
            ))
        })?;
        // Not the old form, which holds the whole file in memory.
        self.key.verify(bytes, &signature, false).map_err(|_| {
            wrong(
                "it is not what was signed, or another key signed it: sign it again with `minisign \
                 -Sm`; the one before stays in force where there is one"
                    .to_owned(),
            )
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Made by the formulas of minisign's page from the private key 00 01 .. 1f.
    const KEY: &str = "untrusted comment: minisign public key\n\
                       RWR2ZXJnZWtleQOhB7/zzhC+HXDdGOdLwJln5NYwm6UNXx3chmQSVTG4\n";
    const SIGNATURE: &str = "untrusted comment: signature from minisign secret key\n\
        RUR2ZXJnZWtleZIdAIIQM3UpmgZYEPTHpd8SkSKT3moJPAxmbftqdv+uXVZRqwnX8Knf62OnsFX/2rWDQBe/J5sbXfp79P/ZyQ0=\n\
        trusted comment: timestamp:1767600000\tfile:verge.toml\n\
        h4Fxyu8hQu4BJiJXjNAicZN5PXH5JKs6QWOfzYaICvx0LLhmsvIsS9GbmPj166a+nrDd+SHa2mgRVktuhgNkAg==\n";
    const SIGNED: &str = "site = \"signed\"\n";

    #[test]
    fn what_was_changed_or_not_signed_is_refused() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let write = |name: &str, text: &str| {
            let path = folder.path().join(name);
            std::fs::write(&path, text).expect("written");
            path
        };
        let key = write("site.pub", KEY);
        let trusted = Trusted::named(Some(key.into())).expect("a key").expect("named");
        let file = write("verge.toml", SIGNED);
        let reason = trusted.check_file(&file).expect_err("not signed").to_string();
        assert!(
            reason.contains("verge.toml.minisig") && reason.contains("minisign -Sm"),
            "{reason}"
        );
        write("verge.toml.minisig", SIGNATURE);
        trusted.check_file(&file).expect("as it was signed");
        for changed in ["site = \"Signed\"\n", "", "site = \"signed\"\n\n"] {
            let reason = trusted.check(&file, changed.as_bytes()).expect_err(changed).to_string();
            assert!(reason.contains("not what was signed"), "{reason}");
        }
        write("verge.toml.minisig", &SIGNATURE.replace("1767600000", "1767600001"));
        assert!(trusted.check_file(&file).is_err(), "its trusted comment is signed too");
        write("verge.toml.minisig", "nonsense");
        assert!(trusted.check_file(&file).is_err());
        assert!(Trusted::named(None).expect("none is named").is_none());
        for odd in ["", "RWR2", "untrusted comment: x\nnonsense"] {
            assert!(Trusted::named(Some(write("odd.pub", odd).into())).is_err(), "{odd}");
        }
    }
}
