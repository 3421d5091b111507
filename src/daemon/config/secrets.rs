//! Files with secrets: who may read them, and what is in them.
//!
//! Owns the rule: a secret is its owner's, or lies in a folder of credentials that systemd,
//! Docker or Kubernetes has made for the service.

use super::ConfigError;
use crate::daemon::{disk, plain};
use std::path::{Path, PathBuf};

/// Most bytes of such a file: MQTT has no room for a longer password.
const MAX_BYTES: u64 = u16::MAX as u64;

/// Folders in which only the service's own credentials are: a group may read there, and with
/// Docker and Kubernetes anybody, for nobody else sees the folder.
const CREDENTIALS: [&str; 3] = ["/run/credentials", "/run/secrets", "/var/run/secrets"];

/// User with the first line of the password's file, which nobody else may read.
pub(super) fn secret(
    key: &'static str,
    user: Option<&str>,
    file: Option<&Path>,
) -> Result<Option<(String, String)>, ConfigError> {
    let Some(user) = user else { return Ok(None) };
    let Some(path) = file else { return Ok(Some((user.to_owned(), String::new()))) };
    let text = private(key, path)?;
    let password = text.lines().next().unwrap_or_default();
    let odd = if text.starts_with('\u{feff}') {
        Some("begins with a byte order mark: save it without")
    } else if text.contains('\0') {
        Some("is UTF-16 or holds zero bytes: save it as UTF-8")
    } else if password.trim().is_empty() {
        Some("has no password in its first line")
    } else {
        None
    };
    match odd {
        None => Ok(Some((user.to_owned(), password.to_owned()))),
        Some(odd) => {
            Err(ConfigError::Secret { key, path: path.to_owned(), reason: odd.to_owned() })
        }
    }
}

/// The text of a file that nobody else may read.
pub(super) fn private(key: &'static str, path: &Path) -> Result<String, ConfigError> {
    let wrong = |reason: String| ConfigError::Secret { key, path: path.to_owned(), reason };
    let bytes = plain::read(path, MAX_BYTES).map_err(|error| {
        wrong(match error.kind() {
            std::io::ErrorKind::FileTooLarge => "is larger than any password or key".to_owned(),
            std::io::ErrorKind::PermissionDenied => {
                "this user may not read it: chown it to the user \
                that verge runs as (verge), or hand it over as a credential of the service"
                    .to_owned()
            }
            _ => disk::unread(&error).to_string(),
        })
    })?;
    let text = String::from_utf8(bytes).map_err(|_| wrong("is not UTF-8 text".to_owned()))?;
    #[cfg(unix)]
    {
        use std::os::unix::fs::MetadataExt;
        let file = std::fs::metadata(path).map_err(|e| wrong(disk::unread(&e).to_string()))?;
        let is_credential = is_credential(path, std::env::var_os("CREDENTIALS_DIRECTORY"));
        judge(file.mode(), is_credential).map_err(wrong)?;
    }
    Ok(text)
}

/// The fault of a secret's mode.
fn judge(mode: u32, is_credential: bool) -> Result<(), String> {
    let mode = mode & 0o777;
    match (is_credential, mode & 0o022, mode & 0o055) {
        (_, 1.., _) => Err(format!("mode {mode:03o} lets others write it: chmod 600")),
        (false, _, 1..) => Err(format!(
            "mode {mode:03o} lets others read it: chmod 600, or hand it over as a credential of the \
             service (LoadCredential=, /run/secrets)"
        )),
        _ => Ok(()),
    }
}

/// Whether a file lies in a folder of credentials, links followed.
fn is_credential(path: &Path, given: Option<std::ffi::OsString>) -> bool {
    let real = |path: &Path| path.canonicalize().unwrap_or_else(|_| path.to_owned());
    let path = real(path);
    let folders = CREDENTIALS.iter().map(PathBuf::from).chain(given.map(PathBuf::from));
    folders.filter(|folder| folder.is_absolute()).any(|folder| path.starts_with(real(&folder)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn modes_as_systemd_docker_and_people_make_them() {
        for (mode, is_credential, right) in [
            (0o600, false, true),
            (0o400, false, true),
            (0o440, false, false),
            (0o444, false, false),
            (0o640, false, false),
            (0o440, true, true),
            (0o444, true, true),
            (0o620, false, false),
            (0o666, true, false),
        ] {
            assert_eq!(judge(0o100_000 | mode, is_credential).is_ok(), right, "{mode:03o}");
        }
    }

    #[test]
    fn credentials_lie_in_their_folder_also_behind_links() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let inside = folder.path().join("given");
        std::fs::create_dir(&inside).expect("a folder");
        std::fs::write(inside.join("password"), "x").expect("written");
        // As Kubernetes does.
        let link = folder.path().join("password");
        std::os::unix::fs::symlink(inside.join("password"), &link).expect("a link");
        let given = || Some(inside.clone().into_os_string());
        assert!(is_credential(&inside.join("password"), given()));
        assert!(is_credential(&link, given()));
        assert!(!is_credential(&link, None));
        assert!(!is_credential(&folder.path().join("other"), given()));
        assert!(!is_credential(&link, Some("".into())));
    }

    #[test]
    fn what_is_no_file_of_a_password_neither_hangs_nor_fills_the_memory() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let long = folder.path().join("long");
        std::fs::write(&long, "x".repeat(70_000)).expect("written");
        for (path, expected) in [
            (Path::new("/dev/zero"), "not a plain file"),
            (folder.path(), "name a file"),
            (&long, "larger than any password"),
            (&folder.path().join("none"), "no such file"),
        ] {
            let error = secret("mqtt.password_file", Some("u"), Some(path));
            let error = error.expect_err("no password").to_string();
            assert!(error.contains(expected) && !error.contains("os error"), "{error}");
        }
    }

    #[test]
    fn odd_passwords_are_named() {
        use std::os::unix::fs::PermissionsExt;
        let folder = tempfile::tempdir().expect("a temporary folder");
        let path = folder.path().join("password");
        for (bytes, expected) in [
            (&b"\xef\xbb\xbfs3cret\n"[..], Err("byte order mark")),
            (b"s\x003\x00", Err("UTF-16")),
            (b"\xff\xfes\x00", Err("UTF-8")),
            (b"\n s3cret", Err("no password")),
            (b"", Err("no password")),
            (b"s3cret\r\nrest", Ok("s3cret")),
            (b"s3cret ", Ok("s3cret ")),
        ] {
            std::fs::write(&path, bytes).expect("written");
            let mode = std::fs::Permissions::from_mode(0o600);
            std::fs::set_permissions(&path, mode).expect("chmod");
            let found = secret("mqtt.password_file", Some("u"), Some(&path));
            match (found, expected) {
                (Ok(Some((_, password))), Ok(expected)) => assert_eq!(password, expected),
                (Err(error), Err(expected)) => {
                    let error = error.to_string();
                    assert!(error.contains(expected) && !error.contains("s3cret"), "{error}");
                }
                (found, expected) => panic!("{found:?}, not {expected:?}"),
            }
        }
    }
}
