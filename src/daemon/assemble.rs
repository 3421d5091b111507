//! Assembly: cameras, lines and outlets from a configuration, or for a recording.
//!
//! Owns what each key of the configuration becomes. No other file gives a stage its settings.

use super::address::{Address, SCHEMES};
use super::capture::{
    CameraSettings, Credentials, DEFAULT_SIZE, DeviceSettings, Recorded, Source, SourceSettings,
    utc_offset,
};
use super::config::{Config, ConfigError, Site, SourceKind};
use super::dates::Dates;
use super::exit::Failure;
use super::frame::Frame;
use super::line::{Line, LineSettings};
use super::locate::Anchor;
use super::outlet::Outlet;
use super::presets::{Following, TableSettings, WindowSettings};
use super::publish::payload::Located;
use super::publish::{Identity, MqttSettings, Tls};
use super::spool::Spool;
use super::station::Station;
use crate::density::Start;
use crate::sensor::{Preset, Sensor, Windows};
use crate::track::rate::DEFAULT_TOP_KMH;
use std::path::Path;
use std::time::Duration;

/// Longest wait for a picture where no configuration says it.
const TIMEOUT: Duration = Duration::from_secs(10);

/// The camera and the line of a configuration, and their broker.
pub struct Assembly {
    /// The line that measures.
    pub line: Line,
    /// The windows over its lanes.
    pub presets: Vec<Preset>,
    /// The camera.
    pub camera: SourceSettings,
    /// Who gets the windows.
    pub broker: MqttSettings,
    /// From whom they are.
    pub identity: Identity,
}

impl Assembly {
    /// Loads what the configuration names. Neither camera nor broker is asked yet; a wrong
    /// address is found here.
    ///
    /// # Errors
    /// [`Failure`] names what cannot be used.
    pub fn of(config: &Config) -> Result<Self, Failure> {
        let line = open_line(config)?;
        let presets = line.windows(&windows(config), config.interval())?;
        let camera = camera(config, Some(&line))?;
        Source::open(camera.clone())?;
        let identity = Identity::new(&config.site.id, line.model()).at(located(config, &line)?);
        Ok(Self { line, presets, camera, broker: broker(config)?, identity })
    }

    /// Puts it to work.
    ///
    /// # Errors
    /// [`Failure`] where the camera or the spool cannot be opened.
    pub fn open(self, config: &Config) -> Result<(Station, Sensor<Vec<Preset>>, Outlet), Failure> {
        let Self { mut line, presets, camera, broker, identity } = self;
        let spool = Spool::open(config.spool_folder(), config.spool_windows())?;
        line.recall_road(&config.road_file());
        let station = Station::open(camera, line)?;
        let mut outlet = Outlet::start(broker, config.mqtt.format, identity, spool);
        outlet.serve_node(config.serial_settings());
        Ok((station, Sensor::new(presets, config.interval()), outlet))
    }
}

/// A line with a recording in front, for `replay` and `demo`.
pub fn open_recording(
    settings: &LineSettings,
    windows: &WindowSettings,
    frames: &Path,
    interval: Option<Duration>,
    (utc_offset_s, dates): (i32, Option<Dates>),
    top_kmh: f32,
) -> Result<(Recorded, Line, Windows<Vec<Preset>>), Failure> {
    let recorded = Recorded::open_local(frames, interval, utc_offset_s, dates)?;
    // Before anything is refused for it.
    if recorded.assumes_interval() {
        log::warn!(
            "neither names nor file times tell when the frames were taken: one each {} s is \
             assumed (--interval)",
            recorded.interval().as_secs_f64()
        );
    }
    let mut line = Line::open(settings)?;
    line.follow(top_kmh, recorded.interval());
    let presets = line.windows(windows, recorded.interval())?;
    Ok((recorded, line, Windows::new(presets)))
}

/// An offset from UTC as people write it, s.
pub fn utc_offset_s(text: &str) -> Option<i32> {
    utc_offset(text)
}

/// A recording, for `detect`.
pub fn open_frames(frames: &Path) -> Result<Recorded, Failure> {
    Ok(Recorded::open(frames, None)?)
}

