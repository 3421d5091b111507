//! In which words a broker is spoken to: MQTT 5 or 3.1.1, with a will that it keeps or without.
//!
//! Owns which of them is tried next. A broker says what it does not speak, or it closes the
//! connection without a reason: then the others have their turn.

use super::MqttVersion;
use super::packet::{Denial, Spoken};

/// A version, and whether messages are to be retained.
pub(super) type Way = (Spoken, bool);

#[derive(Debug)]
pub(super) struct Ways {
    all: Vec<Way>,
    /// In the order in which they are tried; the first is the one that worked, or should.
    order: Vec<Way>,
    next: usize,
    /// Changes that the broker asked for, since it last let us in.
    turns: u32,
}

impl Ways {
    pub(super) fn new(version: MqttVersion) -> Self {
        use Spoken::{V3, V5};
        let all = match version {
            MqttVersion::Auto => vec![(V5, true), (V3, true), (V5, false), (V3, false)],
            MqttVersion::V3 => vec![(V3, true), (V3, false)],
            MqttVersion::V5 => vec![(V5, true), (V5, false)],
        };
        Self { order: all.clone(), all, next: 0, turns: 0 }
    }

    /// The way to try now.
    pub(super) fn now(&self) -> Way {
        self.order[self.next % self.order.len()]
    }

    /// The broker has let us in, and keeps retained messages or does not. A way that was found by
    /// trying is tried again in its turn the next time, for a closed connection proves nothing.
    pub(super) fn accepted(&mut self, retains: bool) {
        let (spoken, retained) = self.now();
        if self.turns > 0 || self.next == 0 {
            let way = (spoken, retained || retains);
            if !self.order.contains(&way) {
                self.order.push(way);
            }
            self.prefer(way);
        }
        (self.next, self.turns) = (0, 0);
    }

    /// The broker has said why it does not let us in; whether another way can be tried at once.
    pub(super) fn denied(&mut self, denial: &Denial) -> bool {
        let (spoken, retained) = self.now();
        let rest = |ways: &[Way], keep: &dyn Fn(Way) -> bool| -> Vec<Way> {
            ways.iter().copied().filter(|&way| keep(way)).collect()
        };
        let order = match denial {
            Denial::Version => {
                // A version that it does not speak is tried again only if the broker was replaced.
                let other = |way: Way| way.0 != spoken;
                let left = rest(&self.order, &other);
                if left.is_empty() { rest(&self.all, &other) } else { left }
            }
            Denial::Retain if retained => rest(&self.order, &|way| way != (spoken, true)),
            _ => Vec::new(),
        };
        self.turns += 1;
        if order.is_empty() || self.turns > 3 {
            return false;
        }
        self.order = order;
        self.next = 0;
        if *denial == Denial::Retain {
            self.prefer((spoken, false));
        }
        true
    }

    /// The broker has closed the connection in place of an answer.
    pub(super) fn closed(&mut self) {
        self.next += 1;
    }

    /// There is a wait before the next attempt.
    pub(super) fn rested(&mut self) {
        self.turns = 0;
    }

    fn prefer(&mut self, way: Way) {
        if let Some(index) = self.order.iter().position(|&other| other == way) {
            self.order[..=index].rotate_right(1);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use Spoken::{V3, V5};

    #[test]
    fn version_5_goes_first_and_what_the_broker_says_counts() {
        let mut ways = Ways::new(MqttVersion::Auto);
        assert_eq!(ways.now(), (V5, true));
        assert!(ways.denied(&Denial::Version));
        assert_eq!(ways.now(), (V3, true));
        ways.accepted(true);
        assert_eq!(ways.now(), (V3, true), "it is remembered");
        // The broker was replaced by one that speaks 5 alone, and keeps nothing.
        assert!(ways.denied(&Denial::Version));
        assert!(ways.denied(&Denial::Retain));
        assert_eq!(ways.now(), (V5, false));
        ways.accepted(false);
        assert_eq!(ways.now(), (V5, false));
        assert!(!ways.denied(&Denial::Login));
        ways.accepted(true);
        assert_eq!(ways.now(), (V5, true), "it keeps messages now");
    }

    #[test]
    fn closing_without_a_word_tries_the_others_in_turn() {
        let mut ways = Ways::new(MqttVersion::Auto);
        for expected in [(V5, true), (V3, true), (V5, false), (V3, false), (V5, true)] {
            assert_eq!(ways.now(), expected);
            ways.closed();
        }
        assert_eq!(ways.now(), (V3, true));
        ways.accepted(true);
        assert_eq!(ways.now(), (V5, true), "it proves nothing");
        let mut ways = Ways::new(MqttVersion::V3);
        assert!(!ways.denied(&Denial::Version), "a version that is set is kept");
        ways.closed();
        assert_eq!(ways.now(), (V3, false));
    }

    #[test]
    fn a_broker_that_denies_everything_is_not_asked_without_end() {
        let mut ways = Ways::new(MqttVersion::Auto);
        let tried = (0..10).take_while(|_| ways.denied(&Denial::Version)).count();
        assert!(tried <= 3);
    }
}
