//! Why a command of the centre failed: what all programs fail at, and the services it needs.

use verge_desk::Exit;
use verge_desk::sysexits::UNAVAILABLE;

/// Why a command failed: what, where, what to do.
#[derive(Debug, thiserror::Error)]
pub enum Failure {
    /// Arguments, files, standard output.
    #[error(transparent)]
    Desk(#[from] verge_desk::Failure),
    /// A broker that cannot be reached, or that refuses.
    #[error("broker {address}: {reason}; is it running, and are name and password right?")]
    Broker {
        /// Host and port.
        address: String,
        /// The reason.
        reason: String,
    },
    /// A cluster that cannot be reached, or that failed.
    #[error(
        "cluster {address}: {reason}; do its scheduler and executors run, in this program's \
         version of Ballista, and do they read the archive under the same path?"
    )]
    Cluster {
        /// Host and port of its scheduler.
        address: String,
        /// The reason.
        reason: String,
    },
}

impl Failure {
    /// Arguments that contradict each other or make no sense.
    pub fn usage(reason: impl Into<String>) -> Self {
        verge_desk::Failure::Usage(reason.into()).into()
    }
}

impl Exit for Failure {
    fn exit_code(&self) -> u8 {
        match self {
            Self::Desk(failure) => failure.exit_code(),
            Self::Broker { .. } | Self::Cluster { .. } => UNAVAILABLE,
        }
    }
}
