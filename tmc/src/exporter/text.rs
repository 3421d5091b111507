//! The latest state of the sites in Prometheus' text format.
//!
//! Owns names and labels: those of the box's own file (docs/reference/formats.md), each with its site. A window
//! that is older than three of its lengths and a quarter of an hour is left out, and so is what is
//! not known; nothing is 0 for want of a value.

use super::state::{Site, State};
use std::fmt::{Display, Write};
use std::time::Duration;
use verge_messages::{Alarm, Density, Lane, Status, Utc, window_name};

/// A window is exported for so many of its lengths.
const WINDOWS: i64 = 3;
/// And so long on top of that, ms.
const PATIENCE_MS: i64 = 15 * 60_000;

/// Every family: name, type, help.
pub const FAMILIES: [(&str, &str, &str); 32] = [
    ("verge_site_info", "gauge", "What people call the site; always 1."),
    ("verge_site_latitude_degrees", "gauge", "Latitude, WGS 84."),
    ("verge_site_longitude_degrees", "gauge", "Longitude, WGS 84."),
    ("verge_up", "gauge", "1: the box is connected to the broker."),
    ("verge_window_end_timestamp_seconds", "gauge", "End of the latest window, since 1970."),
    ("verge_lane_status", "gauge", "Status of the lane, a number of NTCIP 1209; 2 is right."),
    ("verge_lane_density_vehicles_per_kilometre", "gauge", "Density of the latest window."),
    ("verge_lane_density_low90_vehicles_per_kilometre", "gauge", "Low end of its 90 % interval."),
    ("verge_lane_density_high90_vehicles_per_kilometre", "gauge", "High end of its 90 % interval."),
    ("verge_lane_space_occupancy_ratio", "gauge", "Share of the lane that vehicles cover."),
    ("verge_lane_completeness_ratio", "gauge", "Frames used, of those expected."),
    ("verge_lane_length_metres", "gauge", "Length of the lane."),
    ("verge_lane_flow_vehicles_per_hour", "gauge", "Flow of the latest window."),
    ("verge_lane_speed_kilometres_per_hour", "gauge", "Space-mean speed of the latest window."),
    ("verge_lane_time_occupancy_ratio", "gauge", "Share of time that the section is covered."),
    ("verge_lane_queue_metres", "gauge", "Mean length of the longest queue."),
    ("verge_lane_vehicles_passed", "gauge", "Vehicles that passed in the latest window."),
    ("verge_status", "gauge", "1 for the sensor's NTCIP 1209 status, 0 for others."),
    ("verge_alarm_active", "gauge", "1 while the alarm is on."),
    ("verge_clock_synchronized", "gauge", "1: a time source has set the clock."),
    ("verge_health_timestamp_seconds", "gauge", "Time of the latest health, since 1970."),
    ("verge_uptime_seconds", "gauge", "Time since the daemon's start."),
    ("verge_build_info", "gauge", "Version of the sensor; always 1."),
    ("verge_frames_total", "counter", "Pictures, by what became of them."),
    ("verge_messages_delivered_total", "counter", "Messages the broker took."),
    ("verge_messages_dropped_total", "counter", "Windows lost for want of room."),
    ("verge_messages_waiting", "gauge", "Windows that wait for the broker."),
    ("verge_enclosure_celsius", "gauge", "Temperature in the enclosure."),
    ("verge_certificate_days", "gauge", "Days until the first certificate in use ends."),
    ("verge_exporter_connected", "gauge", "1: the exporter's connection to the broker stands."),
    ("verge_exporter_messages_total", "counter", "Messages that came to the exporter."),
    ("verge_exporter_refused_total", "counter", "Messages of them that no box may send."),
];

/// Labels of a sample.
type Labels<'a> = Vec<(&'a str, String)>;

/// The text of a family at a time, from the samples of all sites.
pub(super) fn text(state: &State, now: Utc) -> String {
    let mut out = String::new();
    for (name, kind, help) in FAMILIES {
        let mut family = Family { name, out: String::new() };
        for (site, known) in &state.sites {
            family.of_site(site, known, now);
        }
        family.own(state);
        if !family.out.is_empty() {
            // Writing to a string does not fail.
            let _ = write!(out, "# HELP {name} {help}\n# TYPE {name} {kind}\n{}", family.out);
        }
    }
    out
}

struct Family {
    name: &'static str,
    out: String,
}

impl Family {
    fn sample(&mut self, labels: &[(&str, String)], value: impl Display) {
        let labels: Vec<_> =
            labels.iter().map(|(key, text)| format!("{key}=\"{}\"", escaped(text))).collect();
        let braces =
            if labels.is_empty() { String::new() } else { format!("{{{}}}", labels.join(",")) };
        let _ = writeln!(self.out, "{}{braces} {value}", self.name);
    }

    fn own(&mut self, state: &State) {
        match self.name {
            "verge_exporter_connected" => self.sample(&[], u8::from(state.is_connected)),
            "verge_exporter_messages_total" => self.sample(&[], state.messages),
            "verge_exporter_refused_total" => self.sample(&[], state.refused),
            _ => {}
        }
    }

