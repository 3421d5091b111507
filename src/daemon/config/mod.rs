//! The configuration file of `verge run`: TOML, unknown keys refused.
//!
//! Owns keys, defaults and their checks. `boards/linux/verge.toml` documents every key; a
//! test holds the two together.

mod check;
pub(in crate::daemon) mod example;
mod secrets;
mod sections;
mod signed;

pub use super::site::Site;
pub use sections::{
    Camera, DEFAULT_MODEL, INPUT_STEP_PX, LaneTable, MAX_INPUT_PX, Model, Mqtt, NetInput, Serial,
    SourceKind, Spool, Traffic, Views, Windows,
};

use crate::daemon::address::{Address, AddressError};
use crate::daemon::disk;
use crate::daemon::places;
use crate::daemon::plain;
use crate::daemon::publish::TlsFiles;
use crate::daemon::road_file;
use crate::daemon::serial::SerialSettings;
use crate::daemon::toml_file;
use crate::daemon::trust::Trust;
use secrets::{private, secret};
use serde::Deserialize;
use signed::Trusted;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Most bytes of a configuration.
const MAX_BYTES: u64 = 1 << 20;
/// Most bytes of a file of certificates: bundles of all public authorities have a quarter of it.
const MAX_CERTIFICATES: u64 = 1 << 20;

/// Why a configuration cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum ConfigError {
    /// It cannot be read.
    #[error("configuration {}: {}", path.display(), disk::unread(source))]
    Read {
        /// The file.
        path: PathBuf,
        /// The system's error.
        source: std::io::Error,
    },
    /// It is no configuration.
    #[error("configuration {}: {reason}", path.display())]
    Parse {
        /// The file.
        path: PathBuf,
        /// Line, key and reason.
        reason: String,
    },
    /// A value is out of its range.
    #[error("configuration {}: {}{key}: {reason}", path.display(), in_line(*line))]
    Value {
        /// The file.
        path: PathBuf,
        /// The line of the key; `None`: its default is wrong beside others.
        line: Option<usize>,
        /// The key.
        key: &'static str,
        /// The fault, and what would be right.
        reason: String,
    },
    /// A file that is not as it was signed.
    #[error("signature of {}: {reason}", path.display())]
    Signature {
        /// The file.
        path: PathBuf,
        /// The fault.
        reason: String,
    },
    /// The camera's keys.
    #[error("{key}: {reason}")]
    Camera {
        /// The key.
        key: &'static str,
        /// The fault.
        reason: String,
    },
    /// A file with a secret that is missing or open to others.
    #[error("{key} {}: {reason}", path.display())]
    Secret {
        /// The key.
        key: &'static str,
        /// The secret's file.
        path: PathBuf,
        /// The fault.
        reason: String,
    },
}

/// The whole configuration.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Config {
    /// Name of the site, in topics and messages, and where it is.
    pub site: Site,
    /// The source of pictures.
    pub camera: Camera,
    /// The model that finds vehicles.
    #[serde(default)]
    pub model: Model,
    /// The lane tables.
    pub lane_table: LaneTable,
    /// Over what time density is taken.
    #[serde(default)]
    pub windows: Windows,
    /// Whether flow and speed are measured.
    #[serde(default)]
    pub traffic: Traffic,
    /// The broker.
    #[serde(default)]
    pub mqtt: Mqtt,
    /// The store of windows until they have arrived.
    #[serde(default)]
    pub spool: Spool,
    /// An I/O node on a serial line.
    #[serde(default)]
    pub serial: Serial,
    /// Whether Home Assistant finds the sensor by itself.
    #[serde(default)]
    pub home_assistant: super::publish::home_assistant::Settings,
    /// A text file for Prometheus.
    #[serde(default)]
    pub metrics: super::metrics::Settings,
}

