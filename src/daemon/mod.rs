//! The daemon: one straight line from camera to broker.
//!
//! ```text
//! camera -> capture -> scene -> detect -> locate -> aggregate -> publish -> broker
//!            Frame      View   Detection  Located   WindowReport  bytes
//! ```
//!
//! Owns the order of the stages: this is the only file that names two of them. Each stage
//! is a module that knows the values of [`flow`] and no other stage; aggregation is the
//! core's [`crate::density`]. Between aggregation and the broker the [`spool`] keeps what
//! has not arrived.

mod board;
pub mod capture;
mod cli;
mod clock;
mod commands;
pub mod config;
mod counting;
pub mod detect;
pub mod exit;
pub mod export;
pub mod flow;
pub mod locate;
pub mod metrics;
mod notify;
mod output;
mod playback;
pub mod publish;
mod reload;
pub mod scene;
mod sensor;
pub mod spool;
pub mod views;

pub use counting::Counting;

use crate::density::{Closed, SampleZoneStatus, Start, WindowReport};
use crate::hal::{Board, Switch, Thermometer, Watchdog};
use crate::health::Event;
use crate::lane::Description;
use crate::units::UtcMs;
use capture::{
    Captured, Credentials, DEFAULT_SIZE, DeviceSettings, MJPEG_SCHEME, MjpegSettings, Recorded,
    SnapshotSettings, Source, SourceSettings,
};
use config::{Config, SourceKind};
use counting::Presets;
use detect::Detector;
use exit::Failure;
use flow::{Detection, Frame};
use locate::Anchor;
use publish::{Delivery, Format, Identity, MqttSettings, Publisher, Tls};
use scene::{Scene, View};
use spool::{Spool, SpoolCounts};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::{Duration, Instant};
use views::{Parts, Views};

/// Runs the program on a board: reads the command line, does what it says.
pub fn main<L, R, W, T>(board: Board<L, R, W, T>) -> ExitCode
where
    L: Switch,
    R: Switch,
    W: Watchdog,
    T: Thermometer,
{
    match cli::run(board) {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => {
            eprintln!("verge: {failure}");
            ExitCode::from(&failure)
        }
    }
}

/// Share of the time between two pictures that the net may take of the processor: the rest is
/// for the camera, the picture, and what else runs on the box.
const NET_SHARE: f64 = 0.5;

/// What a line is built from.
#[derive(Clone, Debug)]
pub struct LineSettings {
    /// The lane table.
    pub table: PathBuf,
    /// The tables of the camera's other presets.
    pub presets: Vec<PathBuf>,
    /// Whether pictures are judged before they are measured: blank, blurred, unchanged, and
    /// whether the camera has moved.
    pub watch: bool,
    /// The camera that it must belong to; `None`: whichever it belongs to.
    pub camera: Option<String>,
    /// Sidecar or model.
    pub model: PathBuf,
    /// Overrides the model's least score.
    pub score: Option<f32>,
    /// Which parts of a picture are searched.
    pub views: Views,
    /// Which point of a box stands for the vehicle.
    pub anchor: Anchor,
    /// Window lengths.
    pub windows: Vec<Duration>,
    /// Share of its frames that a window needs.
    pub min_completeness: f32,
    /// What happens to a window that was begun in its middle.
    pub start: Start,
}

impl LineSettings {
    /// For a recording: every frame counts, whichever camera it is of.
    pub fn recorded(table: &Path, model: &Path, window: Duration) -> Self {
        Self {
            table: table.to_owned(),
            presets: Vec::new(),
            watch: true,
            camera: None,
            model: model.to_owned(),
            score: None,
            views: Views::default(),
            anchor: Anchor::default(),
            windows: vec![window],
            min_completeness: 0.0,
            start: Start::WithFirstFrame,
        }
    }
}

/// What the stages took for one frame.
#[derive(Clone, Copy, Debug, Default)]
pub struct StageTimes {
    /// Reading and decoding the picture.
    pub capture: Duration,
    /// Judging the picture and finding the scene in it.
    pub scene: Duration,
    /// The picture into the net's input.
    pub prepare: Duration,
    /// The net.
    pub infer: Duration,
    /// The net's output into boxes.
    pub read: Duration,
    /// Boxes into lanes and windows.
    pub count: Duration,
}

/// What became of a frame.
#[derive(Clone, Debug)]
pub struct Measured {
    /// What it was: measured, unchanged, or not fit to be measured.
    pub event: Event,
    /// The windows that it closes.
    pub closed: Closed,
}