    fn of_site(&mut self, site: &str, known: &Site, now: Utc) {
        let labels = || vec![("site", site.to_owned())];
        let with = |more: &[(&'static str, &str)]| -> Labels<'_> {
            let mut all = labels();
            all.extend(more.iter().map(|(key, value)| (*key, (*value).to_owned())));
            all
        };
        let latest = known.windows.values().max_by_key(|window| window.to);
        let place = latest.and_then(|window| window.place.as_ref());
        let health = known.health.as_ref();
        match self.name {
            "verge_site_info" => {
                if let Some(place) = place {
                    let text = |word: &Option<String>| word.clone().unwrap_or_default();
                    let (name, road) = (text(&place.name), text(&place.road));
                    let direction = text(&place.direction);
                    let words = [("name", &*name), ("road", &*road), ("direction", &*direction)];
                    self.sample(&with(&words), 1);
                }
            }
            "verge_site_latitude_degrees" => {
                self.known(&labels(), place.and_then(|it| it.latitude))
            }
            "verge_site_longitude_degrees" => {
                self.known(&labels(), place.and_then(|it| it.longitude));
            }
            "verge_up" => self.known(&labels(), known.is_online.map(u8::from)),
            "verge_status" => {
                for status in health.iter().flat_map(|_| Status::ALL) {
                    let is_so = health.is_some_and(|health| health.status == status);
                    self.sample(&with(&[("status", status.name())]), u8::from(is_so));
                }
            }
            "verge_alarm_active" => {
                for alarm in Alarm::ALL {
                    let is_on = known.alarms.contains(alarm.name());
                    self.sample(&with(&[("alarm", alarm.name())]), u8::from(is_on));
                }
            }
            "verge_clock_synchronized" => {
                self.known(&labels(), health.map(|it| u8::from(it.clock_synced)));
            }
            "verge_health_timestamp_seconds" => {
                self.known(&labels(), health.map(|it| it.time.0 as f64 / 1000.0));
            }
            "verge_uptime_seconds" => self.known(&labels(), health.map(|it| it.uptime_s)),
            "verge_build_info" => {
                if let Some(health) = health {
                    self.sample(&with(&[("version", &health.version)]), 1);
                }
            }
            "verge_frames_total" => {
                for (outcome, count) in health.iter().flat_map(|it| {
                    [
                        ("measured", it.frames.measured),
                        ("unchanged", it.frames.unchanged),
                        ("damaged", it.frames.damaged),
                        ("missing", it.frames.missing),
                        ("withheld", it.frames.withheld),
                    ]
                }) {
                    self.sample(&with(&[("outcome", outcome)]), count);
                }
            }
            "verge_messages_delivered_total" => {
                self.known(&labels(), health.map(|it| it.messages.delivered));
            }
            "verge_messages_dropped_total" => {
                self.known(&labels(), health.map(|it| it.messages.dropped));
            }
            "verge_messages_waiting" => {
                self.known(&labels(), health.map(|it| it.messages.waiting));
            }
            "verge_enclosure_celsius" => {
                self.known(&labels(), health.and_then(|it| it.board.enclosure_c));
            }
            "verge_certificate_days" => {
                self.known(&labels(), health.and_then(|it| it.certificate_days));
            }
            _ => {
                for window in known.windows.values() {
                    self.of_window(window, now);
                }
            }
        }
    }

    fn of_window(&mut self, window: &Density, now: Utc) {
        let name = window_name(Duration::from_secs(window.window_s.into()));
        let labels = [("site", window.site.clone()), ("window", name)];
        if self.name == "verge_window_end_timestamp_seconds" {
            self.sample(&labels, window.to.0 as f64 / 1000.0);
            return;
        }
        let length_ms = i64::from(window.window_s) * 1000;
        if now.0 - window.to.0 > WINDOWS * length_ms + PATIENCE_MS {
            return;
        }
        for lane in &window.lanes {
            let mut labels = labels.to_vec();
            labels.push(("lane", lane.lane.to_string()));
            labels.push(("direction", lane.direction.name().to_owned()));
            if let Some(name) = &lane.lane_name {
                labels.push(("lane_name", name.clone()));
            }
            self.known(&labels, self.of_lane(lane));
        }
    }

    fn of_lane(&self, lane: &Lane) -> Option<f32> {
        let traffic = lane.traffic.as_ref();
        match self.name {
            "verge_lane_status" => Some(lane.status.number().into()),
            "verge_lane_density_vehicles_per_kilometre" => lane.density_veh_km,
            "verge_lane_density_low90_vehicles_per_kilometre" => lane.density_ci90.map(|it| it[0]),
            "verge_lane_density_high90_vehicles_per_kilometre" => lane.density_ci90.map(|it| it[1]),
            "verge_lane_space_occupancy_ratio" => lane.space_occupancy,
            "verge_lane_completeness_ratio" => {
                Some(lane.frames_used as f32 / lane.frames_expected.max(1) as f32)
            }
            "verge_lane_length_metres" => Some(lane.length_m),
            "verge_lane_flow_vehicles_per_hour" => traffic?.flow_veh_h,
            "verge_lane_speed_kilometres_per_hour" => traffic?.speed_kmh,
            "verge_lane_time_occupancy_ratio" => traffic?.time_occupancy,
            "verge_lane_queue_metres" => traffic?.queue_m,
            "verge_lane_vehicles_passed" => {
                traffic?.passed.as_ref().map(|passed| passed.all() as f32)
            }
            _ => None,
        }
    }

    fn known(&mut self, labels: &[(&str, String)], value: Option<impl Display>) {
        if let Some(value) = value {
            self.sample(labels, value);
        }
    }
}

/// A label's value: backslash, quote and line end are escaped.
fn escaped(text: &str) -> String {
    text.replace('\\', "\\\\").replace('"', "\\\"").replace('\n', "\\n")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::message::tests::{alarm, health, message};

    const NOW: Utc = Utc(1_767_600_120_000);

    fn state(messages: &[(&str, String)]) -> State {
        let mut state = State::of("verge");
        for (topic, payload) in messages {
            state.take(topic, payload.as_bytes(), NOW);
        }
        state
    }

    #[test]
    fn every_family_is_written_and_says_whose_it_is() {
        let time = "2026-01-05T08:00:00.000Z";
        let place = "\"schema\":2,\"place\":{\"name\":\"Siu \\\"Lam\\\"\",\"latitude\":22.5,\"longitude\":114}";
        let window = message("a", 1, time).replacen("\"schema\":1", place, 1);
        let traffic = "\"status\":\"oK\",\"traffic_status\":\"oK\",\"flow_veh_h\":875.5,\
            \"flow_ci90\":null,\"speed_kmh\":36.5,\"speed_ci90\":null,\"time_occupancy\":0.1,\
            \"time_occupancy_ci90\":null,\"passed\":{\"vehicle\":0,\"car\":10,\"van\":1,\"bus\":0,\
            \"truck\":1,\"motorcycle\":0},\"section_flow_veh_h\":null,\"speed_time_mean_kmh\":null,\
            \"headway_s\":null,\"headway_sd_s\":null,\"queue_m\":15.0,\"queue_max_m\":null,\
            \"density_difference\":null,\"density_ci90\":[10.0,15.0]";
        let window = window.replacen("\"status\":\"oK\"", traffic, 1);
        let state = state(&[
            ("verge/a/latest/60s", window.clone()),
            ("verge/a/health", health("a", time, true).replace("days\":null", "days\":12")),
            ("verge/a/alarm/camera_moved", alarm("a", "camera_moved", true, time)),
            ("verge/a/presence", "online".into()),
            // No site speaks for another, and bytes that are not a message are counted.
            ("verge/b/density/60s", window),
            ("verge/b/health", "{}".into()),
        ]);
        assert_eq!((state.messages, state.refused), (6, 2));
        let out = text(&state, NOW);
        for (name, kind, _) in FAMILIES {
            assert!(out.contains(&format!("# TYPE {name} {kind}\n{name}")), "{name} in\n{out}");
        }
        for line in [
            "verge_site_info{site=\"a\",name=\"Siu \\\"Lam\\\"\",road=\"\",direction=\"\"} 1",
            "verge_lane_density_vehicles_per_kilometre{site=\"a\",window=\"60s\",lane=\"1\",direction=\"away\"} 12.5",
            "verge_lane_status{site=\"a\",window=\"60s\",lane=\"2\",direction=\"away\"} 10",
            "verge_lane_vehicles_passed{site=\"a\",window=\"60s\",lane=\"1\",direction=\"away\"} 12",
            "verge_alarm_active{site=\"a\",alarm=\"camera_moved\"} 1",
            "verge_alarm_active{site=\"a\",alarm=\"no_picture\"} 0",
            "verge_up{site=\"a\"} 1",
            "verge_exporter_refused_total 2",
        ] {
            assert!(out.lines().any(|found| found == line), "{line} in\n{out}");
        }
        let density = "verge_lane_density_vehicles_per_kilometre{";
        assert_eq!(out.matches(density).count(), 1, "a lane without a density has no sample");
        // An hour later the window is old: only its end is exported.
        let later = text(&state, Utc(NOW.0 + 3_600_000));
        assert!(!later.contains(density) && later.contains("verge_window_end_timestamp_seconds{"));
    }

    #[test]
    fn the_latest_window_counts_however_it_comes() {
        let at = |minute: u32| message("a", 1, &format!("2026-01-05T08:{minute:02}:00.000Z"));
        let state = state(&[
            ("verge/a/density/60s", at(1)),
            ("verge/a/latest/60s", at(0)),
            ("verge/a/density/60s", at(40)),
        ]);
        let out = text(&state, NOW);
        assert!(
            out.contains(
                "verge_window_end_timestamp_seconds{site=\"a\",window=\"60s\"} 1767600120\n"
            ),
            "{out}"
        );
        assert_eq!(state.refused, 1, "a window that is to come");
    }
}