impl Config {
    /// Reads and checks a configuration. Relative paths in it count from its folder; a model or a
    /// lane table that is not there is looked for where `places::find` says.
    ///
    /// # Errors
    /// [`ConfigError`] names file, key and reason.
    pub fn read(path: &Path) -> Result<Self, ConfigError> {
        let unread = |source| ConfigError::Read { path: path.to_owned(), source };
        let text = plain::read_text(path, MAX_BYTES).map_err(unread)?;
        let writable = writable_by_others(path).map_err(unread)?;
        if let Some(mode) = writable {
            return Err(ConfigError::Parse {
                path: path.to_owned(),
                reason: format!("mode {mode:03o} lets everybody write it: chmod o-w"),
            });
        }
        let trusted = Trusted::from_environment()?;
        if let Some(trusted) = &trusted {
            trusted.check(path, text.as_bytes())?;
        }
        let mut config = Self::parse(&text)
            .map_err(|reason| ConfigError::Parse { path: path.to_owned(), reason })?;
        let wrong = |key, reason| ConfigError::Value {
            path: path.to_owned(),
            line: toml_file::line_of(&text, key),
            key,
            reason,
        };
        config.check().map_err(|(key, reason)| wrong(key, reason))?;
        let is_like_a_host = config.camera.is_like_a_host();
        config.resolve(path.parent().unwrap_or(Path::new("")));
        if is_like_a_host && !Path::new(&config.camera.source).exists() {
            return Err(wrong("camera.source", sections::NEITHER.to_owned()));
        }
        if let Some(trusted) = trusted {
            config.signed_files().try_for_each(|file| trusted.check_file(&file))?;
        }
        Ok(config)
    }

    /// The configuration that a text is, its values not checked yet.
    pub(super) fn parse(text: &str) -> Result<Self, String> {
        let known = example::names();
        toml_file::parse(text, &known).map_err(|fault| fault.to_string())
    }

    /// The files that change what is counted, beside the configuration itself. The model's sidecar
    /// holds the digest of its net.
    fn signed_files(&self) -> impl Iterator<Item = PathBuf> {
        let tables = &self.lane_table;
        let tables = std::iter::once(&tables.file).chain(&tables.presets).chain(&tables.audit);
        std::iter::once(self.model.file.with_extension("toml")).chain(tables.cloned())
    }

    /// The files and folders that it names and that are read.
    pub fn files(&self) -> Vec<PathBuf> {
        let (camera, mqtt, tables) = (&self.camera, &self.mqtt, &self.lane_table);
        let folder = PathBuf::from(&camera.source);
        let of_camera = [&camera.password_file, &camera.ca_file];
        let of_broker =
            [&mqtt.password_file, &mqtt.ca_file, &mqtt.certificate_file, &mqtt.key_file];
        let options = of_camera.into_iter().chain(of_broker).chain([&tables.audit]);
        [&self.model.file, &tables.file]
            .into_iter()
            .chain(&tables.presets)
            .chain(options.flatten())
            .cloned()
            .chain((camera.kind() == SourceKind::Folder).then_some(folder))
            .collect()
    }

    /// The camera's user and password.
    ///
    /// # Errors
    /// [`ConfigError::Secret`].
    pub fn camera_secret(&self) -> Result<Option<(String, String)>, ConfigError> {
        let Camera { user, password_file, .. } = &self.camera;
        secret("camera.password_file", user.as_deref(), password_file.as_deref())
    }

    /// The camera's address, where it is on a network.
    ///
    /// # Errors
    /// [`ConfigError::Camera`].
    pub fn camera_address(&self) -> Result<Address, ConfigError> {
        let wrong = |error: AddressError| ConfigError::Camera {
            key: "camera.source",
            reason: error.to_string(),
        };
        Address::parse(&self.camera.source).map_err(wrong)
    }

    /// Certificates that the camera may show.
    ///
    /// # Errors
    /// [`ConfigError::Secret`] for a file that cannot be read, [`ConfigError::Camera`].
    pub fn camera_trust(&self) -> Result<Trust, ConfigError> {
        let Camera { ca_file, fingerprint, .. } = &self.camera;
        let wrong = |key, reason| ConfigError::Camera { key, reason };
        if let Some(path) = ca_file {
            let file =
                plain::read(path, MAX_CERTIFICATES).map_err(|error| ConfigError::Secret {
                    key: "camera.ca_file",
                    path: path.clone(),
                    reason: disk::unread(&error).to_string(),
                })?;
            let reason = |reason| wrong("camera.ca_file", format!("{}: {reason}", path.display()));
            return Trust::certificates(path, &file).map_err(reason);
        }
        match fingerprint {
            Some(text) => Trust::fingerprint(text).map_err(|e| wrong("camera.fingerprint", e)),
            None => Ok(Trust::Public),
        }
    }

