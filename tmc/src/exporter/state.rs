//! The latest state of each site.
//!
//! Owns what is kept: the latest window of each length, the latest health, the alarms that are on,
//! presence. Memory is bounded by [`MOST_SITES`].

use crate::broker::LARGEST;
use crate::message::{self, Message};
use std::collections::{BTreeMap, BTreeSet};
use verge_messages::{Density, Health, Kind, Topic, Utc};

/// Most sites; what others say is refused.
const MOST_SITES: usize = 20_000;
/// Lengths of windows of a site.
const MOST_LENGTHS: usize = 12;
/// A window that ends this long after now is of a clock that is not set, ms.
const AHEAD_MS: i64 = 600_000;

/// A site.
#[derive(Clone, Debug, Default)]
pub(super) struct Site {
    /// By their length, s.
    pub(super) windows: BTreeMap<u32, Density>,
    pub(super) health: Option<Health>,
    /// Names of the alarms that are on.
    pub(super) alarms: BTreeSet<&'static str>,
    /// Whether the box is connected to the broker; none where it never said.
    pub(super) is_online: Option<bool>,
}

/// All sites.
#[derive(Debug, Default)]
pub(super) struct State {
    root: String,
    pub(super) sites: BTreeMap<String, Site>,
    pub(super) is_connected: bool,
    pub(super) messages: u64,
    pub(super) refused: u64,
}

impl State {
    /// Of sites whose topics stand under `root`.
    pub(super) fn of(root: &str) -> Self {
        Self { root: root.to_owned(), ..Self::default() }
    }

    /// Takes a message that arrived `now`; one that is wrong is counted.
    pub(super) fn take(&mut self, topic: &str, payload: &[u8], now: Utc) {
        self.messages += 1;
        if self.try_take(topic, payload, now).is_none() {
            self.refused += 1;
        }
    }

    fn try_take(&mut self, topic: &str, payload: &[u8], now: Utc) -> Option<()> {
        // Discovery of a topic's end, and the end of a replay, say nothing.
        if payload.is_empty() {
            return Some(());
        }
        if payload.len() > LARGEST {
            return None;
        }
        let rest = topic.strip_prefix(&self.root)?.strip_prefix('/')?;
        let (site, kind) = rest.split_once('/')?;
        if kind == "presence" {
            self.site(site)?.is_online = Some(payload == b"online");
            return Some(());
        }
        let kind = match kind.strip_prefix("latest/") {
            Some(_) => Kind::Density,
            None => Topic::kind_of(&self.root, topic)?.1,
        };
        let message = message::read_kind(kind, payload).ok()?;
        if message.site() != site || message.span().1.0 > now.0 + AHEAD_MS {
            return None;
        }
        let known = self.site(site)?;
        match message {
            Message::Density(window) => {
                let is_full = known.windows.len() >= MOST_LENGTHS;
                match known.windows.get(&window.window_s) {
                    None if is_full => return None,
                    // The retained one comes beside the live one.
                    Some(old) if old.to >= window.to => {}
                    _ => drop(known.windows.insert(window.window_s, *window)),
                }
            }
            Message::Health(health) => known.health = Some(*health),
            Message::Alarm(alarm) if alarm.active => {
                known.alarms.insert(alarm.name.name());
            }
            Message::Alarm(alarm) => {
                known.alarms.remove(alarm.name.name());
            }
        }
        Some(())
    }

    fn site(&mut self, name: &str) -> Option<&mut Site> {
        let has_room = self.sites.len() < MOST_SITES || self.sites.contains_key(name);
        (has_room && message::is_site(name)).then(|| self.sites.entry(name.to_owned()).or_default())
    }
}
