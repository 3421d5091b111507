//! Tries of `verge check` at a broker: a session with its will, a retained message, and each
//! density topic, as the running sensor uses them.
//!
//! Owns what is published for it: an empty message on each density topic, which readers pass
//! over, and once more what `presence` said before.

use super::link::{End, Link};
use super::packet::{Acknowledged, Denial, Incoming, Limits, Spoken};
use super::ways::Ways;
use super::{Message, MqttSettings, said_of};
use std::time::{Duration, Instant};
use verge_messages::{Presence, Topic};

/// Longest wait for an acknowledgement, and for what was published to come back.
const ANSWER: Duration = Duration::from_secs(5);

/// Tries all that `verge run` would do, with windows of at least `size` bytes, and describes what is
/// there.
///
/// # Errors
/// Why density would not arrive.
pub fn probe(settings: &MqttSettings, windows: &[Duration], size: usize) -> Result<String, String> {
    let outcome = match attempt(settings, windows, size, true) {
        // Some brokers close on a subscription that they do not allow.
        Err(Fault::Reading) => attempt(settings, windows, size, false),
        outcome => outcome,
    };
    let (spoken, said) = outcome.map_err(Fault::reason)?;
    if spoken == Spoken::V3 {
        carries(settings, size)?;
    }
    Ok(said)
}

/// Whether a broker takes packets of so many bytes: 3.1.1 has no words for its limit. The first packet is
/// one of that size, by a will that a goodbye makes void.
fn carries(settings: &MqttSettings, size: usize) -> Result<(), String> {
    let mut payload = Presence::Offline.text().as_bytes().to_vec();
    payload.resize(size, b' ');
    let topic = Topic::Presence.under(&settings.root);
    let will = Message { topic, payload, retain: false };
    let entered = enter_with(settings, Spoken::V3, &will).map(|(mut link, _)| link.disconnect());
    match entered {
        Err(Refusal::Closed) => Err(too_large(None, size)),
        // A broker that answers differently now has not been asked for its limit.
        Ok(()) | Err(Refusal::Denied(_) | Refusal::Ended(_)) => Ok(()),
    }
}

fn too_large(limit: Option<usize>, size: usize) -> String {
    let limit = limit.map_or("smaller packets alone".to_owned(), |limit| {
        format!("packets of {limit} bytes at most")
    });
    format!(
        "the broker takes {limit}, and a window has {size} bytes or more: it would wait in the spool. \
         Raise the broker's limit (mosquitto: max_packet_size, message_size_limit)"
    )
}

enum Fault {
    /// It ended while own topics were read.
    Reading,
    Told(String),
}

impl Fault {
    fn reason(self) -> String {
        match self {
            Self::Reading => "it closed the connection on a subscription".to_owned(),
            Self::Told(reason) => reason,
        }
    }
}

impl From<End> for Fault {
    fn from(end: End) -> Self {
        Self::Told(end.reason())
    }
}

struct Trial<'a> {
    settings: &'a MqttSettings,
    spoken: Spoken,
    link: Link,
    limits: Limits,
    /// Messages that came back and were not asked for yet.
    came: Vec<(String, Vec<u8>)>,
}

fn attempt(
    settings: &MqttSettings,
    windows: &[Duration],
    size: usize,
    reads: bool,
) -> Result<(Spoken, String), Fault> {
    let (spoken, mut link, limits) = enter(settings)?;
    if limits.packet < size {
        link.disconnect();
        return Err(Fault::Told(too_large(Some(limits.packet), size)));
    }
    let mut trial = Trial { settings, spoken, link, limits, came: Vec::new() };
    let outcome = trial.run(windows, reads);
    trial.link.disconnect();
    outcome.map(|said| (spoken, said))
}

/// Why one way does not lead in.
enum Refusal {
    Denied(Denial),
    Closed,
    Ended(String),
}