    /// The broker's user and password.
    ///
    /// # Errors
    /// [`ConfigError::Secret`].
    pub fn mqtt_secret(&self) -> Result<Option<(String, String)>, ConfigError> {
        let Mqtt { user, password_file, .. } = &self.mqtt;
        secret("mqtt.password_file", user.as_deref(), password_file.as_deref())
    }

    /// The files that secure the connection to the broker, when it is to be secured.
    ///
    /// # Errors
    /// [`ConfigError::Secret`] for a key that others can read.
    pub fn mqtt_tls(&self) -> Result<Option<TlsFiles>, ConfigError> {
        let Mqtt { tls, ca_file, certificate_file, key_file, .. } = &self.mqtt;
        if let Some(key) = key_file.as_ref().filter(|_| *tls) {
            private("mqtt.key_file", key)?;
        }
        let identity = certificate_file.clone().zip(key_file.clone());
        Ok(tls.then(|| TlsFiles { ca: ca_file.clone(), identity }))
    }

    /// Topic under which this site's topics stand.
    pub fn root_topic(&self) -> String {
        self.mqtt.root.clone().unwrap_or_else(|| format!("verge/{}", self.site.id))
    }

    /// Time between two pictures.
    pub fn interval(&self) -> Duration {
        Duration::from_secs_f64(self.camera.interval_s)
    }

    /// Lengths of the windows.
    pub fn window_lengths(&self) -> Vec<Duration> {
        self.windows.lengths_s.iter().copied().map(Duration::from_secs).collect()
    }

    /// The serial line to an I/O node.
    pub fn serial_settings(&self) -> Option<SerialSettings> {
        let Serial { device, baud, window_s } = self.serial.clone();
        let shortest = self.windows.lengths_s.iter().copied().min();
        let window_s = window_s.or(shortest)?;
        Some(SerialSettings { device: device?, baud, window_s })
    }

    /// Folder of the windows that have not arrived.
    pub fn spool_folder(&self) -> &Path {
        &self.spool.folder
    }

    /// Where the empty road is kept: the folder that is the daemon's to write.
    pub fn road_file(&self) -> PathBuf {
        self.spool_folder().join(road_file::NAME)
    }

    /// How many windows the spool must hold.
    pub fn spool_windows(&self) -> u64 {
        let a_day: u64 = self.windows.lengths_s.iter().map(|&s| 86_400_u64.div_ceil(s)).sum();
        (a_day as f64 * self.spool.days).ceil() as u64
    }

    fn resolve(&mut self, folder: &Path) {
        let absolute = |path: &mut PathBuf| *path = folder.join(&*path);
        let find = |path: &mut PathBuf| *path = places::find(folder, path);
        find(&mut self.model.file);
        find(&mut self.lane_table.file);
        self.lane_table.presets.iter_mut().for_each(find);
        self.lane_table.audit.as_mut().map(absolute);
        // Where systemd gives a folder for state, it is meant for this.
        let state = std::env::var_os("STATE_DIRECTORY").map_or(folder.to_owned(), PathBuf::from);
        self.spool.folder = state.join(&self.spool.folder);
        self.camera.password_file.as_mut().map(absolute);
        self.camera.ca_file.as_mut().map(absolute);
        for file in [
            &mut self.mqtt.password_file,
            &mut self.mqtt.ca_file,
            &mut self.mqtt.certificate_file,
            &mut self.mqtt.key_file,
        ] {
            file.as_mut().map(absolute);
        }
        self.metrics.file.as_mut().map(absolute);
        if self.camera.kind() == SourceKind::Folder {
            self.camera.source =
                folder.join(self.camera.source.trim()).to_string_lossy().into_owned();
        }
    }
}

fn in_line(line: Option<usize>) -> String {
    line.map_or(String::new(), |line| format!("line {line}: "))
}

/// The mode of a file that everybody may write.
fn writable_by_others(path: &Path) -> std::io::Result<Option<u32>> {
    use std::os::unix::fs::MetadataExt;
    let mode = std::fs::metadata(path)?.mode() & 0o777;
    Ok((mode & 0o002 != 0).then_some(mode))
}

#[cfg(test)]
mod tests;
