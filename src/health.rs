//! Whether the sensor can be believed: picture faults, alarms, and the camera's power.
//!
//! Owns the rules by which faults of pictures become an [`Alarm`]. Reads no clock and drives no pin: it is
//! told the time since start and returns what to do. Judging the picture itself is done in
//! [`crate::picture`] and [`crate::scene`].

use crate::alarm::Alarm;
use crate::density::SampleZoneStatus;
use crate::refresh::Refresh;
use core::time::Duration;

/// A frozen picture is noticed after this time, or after [`PERIODS`] of the camera where
/// those are longer: a camera that has a new picture less often than it is asked is slow, not frozen.
pub const NOTICE: Duration = Duration::from_secs(20);
/// The same for a missing picture: half as long, since the line may wait another ten
/// seconds for the next picture before it can report so. It is reported within twenty.
pub const NOTICE_MISSING: Duration = Duration::from_secs(10);
/// Camera periods without a new picture until it is noticed.
pub const PERIODS: u32 = 3;
/// How long the camera's power stays off in a power cycle: long enough for its supply's
/// capacitors to empty.
pub const POWER_OFF: Duration = Duration::from_secs(10);
/// Wait between a missing picture and the first power cycle; doubles up to
/// [`POWER_CYCLE_MAX`] while it does not help.
pub const POWER_CYCLE_FIRST: Duration = Duration::from_secs(120);
/// Longest wait between two power cycles.
pub const POWER_CYCLE_MAX: Duration = Duration::from_secs(3600);

/// The event of one turn of the line.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Event {
    /// A new picture went through the whole line.
    Measured,
    /// The camera gave the picture that it gave before.
    Unchanged,
    /// A picture came that cannot be read or measured.
    Damaged,
    /// No picture came.
    Missing,
    /// A new picture came that was not measured, for the reason of this alarm.
    Withheld(Alarm),
    /// A new picture came that was not measured, and nothing is wrong yet.
    PassedOver,
}

/// Consequences of an event.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Actions {
    /// How far a measurement can be used now.
    pub status: SampleZoneStatus,
    /// The alarm that is on now.
    pub alarm: Option<Alarm>,
    /// The status lamp: lit while measuring, blinking at 1 Hz otherwise.
    pub led_on: bool,
    /// The camera's power.
    pub camera_power_on: bool,
}

/// The state of the camera as far as its pictures show it.
#[derive(Clone, Debug)]
pub struct Health {
    /// Time between two requests.
    interval: Duration,
    refresh: Refresh,
    missing_limit: Duration,
    last_new: Duration,
    last_any: Duration,
    /// Why pictures are withheld, and since when.
    withheld: Option<(Alarm, Duration)>,
    next_cycle: Duration,
    cycle_wait: Duration,
    power_back: Option<Duration>,
}

impl Health {
    /// A camera that gives a picture each `interval`, healthy at `now` (time since start).
    pub fn new(interval: Duration, now: Duration) -> Self {
        let limit = interval.saturating_mul(PERIODS).max(NOTICE);
        Self {
            interval,
            refresh: Refresh::default(),
            missing_limit: interval.saturating_mul(PERIODS).max(NOTICE_MISSING),
            last_new: now,
            last_any: now,
            withheld: None,
            next_cycle: now.saturating_add(limit).saturating_add(POWER_CYCLE_FIRST),
            cycle_wait: POWER_CYCLE_FIRST,
            power_back: None,
        }
    }

    /// Says what follows at `now` when nothing has happened since the last call.
    pub fn idle(&mut self, now: Duration) -> Actions {
        self.judge(now)
    }

    /// Says what follows at `now` when no picture is asked for, on purpose: the camera is
    /// neither missing nor frozen.
    pub fn hold(&mut self, now: Duration) -> Actions {
        (self.last_new, self.last_any) = (now, now);
        self.refresh.note_gap();
        self.judge(now)
    }

    /// Time between two new pictures, where the camera has them less often than it is asked.
    pub fn period(&self) -> Option<Duration> {
        self.refresh.period(self.interval)
    }

