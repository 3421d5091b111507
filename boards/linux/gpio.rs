//! An output line of the kernel's GPIO character devices, found by its name.
//!
//! Owns the search and the request. Names are the device tree's or the firmware's
//! (`gpioinfo` lists them): a chip's number depends on the order in which drivers start, a
//! line's name does not.

use embedded_hal::digital::{ErrorKind, ErrorType, OutputPin};
use linux_embedded_hal::CdevPin;
use linux_embedded_hal::gpio_cdev::{self, LineRequestFlags};
use std::fmt;

/// Who holds the line, in `gpioinfo`.
const CONSUMER: &str = "verge";

/// An output line; it is requested when it is first set.
pub struct Line {
    name: &'static str,
    pin: Option<CdevPin>,
}

/// Why a line cannot be set.
pub enum LineError {
    /// No chip has a line of that name.
    NotFound(&'static str),
    /// The kernel refuses.
    Kernel {
        /// The line.
        name: &'static str,
        /// The system's reason.
        reason: String,
    },
}

impl fmt::Debug for LineError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NotFound(name) => write!(f, "no GPIO line is named {name}; see gpioinfo"),
            Self::Kernel { name, reason } => write!(f, "GPIO line {name}: {reason}"),
        }
    }
}

impl embedded_hal::digital::Error for LineError {
    fn kind(&self) -> ErrorKind {
        ErrorKind::Other
    }
}

impl Line {
    /// The line of that name on whichever chip has it.
    pub const fn named(name: &'static str) -> Self {
        Self { name, pin: None }
    }

    fn set(&mut self, high: bool) -> Result<(), LineError> {
        let kernel = |error: &dyn fmt::Display| LineError::Kernel {
            name: self.name,
            reason: error.to_string(),
        };
        let Some(pin) = &mut self.pin else {
            let line = find(self.name)?;
            // Requested at the level that is wanted: a relay must not click in between.
            let handle = line
                .request(LineRequestFlags::OUTPUT, u8::from(high), CONSUMER)
                .map_err(|e| kernel(&e))?;
            self.pin = Some(CdevPin::new(handle).map_err(|e| kernel(&e))?);
            return Ok(());
        };
        let outcome = if high { pin.set_high() } else { pin.set_low() };
        outcome.map_err(|error| {
            let error = kernel(&error);
            self.pin = None;
            error
        })
    }
}

fn find(name: &'static str) -> Result<gpio_cdev::Line, LineError> {
    let kernel = |error: gpio_cdev::Error| LineError::Kernel { name, reason: error.to_string() };
    for chip in gpio_cdev::chips().map_err(kernel)? {
        // A chip that cannot be opened may not be the one.
        let Ok(chip) = chip else { continue };
        for line in chip.lines() {
            if line.info().is_ok_and(|info| info.name() == Some(name)) {
                return Ok(line);
            }
        }
    }
    Err(LineError::NotFound(name))
}

impl ErrorType for Line {
    type Error = LineError;
}

impl OutputPin for Line {
    fn set_low(&mut self) -> Result<(), LineError> {
        self.set(false)
    }

    fn set_high(&mut self) -> Result<(), LineError> {
        self.set(true)
    }
}