/// A recording that is played in a loop in front of a line, for `bench`.
pub fn open_endless(
    settings: &LineSettings,
    windows: &WindowSettings,
    frames: &Path,
) -> Result<(Station, Windows<Vec<Preset>>), Failure> {
    let (recorded, line, windows) =
        open_recording(settings, windows, frames, None, (0, None), DEFAULT_TOP_KMH)?;
    let source = Source::Recorded(recorded.for_ever());
    Ok((Station::with(source, Frame::default(), line), windows))
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
    let size = line.map(|line| line.preset().table().image_size);
    let size = size.map(|size| (u32::from(size.width), u32::from(size.height)));
    Ok(match config.camera.kind() {
        SourceKind::Folder => SourceSettings::Recorded { folder: source.into(), interval },
        SourceKind::Device => {
            let size = size.unwrap_or(DEFAULT_SIZE);
            SourceSettings::Device(DeviceSettings { path: source.into(), size, interval, timeout })
        }
        SourceKind::Network => {
            let credentials = config.camera_secret()?;
            SourceSettings::Network(CameraSettings {
                address: config.camera_address()?,
                credentials: credentials.map(|(user, password)| Credentials { user, password }),
                trust: config.camera_trust()?,
                redirect_hosts: config.camera.redirect_hosts.clone(),
                interval,
                timeout,
                size,
                every_picture: line
                    .is_some_and(|line| matches!(line.following(), Following::On { .. })),
            })
        }
    })
}

/// A camera without a configuration, asked for a picture each `interval`, in whatever shape.
///
/// # Errors
/// [`Failure::Config`] where `source` is neither an address nor a device.
pub fn camera_at(source: &str, interval: Duration) -> Result<SourceSettings, Failure> {
    if source.starts_with("/dev/") {
        let (path, size, timeout) = (source.into(), DEFAULT_SIZE, TIMEOUT);
        return Ok(SourceSettings::Device(DeviceSettings { path, size, interval, timeout }));
    }
    let wrong = |reason| ConfigError::Camera { key: "--camera", reason };
    if !source.contains("://") {
        let schemes = SCHEMES.join(", ");
        let reason = format!("it begins neither with {schemes} nor with /dev/");
        return Err(wrong(reason).into());
    }
    let address = Address::parse(source).map_err(|error| wrong(error.to_string()))?;
    Ok(SourceSettings::Network(CameraSettings::new(address, interval, TIMEOUT)))
}

/// The settings of a configuration's line.
pub fn line_settings(config: &Config) -> LineSettings {
    let tables = &config.lane_table;
    LineSettings {
        tables: TableSettings {
            files: std::iter::once(&tables.file).chain(&tables.presets).cloned().collect(),
            camera: Some(config.camera.id.clone()),
            anchor: Anchor::default(),
        },
        judging: config.camera.watch.into(),
        model: config.model.file.clone(),
        score: config.model.score,
        input: config.model.input,
        audit: tables.audit.clone(),
        views: config.model.views,
    }
}

/// The line of a configuration.
pub fn open_line(config: &Config) -> Result<Line, Failure> {
    let mut line = Line::open(&line_settings(config))?;
    line.keep_within(config.interval())?;
    if config.traffic.enabled {
        line.follow(config.traffic.top_speed_kmh, config.interval());
    }
    line.set_sections(config.traffic.sections())?;
    Ok(line)
}

/// Where the site is, if the configuration says.
fn located(config: &Config, line: &Line) -> Result<Option<Located>, Failure> {
    let Site { place, lanes, .. } = &config.site;
    let table = &line.preset().table().lanes;
    // Each preset has lanes of its own.
    let unknown = lanes.iter().find(|named| {
        config.lane_table.presets.is_empty() && table.iter().all(|lane| lane.id.get() != named.lane)
    });
    if let Some(named) = unknown {
        let numbers: Vec<_> = table.iter().map(|lane| lane.id.get().to_string()).collect();
        let reason =
            format!("lane {}: the lane table has lanes {}", named.lane, numbers.join(", "));
        let path = config.lane_table.file.clone();
        return Err(ConfigError::Value { path, line: None, key: "site.lanes", reason }.into());
    }
    let lanes = lanes.clone();
    Ok(place.clone().map(|place| Located { place, lanes }))
}

/// The windows of a configuration: none that was begun in its middle.
fn windows(config: &Config) -> WindowSettings {
    WindowSettings {
        lengths: config.window_lengths(),
        min_completeness: config.windows.min_completeness,
        start: Start::AtNextWindow,
    }
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
        keeps_latest: config.mqtt.latest,
    })
}
