//! Consequences of a broker's behaviour: for a message, for its topic, and for the sessions to
//! come.
//!
//! Owns the rule that nothing a broker does loses a window: it has arrived, or it is put off and
//! stays in the spool.

use super::super::Report;
use super::super::echo::Verdict;
use super::super::link::End;
use super::super::outbox::{Kind, Sending};
use super::super::packet::{Acknowledged, Incoming, TAKEN_OVER};
use super::{QUIET, Session, Worker};
use std::sync::atomic::Ordering;
use std::time::Instant;

/// Sessions that end early, with nothing on its way, before a second client of our id is suspected.
const EARLY_ENDS: u32 = 3;

impl Worker {
    pub(super) fn hear(&mut self, session: &mut Session, incoming: Incoming) -> Result<(), End> {
        match incoming {
            Incoming::Acknowledged(packet, outcome) => {
                if let Some(sent) = self.outbox.remove(packet) {
                    self.acknowledged(session, sent, outcome);
                }
            }
            Incoming::Subscribed { granted } => {
                if let Some(verdict) = session.echo.answered(granted) {
                    self.follow(verdict);
                }
            }
            Incoming::Echo { topic, .. } => {
                let (is_proven, verdict) = session.echo.came(&topic);
                if is_proven {
                    session.link.unsubscribe(&topic)?;
                }
                if let Some(verdict) = verdict {
                    self.follow(verdict);
                }
            }
            Incoming::Accepted(_) | Incoming::Denied(_) => {
                return Err(End::Broken("the broker says yes or no twice".to_owned()));
            }
            Incoming::Pong | Incoming::Closing(_) | Incoming::Other => {}
        }
        Ok(())
    }

    fn acknowledged(&mut self, session: &mut Session, sent: Sending, outcome: Acknowledged) {
        let (topic, size) = (&sent.message.topic, sent.message.payload.len());
        let family = self.family(topic);
        let key = match sent.kind {
            Kind::Window { key } => Some(key),
            Kind::Presence | Kind::State => None,
        };
        match outcome {
            Acknowledged::Taken => {}
            // The next subscriber gets what is retained.
            Acknowledged::Unheard if key.is_none() => {}
            Acknowledged::Unheard => {
                if self.bans.refused(topic, Instant::now()) {
                    log::warn!(
                        "nobody subscribes to {topic}: its windows wait in the spool until \
                         somebody does"
                    );
                }
                return self.put_off(key);
            }
            Acknowledged::Refused(reason) => {
                self.statistics.refused.fetch_add(1, Ordering::Relaxed);
                if self.bans.refused(&family, Instant::now()) {
                    log::error!(
                        "the broker refuses {family}: {reason}; allow {} to publish there. Windows \
                         stay in the spool",
                        self.settings.who()
                    );
                }
                return self.put_off(key);
            }
        }
        if let Some(key) = key
            && !session.echo.acknowledged(topic, key, Instant::now())
        {
            return;
        }
        if self.bans.taken(&family, size) {
            log::info!("the broker takes {family} again");
        }
        if sent.kind == Kind::State && size == 0 {
            self.statistics.note_cleared(topic);
        }
        if sent.kind != Kind::Presence {
            self.statistics.delivered.fetch_add(1, Ordering::Relaxed);
        }
        if let Some(key) = key {
            self.arrived(key);
        }
    }

    /// A window is where it belongs.
    fn arrived(&mut self, key: u64) {
        self.backoff.reset();
        self.report(Report::Taken { key });
    }

    fn put_off(&self, key: Option<u64>) {
        if let Some(key) = key {
            self.report(Report::PutOff { key });
        }
    }

    pub(super) fn follow(&mut self, verdict: Verdict) {
        match verdict {
            Verdict::Taken(keys) => {
                self.statistics.delivered.fetch_add(keys.len() as u64, Ordering::Relaxed);
                keys.into_iter().for_each(|key| self.arrived(key));
            }
            Verdict::Unprovable(keys) => {
                if self.said.insert("unprovable".to_owned()) {
                    log::info!(
                        "this client may not read its own topics: with MQTT 3.1.1 nobody knows \
                         whether the broker keeps what it acknowledges (mqtt.version = \"5\" tells)"
                    );
                }
                self.follow(Verdict::Taken(keys));
            }
            Verdict::Dropped { topic, keys } => {
                self.statistics.refused.fetch_add(keys.len() as u64, Ordering::Relaxed);
                if self.bans.refused(&topic, Instant::now()) {
                    log::error!(
                        "the broker acknowledges {topic} and throws it away: allow {} to write and \
                         read it, in the broker's access list. Windows stay in the spool",
                        self.settings.who()
                    );
                }
                keys.into_iter().for_each(|key| self.put_off(Some(key)));
            }
        }
    }

    /// Draws the consequences of a session's end for later ones; returns the reason for people.
    pub(super) fn judge(&mut self, session: &Session, end: &End) -> String {
        let mut reason = end.reason();
        let is_early = session.since.elapsed() < QUIET;
        let is_closed = *end == End::Closed;
        let taken_over = reason.contains(TAKEN_OVER);
        let is_told = matches!(end, End::Told(_)) && !taken_over;
        if session.leaving.is_some() {
            return reason;
        }
        if (is_closed || is_told) && session.echo.is_asking() {
            self.echoes = false;
        }
        let alone = self.outbox.alone_in_flight();
        if (is_closed || is_told) && self.outbox.in_flight() > 0 {
            self.careful = true;
            if let Some(message) = alone {
                let (topic, size) = (self.family(&message.topic), message.payload.len());
                match self.bans.closed_on(&topic, size, Instant::now()) {
                    Some(0) => log::error!(
                        "the broker closes the connection on {topic}: it is set aside for a while. \
                         Allow {} to publish there. Windows stay in the spool",
                        self.settings.who()
                    ),
                    Some(from) => log::error!(
                        "the broker closes the connection on {topic} from {from} bytes on: such \
                         messages are set aside for a while. Raise its limit on packets. Windows \
                         stay in the spool"
                    ),
                    None => {}
                }
            }
        } else if is_closed && is_early {
            self.early_ends += 1;
        }
        if taken_over {
            self.backoff.give_way();
        } else if self.early_ends >= EARLY_ENDS {
            // A broker that is started again and again looks the same: it is only said.
            reason += &format!(
                " again and again: does another client use the client id {:?}?",
                self.settings.client_id()
            );
        }
        reason
    }

    /// A message does not go now: a window comes again from the spool, a state with the next one
    /// of its topic.
    pub(super) fn set_aside(&self, sending: &Sending) {
        if let Kind::Window { key } = sending.kind {
            self.put_off(Some(key));
        }
    }
}
