//! Messages that wait to be sent in a session, and those in flight.
//!
//! Owns the order: presence, live windows, states, windows of an outage. No window waits behind
//! discovery or alarms: states have places of their own, and no more, and where they may end the
//! session they come last.

use super::Message;
use std::collections::VecDeque;
use std::time::Instant;

/// Most messages that may be sent ahead of their acknowledgements.
const IN_FLIGHT: usize = 16;
/// Most of these that are states.
const STATES_IN_FLIGHT: usize = 4;
/// Most states that wait: health and alarms are a dozen topics, discovery up to fifty.
const MAX_STATES: usize = 128;

/// Kind of a message: it decides the message's fate when the session ends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    /// Published again by each session.
    Presence,
    /// Kept until a broker has it.
    State,
    /// Given again by the spool.
    Window { key: u64 },
}

/// Whose turn it is among states.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum States {
    /// Before the windows of an outage, of which there may be thousands.
    BeforeArrears,
    /// Behind all windows.
    Last,
    /// None yet.
    Wait,
}

#[derive(Debug)]
pub(super) struct Sending {
    pub(super) kind: Kind,
    pub(super) message: Message,
}

#[derive(Debug)]
struct InFlight {
    sending: Sending,
    packet: u16,
    since: Instant,
}

#[derive(Debug, Default)]
pub(super) struct Outbox {
    first: VecDeque<Sending>,
    live: VecDeque<Sending>,
    states: VecDeque<Sending>,
    arrears: VecDeque<Sending>,
    in_flight: VecDeque<InFlight>,
}

impl Outbox {
    /// A message that goes before all others.
    pub(super) fn first(&mut self, kind: Kind, message: Message) {
        self.first.push_back(Sending { kind, message });
    }

    pub(super) fn window(&mut self, key: u64, live: bool, message: Message) {
        let queue = if live { &mut self.live } else { &mut self.arrears };
        queue.push_back(Sending { kind: Kind::Window { key }, message });
    }

    /// A state; only the latest of a topic is of use.
    pub(super) fn state(&mut self, message: Message) {
        self.states.retain(|waiting| waiting.message.topic != message.topic);
        if self.states.len() < MAX_STATES {
            self.states.push_back(Sending { kind: Kind::State, message });
        }
    }

    /// The next message, where `most` and our own limits let one more go ahead.
    pub(super) fn next(&mut self, most: usize, turn: States) -> Option<Sending> {
        if self.in_flight.len() >= most.min(IN_FLIGHT) {
            return None;
        }
        let states = self.in_flight.iter().filter(|sent| sent.sending.kind == Kind::State).count();
        let is_room = states < STATES_IN_FLIGHT;
        let mut state = |at| if is_room && turn == at { self.states.pop_front() } else { None };
        self.first
            .pop_front()
            .or_else(|| self.live.pop_front())
            .or_else(|| state(States::BeforeArrears))
            .or_else(|| self.arrears.pop_front())
            .or_else(|| state(States::Last))
    }

    pub(super) fn sent(&mut self, sending: Sending, packet: u16, now: Instant) {
        self.in_flight.push_back(InFlight { sending, packet, since: now });
    }

    /// The message with this packet id, which is on its way no more.
    pub(super) fn remove(&mut self, packet: u16) -> Option<Sending> {
        let index = self.in_flight.iter().position(|sent| sent.packet == packet)?;
        self.in_flight.remove(index).map(|sent| sent.sending)
    }

    pub(super) fn in_flight(&self) -> usize {
        self.in_flight.len()
    }

    pub(super) fn oldest_in_flight(&self) -> Option<Instant> {
        self.in_flight.front().map(|sent| sent.since)
    }

    /// The message that is on its way, where there is one alone.
    pub(super) fn alone_in_flight(&self) -> Option<&Message> {
        match self.in_flight.len() {
            1 => self.in_flight.front().map(|sent| &sent.sending.message),
            _ => None,
        }
    }

    /// Nothing is on its way.
    pub(super) fn is_idle(&self) -> bool {
        self.in_flight.is_empty()
    }

    /// Nothing is on its way, and of what goes before an outage's windows nothing waits.
    pub(super) fn is_delivered(&self) -> bool {
        self.is_idle() && self.first.is_empty() && self.live.is_empty() && self.states.is_empty()
    }

    /// Forgets windows and presence; states wait for the next session, in their order.
    pub(super) fn end_session(&mut self) {
        let sent = std::mem::take(&mut self.in_flight).into_iter().map(|sent| sent.sending);
        let waiting = std::mem::take(&mut self.states);
        (self.first, self.live, self.arrears) = Default::default();
        for sending in sent.filter(|sending| sending.kind == Kind::State).chain(waiting) {
            self.state(sending.message);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn message(topic: &str) -> Message {
        Message { topic: topic.to_owned(), payload: Vec::new(), retain: false }
    }

    #[test]
    fn no_window_waits_behind_states() {
        let mut outbox = Outbox::default();
        (0..20).for_each(|n| outbox.state(message(&format!("s{n}"))));
        outbox.window(1, false, message("arrear"));
        outbox.window(2, true, message("live"));
        outbox.first(Kind::Presence, message("presence"));
        let now = Instant::now();
        let mut order = Vec::new();
        let mut packet = 0;
        while let Some(sending) = outbox.next(usize::MAX, States::BeforeArrears) {
            packet += 1;
            order.push(sending.message.topic.clone());
            outbox.sent(sending, packet, now);
        }
        // The states wait for an acknowledgement; the windows are on their way.
        assert_eq!(order, ["presence", "live", "s0", "s1", "s2", "s3", "arrear"]);
        assert!(outbox.remove(3).is_some() && outbox.remove(3).is_none());
        let next = outbox.next(usize::MAX, States::BeforeArrears);
        assert_eq!(next.expect("one more").message.topic, "s4");
        outbox.end_session();
        let left: Vec<_> = outbox.states.iter().map(|s| s.message.topic.as_str()).collect();
        assert_eq!((left.len(), left[0], left[3]), (18, "s1", "s5"));
        assert!(outbox.is_idle() && !outbox.is_delivered());
    }

    #[test]
    fn where_states_may_end_the_session_windows_go_first() {
        let mut outbox = Outbox::default();
        outbox.state(message("s"));
        assert!(outbox.next(1, States::Wait).is_none());
        outbox.window(1, false, message("arrear"));
        let mut topics = Vec::new();
        while let Some(sending) = outbox.next(1, States::Last) {
            topics.push(sending.message.topic);
        }
        assert_eq!(topics, ["arrear", "s"]);
    }

    #[test]
    fn one_at_a_time_where_that_is_asked() {
        let mut outbox = Outbox::default();
        (0..3).for_each(|key| outbox.window(key, true, message("w")));
        let first = outbox.next(1, States::Last).expect("one");
        outbox.sent(first, 7, Instant::now());
        assert!(outbox.next(1, States::Last).is_none());
        assert_eq!(outbox.alone_in_flight().map(|m| m.topic.as_str()), Some("w"));
        outbox.remove(7);
        assert!(outbox.next(1, States::Last).is_some());
    }
}