/// The line without its ends: from a frame to density.
#[derive(Debug)]
pub struct Line {
    detector: Detector,
    scene: Option<Scene>,
    presets: Presets,
    /// Where each preset's pictures are searched.
    parts: Vec<Parts>,
    found: Vec<Detection>,
}

impl Line {
    /// Loads model and tables.
    ///
    /// # Errors
    /// [`Failure`] names the file that is missing or wrong.
    pub fn open(settings: &LineSettings, interval: Duration) -> Result<Self, Failure> {
        let presets = Presets::open(settings, interval)?;
        let references = presets.references()?;
        let scene = settings.watch.then(|| Scene::new(references));
        let detector = Detector::load(&settings.model, settings.score)?;
        let parts = presets.parts(settings.views, detector.input_size());
        Ok(Self { detector, scene, presets, parts, found: Vec::new() })
    }

    /// Searches each picture once, and not its far part again, where the net is too slow for
    /// that with pictures in this interval. A box that falls behind its camera loses windows.
    fn keep_within(&mut self, interval: Duration) -> Result<(), Failure> {
        let Some(passes) = self.parts.iter().map(Parts::count).max().filter(|&count| count > 1)
        else {
            return Ok(());
        };
        // The first run brings the net's memory in.
        self.detector.infer()?;
        let begun = clock::processor_time();
        self.detector.infer()?;
        let took = clock::processor_time() - begun;
        if took.mul_f64(passes as f64) > interval.mul_f64(NET_SHARE) {
            log::warn!(
                "the net takes {took:.0?}: with pictures each {interval:?} their far part is not \
                 searched again (model.views)"
            );
            self.parts.iter_mut().for_each(Parts::keep_one);
        }
        Ok(())
    }

    /// Measures one frame.
    ///
    /// # Errors
    /// [`Failure::Detect`] and [`Failure::Locate`]; the frame then counts as missed.
    pub fn measure(&mut self, frame: &Frame) -> Result<Measured, Failure> {
        self.found.clear();
        let (preset, shift) = match self.look(frame)? {
            View::Fit { preset, shift } => (preset, shift),
            View::Unchanged => {
                let closed = self.miss(frame.time, SampleZoneStatus::InputDataIntegrity);
                return Ok(Measured { event: Event::Unchanged, closed });
            }
            View::PassedOver => {
                let closed = self.miss(frame.time, SampleZoneStatus::DetectionAutoSuspended);
                return Ok(Measured { event: Event::PassedOver, closed });
            }
            View::Withheld(alarm) => {
                let closed = self.miss(frame.time, alarm.status());
                return Ok(Measured { event: Event::Withheld(alarm), closed });
            }
        };
        let size = (frame.picture.width, frame.picture.height);
        self.detector.look_at(&self.parts[preset].of(size));
        self.detector.detect(&frame.picture, &mut self.found)?;
        let closed = self.presets.count(preset, &self.found, size, shift, frame.time)?;
        Ok(Measured { event: Event::Measured, closed })
    }

    /// Judges a frame. A wrong picture is refused before it costs anything.
    fn look(&mut self, frame: &Frame) -> Result<View, Failure> {
        self.presets.check_size((frame.picture.width, frame.picture.height))?;
        Ok(match &mut self.scene {
            Some(scene) => scene.judge(&frame.picture, frame.time),
            None => View::UNJUDGED,
        })
    }

    /// Measures one frame and tells what each stage took. A frame that would be withheld is
    /// measured all the same.
    ///
    /// # Errors
    /// As [`Self::measure`].
    pub fn measure_timed(&mut self, frame: &Frame) -> Result<StageTimes, Failure> {
        let picture = &frame.picture;
        let size = (picture.width, picture.height);
        let mut clock = Instant::now();
        let mut lap = || {
            let now = Instant::now();
            now - std::mem::replace(&mut clock, now)
        };
        let (preset, shift) = match self.look(frame)? {
            View::Fit { preset, shift } => (preset, shift),
            _ => View::NOWHERE,
        };
        let scene = lap();
        self.detector.look_at(&self.parts[preset].of(size));
        self.found.clear();
        let mut times = StageTimes { scene, ..StageTimes::default() };
        for pass in 0..self.detector.passes() {
            self.detector.prepare(picture, pass);
            times.prepare += lap();
            let output = self.detector.infer()?;
            times.infer += lap();
            self.detector.read(picture, pass, &output, &mut self.found)?;
            times.read += lap();
        }
        self.presets.count(preset, &self.found, size, shift, frame.time)?;
        Ok(StageTimes { count: lap(), ..times })
    }

    /// Notes that at `time` there was no usable frame, and why.
    pub fn miss(&mut self, time: UtcMs, status: SampleZoneStatus) -> Closed {
        self.presets.miss(time, status)
    }

