//! The sections of the configuration with their keys and defaults.

use crate::daemon::address::Address;
use crate::daemon::foreign::shown;
use crate::daemon::serial::DEFAULT_BAUD;
use crate::track::rate::DEFAULT_TOP_KMH;
use crate::units::LaneId;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::PathBuf;

/// The source of pictures.
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
    /// User, where the camera wants a login.
    pub user: Option<String>,
    /// File with the user's password.
    pub password_file: Option<PathBuf>,
    /// Certificates (PEM) that the camera may show, or that vouch for it, in place of the public
    /// ones.
    pub ca_file: Option<PathBuf>,
    /// SHA-256 of the one certificate that the camera may show.
    pub fingerprint: Option<String>,
    /// Other hosts to which the camera may redirect.
    #[serde(default)]
    pub redirect_hosts: Vec<String>,
    /// Whether pictures are judged before they are measured.
    #[serde(default = "default_watch")]
    pub watch: bool,
}

const fn default_watch() -> bool {
    true
}

/// Longest wait for a picture, s: watchdogs take a line that waits for one that hangs, and
/// the shortest (Raspberry Pi) counts 15 s.
pub(super) const MAX_TIMEOUT_S: f64 = 10.0;

const fn default_timeout_s() -> f64 {
    10.0
}

/// The model that finds vehicles.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Model {
    /// Sidecar (`.toml`) or model (`.onnx`).
    pub file: PathBuf,
    /// Least score that counts; the sidecar's where it is not given.
    pub score: Option<f32>,
    /// Searched parts of a picture: `auto` or `whole`.
    pub views: Views,
    /// Columns and rows of the net's input: `auto` or such as `800x608`.
    pub input: NetInput,
}

impl Default for Model {
    fn default() -> Self {
        Self {
            file: PathBuf::from(DEFAULT_MODEL),
            score: None,
            views: Views::default(),
            input: NetInput::Auto,
        }
    }
}

/// Searched parts of a picture.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize, Serialize, clap::ValueEnum)]
#[serde(rename_all = "lowercase")]
pub enum Views {
    /// The road, and its far part once more where that makes far vehicles as large as near ones.
    Auto,
    /// The whole picture, once.
    #[default]
    Whole,
}

/// How large the net's input is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum NetInput {
    /// As large as the cars along the lanes ask for, of the model's steps.
    #[default]
    Auto,
    /// Columns and rows, px; multiples of 32.
    Px([usize; 2]),
}

/// Largest side of a net's input, px.
pub const MAX_INPUT_PX: usize = 4096;
/// An input of another size than the file's is a multiple of this, px: the cells of stride 32 that
/// are enlarged meet those of stride 16, and theirs those of stride 8.
pub const INPUT_STEP_PX: usize = 32;

impl NetInput {
    /// Whether a net may have an input of so many columns and rows.
    pub fn is_possible(size: [usize; 2]) -> bool {
        let is_side =
            |side: &usize| (1..=MAX_INPUT_PX).contains(side) && side.is_multiple_of(INPUT_STEP_PX);
        size.iter().all(is_side)
    }
}

impl std::str::FromStr for NetInput {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let size = text.split_once('x').and_then(|(width, height)| {
            Some(Self::Px([width.parse().ok()?, height.parse().ok()?]))
        });
        let shown = shown(text);
        match (text, size) {
            ("auto", _) => Ok(Self::Auto),
            (_, Some(Self::Px(px))) if !Self::is_possible(px) => Err(format!(
                "\"{shown}\": each side must be a multiple of {INPUT_STEP_PX} up to {MAX_INPUT_PX}"
            )),
            (_, Some(size)) => Ok(size),
            _ => Err(format!("\"{shown}\": give auto, or columns and rows such as 800x608")),
        }
    }
}

impl<'de> Deserialize<'de> for NetInput {
    fn deserialize<D: serde::Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        String::deserialize(deserializer)?.parse().map_err(serde::de::Error::custom)
    }
}

/// The model that is used when none is named, from the working directory; where it is not there,
/// `places` looks where packages and builds have it.
pub const DEFAULT_MODEL: &str = "models/verge_nanodet_640x480.toml";

/// The lane tables.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LaneTable {
    /// A file made by `mvcalib table`.
    pub file: PathBuf,
    /// The files of the camera's other presets.
    #[serde(default)]
    pub presets: Vec<PathBuf>,
    /// File of this site's `verge audit`.
    pub audit: Option<PathBuf>,
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

/// Whether flow and speed are measured.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Traffic {
    /// Whether they are, where pictures come often enough.
    pub enabled: bool,
    /// Highest speed that is driven there, km/h: it decides how many pictures are needed.
    pub top_speed_kmh: f32,
    /// Where vehicles are counted: for a lane's number, the distance from its upstream end, m. Its
    /// middle where nothing stands.
    pub section_m: BTreeMap<String, f32>,
}

