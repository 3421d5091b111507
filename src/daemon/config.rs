//! The configuration file of `verge run`: TOML, unknown keys refused.
//!
//! Owns keys, defaults and their checks. `boards/linux/verge.toml` documents every key; a
//! test holds the two together.

use crate::daemon::publish::TlsFiles;
use crate::density::{MAX_WINDOW_S, MIN_WINDOW_S};
use crate::lane::MAX_NAME;
use serde::Deserialize;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Why a configuration cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum ConfigError {
    /// It cannot be read.
    #[error("configuration {}: {source}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// What the system says.
        source: std::io::Error,
    },
    /// It does not parse.
    #[error("configuration {}: {reason}", path.display())]
    Parse {
        /// The file.
        path: PathBuf,
        /// Line, key and reason.
        reason: String,
    },
    /// A value is out of its range.
    #[error("configuration {}: {key}: {reason}", path.display())]
    Value {
        /// The file.
        path: PathBuf,
        /// Which key.
        key: &'static str,
        /// What is wrong, and what would be right.
        reason: String,
    },
    /// A file with a secret that is missing or open to others.
    #[error("{key} {}: {reason}", path.display())]
    Secret {
        /// Which key.
        key: &'static str,
        /// The secret's file.
        path: PathBuf,
        /// What is wrong with it.
        reason: String,
    },
}

/// The whole configuration.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Config {
    /// Name of the site, in topics and messages.
    pub site: String,
    /// Where pictures come from.
    pub camera: Camera,
    /// What finds vehicles.
    #[serde(default)]
    pub model: Model,
    /// Where lanes are.
    pub lane_table: LaneTable,
    /// Over what time density is taken.
    #[serde(default)]
    pub windows: Windows,
    /// Where messages go.
    #[serde(default)]
    pub mqtt: Mqtt,
    /// What is kept until it has arrived.
    #[serde(default)]
    pub spool: Spool,
    /// Whether Home Assistant finds the sensor by itself.
    #[serde(default)]
    pub home_assistant: super::publish::home_assistant::Settings,
    /// A text file for Prometheus.
    #[serde(default)]
    pub metrics: super::metrics::Settings,
}

/// Where pictures come from.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Camera {
    /// Name of the camera; the lane table must be made for it.
    pub id: String,
    /// Address of a snapshot or of a stream, a device under `/dev`, or a folder of recorded frames.
    pub source: String,
    /// Time between two pictures, s.
    pub interval_s: f64,
    /// Longest wait for a snapshot, s.
    #[serde(default = "default_timeout_s")]
    pub timeout_s: f64,
    /// User for basic authentication.
    pub user: Option<String>,
    /// File with the user's password.
    pub password_file: Option<PathBuf>,
    /// Whether pictures are judged before they are measured.
    #[serde(default = "default_watch")]
    pub watch: bool,
}

const fn default_watch() -> bool {
    true
}

/// Longest wait for a picture, s: watchdogs take a line that waits for one that hangs, and
/// the shortest (Raspberry Pi) counts 15 s.
const MAX_TIMEOUT_S: f64 = 10.0;

const fn default_timeout_s() -> f64 {
    10.0
}

/// What finds vehicles.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Model {
    /// Sidecar (`.toml`) or model (`.onnx`).
    pub file: PathBuf,
    /// Least score that counts; the sidecar's where it is not given.
    pub score: Option<f32>,
}

impl Default for Model {
    fn default() -> Self {
        Self { file: PathBuf::from(DEFAULT_MODEL), score: None }
    }
}

/// The model that is used when none is named, from the working directory.
pub const DEFAULT_MODEL: &str = "models/verge_nanodet_640x480.toml";

/// Where lanes are.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LaneTable {
    /// A file made by `mvcalib table`.
    pub file: PathBuf,
    /// The files of the camera's other presets.
    #[serde(default)]
    pub presets: Vec<PathBuf>,
}

/// Over what time density is taken.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Windows {
    /// Lengths, s.
    pub lengths_s: Vec<u64>,
    /// Share of a window's frames without which it reports no density, 0 to 1.
    pub min_completeness: f32,
}

impl Default for Windows {
    fn default() -> Self {
        // Three quarters: below it German traffic centres do not publish an interval.
        Self { lengths_s: vec![60, 900], min_completeness: 0.75 }
    }
}

