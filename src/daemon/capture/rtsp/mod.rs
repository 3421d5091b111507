//! RTSP: a camera that plays video, read over one TCP connection.
//!
//! Owns the stream's thread, which reads all and keeps the latest picture that can be measured,
//! and what is known of the stream: losses, refused pictures, key interval. [`session`] is the
//! protocol, [`sdp`] the description, [`rtp`], [`assembler`] with [`h264`] and `h265`, and [`jpeg`]
//! make whole pictures of packets, [`video`] decodes.
//!
//! Where density alone is asked for, key pictures, which decode without others, are enough:
//! they are kept as they come, and one is decoded when the line asks for it. Where every picture
//! is asked for, the thread decodes them all, for each builds on the one before.

pub mod assembler;
pub mod h264;
#[cfg(feature = "h265")]
pub mod h265;
pub mod jpeg;
pub mod rtp;
pub mod sdp;
pub mod session;
mod stream;
pub mod video;

pub use stream::Stream;

use super::backoff::Backoff;
use super::latest::{Latest, Worker};
use super::network::login::Login;
use super::network::{CameraError, CameraSettings, Fault};
use super::queue::FRESH;
use super::{CaptureError, Captured, DecodeError, StreamCounts, decode_shaped};
use crate::daemon::clock;
use crate::daemon::frame::{Frame, Picture, Shape};
use rtp::Packet;
use sdp::Codec;
use session::{Event, Session};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};
use video::Video;

/// Largest coded picture, bytes: key pictures of 4K at a high rate have 1.5 MB.
pub const MAX_UNIT: usize = 2 << 20;
/// Oldest key picture that is taken, where the line asks seldom.
const OLDEST: Duration = Duration::from_secs(10);
/// Bad packets in a row before a stream is given up.
const MOST_BAD_PACKETS: u32 = 1000;

/// How a picture is coded.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Coding {
    /// JPEG.
    #[default]
    Jpeg,
    /// H.264 in Annex B's form.
    H264,
    /// H.265 in Annex B's form.
    #[cfg(feature = "h265")]
    H265,
}

impl Coding {
    /// As people write it.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Jpeg => "JPEG",
            Self::H264 => "H.264",
            #[cfg(feature = "h265")]
            Self::H265 => "H.265",
        }
    }
}

/// A coded picture, or a decoded one.
#[derive(Debug, Default)]
pub struct Unit {
    /// As [`Self::coding`] says.
    pub bytes: Vec<u8>,
    /// How they are coded.
    pub coding: Coding,
    /// It decodes without others.
    pub key: bool,
    /// It is decoded already, and this is it.
    pub picture: Option<Picture>,
}

/// A camera whose video is read.
#[derive(Debug)]
pub struct Rtsp {
    settings: CameraSettings,
    login: Arc<Mutex<Login>>,
    stream: Arc<Mutex<Stream>>,
    worker: Option<Worker<Unit>>,
    backoff: Backoff,
    last_error: Option<CameraError>,
    reopened: u64,
    /// Pictures that could not be decoded.
    undecoded: u64,
    unit: Unit,
}

impl Rtsp {
    /// A camera; no request is made before the first picture is asked for.
    pub fn new(settings: CameraSettings) -> Self {
        Self {
            login: Arc::new(Mutex::new(Login::new(settings.login()))),
            settings,
            stream: Arc::default(),
            worker: None,
            backoff: Backoff::default(),
            last_error: None,
            reopened: 0,
            undecoded: 0,
            unit: Unit::default(),
        }
    }

    /// Counts of the stream's frames since start.
    pub fn counts(&self) -> StreamCounts {
        let stream = locked(&self.stream);
        StreamCounts {
            lost: stream.lost,
            flagged: stream.refused + self.undecoded,
            reopened: self.reopened,
            key_interval: stream.key_interval,
        }
    }

    /// Time between two pictures that are taken.
    pub fn interval(&self) -> Duration {
        self.settings.interval
    }

    /// How often a key picture must come; `None` where every picture is measured.
    pub fn key_interval_allowed(&self) -> Option<Duration> {
        (!self.settings.every_picture).then_some(self.settings.interval)
    }

    /// Description of the stream, as far as it is known.
    pub fn stream(&self) -> Stream {
        locked(&self.stream).clone()
    }

