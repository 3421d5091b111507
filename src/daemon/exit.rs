//! How the program ends: every failure of a command, with its sysexits code.
//!
//! Owns the mapping from errors to exit codes (`sysexits.h`), so that a supervisor can tell
//! a wrong file from a missing one without reading the message.

use super::audit::{AnswersError, FitError, LEAST_FRAMES, SiteError};
use super::capture::{CaptureError, DeviceError, RecordingError, SourceError};
use super::config::ConfigError;
use super::detect::{DetectError, ModelError, SidecarError};
use super::disk;
use super::locate::LocateError;
use super::output::WriteError;
use super::publish::TlsError;
use super::spool::SpoolError;
use crate::density::AggregateError;
use std::borrow::Cow;
use std::path::PathBuf;
use verge_desk::Exit;
use verge_desk::sysexits::{CANTCREAT, CONFIG, DATAERR, NOINPUT, SOFTWARE, UNAVAILABLE, USAGE};

/// Why a command failed.
#[derive(Debug, thiserror::Error)]
pub enum Failure {
    /// The configuration.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// The recording.
    #[error(transparent)]
    Recording(#[from] RecordingError),
    /// A picture or the camera.
    #[error(transparent)]
    Capture(#[from] CaptureError),
    /// The camera's device.
    #[error(transparent)]
    Device(#[from] DeviceError),
    /// The model.
    #[error(transparent)]
    Model(#[from] ModelError),
    /// Inference.
    #[error(transparent)]
    Detect(#[from] DetectError),
    /// The lane table.
    #[error(transparent)]
    Locate(#[from] LocateError),
    /// The site's own file.
    #[error(transparent)]
    Site(#[from] SiteError),
    /// Counts by people.
    #[error(transparent)]
    Answers(#[from] AnswersError),
    /// Counts that contradict what is seen, or are too few.
    #[error("the answers cannot be used: {0}")]
    Audit(#[from] FitError),
    /// A recording with too few frames for an audit.
    #[error(
        "{}: {measured} frames can be measured, and an audit takes {LEAST_FRAMES} at least: record more",
        frames.display()
    )]
    FewToCount {
        /// The recording.
        frames: PathBuf,
        /// Frames that can be measured.
        measured: usize,
    },
    /// The model does not say how cameras differ.
    #[error(
        "the model says no counting error of its own ([counting] in its sidecar), from which an \
         audit starts"
    )]
    NoCounting,
    /// The certificates.
    #[error(transparent)]
    Tls(#[from] TlsError),
    /// The spool.
    #[error(transparent)]
    Spool(#[from] SpoolError),
    /// The windows.
    #[error(transparent)]
    Aggregate(#[from] AggregateError),
    /// A picture that came is not fit to be measured.
    #[error("no density from this picture: {reason} ({status}); {hint}")]
    Withheld {
        /// The alarm that it would raise.
        reason: &'static str,
        /// The status that windows would have.
        status: &'static str,
        /// Advice.
        hint: Cow<'static, str>,
    },
    /// The camera's aim is not checked.
    #[error(
        "there is nothing to aim by: the lane table has no reference of the scene (make it with \
         `mvcalib table --reference FRAMES`), or camera.watch is false"
    )]
    NothingToAimBy,
    /// Pictures come so seldom that windows would have no density.
    #[error("{0}")]
    Pace(String),
    /// Every single picture of a recording failed.
    #[error("none of the {frames} frames could be measured; the first fault: {first}")]
    NothingMeasured {
        /// Frames in the recording.
        frames: usize,
        /// The first fault.
        first: String,
    },
    /// An output file, or a place that the daemon must write to.
    #[error("cannot write {}: {}", path.display(), disk::unwritten(source))]
    Write {
        /// The file.
        path: PathBuf,
        /// The system's error.
        source: std::io::Error,
    },
    /// An input file that cannot be read.
    #[error("cannot read {}: {}", path.display(), disk::unread(source))]
    Input {
        /// The file.
        path: PathBuf,
        /// The system's error.
        source: std::io::Error,
    },
    /// An input file in a form that is not read.
    #[error("{}: it is {what}", path.display())]
    InputForm {
        /// The file.
        path: PathBuf,
        /// The fault, and what to do.
        what: &'static str,
    },
    /// Messages that could not be converted.
    #[error("{bad} of {count} messages are left out; the others are converted")]
    Messages {
        /// Messages that could not be read, or that lack what the format asks for.
        bad: usize,
        /// All messages.
        count: usize,
    },
    /// The broker.
    #[error("broker {host}:{port}: {reason}")]
    Broker {
        /// Host name or address.
        host: String,
        /// Port.
        port: u16,
        /// The reason.
        reason: String,
    },
    /// Checks that did not pass.
    #[error("{failed} of {checks} checks failed")]
    Checks {
        /// Checks that failed.
        failed: usize,
        /// All checks.
        checks: usize,
        /// Exit code of the first that failed.
        code: u8,
    },
    /// The files of the recording that is played when none is named are not there.
    #[error("{needed_by} needs {what}: {hint}")]
    DemoFiles {
        /// Who needs them.
        needed_by: &'static str,
        /// The missing part.
        what: String,
        /// Advice.
        hint: &'static str,
    },
    /// The comparison with ONNX Runtime could not be made.
    #[error(
        "ONNX Runtime cannot be run: {0}; the comparison needs python3 with the packages \
         onnxruntime and numpy (pip install onnxruntime numpy)"
    )]
    OnnxRuntime(String),
    /// A serial line.
    #[error(
        "serial line {}: {}; is the node connected and powered, are device and baud right, \
         and does no other program (verge run) hold the line?",
        device.display(), disk::unread(source)
    )]
    Serial {
        /// The device.
        device: PathBuf,
        /// The system's error.
        source: std::io::Error,
    },
    /// Settings that an I/O node cannot work by.
    #[error("node settings{}: {reason}", path.as_ref().map_or(String::new(), |path| format!(" {}", path.display())))]
    NodeSettings {
        /// The file; `None` where the node itself refused.
        path: Option<PathBuf>,
        /// The fault.
        reason: String,
    },
    /// Values of the command line that do not fit what they are for.
    #[error("{0}")]
    Usage(String),
    /// A fault in the words of a command that reads no configuration.
    #[error("{reason}")]
    Reworded {
        /// The fault.
        reason: String,
        /// Its exit code.
        code: u8,
    },
    /// A port of loopback for a page.
    #[error("{0}")]
    Page(String),
    /// A stage panicked.
    #[error("a fault of the program, please report it: {0}")]
    Stage(String),
    /// A part of the demo or the benchmark did not do its work.
    #[error("{0}")]
    Internal(String),
}

impl Failure {
    /// No picture came; one that cannot be measured is another failure.
    pub fn is_missing_picture(&self) -> bool {
        matches!(self, Self::Capture(fault) if !fault.is_damage())
    }

    /// What it says of whichever picture of a recording has it: without the picture's name.
    pub fn of_any_picture(&self) -> String {
        match self {
            Self::Capture(CaptureError::Read { source, .. }) => disk::unread(source).to_string(),
            Self::Capture(CaptureError::Decode { source, .. }) => source.to_string(),
            other => other.to_string(),
        }
    }
}

impl Exit for Failure {
    fn exit_code(&self) -> u8 {
        match self {
            Self::Config(ConfigError::Read { source, .. }) => unread(source, CONFIG),
            Self::Config(_) | Self::Aggregate(_) => CONFIG,
            Self::Recording(RecordingError::Interval(_)) => CONFIG,
            Self::Recording(_) | Self::DemoFiles { .. } => NOINPUT,
            Self::Capture(CaptureError::Read { .. }) => NOINPUT,
            Self::Capture(CaptureError::Decode { .. }) => DATAERR,
            Self::NothingMeasured { .. } | Self::Withheld { .. } | Self::Pace(_) => DATAERR,
            Self::NothingToAimBy => CONFIG,
            Self::Device(DeviceError::NotBuilt { .. }) => CONFIG,
            Self::Capture(_) => UNAVAILABLE,
            Self::Device(_) | Self::OnnxRuntime(_) | Self::Page(_) => UNAVAILABLE,
            Self::Broker { .. } | Self::Serial { .. } => UNAVAILABLE,
            Self::Tls(TlsError::Read { .. }) | Self::Model(ModelError::Read { .. }) => NOINPUT,
            Self::Model(ModelError::Sidecar(SidecarError::Read { source, .. })) => {
                unread(source, DATAERR)
            }
            Self::Model(_) => DATAERR,
            Self::Locate(LocateError::Read { .. }) => NOINPUT,
            Self::Locate(_) | Self::Tls(_) => DATAERR,
            Self::Input { source, .. }
            | Self::Site(SiteError::Read { source, .. })
            | Self::Answers(AnswersError::Read { source, .. }) => unread(source, DATAERR),
            Self::Site(_) | Self::Answers(_) | Self::Audit(_) => DATAERR,
            Self::FewToCount { .. } | Self::NoCounting => DATAERR,
            Self::Messages { .. } | Self::NodeSettings { .. } => DATAERR,
            Self::InputForm { .. } => DATAERR,
            Self::Spool(SpoolError::Version(_)) => DATAERR,
            Self::Write { .. } | Self::Spool(_) => CANTCREAT,
            Self::Usage(_) => USAGE,
            Self::Checks { code, .. } | Self::Reworded { code, .. } => *code,
            Self::Detect(_) | Self::Stage(_) | Self::Internal(_) => SOFTWARE,
        }
    }
}

/// A file that is there and no text is as wrong as its content could be.
fn unread(source: &std::io::Error, wrong: u8) -> u8 {
    if source.kind() == std::io::ErrorKind::InvalidData { wrong } else { NOINPUT }
}

impl From<WriteError> for Failure {
    fn from(WriteError { path, source }: WriteError) -> Self {
        Self::Write { path, source }
    }
}

impl From<SourceError> for Failure {
    fn from(error: SourceError) -> Self {
        match error {
            SourceError::Recording(error) => error.into(),
            SourceError::Device(error) => error.into(),
        }
    }
}
