//! The board's parts in the running daemon: what is driven, read and fed, and what fails.
//!
//! Owns how the line goes on when a part fails: it is asked less often, its failures are
//! counted, and the first is logged. Decides nothing about pictures; what to drive comes in
//! as [`Actions`].

use crate::derate::{Derating, Pace};
use crate::fault::{Change, Part};
use crate::hal::{Board, Switch, Thermometer, Watchdog};
use crate::health::Actions;
use std::fmt::Debug;
use std::time::Duration;

/// Time between two readings of the thermometer: an enclosure is slow.
const READ_INTERVAL: Duration = Duration::from_secs(5);
/// A watchdog that cannot be fed is tried again this soon: it may be counting.
const FEED_AGAIN: Duration = Duration::from_secs(1);

/// Failures of each part since start.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Faults {
    /// Of the status lamp.
    pub status_led: u64,
    /// Of the camera's relay.
    pub camera_power: u64,
    /// Of the watchdog.
    pub watchdog: u64,
    /// Of the thermometer, unbelievable readings included.
    pub thermometer: u64,
}

/// A board that is being driven.
#[derive(Debug)]
pub struct Driven<L, R, W, T> {
    board: Board<L, R, W, T>,
    led: Part,
    relay: Part,
    dog: Part,
    thermometer: Part,
    derating: Derating,
    next_reading: Duration,
    last_fault: Option<String>,
}

impl<L: Switch, R: Switch, W: Watchdog, T: Thermometer> Driven<L, R, W, T> {
    /// Drives `board`.
    pub fn new(board: Board<L, R, W, T>) -> Self {
        Self {
            board,
            led: Part::default(),
            relay: Part::default(),
            dog: Part::asked_within(FEED_AGAIN),
            thermometer: Part::default(),
            derating: Derating::default(),
            next_reading: Duration::ZERO,
            last_fault: None,
        }
    }

    /// Reads the thermometer where it is time, and returns the pace that its latest
    /// reading allows.
    pub fn pace(&mut self, now: Duration) -> Pace {
        if now >= self.next_reading && self.thermometer.is_due(now) {
            self.next_reading = now + READ_INTERVAL;
            let outcome = match self.board.thermometer.enclosure_c() {
                Ok(reading) => self.derating.take(reading).map(drop).map_err(|unbelievable| {
                    format!("{:.1} degrees Celsius cannot be true", unbelievable.read_c)
                }),
                Err(error) => Err(words(&error)),
            };
            if outcome.is_err() && self.thermometer.is_broken() {
                self.derating.lose();
            }
            note("thermometer", &mut self.thermometer, outcome, now, &mut self.last_fault);
        }
        self.derating.pace()
    }

    /// Sets lamp and relay.
    pub fn drive(&mut self, actions: Actions, now: Duration) {
        let Self { board, led, relay, last_fault, .. } = self;
        if led.is_due(now) {
            let outcome = said(board.status_led.set(actions.led_on));
            note("status lamp", led, outcome, now, last_fault);
        }
        if relay.is_due(now) {
            let outcome = said(board.camera_power.set(actions.camera_power_on));
            note("camera power", relay, outcome, now, last_fault);
        }
    }

    /// Feeds the watchdog. To be called at the end of the line and nowhere else.
    pub fn feed(&mut self, now: Duration) {
        if self.dog.is_due(now) {
            let outcome = said(self.board.watchdog.feed());
            note("watchdog", &mut self.dog, outcome, now, &mut self.last_fault);
        }
    }

    /// The program ends on purpose: the lamp goes out, the camera keeps its power, and the
    /// watchdog must not reset the box.
    pub fn stop(&mut self) {
        if let Err(error) = self.board.watchdog.disarm() {
            log::error!("watchdog: {}; the box will be reset", words(&error));
        }
        let _ = self.board.status_led.set(false);
        let _ = self.board.camera_power.set(true);
    }

