//! Board: an x86 industrial PC with digital outputs, a watchdog on its chip set and a board
//! thermometer that the kernel has a driver for.
//!
//! Digital outputs have no names of their own on such boards: give them these, with
//! `gpio-line-names` in firmware or a `gpio-aggregator`. The relay's normally-closed contact
//! feeds the camera, so that it has power without the daemon.

#[path = "linux/mod.rs"]
mod linux;

use linux::gpio::Line;
use linux::temperature::Hwmon;
use linux::watchdog::DevWatchdog;
use std::process::ExitCode;
use verge::hal::{Board, PinSwitch};

/// Digital output to the lamp.
const STATUS_LED: &str = "STATUS_LED";
/// Digital output to the relay.
const CAMERA_POWER: &str = "CAMERA_POWER";
/// The board's thermometer, by its driver.
const THERMOMETER: &str = "lm75";
/// `iTCO_wdt`, `i6300esb` or a super-I/O's.
const WATCHDOG: &str = "/dev/watchdog0";
/// Twice the service manager's 30 s: it restarts the daemon first.
const WATCHDOG_S: i32 = 60;

type X86Industrial = Board<PinSwitch<Line>, PinSwitch<Line>, DevWatchdog, Hwmon>;

fn main() -> ExitCode {
    verge::daemon::main(X86Industrial {
        status_led: PinSwitch::active_high(Line::named(STATUS_LED)),
        camera_power: PinSwitch::active_high(Line::named(CAMERA_POWER)),
        watchdog: DevWatchdog::new(WATCHDOG, WATCHDOG_S),
        thermometer: Hwmon::named(THERMOMETER),
    })
}