impl Traffic {
    /// The sections of lanes that can be.
    pub fn sections(&self) -> impl Iterator<Item = (LaneId, f32)> {
        // As numbers are written: 03 and +3 would be lane 3 a second time.
        let lane = |number: &String| {
            let lane = number.parse().ok().and_then(LaneId::new);
            lane.filter(|lane| lane.get().to_string() == *number)
        };
        self.section_m.iter().filter_map(move |(number, &m)| Some((lane(number)?, m)))
    }
}

impl Default for Traffic {
    fn default() -> Self {
        Self { enabled: true, top_speed_kmh: DEFAULT_TOP_KMH, section_m: BTreeMap::new() }
    }
}

/// The store of windows until they have arrived.
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

/// The broker.
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
    pub format: crate::daemon::publish::Format,
    /// User.
    pub user: Option<String>,
    /// File with the user's password.
    pub password_file: Option<PathBuf>,
    /// Silence after which the connection is tested, s.
    pub keep_alive_s: u64,
    /// Version of the protocol, `3.1.1` or `5`.
    pub version: crate::daemon::publish::MqttVersion,
    /// Most windows of an outage that are sent later, a second.
    pub replay_per_s: f64,
    /// Whether the broker keeps the latest live window of each length on `latest/<window>`.
    pub latest: bool,
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
            format: crate::daemon::publish::Format::Json,
            user: None,
            password_file: None,
            keep_alive_s: 30,
            version: crate::daemon::publish::MqttVersion::Auto,
            replay_per_s: 10.0,
            latest: true,
        }
    }
}

/// Kind of a camera's source, by its prefix.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SourceKind {
    /// A camera on a network: anything with `://`.
    Network,
    /// `/dev/`: a device at the box.
    Device,
    /// Anything else: recorded frames.
    Folder,
}

/// The fault of a source that nothing can open.
pub(super) const NEITHER: &str = "it is neither an address nor a folder: a camera's begins with http://, \
    https://, mjpeg+http://, mjpeg+https://, rtsp:// or rtsps://, one at the box with /dev/";
/// The beginning of [`NEITHER`].
const NO_SOURCE: &str = "it is neither an address nor a folder: ";

impl Camera {
    /// The kind of the source.
    pub fn kind(&self) -> SourceKind {
        match self.source.trim() {
            source if source.contains("://") => SourceKind::Network,
            source if source.starts_with("/dev/") => SourceKind::Device,
            _ => SourceKind::Folder,
        }
    }

    /// Whether the source, should no such folder be there, is rather the address of a camera without its
    /// beginning.
    pub(super) fn is_like_a_host(&self) -> bool {
        let source = self.source.trim();
        let first = source.split('/').next().unwrap_or_default();
        let has_dots = first.trim_matches('.').contains('.') && !first.starts_with('.');
        let is_scheme = ["http", "https", "rtsp"].iter().any(|one| first.eq_ignore_ascii_case(one));
        // As other programs number cameras at the box.
        let number = source.strip_prefix("video").unwrap_or(source);
        let is_number =
            (1..=2).contains(&number.len()) && number.bytes().all(|b| b.is_ascii_digit());
        let is_none = source.starts_with("//") || has_dots || is_scheme || is_number;
        self.kind() == SourceKind::Folder && is_none
    }

    /// The fault of a source that nothing can open.
    pub(super) fn impossible(&self) -> Option<String> {
        match self.kind() {
            SourceKind::Network => Address::parse(&self.source).err().map(|e| e.to_string()),
            SourceKind::Device => None,
            SourceKind::Folder => {
                if self.source.trim().is_empty() {
                    return Some(format!("it is empty; {}", NEITHER.trim_start_matches(NO_SOURCE)));
                }
                let first = self.source.trim().split(['/', '?']).next().unwrap_or_default();
                let name = first.split(':').next().unwrap_or_default();
                let is_host = name.parse::<std::net::IpAddr>().is_ok()
                    || name.eq_ignore_ascii_case("localhost")
                    || (first.contains(':') && !name.is_empty())
                    || self.source.contains(['?', '@']);
                is_host.then(|| NEITHER.to_owned())
            }
        }
    }
}

/// An I/O node on a serial line.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Serial {
    /// The line's device; `None`: there is no node.
    pub device: Option<PathBuf>,
    /// Bits per second.
    pub baud: u32,
    /// Length of the windows that go over it, s; `None`: the shortest.
    pub window_s: Option<u64>,
}

impl Default for Serial {
    fn default() -> Self {
        Self { device: None, baud: DEFAULT_BAUD, window_s: None }
    }
}