    /// The stream in words, and what to set.
    pub fn describe(&self) -> String {
        self.stream().describe(self.key_interval_allowed())
    }

    pub(super) fn next(&mut self, frame: &mut Frame) -> Result<Captured, CaptureError> {
        let worker = match &mut self.worker {
            Some(worker) if !worker.is_left() => worker,
            // One session at a time: cameras have few of them.
            Some(worker) if !worker.is_finished() => return Err(self.failed()),
            _ if self.backoff.waits(Instant::now()) => return Err(self.failed()),
            worker => {
                let reader = Reader {
                    settings: self.settings.clone(),
                    login: Arc::clone(&self.login),
                    stream: Arc::clone(&self.stream),
                };
                worker.insert(Worker::start("rtsp", move |latest| reader.read(latest)))
            }
        };
        let fresh = if self.settings.every_picture {
            FRESH
        } else {
            FRESH.max(self.settings.interval).min(OLDEST)
        };
        let pictures = locked(&self.stream).pictures;
        if let Err(mut fault) = worker.take(self.settings.timeout, fresh, &mut self.unit) {
            worker.leave();
            let stream = locked(&self.stream).clone();
            if matches!(fault, Fault::Timeout { what: "picture", .. }) && stream.pictures > pictures
            {
                fault = Fault::NoKey {
                    waited: self.settings.timeout,
                    pictures: stream.pictures - pictures,
                };
            }
            self.reopened += 1;
            self.backoff.failed(Instant::now(), fastrand::f32());
            let error = fault.at(&self.settings.address);
            self.last_error = Some(error.clone());
            return Err(error.into());
        }
        self.backoff.succeeded();
        self.last_error = None;
        frame.time = clock::now();
        "video".clone_into(&mut frame.name);
        let decoded = match self.unit.picture.take() {
            Some(picture) => {
                frame.picture = picture;
                Ok(())
            }
            None => decode(&self.unit, self.settings.shape(), &mut frame.picture),
        };
        decoded.map_err(|source| {
            self.undecoded += 1;
            CaptureError::Decode { name: self.settings.address.to_string(), source }
        })?;
        Ok(Captured::New)
    }

    fn failed(&self) -> CaptureError {
        let waited = self.settings.timeout;
        let timeout = || Fault::Timeout { what: "picture", waited }.at(&self.settings.address);
        self.last_error.clone().unwrap_or_else(timeout).into()
    }
}

fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Decodes a key picture.
fn decode(unit: &Unit, shape: Option<Shape>, picture: &mut Picture) -> Result<(), DecodeError> {
    match unit.coding {
        Coding::Jpeg => decode_shaped(&unit.bytes, shape, picture),
        coding => Video::alone(coding).decode(&unit.bytes, shape, picture),
    }
}

/// Assembles packets into pictures.
enum Assembler {
    Jpeg(jpeg::Assembler),
    H264(Box<h264::Assembler>),
    #[cfg(feature = "h265")]
    H265(Box<h265::Assembler>),
}

impl Assembler {
    fn new(described: &sdp::Video) -> Self {
        match described.codec {
            #[cfg(feature = "h265")]
            Codec::H265 => Self::H265(Box::new(h265::Assembler::new(&described.sets))),
            Codec::Jpeg => Self::Jpeg(jpeg::Assembler::default()),
            _ => Self::H264(Box::new(h264::Assembler::new(&described.sets))),
        }
    }

    fn coding(&self) -> Coding {
        match self {
            Self::Jpeg(_) => Coding::Jpeg,
            Self::H264(_) => Coding::H264,
            #[cfg(feature = "h265")]
            Self::H265(_) => Coding::H265,
        }
    }

    fn push(&mut self, packet: &Packet<'_>, unit: &mut Unit) -> bool {
        match self {
            Self::Jpeg(assembler) => assembler.push(packet, unit),
            Self::H264(assembler) => assembler.push(packet, unit),
            #[cfg(feature = "h265")]
            Self::H265(assembler) => assembler.push(packet, unit),
        }
    }

    fn counts(&self) -> (u64, u64) {
        match self {
            Self::Jpeg(assembler) => (assembler.lost, assembler.refused),
            Self::H264(assembler) => (assembler.lost, assembler.refused),
            #[cfg(feature = "h265")]
            Self::H265(assembler) => (assembler.lost, assembler.refused),
        }
    }

