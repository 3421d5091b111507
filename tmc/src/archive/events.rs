//! Alarms, health and places into their tables.
//!
//! Owns which of them are new. An alarm stands once for a site, time and name, whether it came
//! live or because the broker keeps it. Of the states of a sensor those are kept that say
//! something else than the one before, and one each [`EACH_MS`]: a box publishes one a minute.
//! Of places, those that differ from the site's latest. A table that cannot be read is moved aside
//! and begins again.

use super::aside;
use crate::message::Message;
use crate::store::events::{self, AlarmRow, HealthRow, PlaceRow, Record};
use crate::store::{DAY_MS, date};
use serde_json::json;
use std::collections::BTreeMap;
use std::path::Path;
use verge_desk::Failure;
use verge_messages::Density;

/// A state that says the same as the one before is kept again after this time, ms.
const EACH_MS: i64 = 15 * 60_000;
/// Most alarms, and most states, of a site in a day: one a minute with each that there is.
const MOST_A_DAY: usize = 2000;

/// Events in a batch of messages, beside densities.
#[derive(Debug, Default)]
pub(super) struct Events {
    alarms: BTreeMap<i64, Vec<AlarmRow>>,
    health: BTreeMap<i64, Vec<HealthRow>>,
    /// Of each site the first message with each place.
    places: BTreeMap<String, Vec<PlaceRow>>,
}

impl Events {
    /// Takes the message of an alarm or of health; windows are others' work.
    pub(super) fn take(&mut self, message: &Message) {
        match message {
            Message::Alarm(alarm) => {
                let day = alarm.time.0.div_euclid(DAY_MS);
                self.alarms.entry(day).or_default().push(alarm.into());
            }
            Message::Health(health) => {
                let day = health.time.0.div_euclid(DAY_MS);
                self.health.entry(day).or_default().push((&**health).into());
            }
            Message::Density(window) => self.take_place(window),
        }
    }

    fn take_place(&mut self, window: &Density) {
        let Some(place) = &window.place else { return };
        let lanes: Vec<_> = window
            .lanes
            .iter()
            .filter(|lane| lane.lane_name.is_some() || lane.lane_order.is_some())
            .map(
                |lane| json!({"lane": lane.lane, "name": lane.lane_name, "order": lane.lane_order}),
            )
            .collect();
        let row = PlaceRow {
            site: window.site.clone(),
            since_ms: window.from.0,
            place: place.clone(),
            lanes: json!(lanes).to_string(),
        };
        let all = self.places.entry(row.site.clone()).or_default();
        let is_same = |last: &PlaceRow| last.place == row.place && last.lanes == row.lanes;
        if !all.last().is_some_and(is_same) {
            all.push(row);
        }
    }

    /// Whether there is nothing to write.
    pub(super) fn is_empty(&self) -> bool {
        self.alarms.is_empty() && self.health.is_empty() && self.places.is_empty()
    }

    /// Writes them into the tables under `root`; returns lines for the log.
    ///
    /// # Errors
    /// [`Failure`] where a table cannot be written; it is then as it was.
    pub(super) fn merge(self, root: &Path) -> Result<Vec<String>, Failure> {
        let mut told = Vec::new();
        for (day, new) in self.alarms {
            let path = events::alarms_path(root, day);
            let old: Vec<AlarmRow> =
                read(root, &path, &format!("alarms-{}", date(day)), &mut told)?;
            let before = old.len();
            let all = with_alarms(old, new);
            if all.len() > before {
                events::write_table(&path, &all)?;
            }
        }
        for (day, new) in self.health {
            let path = events::health_path(root, day);
            let old: Vec<HealthRow> =
                read(root, &path, &format!("health-{}", date(day)), &mut told)?;
            let before = old.len();
            let all = with_states(old, new);
            if all.len() > before {
                events::write_table(&path, &all)?;
            }
        }
        if !self.places.is_empty() {
            let path = events::places_path(root);
            let old: Vec<PlaceRow> = read(root, &path, "places", &mut told)?;
            let before = old.len();
            let all = with_places(old, self.places);
            if all.len() > before {
                events::write_table(&path, &all)?;
            }
        }
        Ok(told)
    }
}

/// The rows of a table; one that cannot be read is moved aside.
fn read<R: Record>(
    root: &Path,
    path: &Path,
    name: &str,
    told: &mut Vec<String>,
) -> Result<Vec<R>, Failure> {
    match events::read_table(path) {
        Err(failure @ Failure::Content { .. }) => {
            let to = aside::move_into(&root.join("_damaged"), path, name, "parquet")?;
            told.push(format!("{failure}; it was moved to {}", to.display()));
            Ok(Vec::new())
        }
        read => read,
    }
}

fn with_alarms(mut all: Vec<AlarmRow>, new: Vec<AlarmRow>) -> Vec<AlarmRow> {
    all.extend(new);
    all.sort();
    // Over before raised at one instant: the sort has false first.
    all.dedup();
    limited(all, |row| &row.site)
}

fn with_states(old: Vec<HealthRow>, mut new: Vec<HealthRow>) -> Vec<HealthRow> {
    let mut all: Vec<(bool, HealthRow)> = old.into_iter().map(|row| (true, row)).collect();
    new.sort_by(|a, b| (&a.site, a.time_ms).cmp(&(&b.site, b.time_ms)));
    all.extend(new.into_iter().map(|row| (false, row)));
    // The first of a time counts: a stable sort has those of the file before.
    all.sort_by(|(_, a), (_, b)| (&a.site, a.time_ms).cmp(&(&b.site, b.time_ms)));
    let mut kept: Vec<HealthRow> = Vec::new();
    for (is_old, row) in all {
        let last = kept.last().filter(|last| last.site == row.site);
        let is_news = last.is_none_or(|last| {
            row.time_ms != last.time_ms
                && (row.time_ms - last.time_ms >= EACH_MS || !says_the_same(last, &row))
        });
        if is_old || is_news {
            kept.push(row);
        }
    }
    limited(kept, |row| &row.site)
}