/// Tries one way in.
fn enter_with(
    settings: &MqttSettings,
    spoken: Spoken,
    will: &Message,
) -> Result<(Link, Limits), Refusal> {
    let id = format!("{}-check", settings.client_id());
    let end = |end: End| match end {
        End::Closed => Refusal::Closed,
        end => Refusal::Ended(end.reason()),
    };
    let mut link = Link::open(settings, spoken, &id, will.clone()).map_err(end)?;
    let until = Instant::now() + super::link::CONNECT;
    loop {
        match link.next(until.saturating_duration_since(Instant::now())).map_err(end)? {
            Some(Incoming::Accepted(limits)) => return Ok((link, limits)),
            Some(Incoming::Denied(denial)) => return Err(Refusal::Denied(denial)),
            _ if Instant::now() >= until => {
                return Err(Refusal::Ended("no answer to our first packet".to_owned()));
            }
            _ => {}
        }
    }
}

/// Finds the way in.
fn enter(settings: &MqttSettings) -> Result<(Spoken, Link, Limits), Fault> {
    let mut ways = Ways::new(settings.version);
    let topic = Topic::Presence.under(&settings.root);
    let mut closed = 0;
    loop {
        let (spoken, retain) = ways.now();
        let payload = Presence::Offline.text().into();
        let will = Message { topic: topic.clone(), payload, retain };
        match enter_with(settings, spoken, &will) {
            Ok((link, limits)) => {
                let retains = limits.retains && retain;
                return Ok((spoken, link, Limits { retains, ..limits }));
            }
            Err(Refusal::Denied(denial)) if ways.denied(&denial) => {}
            Err(Refusal::Denied(denial)) => {
                return Err(Fault::Told(said_of(&denial, settings, spoken)));
            }
            Err(Refusal::Closed) if closed < 3 => {
                closed += 1;
                ways.closed();
            }
            Err(Refusal::Closed) => {
                return Err(Fault::Told(
                    "it closes each connection in place of an answer; does it want TLS \
                     (mqtt.tls = true), or a certificate of the box?"
                        .to_owned(),
                ));
            }
            Err(Refusal::Ended(reason)) => return Err(Fault::Told(reason)),
        }
    }
}