    fn described(&self) -> Option<video::Description> {
        let sequence_set = match self {
            Self::Jpeg(_) => None,
            Self::H264(assembler) => assembler.sequence_set(),
            #[cfg(feature = "h265")]
            Self::H265(assembler) => assembler.sequence_set(),
        };
        video::describe(self.coding(), sequence_set?)
    }
}

/// The thread's part.
struct Reader {
    settings: CameraSettings,
    login: Arc<Mutex<Login>>,
    stream: Arc<Mutex<Stream>>,
}

impl Reader {
    /// Reads the stream into the slot until it ends, and says why it did.
    fn read(&self, latest: &Latest<Unit>) -> Fault {
        let mut login = locked(&self.login);
        let (mut session, described) = match Session::play(&self.settings, &mut login) {
            Ok(playing) => playing,
            Err(fault) => return fault,
        };
        let mut assembler = Assembler::new(&described);
        {
            let mut stream = locked(&self.stream);
            let (lost, refused) = (stream.lost, stream.refused);
            *stream = Stream { lost, refused, login: login.scheme(), ..Stream::default() };
            assembler.coding().name().clone_into(&mut stream.codec);
            stream.since = Some(Instant::now());
        }
        let fault = self.play(&mut session, &mut login, &mut assembler, latest);
        session.end(&mut login);
        fault
    }

    fn play(
        &self,
        session: &mut Session,
        login: &mut Login,
        assembler: &mut Assembler,
        latest: &Latest<Unit>,
    ) -> Fault {
        let (mut unit, mut every, mut bad) = (Unit::default(), Every::default(), 0);
        let (lost_before, refused_before) = {
            let stream = locked(&self.stream);
            (stream.lost, stream.refused)
        };
        let mut last_packet = Instant::now();
        let mut is_described = false;
        while !latest.is_left() {
            match session.next(login, self.settings.timeout) {
                Ok(Event::Packet) => last_packet = Instant::now(),
                Ok(Event::Quiet) if last_packet.elapsed() >= self.settings.timeout => {
                    return Fault::Timeout { what: "packet", waited: self.settings.timeout };
                }
                Ok(Event::Quiet) => continue,
                Err(fault) => return fault,
            }
            let Some(packet) = Packet::parse(session.packet()) else {
                bad += 1;
                if bad > MOST_BAD_PACKETS {
                    let begins = "packets that are not RTP".to_owned();
                    return Fault::Protocol { protocol: "RTP", begins };
                }
                continue;
            };
            bad = 0;
            let is_whole = assembler.push(&packet, &mut unit);
            let (lost, refused) = assembler.counts();
            let mut stream = locked(&self.stream);
            (stream.lost, stream.refused) =
                (lost_before + lost, refused_before + refused + every.refused);
            if !is_whole {
                continue;
            }
            if !is_described && let Some(described) = assembler.described() {
                is_described = true;
                stream.codec = format!("{} {}", assembler.coding().name(), described.profile);
                stream.size = Some(described.size);
            }
            stream.pictures += 1;
            if unit.key {
                stream.keys += 1;
                let now = Instant::now();
                let before = stream.last_key.replace(now);
                stream.key_interval = before.map(|before| now - before).or(stream.key_interval);
            }
            drop(stream);
            if self.settings.every_picture && unit.coding != Coding::Jpeg {
                if every.decode(&mut unit, self.settings.shape()) {
                    latest.put(&mut unit);
                }
            } else if unit.key {
                latest.put(&mut unit);
            }
        }
        Fault::Ended("the stream was left".to_owned())
    }
}

/// Decodes every picture, from a key picture on to the first that is damaged.
#[derive(Default)]
struct Every {
    video: Option<Video>,
    refused: u64,
}

impl Every {
    fn decode(&mut self, unit: &mut Unit, shape: Option<Shape>) -> bool {
        if unit.key && self.video.is_none() {
            self.video = Some(Video::every(unit.coding));
        }
        let Some(video) = &mut self.video else { return false };
        let mut picture = unit.picture.take().unwrap_or_default();
        let decoded = video.decode(&unit.bytes, shape, &mut picture);
        if decoded.is_err() {
            // Later pictures build on it.
            self.refused += 1;
            self.video = None;
            return false;
        }
        unit.picture = Some(picture);
        true
    }
}