    /// From now on pictures come in this interval.
    pub fn set_interval(&mut self, interval: Duration) {
        self.presets.set_interval(interval);
    }

    /// Closes the windows that have ended at `time`.
    pub fn advance(&mut self, time: UtcMs) -> Closed {
        self.presets.advance(time)
    }

    /// Notes that the clock was set, and closes the windows that it leaps over the end of. To
    /// be called after [`Self::advance`] to `from`.
    pub fn set_clock(&mut self, from: UtcMs, to: UtcMs) -> Closed {
        self.presets.set_clock(from, to)
    }

    /// Closes what runs, at the end of a recording.
    pub fn finish(&mut self) -> Closed {
        self.presets.finish()
    }

    /// The table to which the windows belong that the latest call closed.
    pub fn reported(&self) -> &Description {
        self.presets.reported()
    }

    /// What judges the pictures, unless that is switched off.
    pub fn scene(&self) -> Option<&Scene> {
        self.scene.as_ref()
    }

    /// What was found in the latest frame.
    pub fn found(&self) -> &[Detection] {
        &self.found
    }

    /// How many vehicles the latest frame shows, and how many of them in the lanes.
    pub fn latest(&self) -> (usize, usize) {
        (self.found.len(), self.presets.active().located())
    }

    /// Model and table in a few words.
    pub fn describe(&self) -> (String, String) {
        let (model, table) = (self.detector.sidecar(), self.counting().table());
        let (id, lanes) = (&table.camera_id, table.lanes.len());
        let error = table
            .length_rel_err
            .map_or("not stated".to_owned(), |error| format!("{:.1} %", error * 100.0));
        (
            format!(
                "{} at {}x{} px, over {}",
                model.name, model.input.width_px, model.input.height_px, self.parts[0]
            ),
            format!("{lanes} lanes of {id}, {}, length error {error}", table.image_size),
        )
    }

    /// The part behind detection, at the preset where the camera looks.
    pub fn counting(&self) -> &Counting {
        self.presets.active()
    }

    /// Who measures, for messages from `site`.
    pub fn identity(&self, site: &str) -> Identity {
        Identity::new(site, self.counting().table(), self.detector.model())
    }
}

/// A line with a recording in front, for `replay` and `demo`.
fn open_recording(
    settings: &LineSettings,
    frames: &Path,
    interval: Option<Duration>,
) -> Result<(Recorded, Line), Failure> {
    let recorded = Recorded::open(frames, interval)?;
    let line = Line::open(settings, recorded.interval())?;
    Ok((recorded, line))
}

/// A detector with a recording in front, for `detect`.
fn open_detector(
    frames: &Path,
    model: &Path,
    score: Option<f32>,
) -> Result<(Recorded, Detector), Failure> {
    Ok((Recorded::open(frames, None)?, Detector::load(model, score)?))
}

/// A camera with the line behind it.
#[derive(Debug)]
struct Station {
    source: Source,
    /// What the source was opened with.
    camera: Option<SourceSettings>,
    frame: Frame,
    line: Line,
}

impl Station {
    /// The station of a configuration.
    fn open(config: &Config) -> Result<Self, Failure> {
        let line = open_line(config)?;
        let camera = camera(config, Some(&line))?;
        let source = Source::open(camera.clone())?;
        Ok(Self { source, camera: Some(camera), frame: Frame::default(), line })
    }

    /// Takes a picture; false when it has the bytes of the one before.
    fn capture(&mut self) -> Result<bool, Failure> {
        Ok(self.source.next(&mut self.frame)? == Captured::New)
    }

    /// Measures the picture that was taken last.
    fn measure(&mut self) -> Result<Measured, Failure> {
        self.line.measure(&self.frame)
    }

    /// Replaces the line, and the camera where it is another one.
    ///
    /// # Errors
    /// Where the camera cannot be set up; all is as it was then.
    fn replace(&mut self, line: Line, camera: SourceSettings) -> Result<(), Failure> {
        if self.camera.as_ref() != Some(&camera) {
            self.source = Source::open(camera.clone())?;
            self.camera = Some(camera);
        }
        self.line = line;
        Ok(())
    }

    /// Takes and measures a picture, timed; for a recording that is played for ever.
    fn turn_timed(&mut self) -> Result<StageTimes, Failure> {
        let begun = Instant::now();
        self.source.next(&mut self.frame)?;
        let capture = begun.elapsed();
        Ok(StageTimes { capture, ..self.line.measure_timed(&self.frame)? })
    }
}

