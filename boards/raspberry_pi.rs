//! Board: Raspberry Pi 4 or 5 with Raspberry Pi OS, camera on USB or Ethernet.
//!
//! Wiring: status LED with its resistor at pin 11, a relay board that is on at low level
//! and whose normally-closed contact feeds the camera at pin 13 (so that the camera has
//! power without the daemon), LM75 or TMP102 at pins 3 and 5 (`dtparam=i2c_arm=on`).

#[path = "linux/mod.rs"]
mod linux;

use linux::gpio::Line;
use linux::temperature::Lm75;
use linux::watchdog::DevWatchdog;
use std::process::ExitCode;
use verge::hal::{Board, PinSwitch};

/// Pin 11. Lines have these names on the 4 (BCM2711) and on the 5 (RP1).
const STATUS_LED: &str = "GPIO17";
/// Pin 13.
const CAMERA_POWER: &str = "GPIO27";
/// Pins 3 and 5.
const I2C_BUS: &str = "/dev/i2c-1";
/// A0 to A2 of the sensor at ground.
const LM75_ADDRESS: u16 = 0x48;
/// `bcm2835_wdt`.
const WATCHDOG: &str = "/dev/watchdog0";
/// The longest that bcm2835_wdt counts is 15 s (20 bits of 1/65536 s).
const WATCHDOG_S: i32 = 15;

type RaspberryPi = Board<PinSwitch<Line>, PinSwitch<Line>, DevWatchdog, Lm75>;

fn main() -> ExitCode {
    verge::daemon::main(RaspberryPi {
        status_led: PinSwitch::active_high(Line::named(STATUS_LED)),
        // The contact is closed while the relay is off.
        camera_power: PinSwitch::active_high(Line::named(CAMERA_POWER)),
        watchdog: DevWatchdog::new(WATCHDOG, WATCHDOG_S),
        thermometer: Lm75::new(I2C_BUS, LM75_ADDRESS),
    })
}
