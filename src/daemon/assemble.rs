//! Assembly: cameras, lines and outlets from a configuration, or for a recording.
//!
//! Owns what each key of the configuration becomes. No other file gives a stage its settings.

use super::capture::{
    Credentials, DEFAULT_SIZE, DeviceSettings, MJPEG_SCHEME, MjpegSettings, Recorded,
    SnapshotSettings, Source, SourceSettings,
};
use super::config::{Config, SourceKind};
use super::detect::Detector;
use super::exit::Failure;
use super::frame::Frame;
use super::line::{Line, LineSettings};
use super::locate::Anchor;
use super::outlet::Outlet;
use super::publish::{MqttSettings, Tls};
use super::spool::Spool;
use super::station::Station;
use crate::density::Start;
use std::path::Path;
use std::time::Duration;

/// The camera and the line of a configuration, and their broker.
pub struct Assembly {
    /// What measures.
    pub line: Line,
    /// Which camera is asked.
    pub camera: SourceSettings,
    /// Who gets the windows.
    pub broker: MqttSettings,
}

impl Assembly {
    /// Loads what the configuration names. Neither camera nor broker is asked yet; an address
    /// that is none is found here.
    ///
    /// # Errors
    /// [`Failure`] names what cannot be used.
    pub fn of(config: &Config) -> Result<Self, Failure> {
        let line = open_line(config)?;
        let camera = camera(config, Some(&line))?;
        Source::open(camera.clone())?;
        Ok(Self { line, camera, broker: broker(config)? })
    }

    /// Puts it to work.
    ///
    /// # Errors
    /// [`Failure`] where the camera or the spool cannot be opened.
    pub fn open(self, config: &Config) -> Result<(Station, Outlet), Failure> {
        let Self { line, camera, broker } = self;
        let spool = Spool::open(config.spool_folder(), config.spool_windows())?;
        let identity = line.identity(&config.site);
        let station = Station::open(camera, line)?;
        let mut outlet = Outlet::start(broker, config.mqtt.format, identity, spool);
        outlet.serve_node(config.serial_settings());
        Ok((station, outlet))
    }
}

/// A line with a recording in front, for `replay` and `demo`.
pub fn open_recording(
    settings: &LineSettings,
    frames: &Path,
    interval: Option<Duration>,
) -> Result<(Recorded, Line), Failure> {
    let recorded = Recorded::open(frames, interval)?;
    let line = Line::open(settings, recorded.interval())?;
    Ok((recorded, line))
}

/// A detector with a recording in front, for `detect`.
pub fn open_detector(
    frames: &Path,
    model: &Path,
    score: Option<f32>,
) -> Result<(Recorded, Detector), Failure> {
    Ok((Recorded::open(frames, None)?, Detector::load(model, score)?))
}

/// A recording that is played for ever in front of a line, for `bench`.
pub fn open_endless(settings: &LineSettings, frames: &Path) -> Result<Station, Failure> {
    let (recorded, line) = open_recording(settings, frames, None)?;
    let source = Source::Recorded(recorded.for_ever());
    Ok(Station::with(source, Frame::default(), line))
}

/// A configuration's camera and its first picture, in the shape of the line's table.
pub fn first_picture(config: &Config, line: Option<&Line>) -> Result<(Source, Frame), Failure> {
    let (mut source, mut frame) = (Source::open(camera(config, line)?)?, Frame::default());
    source.next(&mut frame)?;
    Ok((source, frame))
}

/// The camera of a configuration, asked for pictures in the shape of the line's table.
pub fn camera(config: &Config, line: Option<&Line>) -> Result<SourceSettings, Failure> {
    let (source, interval) = (&config.camera.source, config.interval());
    let timeout = Duration::from_secs_f64(config.camera.timeout_s);
    let credentials = || -> Result<_, Failure> {
        Ok(config.camera_secret()?.map(|(user, password)| Credentials { user, password }))
    };
    Ok(match config.camera.kind() {
        SourceKind::Folder => SourceSettings::Recorded { folder: source.into(), interval },
        SourceKind::Device => {
            let size = line.map(|line| line.counting().table().image_size);
            let size =
                size.map_or(DEFAULT_SIZE, |size| (u32::from(size.width), u32::from(size.height)));
            SourceSettings::Device(DeviceSettings { path: source.into(), size, interval, timeout })
        }
        SourceKind::Mjpeg => {
            let url = source.strip_prefix(MJPEG_SCHEME).unwrap_or(source).to_owned();
            let credentials = credentials()?;
            SourceSettings::Mjpeg(MjpegSettings { url, credentials, interval, timeout })
        }
        SourceKind::Snapshot => {
            let (url, credentials) = (source.clone(), credentials()?);
            SourceSettings::Snapshot(SnapshotSettings { url, credentials, interval, timeout })
        }
    })
}

/// The line of a configuration.
pub fn open_line(config: &Config) -> Result<Line, Failure> {
    let settings = LineSettings {
        table: config.lane_table.file.clone(),
        presets: config.lane_table.presets.clone(),
        watch: config.camera.watch,
        camera: Some(config.camera.id.clone()),
        model: config.model.file.clone(),
        score: config.model.score,
        views: config.model.views,
        anchor: Anchor::default(),
        windows: config.windows.lengths_s.iter().copied().map(Duration::from_secs).collect(),
        min_completeness: config.windows.min_completeness,
        start: Start::AtNextWindow,
    };
    let mut line = Line::open(&settings, config.interval())?;
    line.keep_within(config.interval())?;
    Ok(line)
}

/// The broker of a configuration.
pub fn broker(config: &Config) -> Result<MqttSettings, Failure> {
    Ok(MqttSettings {
        host: config.mqtt.host.clone(),
        port: config.mqtt.port,
        tls: config.mqtt_tls()?.as_ref().map(Tls::load).transpose()?,
        client_id: config.mqtt.client_id.clone(),
        credentials: config.mqtt_secret()?,
        root: config.root_topic(),
        keep_alive: Duration::from_secs(config.mqtt.keep_alive_s),
        version: config.mqtt.version,
        replay_per_s: config.mqtt.replay_per_s,
    })
}
