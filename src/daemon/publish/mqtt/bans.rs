//! Messages that a broker refuses, set aside for a while so that others pass.
//!
//! Owns which topic, from which size on, and until when. A broker may say that it refuses a
//! message, throw it away, close the connection on it, or close it on its size; the last two it
//! does not tell apart, and neither from a broker that died. So it takes two connections that end
//! with one and the same message alone on its way.

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

/// How long a topic is left alone on which a broker closes: each try costs a connection.
const CLOSES: Duration = Duration::from_secs(15 * 60);
/// How long one is that a broker refuses in words: a try costs nothing.
const REFUSES: Duration = Duration::from_secs(25);
/// Connections that a message must have ended.
const STRIKES: u32 = 2;

#[derive(Debug, Default)]
pub(super) struct Bans {
    bans: BTreeMap<String, Ban>,
    /// Largest message of each topic that was taken, bytes.
    taken: BTreeMap<String, usize>,
    suspect: Option<Suspect>,
}

#[derive(Debug)]
struct Ban {
    /// Messages of this size on are set aside, bytes.
    from: usize,
    until: Instant,
    closes: bool,
}

#[derive(Debug)]
struct Suspect {
    topic: String,
    size: usize,
    strikes: u32,
}

impl Bans {
    /// Whether a message is not to be sent now.
    pub(super) fn forbid(&self, topic: &str, size: usize, now: Instant) -> bool {
        self.bans.get(topic).is_some_and(|ban| size >= ban.from && now < ban.until)
    }

    /// The broker has taken a message; true where its topic was set aside before.
    pub(super) fn taken(&mut self, topic: &str, size: usize) -> bool {
        let largest = self.taken.entry(topic.to_owned()).or_default();
        *largest = size.max(*largest);
        let known = |suspect: &Suspect| suspect.topic == topic && suspect.size <= size;
        if self.suspect.as_ref().is_some_and(known) {
            self.suspect = None;
        }
        self.bans.get(topic).is_some_and(|ban| size >= ban.from) && {
            self.bans.remove(topic);
            true
        }
    }

    /// A session begins: messages that were refused with a reason have a new try.
    pub(super) fn begin(&mut self) {
        self.bans.retain(|_, ban| ban.closes);
    }

    /// The broker has refused a message in words; true where this is news.
    pub(super) fn refused(&mut self, topic: &str, now: Instant) -> bool {
        let ban = Ban { from: 0, until: now + REFUSES, closes: false };
        self.bans.insert(topic.to_owned(), ban).is_none()
    }

    /// A connection has ended with this message alone on its way. Returns from which size on the
    /// topic is set aside, where it is from now on.
    pub(super) fn closed_on(&mut self, topic: &str, size: usize, now: Instant) -> Option<usize> {
        let strikes = match &self.suspect {
            Some(suspect) if suspect.topic == topic => suspect.strikes + 1,
            _ => 1,
        };
        let known = self.bans.get(topic).is_some_and(|ban| ban.closes);
        self.suspect = Some(Suspect { topic: topic.to_owned(), size, strikes });
        if strikes < STRIKES && !known {
            return None;
        }
        self.suspect = None;
        // Smaller ones have passed: it is the size. Otherwise it is the topic.
        let from = if self.taken.get(topic).is_some_and(|&taken| taken < size) { size } else { 0 };
        let ban = Ban { from, until: now + CLOSES, closes: true };
        self.bans.insert(topic.to_owned(), ban);
        Some(from)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_connections_that_end_with_a_message_set_its_topic_aside() {
        let (mut bans, now) = (Bans::default(), Instant::now());
        assert_eq!(bans.closed_on("a", 100, now), None);
        // It was the broker that died: the message passes the next time.
        assert!(!bans.taken("a", 100));
        assert_eq!(bans.closed_on("b", 50, now), None);
        assert_eq!(bans.closed_on("b", 50, now), Some(0));
        assert!(bans.forbid("b", 1, now) && !bans.forbid("a", 1, now));
        // Later it has one more try, and not two.
        let later = now + CLOSES;
        assert!(!bans.forbid("b", 1, later));
        assert_eq!(bans.closed_on("b", 50, later), Some(0));
        assert!(bans.forbid("b", 1, later));
        assert!(bans.taken("b", 50) && !bans.forbid("b", 1, later));
    }

    #[test]
    fn where_smaller_ones_passed_it_is_the_size() {
        let (mut bans, now) = (Bans::default(), Instant::now());
        bans.taken("a", 900);
        assert_eq!(bans.closed_on("a", 1300, now), None);
        assert_eq!(bans.closed_on("a", 1300, now), Some(1300));
        assert!(bans.forbid("a", 1300, now) && !bans.forbid("a", 901, now));
    }

    #[test]
    fn a_refusal_in_words_is_news_once_and_tried_again_soon() {
        let (mut bans, now) = (Bans::default(), Instant::now());
        assert!(bans.refused("a", now) && !bans.refused("a", now));
        assert!(bans.forbid("a", 1, now) && !bans.forbid("a", 1, now + REFUSES));
        assert!(bans.taken("a", 1));
        assert!(bans.refused("a", now), "it is news again");
    }
}