/// What is kept until it has arrived.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Spool {
    /// Folder of the windows that the broker has not taken yet.
    pub folder: PathBuf,
    /// Time for which windows are kept while the broker is away, days.
    pub days: f64,
}

impl Default for Spool {
    fn default() -> Self {
        Self { folder: PathBuf::from("spool"), days: 7.0 }
    }
}

/// Where messages go.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Mqtt {
    /// Host name or address of the broker.
    pub host: String,
    /// Its port.
    pub port: u16,
    /// Whether the connection is secured by TLS.
    pub tls: bool,
    /// Certificates (PEM) that vouch for the broker, in place of the public ones.
    pub ca_file: Option<PathBuf>,
    /// The box's own certificate chain (PEM), where the broker asks for one.
    pub certificate_file: Option<PathBuf>,
    /// Its private key (PEM).
    pub key_file: Option<PathBuf>,
    /// Topic under which this site's topics stand; `verge/<site>` where it is not given.
    pub root: Option<String>,
    /// Client id; made from the root topic where it is not given.
    pub client_id: String,
    /// `json` or `postcard`.
    pub format: super::publish::Format,
    /// User.
    pub user: Option<String>,
    /// File with the user's password.
    pub password_file: Option<PathBuf>,
    /// Silence after which the connection is tested, s.
    pub keep_alive_s: u64,
    /// Version of the protocol, `3.1.1` or `5`.
    pub version: super::publish::MqttVersion,
    /// Most windows of an outage that are sent later, a second.
    pub replay_per_s: f64,
}

impl Default for Mqtt {
    fn default() -> Self {
        Self {
            host: "127.0.0.1".into(),
            port: 1883,
            tls: false,
            ca_file: None,
            certificate_file: None,
            key_file: None,
            root: None,
            client_id: String::new(),
            format: super::publish::Format::Json,
            user: None,
            password_file: None,
            keep_alive_s: 30,
            version: super::publish::MqttVersion::V3,
            replay_per_s: 10.0,
        }
    }
}

impl Config {
    /// Reads and checks a configuration. Relative paths in it count from its folder.
    ///
    /// # Errors
    /// [`ConfigError`] names file, key and reason.
    pub fn read(path: &Path) -> Result<Self, ConfigError> {
        let text = std::fs::read_to_string(path)
            .map_err(|source| ConfigError::Read { path: path.to_owned(), source })?;
        let mut config: Self = toml::from_str(&text).map_err(|error| ConfigError::Parse {
            path: path.to_owned(),
            reason: error.to_string().trim_end().to_owned(),
        })?;
        config.check().map_err(|(key, reason)| ConfigError::Value {
            path: path.to_owned(),
            key,
            reason,
        })?;
        config.resolve(path.parent().unwrap_or(Path::new("")));
        Ok(config)
    }

    /// The camera's user and password.
    ///
    /// # Errors
    /// [`ConfigError::Secret`].
    pub fn camera_secret(&self) -> Result<Option<(String, String)>, ConfigError> {
        let Camera { user, password_file, .. } = &self.camera;
        secret("camera.password_file", user.as_deref(), password_file.as_deref())
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
        self.mqtt.root.clone().unwrap_or_else(|| format!("verge/{}", self.site))
    }

    /// Time between two pictures.
    pub fn interval(&self) -> Duration {
        Duration::from_secs_f64(self.camera.interval_s)
    }

    /// Folder of the windows that have not arrived.
    pub fn spool_folder(&self) -> &Path {
        &self.spool.folder
    }

    /// How many windows the spool must hold.
    pub fn spool_windows(&self) -> u64 {
        let a_day: u64 = self.windows.lengths_s.iter().map(|&s| 86_400_u64.div_ceil(s)).sum();
        (a_day as f64 * self.spool.days).ceil() as u64
    }