    /// How long a picture may stand still.
    fn limit(&self) -> Duration {
        let period = self.refresh.gap(self.interval).unwrap_or_default().max(self.interval);
        period.saturating_mul(PERIODS).max(NOTICE)
    }

    /// Takes what happened at `now` and returns what follows.
    pub fn on(&mut self, event: Event, now: Duration) -> Actions {
        match event {
            Event::Unchanged => self.refresh.note(false, now),
            Event::Damaged | Event::Missing => self.refresh.note_gap(),
            Event::Measured | Event::PassedOver | Event::Withheld(_) => {
                self.refresh.note(true, now);
            }
        }
        match event {
            Event::Measured => {
                (self.last_new, self.last_any) = (now, now);
                self.withheld = None;
            }
            Event::PassedOver => (self.last_new, self.last_any) = (now, now),
            Event::Withheld(alarm) => {
                (self.last_new, self.last_any) = (now, now);
                let since = self.withheld.filter(|&(before, _)| before == alarm);
                self.withheld = since.or(Some((alarm, now)));
            }
            Event::Unchanged | Event::Damaged => self.last_any = now,
            Event::Missing => {}
        }
        self.judge(now)
    }

    fn judge(&mut self, now: Duration) -> Actions {
        let limit = self.limit();
        let alarm = if now.saturating_sub(self.last_any) > self.missing_limit {
            Some(Alarm::NoPicture)
        } else if now.saturating_sub(self.last_new) > limit {
            Some(Alarm::FrozenPicture)
        } else {
            // A moved camera is reported only after several pictures agree on it.
            let lasting = |&(alarm, since): &(Alarm, Duration)| {
                alarm == Alarm::CameraMoved || now.saturating_sub(since) > limit
            };
            self.withheld.filter(lasting).map(|(alarm, _)| alarm)
        };
        // Of a slow camera windows have too few pictures, and no density.
        let status = match alarm {
            Some(alarm) => alarm.status(),
            None if self.period().is_some() => SampleZoneStatus::InputDataIntegrity,
            None => SampleZoneStatus::Ok,
        };
        let camera_power_on = self.power(alarm, now);
        let led_on = status == SampleZoneStatus::Ok || now.subsec_millis() < 500;
        Actions { status, alarm, led_on, camera_power_on }
    }