    /// Failures since start.
    pub fn faults(&self) -> Faults {
        Faults {
            status_led: self.led.faults(),
            camera_power: self.relay.faults(),
            watchdog: self.dog.faults(),
            thermometer: self.thermometer.faults(),
        }
    }

    /// Whether a part does not work now.
    pub fn is_broken(&self) -> bool {
        [self.led, self.relay, self.dog, self.thermometer].iter().any(Part::is_broken)
    }

    /// The latest failure, while a part does not work.
    pub fn last_fault(&self) -> Option<&str> {
        self.last_fault.as_deref().filter(|_| self.is_broken())
    }

    /// The latest believable temperature, degrees Celsius.
    pub fn enclosure_c(&self) -> Option<f32> {
        self.derating.latest_c()
    }
}

fn said<E: Debug>(outcome: Result<(), E>) -> Result<(), String> {
    outcome.map_err(|error| words(&error))
}

/// A part's fault in words. `embedded-hal` asks errors for `Debug` alone: a text comes quoted by it, a
/// number of the system behind it.
fn words(error: &impl Debug) -> String {
    let said = format!("{error:?}");
    let text = said.strip_prefix('"').and_then(|rest| rest.strip_suffix('"')).unwrap_or(&said);
    text.split(" (os error").next().unwrap_or_default().replace("\\\"", "\"")
}

