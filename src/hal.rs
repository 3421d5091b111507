//! Optional parts of a board: a lamp, a relay, a watchdog, a thermometer.
//!
//! Owns the traits that the daemon drives and their adapters over `embedded-hal`. `()` is
//! the part that a board lacks. Knows no board and no operating system.

use embedded_hal::digital::{OutputPin, PinState};

/// Something that is on or off: the status lamp, the camera's power relay.
pub trait Switch {
    /// Error of the hardware.
    type Error: core::fmt::Debug;
    /// Turns it on or off.
    ///
    /// # Errors
    /// The pin's own.
    fn set(&mut self, on: bool) -> Result<(), Self::Error>;
}

/// A timer that resets the box unless it is fed.
pub trait Watchdog {
    /// Error of the hardware.
    type Error: core::fmt::Debug;
    /// Starts the count, or starts it again.
    ///
    /// # Errors
    /// The device's own.
    fn feed(&mut self) -> Result<(), Self::Error>;
    /// Stops the count, where the program ends on purpose.
    ///
    /// # Errors
    /// The device's own.
    fn disarm(&mut self) -> Result<(), Self::Error>;
}

/// Temperature inside the enclosure.
pub trait Thermometer {
    /// Error of the hardware.
    type Error: core::fmt::Debug;
    /// The temperature in degrees Celsius, `None` where there is no sensor.
    ///
    /// # Errors
    /// The device's own.
    fn enclosure_c(&mut self) -> Result<Option<f32>, Self::Error>;
}

/// A switch on an output pin, with the polarity that the wiring has.
#[derive(Debug)]
pub struct PinSwitch<P> {
    pin: P,
    on: PinState,
}

impl<P: OutputPin> PinSwitch<P> {
    /// On while the pin is high.
    pub const fn active_high(pin: P) -> Self {
        Self { pin, on: PinState::High }
    }

    /// On while the pin is low.
    pub const fn active_low(pin: P) -> Self {
        Self { pin, on: PinState::Low }
    }
}

impl<P: OutputPin> Switch for PinSwitch<P> {
    type Error = P::Error;

    fn set(&mut self, on: bool) -> Result<(), Self::Error> {
        self.pin.set_state(if on { self.on } else { !self.on })
    }
}

impl Switch for () {
    type Error = core::convert::Infallible;
    fn set(&mut self, _on: bool) -> Result<(), Self::Error> {
        Ok(())
    }
}

impl Watchdog for () {
    type Error = core::convert::Infallible;
    fn feed(&mut self) -> Result<(), Self::Error> {
        Ok(())
    }
    fn disarm(&mut self) -> Result<(), Self::Error> {
        Ok(())
    }
}

impl Thermometer for () {
    type Error = core::convert::Infallible;
    fn enclosure_c(&mut self) -> Result<Option<f32>, Self::Error> {
        Ok(None)
    }
}

/// The parts of one board.
#[derive(Debug, Default)]
pub struct Board<Led = (), Relay = (), Dog = (), Temperature = ()> {
    /// Lit while the sensor measures.
    pub status_led: Led,
    /// Power of the camera.
    pub camera_power: Relay,
    /// The hardware watchdog.
    pub watchdog: Dog,
    /// The enclosure's thermometer.
    pub thermometer: Temperature,
}

#[cfg(test)]
mod tests {
    use super::*;
    use embedded_hal::digital::{Error, ErrorKind, ErrorType};

    /// A pin that remembers its level and can be made to fail.
    #[derive(Debug)]
    struct MockPin {
        high: bool,
        broken: bool,
    }

    #[derive(Debug, PartialEq)]
    struct Broken;
    impl Error for Broken {
        fn kind(&self) -> ErrorKind {
            ErrorKind::Other
        }
    }
    impl ErrorType for MockPin {
        type Error = Broken;
    }
    impl OutputPin for MockPin {
        fn set_low(&mut self) -> Result<(), Broken> {
            self.high = false;
            if self.broken { Err(Broken) } else { Ok(()) }
        }
        fn set_high(&mut self) -> Result<(), Broken> {
            self.high = true;
            if self.broken { Err(Broken) } else { Ok(()) }
        }
    }

    #[test]
    fn polarity_is_the_wirings() {
        let mut high = PinSwitch::active_high(MockPin { high: false, broken: false });
        high.set(true).expect("a whole pin");
        assert!(high.pin.high);
        let mut low = PinSwitch::active_low(MockPin { high: false, broken: false });
        low.set(true).expect("a whole pin");
        assert!(!low.pin.high);
        low.set(false).expect("a whole pin");
        assert!(low.pin.high);
    }

    #[test]
    fn a_broken_pin_says_so() {
        let mut switch = PinSwitch::active_high(MockPin { high: false, broken: true });
        assert_eq!(switch.set(true), Err(Broken));
    }
}
