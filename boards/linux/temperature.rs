//! Thermometers: a sensor on I2C, or one that a driver of the kernel reads.
//!
//! Owns how they are found and read. Whether a reading can be true is the core's business.

use linux_embedded_hal::i2cdev::core::I2CDevice;
use linux_embedded_hal::i2cdev::linux::LinuxI2CDevice;
use std::fs;
use std::path::{Path, PathBuf};
use verge::hal::Thermometer;

/// Temperature register of LM75, TMP102 and their kin.
const TEMPERATURE: u8 = 0x00;

/// LM75, TMP102 or a sensor like them on an I2C bus, read with SMBus words.
pub struct Lm75 {
    bus: &'static str,
    address: u16,
    device: Option<LinuxI2CDevice>,
}

impl Lm75 {
    /// The sensor at `address` of the bus with this device node.
    pub const fn new(bus: &'static str, address: u16) -> Self {
        Self { bus, address, device: None }
    }
}

impl Thermometer for Lm75 {
    type Error = String;

    fn enclosure_c(&mut self) -> Result<Option<f32>, String> {
        let Self { bus, address, .. } = *self;
        let at = |error: &dyn std::fmt::Display| format!("{bus} at {address:#04x}: {error}");
        let device = match &mut self.device {
            Some(device) => device,
            closed => closed.insert(LinuxI2CDevice::new(bus, address).map_err(|e| at(&e))?),
        };
        let word = device.smbus_read_word_data(TEMPERATURE).map_err(|e| {
            let error = at(&e);
            self.device = None;
            error
        })?;
        Ok(Some(celsius(word)))
    }
}

/// LM75 sends the high byte first, SMBus takes the low one first; in the sensor's order the
/// word is a signed number of 1/256 degrees, of which nine to twelve bits are used.
fn celsius(smbus_word: u16) -> f32 {
    f32::from(i16::from_be_bytes(smbus_word.to_le_bytes())) / 256.0
}

/// A sensor of the kernel's hwmon class, found by its driver's name.
pub struct Hwmon {
    name: &'static str,
    class: PathBuf,
    input: Option<PathBuf>,
}

impl Hwmon {
    /// The first sensor whose driver has this name (`cat /sys/class/hwmon/*/name`).
    pub fn named(name: &'static str) -> Self {
        Self::within(Path::new("/sys/class/hwmon"), name)
    }

    /// The same in another folder.
    pub fn within(class: &Path, name: &'static str) -> Self {
        Self { name, class: class.to_owned(), input: None }
    }

    fn find(&self) -> Result<PathBuf, String> {
        let none = || format!("no hwmon sensor is named {}", self.name);
        let entries = fs::read_dir(&self.class).map_err(|_| none())?;
        entries
            .filter_map(Result::ok)
            .map(|entry| entry.path())
            .find(|path| fs::read_to_string(path.join("name")).is_ok_and(|n| n.trim() == self.name))
            .map(|path| path.join("temp1_input"))
            .ok_or_else(none)
    }
}

impl Thermometer for Hwmon {
    type Error = String;

    fn enclosure_c(&mut self) -> Result<Option<f32>, String> {
        let path = match &self.input {
            Some(path) => path.clone(),
            None => self.find()?,
        };
        let at = |error: &dyn std::fmt::Display| format!("{}: {error}", path.display());
        // A sensor that fails may have come back under another number.
        self.input = None;
        let text = fs::read_to_string(&path).map_err(|e| at(&e))?;
        let thousandths: i32 = text.trim().parse().map_err(|e| at(&e))?;
        self.input = Some(path);
        Ok(Some(thousandths as f32 / 1000.0))
    }
}

#[cfg(test)]
mod tests {
    use super::celsius;

    /// LM75B datasheet (NXP), table 10, as SMBus swaps it; and the extremes of TMP102.
    #[test]
    fn words_of_the_datasheet() {
        for (word, expected) in [
            (0x0000, 0.0),
            (0x8019, 25.5),
            (0x007f, 127.0),
            (0x20ff, -0.875),
            (0x00e7, -25.0),
            (0x00c9, -55.0),
        ] {
            assert_eq!(celsius(word), expected, "{word:#06x}");
        }
    }
}
