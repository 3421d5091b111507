//! Board: any computer with Linux, macOS or the like; no lamp, relay or watchdog.
//!
//! For development, the demo, and boxes that are supervised from outside.

use std::process::ExitCode;
use verge::hal::Board;

/// The board of an ordinary computer: a camera and no parts of its own.
type Host = Board;

fn main() -> ExitCode {
    verge::daemon::main(Host::default())
}