/// Whether two states of a sensor differ in nothing but counters and temperature.
fn says_the_same(a: &HealthRow, b: &HealthRow) -> bool {
    let of = |row: &HealthRow| HealthRow {
        time_ms: 0,
        uptime_s: 0,
        frames: [0; 5],
        windows: row.windows.map(|count| i64::from(count > 0)),
        enclosure_c: None,
        density_difference: None,
        ..row.clone()
    };
    of(a) == of(b)
}

fn with_places(mut all: Vec<PlaceRow>, new: BTreeMap<String, Vec<PlaceRow>>) -> Vec<PlaceRow> {
    for row in new.into_values().flatten() {
        let latest = all.iter().filter(|old| old.site == row.site).max_by_key(|old| old.since_ms);
        let is_news = latest.is_none_or(|old| {
            // A replay tells of a place that a later window has already changed.
            row.since_ms > old.since_ms && (old.place != row.place || old.lanes != row.lanes)
        });
        if is_news {
            all.push(row);
        }
    }
    all.sort_by(|a, b| (&a.site, a.since_ms).cmp(&(&b.site, b.since_ms)));
    limited(all, |row| &row.site)
}

/// At most [`MOST_A_DAY`] rows of a site, the first ones.
fn limited<R>(rows: Vec<R>, site: impl Fn(&R) -> &String) -> Vec<R> {
    let mut counts = BTreeMap::<String, usize>::new();
    let mut rows = rows;
    rows.retain(|row| {
        let count = counts.entry(site(row).clone()).or_default();
        *count += 1;
        *count <= MOST_A_DAY
    });
    rows
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::message::read_any;
    use crate::message::tests::{alarm, health, message};

    fn merged(root: &Path, texts: &[String]) -> Vec<String> {
        let mut events = Events::default();
        texts.iter().for_each(|text| events.take(&read_any(text.as_bytes()).unwrap()));
        events.merge(root).unwrap()
    }

    #[test]
    fn an_alarm_stands_once_however_often_it_comes() {
        let folder = tempfile::tempdir().unwrap();
        let root = folder.path();
        let raised = alarm("a", "camera_moved", true, "2026-01-05T08:00:00.000Z");
        let over = alarm("a", "camera_moved", false, "2026-01-05T09:00:00.000Z");
        let other = alarm("b", "no_picture", true, "2026-01-06T00:00:00.000Z");
        merged(root, &[over.clone(), raised.clone(), raised.clone()]);
        merged(root, &[raised, over, other]);
        let rows: Vec<AlarmRow> = events::read_table(&events::alarms_path(root, 20_458)).unwrap();
        let told: Vec<_> = rows.iter().map(|row| (row.time_ms, row.active)).collect();
        assert_eq!(told, [(1_767_600_000_000, true), (1_767_603_600_000, false)]);
        let rows: Vec<AlarmRow> = events::read_table(&events::alarms_path(root, 20_459)).unwrap();
        assert_eq!(rows.len(), 1);
    }

    #[test]
    fn states_are_kept_that_say_something_new() {
        let folder = tempfile::tempdir().unwrap();
        let root = folder.path();
        let at = |minute: u32, synced| {
            health("a", &format!("2026-01-05T08:{minute:02}:00.000Z"), synced)
        };
        let texts: Vec<_> = (0..40).map(|minute| at(minute, minute != 7)).collect();
        merged(root, &texts[..20]);
        merged(root, &texts[10..]);
        let path = events::health_path(root, 20_458);
        let rows: Vec<HealthRow> = events::read_table(&path).unwrap();
        let minutes: Vec<_> =
            rows.iter().map(|row| (row.time_ms - 1_767_600_000_000) / 60_000).collect();
        // The first, the clock lost, the clock back, and one each quarter of an hour.
        assert_eq!(minutes, [0, 7, 8, 23, 38]);
        // A damaged table is moved aside and begins again.
        std::fs::write(&path, b"other").unwrap();
        let told = merged(root, &texts[..1]);
        assert!(told[0].contains("it was moved to"), "{told:?}");
        assert_eq!(events::read_table::<HealthRow>(&path).unwrap().len(), 1);
    }

    #[test]
    fn a_place_is_kept_when_it_changes() {
        let folder = tempfile::tempdir().unwrap();
        let root = folder.path();
        let at = |seq: u64, latitude: &str| {
            let place = format!(
                "\"schema\":2,\"place\":{{\"name\":\"Siu Lam\",\"latitude\":{latitude},\"longitude\":114}}"
            );
            let text = message("a", seq, &format!("2026-01-05T08:{seq:02}:00.000Z"));
            text.replacen("\"schema\":1", &place, 1)
        };
        merged(root, &[at(1, "22.5"), at(2, "22.5"), at(3, "22.6")]);
        merged(root, &[at(4, "22.6"), at(2, "22.5")]);
        let rows: Vec<PlaceRow> = events::read_table(&events::places_path(root)).unwrap();
        let latitudes: Vec<_> = rows.iter().map(|row| row.place.latitude).collect();
        assert_eq!(latitudes, [Some(22.5), Some(22.6)]);
    }
}
