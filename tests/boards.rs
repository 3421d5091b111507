//! The adapters of the boards on this machine, which lacks most of their parts: each says
//! what is missing, and what can be stood in for by files works.
#![cfg(target_os = "linux")]

mod common;
#[path = "../boards/linux/mod.rs"]
mod linux;

use linux::gpio::Line;
use linux::temperature::{Hwmon, Lm75};
use linux::watchdog::DevWatchdog;
use std::fs;
use verge::hal::{PinSwitch, Switch, Thermometer, Watchdog};

#[test]
fn parts_that_are_not_there_are_named_and_asked_again() {
    let mut led = PinSwitch::active_high(Line::named("NO_SUCH_LINE"));
    let mut sensor = Lm75::new("/dev/i2c-none", 0x48);
    let mut dog = DevWatchdog::new("/dev/watchdog-none", 60);
    let mut hwmon = Hwmon::named("no such driver");
    for _ in 0..2 {
        let said = format!("{:?}", led.set(true).expect_err("no line"));
        assert!(said.contains("NO_SUCH_LINE"), "{said}");
        let said = sensor.enclosure_c().expect_err("no bus");
        assert!(said.contains("/dev/i2c-none at 0x48"), "{said}");
        let said = dog.feed().expect_err("no watchdog");
        assert!(said.contains("/dev/watchdog-none"), "{said}");
        let said = hwmon.enclosure_c().expect_err("no sensor");
        assert!(said.contains("no such driver"), "{said}");
    }
    assert_eq!(dog.disarm(), Ok(()), "what never counted need not be stopped");
}

#[test]
fn a_thermometer_of_the_kernel_is_found_by_name_and_found_again() {
    let class = common::folder();
    let sensor = |number: u8, name: &str, thousandths: &str| {
        let folder = class.path().join(format!("hwmon{number}"));
        fs::create_dir_all(&folder).expect("a folder");
        fs::write(folder.join("name"), format!("{name}\n")).expect("a name");
        fs::write(folder.join("temp1_input"), thousandths).expect("a reading");
    };
    sensor(0, "coretemp", "90000\n");
    sensor(1, "lm75", "-25500\n");
    let mut lm75 = Hwmon::within(class.path(), "lm75");
    assert_eq!(lm75.enclosure_c(), Ok(Some(-25.5)));
    sensor(1, "lm75", "rubbish\n");
    let said = lm75.enclosure_c().expect_err("no number");
    assert!(said.contains("hwmon1"), "{said}");
    fs::remove_dir_all(class.path().join("hwmon1")).expect("it goes");
    assert!(lm75.enclosure_c().is_err(), "it is gone");
    sensor(7, "lm75", "41500\n");
    assert_eq!(lm75.enclosure_c(), Ok(Some(41.5)), "it is back under another number");
}
