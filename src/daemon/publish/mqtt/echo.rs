//! Whether a broker of MQTT 3.1.1 does with windows what it acknowledges: it may throw them away,
//! where its access list forbids the topic, and has no words to say so.
//!
//! Owns the proof: what is published on a topic comes back to us, once in each session. A client
//! that may not read its own topics cannot have it; `presence` tells that apart.

use std::collections::{BTreeSet, VecDeque};
use std::time::{Duration, Instant};

/// How long an acknowledged message may take to come back.
pub(super) const PATIENCE: Duration = Duration::from_secs(10);

#[derive(Clone, Copy, Debug, PartialEq)]
enum Reading {
    Unknown { until: Instant },
    Allowed,
    Impossible,
}

/// A window that was acknowledged, and not seen again yet.
#[derive(Debug)]
struct Unproven {
    topic: String,
    key: u64,
    until: Instant,
}

/// Verdict on acknowledged windows.
#[derive(Debug, PartialEq)]
pub(super) enum Verdict {
    /// These have arrived at the broker.
    Taken(Vec<u64>),
    /// The broker throws away what is published on this topic.
    Dropped { topic: String, keys: Vec<u64> },
    /// It cannot be known: this client may not read.
    Unprovable(Vec<u64>),
}

/// The proof in one session.
#[derive(Debug)]
pub(super) struct Echo {
    reading: Reading,
    presence: String,
    asked: BTreeSet<String>,
    proven: BTreeSet<String>,
    unproven: VecDeque<Unproven>,
    /// Subscriptions that wait for their answer.
    unanswered: usize,
}

impl Echo {
    /// Begins with a session; without `wanted` nothing is asked for, and all is believed.
    pub(super) fn new(wanted: bool, presence: String, now: Instant) -> Self {
        let reading =
            if wanted { Reading::Unknown { until: now + PATIENCE } } else { Reading::Impossible };
        Self {
            reading,
            presence,
            asked: BTreeSet::new(),
            proven: BTreeSet::new(),
            unproven: VecDeque::new(),
            unanswered: 0,
        }
    }

    /// Whether this topic is to be subscribed to before something is published on it.
    pub(super) fn asks(&mut self, topic: &str) -> bool {
        let asks = self.reading != Reading::Impossible
            && !self.proven.contains(topic)
            && self.asked.insert(topic.to_owned());
        self.unanswered += usize::from(asks);
        asks
    }

    /// Whether a subscription waits for its answer: a broker may close on it.
    pub(super) fn is_asking(&self) -> bool {
        self.unanswered > 0
    }

    /// The answer to a subscription.
    pub(super) fn answered(&mut self, granted: bool) -> Option<Verdict> {
        self.unanswered = self.unanswered.saturating_sub(1);
        (!granted).then(|| self.give_up())
    }

    /// Something came back; whether its topic need not be read any longer, and what follows.
    pub(super) fn came(&mut self, topic: &str) -> (bool, Option<Verdict>) {
        if !self.asked.remove(topic) {
            return (false, None);
        }
        if topic == self.presence {
            self.reading = Reading::Allowed;
            self.proven.insert(topic.to_owned());
            return (true, None);
        }
        self.proven.insert(topic.to_owned());
        let keys = self.take(|unproven| unproven.topic == topic);
        (true, Some(Verdict::Taken(keys)))
    }

    /// A window was acknowledged; whether that is enough.
    pub(super) fn acknowledged(&mut self, topic: &str, key: u64, now: Instant) -> bool {
        if self.reading == Reading::Impossible || self.proven.contains(topic) {
            return true;
        }
        let until = now + PATIENCE;
        self.unproven.push_back(Unproven { topic: topic.to_owned(), key, until });
        false
    }

    /// The verdict when nothing has come back in time.
    pub(super) fn tick(&mut self, now: Instant) -> Option<Verdict> {
        match self.reading {
            Reading::Unknown { until } if now >= until => return Some(self.give_up()),
            Reading::Allowed => {}
            _ => return None,
        }
        let late = self.unproven.front().filter(|unproven| now >= unproven.until)?;
        let topic = late.topic.clone();
        let keys = self.take(|unproven| unproven.topic == topic);
        // The next try asks again.
        self.asked.remove(&topic);
        Some(Verdict::Dropped { topic, keys })
    }

    fn give_up(&mut self) -> Verdict {
        self.reading = Reading::Impossible;
        Verdict::Unprovable(self.take(|_| true))
    }

    fn take(&mut self, which: impl Fn(&Unproven) -> bool) -> Vec<u64> {
        let (these, others): (VecDeque<_>, VecDeque<_>) = self.unproven.drain(..).partition(which);
        self.unproven = others;
        these.into_iter().map(|unproven| unproven.key).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn echo(now: Instant) -> Echo {
        let mut echo = Echo::new(true, "p".to_owned(), now);
        assert!(echo.asks("p") && echo.asks("d") && !echo.asks("d"));
        echo
    }

    #[test]
    fn a_topic_is_proven_once_and_then_believed() {
        let now = Instant::now();
        let mut echo = echo(now);
        assert_eq!(echo.came("p"), (true, None));
        assert!(!echo.acknowledged("d", 1, now) && !echo.acknowledged("d", 2, now));
        assert_eq!(echo.came("d"), (true, Some(Verdict::Taken(vec![1, 2]))));
        assert!(echo.acknowledged("d", 3, now) && !echo.asks("d"));
        assert_eq!(echo.tick(now + 2 * PATIENCE), None);
        assert_eq!(echo.came("other"), (false, None));
    }

    #[test]
    fn what_is_acknowledged_and_does_not_come_back_was_thrown_away() {
        let now = Instant::now();
        let mut echo = echo(now);
        let _ = echo.came("p");
        assert!(!echo.acknowledged("d", 1, now));
        assert_eq!(echo.tick(now), None);
        let dropped = Verdict::Dropped { topic: "d".to_owned(), keys: vec![1] };
        assert_eq!(echo.tick(now + PATIENCE), Some(dropped));
        assert!(echo.asks("d"), "a later try has its proof again");
    }

    #[test]
    fn who_may_not_read_is_believed() {
        let now = Instant::now();
        let mut silent = echo(now);
        assert!(!silent.acknowledged("d", 1, now));
        assert_eq!(silent.tick(now + PATIENCE), Some(Verdict::Unprovable(vec![1])));
        assert!(silent.acknowledged("d", 2, now) && !silent.asks("e"));
        let mut refused = echo(now);
        assert!(refused.is_asking());
        assert_eq!(refused.answered(false), Some(Verdict::Unprovable(vec![])));
    }
}
