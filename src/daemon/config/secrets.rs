//! Files that nobody but their owner may read.

use super::ConfigError;
use std::path::Path;

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
    Ok(Some((user.to_owned(), password.to_owned())))
}

/// The text of a file that nobody else may read.
pub(super) fn private(key: &'static str, path: &Path) -> Result<String, ConfigError> {
    let wrong = |reason: String| ConfigError::Secret { key, path: path.to_owned(), reason };
    let text = std::fs::read_to_string(path).map_err(|error| wrong(error.to_string()))?;
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        let mode = std::fs::metadata(path).map_err(|e| wrong(e.to_string()))?.permissions().mode();
        if mode & 0o077 != 0 {
            return Err(wrong(format!("mode {:03o} lets others read it: chmod 600", mode & 0o777)));
        }
    }
    Ok(text)
}