/// Counts an outcome, and says it when it is another than the last.
fn note(
    name: &str,
    part: &mut Part,
    outcome: Result<(), String>,
    now: Duration,
    last_fault: &mut Option<String>,
) {
    let change = part.note(outcome.is_ok(), now);
    if let Err(reason) = outcome {
        let text = format!("{name}: {reason}");
        if change == Change::Broke {
            log::error!("{text}; the measurement goes on");
        }
        *last_fault = Some(text);
    } else if change == Change::Mended {
        log::info!("{name}: works again");
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::density::SampleZoneStatus;
    use crate::hal::PinSwitch;
    use embedded_hal::digital::{ErrorKind, ErrorType, OutputPin};
    use std::cell::Cell;
    use std::rc::Rc;

    /// A part that can be broken from outside, and what reached it.
    #[derive(Clone, Debug, Default)]
    struct Mock {
        broken: Rc<Cell<bool>>,
        asked: Rc<Cell<u32>>,
        value: Rc<Cell<f32>>,
    }

    impl Mock {
        fn outcome(&self) -> Result<(), ErrorKind> {
            self.asked.set(self.asked.get() + 1);
            if self.broken.get() { Err(ErrorKind::Other) } else { Ok(()) }
        }
    }

    impl ErrorType for Mock {
        type Error = ErrorKind;
    }
    impl OutputPin for Mock {
        fn set_low(&mut self) -> Result<(), ErrorKind> {
            self.outcome().inspect(|()| self.value.set(0.0))
        }
        fn set_high(&mut self) -> Result<(), ErrorKind> {
            self.outcome().inspect(|()| self.value.set(1.0))
        }
    }
    impl Watchdog for Mock {
        type Error = ErrorKind;
        fn feed(&mut self) -> Result<(), ErrorKind> {
            self.outcome()
        }
        fn disarm(&mut self) -> Result<(), ErrorKind> {
            self.outcome().inspect(|()| self.value.set(-1.0))
        }
    }
    impl Thermometer for Mock {
        type Error = ErrorKind;
        fn enclosure_c(&mut self) -> Result<Option<f32>, ErrorKind> {
            self.outcome().map(|()| Some(self.value.get()))
        }
    }

    type Mocked = Driven<PinSwitch<Mock>, PinSwitch<Mock>, Mock, Mock>;

    /// A board of mocks: lamp, relay, watchdog, thermometer.
    fn mocked() -> ([Mock; 4], Mocked) {
        let mocks: [Mock; 4] = Default::default();
        let [led, relay, dog, thermometer] = mocks.clone();
        thermometer.value.set(25.0);
        let board = Board {
            status_led: PinSwitch::active_high(led),
            camera_power: PinSwitch::active_low(relay),
            watchdog: dog,
            thermometer,
        };
        (mocks, Driven::new(board))
    }

    const ACTIONS: Actions =
        Actions { status: SampleZoneStatus::Ok, alarm: None, led_on: true, camera_power_on: true };

    fn seconds(n: u64) -> Duration {
        Duration::from_secs(n)
    }

    /// One turn of the loop each second of `time`.
    fn turns(driven: &mut Mocked, time: std::ops::Range<u64>) -> Pace {
        let mut pace = Pace::Full;
        for second in time {
            pace = driven.pace(seconds(second));
            driven.drive(ACTIONS, seconds(second));
            driven.feed(seconds(second));
        }
        pace
    }

    #[test]
    fn a_whole_board_is_driven_read_fed_and_left_safe() {
        let ([led, relay, dog, thermometer], mut driven) = mocked();
        assert_eq!(turns(&mut driven, 0..10), Pace::Full);
        assert_eq!((led.value.get(), relay.value.get()), (1.0, 0.0), "the relay is active low");
        assert_eq!((dog.asked.get(), thermometer.asked.get()), (10, 2));
        assert_eq!((driven.enclosure_c(), driven.is_broken()), (Some(25.0), false));
        driven.stop();
        assert_eq!((led.value.get(), relay.value.get(), dog.value.get()), (0.0, 0.0, -1.0));
        assert_eq!(driven.faults(), Faults::default());
    }

    #[test]
    fn each_part_may_break_and_the_others_go_on() {
        for broken in 0..4 {
            let (mocks, mut driven) = mocked();
            mocks[broken].broken.set(true);
            turns(&mut driven, 0..60);
            let faults = driven.faults();
            let counted =
                [faults.status_led, faults.camera_power, faults.watchdog, faults.thermometer];
            for (part, count) in counted.into_iter().enumerate() {
                assert_eq!(count > 0, part == broken, "{faults:?}");
            }
            // The watchdog each second; the others after 1, 2, 4, ... s.
            assert!(if broken == 2 { counted[2] == 60 } else { counted[broken] < 10 });
            assert!(driven.is_broken() && driven.last_fault().is_some());
            mocks[broken].broken.set(false);
            turns(&mut driven, 60..130);
            assert!(!driven.is_broken() && driven.last_fault().is_none(), "works again");
        }
    }

    #[test]
    fn heat_slows_the_line_and_nonsense_does_not() {
        let ([.., thermometer], mut driven) = mocked();
        turns(&mut driven, 0..10);
        thermometer.value.set(f32::NAN);
        assert_eq!(turns(&mut driven, 10..30), Pace::Full);
        assert!(driven.is_broken());
        assert!(driven.last_fault().is_some_and(|fault| fault.contains("cannot be true")));
        thermometer.value.set(75.0);
        assert_eq!(turns(&mut driven, 30..100), Pace::Half);
        thermometer.value.set(82.0);
        assert_eq!(turns(&mut driven, 100..120), Pace::Stopped);
        thermometer.broken.set(true);
        assert_eq!(turns(&mut driven, 120..150), Pace::Stopped, "unknown is not cool");
        assert_eq!(driven.enclosure_c(), None);
        thermometer.broken.set(false);
        thermometer.value.set(40.0);
        assert_eq!(turns(&mut driven, 150..240), Pace::Full);
    }

    #[test]
    fn a_board_without_parts_has_no_faults() {
        let mut driven = Driven::new(Board::<(), (), (), ()>::default());
        assert_eq!(driven.pace(seconds(0)), Pace::Full);
        driven.drive(ACTIONS, seconds(0));
        driven.feed(seconds(0));
        driven.stop();
        assert_eq!((driven.faults(), driven.enclosure_c()), (Faults::default(), None));
    }
}
