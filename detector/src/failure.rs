//! Why a command of the detector failed: what all programs fail at, and the linear program.

use verge_desk::Exit;
use verge_desk::sysexits::DATAERR;

/// Why a command failed: what, where, what to do.
#[derive(Debug, thiserror::Error)]
pub enum Failure {
    /// Arguments or files.
    #[error(transparent)]
    Desk(#[from] verge_desk::Failure),
    /// A linear program without a solution.
    #[error("no allocation satisfies the constraints: {constraint}; {remedy}")]
    Infeasible {
        /// The constraint that cannot hold.
        constraint: String,
        /// A change that would satisfy it.
        remedy: String,
    },
}

impl Exit for Failure {
    fn exit_code(&self) -> u8 {
        match self {
            Self::Desk(failure) => failure.exit_code(),
            Self::Infeasible { .. } => DATAERR,
        }
    }
}
