//! Board: NVIDIA Jetson Orin Nano or Orin NX on its developer kit's carrier.
//!
//! Wiring on the 40-pin header: status LED with a transistor (the header's pins drive 2 mA)
//! at pin 29, the camera's relay, normally closed, at pin 31, LM75 or TMP102 at pins 3
//! and 5.

#[path = "linux/mod.rs"]
mod linux;

use linux::gpio::Line;
use linux::temperature::Lm75;
use linux::watchdog::DevWatchdog;
use std::process::ExitCode;
use verge::hal::{Board, PinSwitch};

/// Pin 29, `GPIO01`: line PQ.05 of the main controller.
const STATUS_LED: &str = "PQ.05";
/// Pin 31, `GPIO11`: line PQ.06 of the main controller.
const CAMERA_POWER: &str = "PQ.06";
/// Pins 3 and 5.
const I2C_BUS: &str = "/dev/i2c-7";
/// A0 to A2 of the sensor at ground.
const LM75_ADDRESS: u16 = 0x48;
/// `tegra_wdt`.
const WATCHDOG: &str = "/dev/watchdog0";
/// Twice the service manager's 30 s: it restarts the daemon first.
const WATCHDOG_S: i32 = 60;

type Jetson = Board<PinSwitch<Line>, PinSwitch<Line>, DevWatchdog, Lm75>;

fn main() -> ExitCode {
    verge::daemon::main(Jetson {
        status_led: PinSwitch::active_high(Line::named(STATUS_LED)),
        camera_power: PinSwitch::active_high(Line::named(CAMERA_POWER)),
        watchdog: DevWatchdog::new(WATCHDOG, WATCHDOG_S),
        thermometer: Lm75::new(I2C_BUS, LM75_ADDRESS),
    })
}