    fn power(&mut self, alarm: Option<Alarm>, now: Duration) -> bool {
        if let Some(back) = self.power_back {
            if now < back {
                return false;
            }
            self.power_back = None;
        }
        if alarm.is_none_or(|alarm| !alarm.is_of_camera()) {
            self.cycle_wait = POWER_CYCLE_FIRST;
            self.next_cycle =
                self.last_new.saturating_add(self.limit()).saturating_add(self.cycle_wait);
        } else if now >= self.next_cycle {
            self.power_back = Some(now.saturating_add(POWER_OFF));
            self.cycle_wait = self.cycle_wait.saturating_mul(2).min(POWER_CYCLE_MAX);
            self.next_cycle = now.saturating_add(self.cycle_wait);
            return false;
        }
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SECOND: Duration = Duration::from_secs(1);

    fn after(seconds: u32) -> Duration {
        SECOND * seconds
    }

    #[test]
    fn a_missing_picture_is_noticed_after_10_s_and_forgotten_when_it_returns() {
        let mut health = Health::new(SECOND, after(0));
        assert_eq!(health.on(Event::Missing, after(10)).alarm, None);
        let noticed = health.on(Event::Missing, after(11));
        assert_eq!(noticed.alarm, Some(Alarm::NoPicture));
        assert_eq!(noticed.status, SampleZoneStatus::SensorFailure);
        assert_eq!(health.on(Event::Measured, after(12)).alarm, None);
    }

    #[test]
    fn a_slow_camera_is_given_three_periods() {
        let mut health = Health::new(after(120), after(0));
        assert_eq!(health.on(Event::Missing, after(360)).alarm, None);
        assert_eq!(health.on(Event::Missing, after(361)).alarm, Some(Alarm::NoPicture));
    }

    #[test]
    fn a_frozen_picture_is_not_a_missing_one() {
        let mut health = Health::new(SECOND, after(0));
        for second in 1..=20 {
            assert_eq!(health.on(Event::Unchanged, after(second)).alarm, None);
        }
        let noticed = health.on(Event::Unchanged, after(21));
        assert_eq!(noticed.alarm, Some(Alarm::FrozenPicture));
        assert_eq!(noticed.status, SampleZoneStatus::InputDataIntegrity);
    }

    #[test]
    fn a_camera_with_a_new_picture_each_30_s_is_slow_and_not_frozen() {
        let mut health = Health::new(after(5), after(0));
        for second in 0..3600 {
            let is_asked = second % 5 == 0;
            let actions = match second % 30 {
                0 => health.on(Event::Measured, after(second)),
                _ if is_asked => health.on(Event::Unchanged, after(second)),
                _ => health.idle(after(second)),
            };
            // Until its first new picture it cannot be known.
            let is_unknown = (21..30).contains(&second);
            assert_eq!(actions.alarm.is_some(), is_unknown, "{second} s");
            let is_slow = second >= 60;
            assert_eq!(health.period(), is_slow.then_some(after(30)), "{second} s");
            let usable = actions.status == SampleZoneStatus::Ok;
            assert_eq!(usable, !is_unknown && !is_slow, "{second} s");
        }
        // It stands still for three of its periods.
        assert_eq!(health.on(Event::Unchanged, after(3570 + 90)).alarm, None);
        let noticed = health.on(Event::Unchanged, after(3570 + 91));
        assert_eq!(noticed.alarm, Some(Alarm::FrozenPicture));
    }

    #[test]
    fn a_pause_is_neither_a_missing_nor_a_frozen_picture() {
        let mut health = Health::new(SECOND, after(0));
        for second in 0..100 {
            let actions = health.hold(after(second));
            assert!(actions.alarm.is_none() && actions.camera_power_on, "{second} s");
        }
        assert_eq!(health.on(Event::Missing, after(109)).alarm, None);
        assert_eq!(health.on(Event::Missing, after(110)).alarm, Some(Alarm::NoPicture));
    }

    #[test]
    fn pictures_withheld_for_longer_than_the_limit_raise_the_alarm_of_their_reason() {
        let blurred = Event::Withheld(Alarm::BlurredPicture);
        let mut health = Health::new(after(10), after(0));
        assert_eq!(health.on(blurred, after(10)).alarm, None);
        assert_eq!(health.on(blurred, after(40)).alarm, None);
        let noticed = health.on(blurred, after(50));
        assert_eq!(noticed.alarm, Some(Alarm::BlurredPicture));
        assert_eq!(noticed.status, SampleZoneStatus::PoorContrast);
        assert_eq!(health.on(Event::Withheld(Alarm::BlindedPicture), after(60)).alarm, None);
        assert_eq!(health.on(Event::PassedOver, after(70)).alarm, None);
        let moved = health.on(Event::Withheld(Alarm::CameraMoved), after(80));
        assert_eq!(moved.status, SampleZoneStatus::DetectionAutoSuspended, "said at once");
        let long = health.on(Event::Withheld(Alarm::CameraMoved), after(9000));
        assert!(long.camera_power_on, "the camera's power is not to blame");
        assert_eq!(health.on(Event::Measured, after(9010)).alarm, None);
    }

    #[test]
    fn power_is_cycled_with_growing_waits() {
        let mut health = Health::new(SECOND, after(0));
        let mut offs = std::vec::Vec::new();
        let mut was_on = true;
        for second in 0..4000 {
            let on = health.on(Event::Missing, after(second)).camera_power_on;
            if was_on && !on {
                offs.push(second);
            }
            was_on = on;
        }
        assert_eq!(offs, [140, 380, 860, 1820, 3740]);
    }

    #[test]
    fn power_stays_off_for_ten_seconds() {
        let mut health = Health::new(SECOND, after(0));
        assert!(!health.on(Event::Missing, after(140)).camera_power_on);
        assert!(!health.on(Event::Missing, after(149)).camera_power_on);
        assert!(health.on(Event::Missing, after(150)).camera_power_on);
    }
}