impl Trial<'_> {
    fn run(&mut self, windows: &[Duration], reads: bool) -> Result<String, Fault> {
        let version = match self.spoken {
            Spoken::V3 => "3.1.1",
            Spoken::V5 => "5",
        };
        let mut said = format!("MQTT {version}");
        if !self.limits.retains {
            said += ", without retained messages: late subscribers miss presence and health";
        }
        let may_read = reads && self.presence()?;
        let mut unheard = Vec::new();
        for &window in windows {
            for (topic, is_live) in [(Topic::Density(window), true), (Topic::Replay(window), false)]
            {
                let topic = topic.under(&self.settings.root);
                if self.topic(&topic, may_read)? == Acknowledged::Unheard {
                    if is_live {
                        return Err(Fault::Told(format!(
                            "nobody subscribes to {topic}: windows would wait in the spool. Connect \
                             the centre's subscriber"
                        )));
                    }
                    unheard.push(topic);
                }
            }
        }
        if !unheard.is_empty() {
            said += &format!(
                "; nobody subscribes to {}: windows of an outage would wait",
                unheard.join(", ")
            );
        }
        if self.spoken == Spoken::V3 && !may_read {
            said += "; not proven that density is kept: this client may not read its own topics";
        }
        Ok(said)
    }

    /// Publishes `presence` as it stands, retained, and reads it back; whether that worked.
    fn presence(&mut self) -> Result<bool, Fault> {
        let topic = Topic::Presence.under(&self.settings.root);
        if !self.subscribe(&topic)? {
            return Ok(false);
        }
        // Retained messages come with the subscription.
        let before = self.wait_for(&topic, Duration::from_millis(300))?;
        let shutdown = Presence::Shutdown.text().as_bytes().to_vec();
        let payload = before.clone().unwrap_or(shutdown);
        let retain = self.limits.retains;
        if let Acknowledged::Refused(reason) = self.publish(&topic, payload, retain)? {
            return Err(self.refused(&topic, &reason));
        }
        let came = self.wait_for(&topic, ANSWER)?.is_some();
        if before.is_none() && retain {
            self.publish(&topic, Vec::new(), true)?;
        }
        self.link.unsubscribe(&topic)?;
        Ok(came)
    }

    /// Publishes an empty message on a density topic.
    fn topic(&mut self, topic: &str, may_read: bool) -> Result<Acknowledged, Fault> {
        // MQTT 5 says what became of it, and our own subscription would count as one.
        let reads = may_read && self.spoken == Spoken::V3;
        if reads && !self.subscribe(topic)? {
            return Err(self.refused(topic, "it may not be read"));
        }
        let outcome = self.publish(topic, Vec::new(), false)?;
        if let Acknowledged::Refused(reason) = &outcome {
            return Err(self.refused(topic, reason));
        }
        if reads {
            if self.wait_for(topic, ANSWER)?.is_none() {
                return Err(Fault::Told(format!(
                    "the broker acknowledges {topic} and throws it away: allow {} to write and read \
                     it, in the broker's access list",
                    self.settings.who()
                )));
            }
            self.link.unsubscribe(topic)?;
        }
        Ok(outcome)
    }

    fn refused(&self, topic: &str, reason: &str) -> Fault {
        let who = self.settings.who();
        Fault::Told(format!("the broker refuses {topic}: {reason}; allow {who} to publish there"))
    }

    fn subscribe(&mut self, topic: &str) -> Result<bool, Fault> {
        self.link.subscribe(topic)?;
        let until = Instant::now() + ANSWER;
        while Instant::now() < until {
            match self.link.next(ANSWER) {
                Ok(Some(Incoming::Subscribed { granted })) => return Ok(granted),
                Ok(Some(Incoming::Echo { topic, payload, .. })) => self.came.push((topic, payload)),
                Ok(_) => {}
                Err(End::Closed | End::Told(_)) => return Err(Fault::Reading),
                Err(end) => return Err(end.into()),
            }
        }
        Ok(false)
    }

    fn publish(
        &mut self,
        topic: &str,
        payload: Vec<u8>,
        retain: bool,
    ) -> Result<Acknowledged, Fault> {
        let message = Message { topic: topic.to_owned(), payload, retain };
        let id = self.link.publish(&message)?;
        let until = Instant::now() + ANSWER;
        while Instant::now() < until {
            match self.link.next(ANSWER) {
                Ok(Some(Incoming::Acknowledged(packet, outcome))) if packet == id => {
                    return Ok(outcome);
                }
                Ok(Some(Incoming::Echo { topic, payload, .. })) => self.came.push((topic, payload)),
                Ok(_) => {}
                Err(End::Closed | End::Told(_)) => {
                    return Err(Fault::Told(format!(
                        "the broker closes the connection on {topic}: allow {} to publish there",
                        self.settings.who()
                    )));
                }
                Err(end) => return Err(end.into()),
            }
        }
        Err(Fault::Told(format!("the broker does not acknowledge {topic}")))
    }

    fn wait_for(&mut self, topic: &str, patience: Duration) -> Result<Option<Vec<u8>>, Fault> {
        let until = Instant::now() + patience;
        loop {
            if let Some(index) = self.came.iter().position(|(came, _)| came == topic) {
                return Ok(Some(self.came.swap_remove(index).1));
            }
            let left = until.saturating_duration_since(Instant::now());
            if left.is_zero() {
                return Ok(None);
            }
            if let Some(Incoming::Echo { topic, payload, .. }) = self.link.next(left)? {
                self.came.push((topic, payload));
            }
        }
    }
}