    fn resolve(&mut self, folder: &Path) {
        let absolute = |path: &mut PathBuf| *path = folder.join(&*path);
        absolute(&mut self.model.file);
        absolute(&mut self.lane_table.file);
        self.lane_table.presets.iter_mut().for_each(absolute);
        // Where systemd gives a folder for state, it is meant for this.
        let state = std::env::var_os("STATE_DIRECTORY").map_or(folder.to_owned(), PathBuf::from);
        self.spool.folder = state.join(&self.spool.folder);
        self.camera.password_file.as_mut().map(absolute);
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
            self.camera.source = folder.join(&self.camera.source).to_string_lossy().into_owned();
        }
    }

    fn check(&self) -> Result<(), (&'static str, String)> {
        let known = |ok: bool, key, reason: String| if ok { Ok(()) } else { Err((key, reason)) };
        let plain = |text: &str| !text.is_empty() && !text.contains(['+', '#', '\0']);
        known(
            plain(&self.site) && self.site.len() <= MAX_NAME && !self.site.contains('/'),
            "site",
            format!("{:?}: give 1 to {MAX_NAME} bytes without / + #", self.site),
        )?;
        known(
            self.mqtt.root.as_deref().is_none_or(plain),
            "mqtt.root",
            format!("{:?}: give a topic without + #", self.mqtt.root),
        )?;
        for (key, seconds, most) in [
            ("camera.interval_s", self.camera.interval_s, 3600.0),
            ("camera.timeout_s", self.camera.timeout_s, MAX_TIMEOUT_S),
        ] {
            known(
                (0.01..=most).contains(&seconds),
                key,
                format!("{seconds} s: give 0.01 to {most}"),
            )?;
        }
        for &length in &self.windows.lengths_s {
            known(
                (MIN_WINDOW_S..=MAX_WINDOW_S).contains(&length),
                "windows.lengths_s",
                format!("{length} s: give {MIN_WINDOW_S} to {MAX_WINDOW_S}"),
            )?;
        }
        known(
            (0.0..=1.0).contains(&self.windows.min_completeness),
            "windows.min_completeness",
            format!("{}: give 0 to 1", self.windows.min_completeness),
        )?;
        known(
            self.lane_table.presets.is_empty() || self.camera.watch,
            "lane_table.presets",
            "presets are told apart by their scene: leave camera.watch = true".to_owned(),
        )?;
        known(
            self.model.score.is_none_or(|score| (0.0..=1.0).contains(&score)),
            "model.score",
            format!("{:?}: give 0 to 1", self.model.score),
        )?;
        let assistant = &self.home_assistant;
        known(
            plain(&assistant.prefix),
            "home_assistant.prefix",
            format!("{:?}: give a topic without + #", assistant.prefix),
        )?;
        known(
            !assistant.discovery || self.mqtt.format == super::publish::Format::Json,
            "home_assistant.discovery",
            "Home Assistant reads json: take mqtt.format = \"json\" or turn it off".to_owned(),
        )?;
        known(
            self.mqtt.keep_alive_s >= 5,
            "mqtt.keep_alive_s",
            format!("{} s: give at least 5", self.mqtt.keep_alive_s),
        )?;
        let Mqtt { tls, ca_file, certificate_file, key_file, .. } = &self.mqtt;
        known(
            *tls || (ca_file.is_none() && certificate_file.is_none() && key_file.is_none()),
            "mqtt.tls",
            "certificates are named, but the connection is not secured: tls = true".into(),
        )?;
        known(
            certificate_file.is_some() == key_file.is_some(),
            "mqtt.certificate_file",
            "a certificate and its key (key_file) go together".into(),
        )?;
        known(
            (0.1..=1000.0).contains(&self.mqtt.replay_per_s),
            "mqtt.replay_per_s",
            format!("{}: give 0.1 to 1000", self.mqtt.replay_per_s),
        )?;
        known(
            (0.01..=60.0).contains(&self.spool.days),
            "spool.days",
            format!("{}: give 0.01 to 60", self.spool.days),
        )
    }
}

/// What a camera's source is, by how it begins.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SourceKind {
    /// `http://`, `https://`: asked for one picture after the other.
    Snapshot,
    /// `mjpeg+http://`, `mjpeg+https://`: asked once, sends picture after picture.
    Mjpeg,
    /// `/dev/`: a device at the box.
    Device,
    /// Anything else: recorded frames.
    Folder,
}

impl Camera {
    /// What the source is.
    pub fn kind(&self) -> SourceKind {
        let begins = |with: &[&str]| with.iter().any(|start| self.source.starts_with(start));
        match () {
            () if begins(&["http://", "https://"]) => SourceKind::Snapshot,
            () if begins(&["mjpeg+http://", "mjpeg+https://"]) => SourceKind::Mjpeg,
            () if begins(&["/dev/"]) => SourceKind::Device,
            () => SourceKind::Folder,
        }
    }
}