/// A recording that is played for ever in front of a line, for `bench`.
fn open_endless(settings: &LineSettings, frames: &Path) -> Result<Station, Failure> {
    let (recorded, line) = open_recording(settings, frames, None)?;
    let source = Source::Recorded(recorded.for_ever());
    Ok(Station { source, camera: None, frame: Frame::default(), line })
}

/// A configuration's camera and its first picture, in the shape of the line's table.
fn first_picture(config: &Config, line: Option<&Line>) -> Result<(Source, Frame), Failure> {
    let (mut source, mut frame) = (Source::open(camera(config, line)?)?, Frame::default());
    source.next(&mut frame)?;
    Ok((source, frame))
}

/// The camera of a configuration, asked for pictures in the shape of the line's table.
fn camera(config: &Config, line: Option<&Line>) -> Result<SourceSettings, Failure> {
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
fn open_line(config: &Config) -> Result<Line, Failure> {
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
fn broker(config: &Config) -> Result<MqttSettings, Failure> {
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

/// The end of the line: windows into the spool, and from there to the broker.
///
/// What closes while a session is open is sent at once; what closed before it, or was on its
/// way when an earlier one broke, follows as replay.
#[derive(Debug)]
pub struct Outlet {
    identity: Identity,
    spool: Spool,
    publisher: Publisher,
}

impl Outlet {
    /// Starts publishing; a broker that is away is no error.
    pub fn start(broker: MqttSettings, format: Format, identity: Identity, spool: Spool) -> Self {
        Self { identity, spool, publisher: Publisher::start(broker, format) }
    }

    /// The same without a disk: what has not arrived ends with the program.
    pub fn in_memory(broker: MqttSettings, format: Format, identity: Identity) -> Self {
        Self::start(broker, format, identity, Spool::in_memory())
    }

    /// The windows that follow were measured with this table.
    pub fn measured_with(&mut self, table: &Description) {
        self.identity.measured_with(table);
    }

    /// Takes a window. It outlives the program from here on, unless the disk refuses it.
    pub fn density(&mut self, report: &WindowReport, clock_synced: bool) {
        let identity = &self.identity;
        let length_s = report.to.saturating_since(report.from).as_secs();
        let length_s = u32::try_from(length_s).unwrap_or(u32::MAX);
        let number = |seq| identity.message(report, clock_synced, seq);
        let (key, message) = self.spool.accept(length_s, number);
        self.hear();
        if self.publisher.live(key, &message) {
            self.spool.give(key);
        }
    }

    /// From here on windows are another line's, and go to this broker; what waits and the
    /// numbers go on. The spool keeps `windows` of them.
    pub fn change(
        &mut self,
        broker: MqttSettings,
        format: Format,
        identity: Identity,
        windows: u64,
    ) {
        self.identity = identity;
        self.spool.keep(windows);
        self.publisher.change(broker, format);
    }

    /// Hears what the broker has taken and sends what an outage has left; to be called a few
    /// times a second.
    pub fn tend(&mut self) {
        self.hear();
        for _ in 0..self.publisher.arrears_wanted() {
            let Some(arrear) = self.spool.next_arrear() else { return };
            self.publisher.arrear(arrear.key, &arrear.message, arrear.is_last);
        }
    }

    fn hear(&mut self) {
        while let Some(delivery) = self.publisher.delivery() {
            match delivery {
                Delivery::Opened => self.spool.rewind(),
                Delivery::Closed => {}
                Delivery::Taken(key) => self.spool.acknowledge(key),
            }
        }
    }

    /// Whether a session with the broker is open.
    pub fn is_open(&self) -> bool {
        self.publisher.is_open()
    }

    /// For what is no window: health and alarms.
    pub fn publisher(&self) -> &Publisher {
        &self.publisher
    }

    /// What waits, and what was lost.
    pub fn counts(&self) -> SpoolCounts {
        self.spool.counts()
    }

    /// Says goodbye to the broker. What it has not taken waits on the disk for a next run.
    pub fn stop(mut self) {
        self.hear();
        self.publisher.stop().for_each(|key| self.spool.acknowledge(key));
        self.spool.note_acknowledged();
        let SpoolCounts { waiting, in_memory, .. } = self.spool.counts();
        if in_memory > 0 {
            log::error!("{in_memory} windows are lost: neither broker nor disk took them");
        }
        if waiting > in_memory {
            log::info!("{} windows wait on the disk", waiting - in_memory);
        }
    }
}

/// Starts publishing what a line measures.
fn open_outlet(config: &Config, line: &Line) -> Result<Outlet, Failure> {
    let spool = Spool::open(config.spool_folder(), config.spool_windows())?;
    Ok(Outlet::start(broker(config)?, config.mqtt.format, line.identity(&config.site), spool))
}