/// User with the first line of the password's file, which nobody else may read.
fn secret(
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
fn private(key: &'static str, path: &Path) -> Result<String, ConfigError> {
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

#[cfg(test)]
mod tests {
    use super::*;

    const EXAMPLE: &str = include_str!("../../boards/linux/verge.toml");

    fn parse(text: &str) -> Result<Config, String> {
        let config: Config = toml::from_str(text).map_err(|error| error.to_string())?;
        config.check().map_err(|(key, reason)| format!("{key}: {reason}"))?;
        Ok(config)
    }

    /// The example with every commented key switched on: what it shows are the defaults.
    fn example_in_full() -> String {
        let uncomment = |line: &str| match line.strip_prefix("#") {
            Some(rest) if !rest.starts_with(' ') && rest.contains(" = ") => rest.to_owned(),
            _ => line.to_owned(),
        };
        EXAMPLE.lines().map(uncomment).collect::<Vec<_>>().join("\n")
    }

    #[test]
    fn the_example_is_right_and_shows_the_defaults() {
        let short = parse(EXAMPLE).expect("the example as it ships");
        let full = parse(&example_in_full()).expect("the example with every key");
        assert_eq!(full.mqtt.root, Some(short.root_topic()));
        let comparable = |mut config: Config| {
            config.mqtt.root = None;
            (config.camera.user, config.camera.password_file) = (None, None);
            (config.mqtt.user, config.mqtt.password_file) = (None, None);
            (config.mqtt.tls, config.mqtt.ca_file) = (false, None);
            (config.mqtt.certificate_file, config.mqtt.key_file) = (None, None);
            config.model.score = None;
            config.metrics.file = None;
            format!("{config:?}")
        };
        assert_eq!(comparable(full), comparable(short));
    }

    #[test]
    fn wrong_keys_and_values_are_named() {
        for (from, to, expected) in [
            ("site = ", "sight = ", "sight"),
            ("interval_s = 120", "interval_s = 0", "camera.interval_s"),
            ("interval_s = 120", "interval_s = \"soon\"", "interval_s"),
            ("#timeout_s = 10.0", "timeout_s = 60", "camera.timeout_s"),
            ("site = \"k109f\"", "site = \"a/b\"", "site"),
            ("lengths_s = [300, 900]", "lengths_s = [5]", "windows.lengths_s"),
            ("#watch = true", "watch = \"yes\"", "watch"),
            ("#presets = []", "presets = \"b.lut\"", "presets"),
            ("#min_completeness = 0.75", "min_completeness = 75", "windows.min_completeness"),
            ("#format = \"json\"", "format = \"xml\"", "xml"),
            ("#ca_file =", "ca_file =", "mqtt.tls"),
            ("#version = \"3.1.1\"", "version = \"4\"", "3.1.1"),
            ("#replay_per_s = 10.0", "replay_per_s = 0", "mqtt.replay_per_s"),
            ("#days = 7.0", "days = 90", "spool.days"),
            ("#prefix = \"homeassistant\"", "prefix = \"a/#\"", "home_assistant.prefix"),
        ] {
            let bad = EXAMPLE.replacen(from, to, 1);
            assert_ne!(bad, EXAMPLE, "{from}");
            let error = parse(&bad).expect_err(to);
            assert!(error.contains(expected), "{to}: {error}");
        }
    }

    #[test]
    #[cfg(unix)]
    fn a_password_that_others_can_read_is_refused() {
        use std::os::unix::fs::PermissionsExt;
        let folder = tempfile::tempdir().expect("a temporary folder");
        let path = folder.path().join("password");
        std::fs::write(&path, "hunter2\n").expect("writing it");
        let mode = |mode| {
            std::fs::set_permissions(&path, std::fs::Permissions::from_mode(mode)).expect("chmod");
            secret("mqtt.password_file", Some("box"), Some(&path))
        };
        let error = mode(0o644).expect_err("readable by all").to_string();
        assert!(error.contains("644") && !error.contains("hunter2"), "{error}");
        let (user, password) = mode(0o600).expect("private").expect("given");
        assert_eq!((user.as_str(), password.as_str()), ("box", "hunter2"));
    }
}
