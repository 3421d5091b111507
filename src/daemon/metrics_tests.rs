//! The Prometheus file: what it says, and that its page names every family.

use super::*;
use crate::daemon::publish::payload::{Board, BoardFaults, Frames, Messages, Schema, Stream};
use crate::density::SampleZoneStatus;
use crate::units::{Direction, LaneId, UtcMs};
use std::collections::{BTreeSet, HashMap};

fn report() -> WindowReport {
    let lane = |number, density| LaneReport {
        lane: LaneId::new(number).expect("in range"),
        direction: Direction::Away,
        density_veh_km: density,
        density_se: density,
        vehicles_mean: density,
        by_class: None,
        space_occupancy: None,
        length_m: 100.5,
        frames_used: 45,
        frames_expected: 60,
        status: SampleZoneStatus::Ok,
        cells: None,
        error: None,
        traffic: None,
    };
    WindowReport {
        from: UtcMs(1_767_600_000_000),
        to: UtcMs(1_767_600_060_000),
        lanes: [lane(1, Some(20.25)), lane(2, None)].into_iter().collect(),
    }
}

fn health() -> Health {
    Health {
        schema: Schema::default(),
        site: "a \"b\" \\".into(),
        time: verge_messages::Utc(1_767_600_000_000),
        version: "0.1.0".into(),
        status: Status::PoorContrast,
        alarm: Some(verge_messages::Alarm::NoPicture),
        uptime_s: 75,
        clock_synced: true,
        frames: Frames { measured: 7, unchanged: 1, damaged: 2, missing: 3, withheld: 8 },
        stream: Stream::default(),
        camera: None,
        traffic: None,
        board: Board {
            enclosure_c: None,
            pace: crate::daemon::publish::payload::Pace::Half,
            faults: BoardFaults::default(),
            last_fault: None,
        },
        stage_faults: 0,
        messages: Messages { delivered: 4, waiting: 5, dropped: 6, ..Messages::default() },
        certificate_days: Some(300),
        node_windows_lost: Some(2),
        last_fault: None,
    }
}

/// The samples by name with labels. Panics on what Prometheus would refuse.
fn parsed(text: &str) -> HashMap<String, f64> {
    let mut samples = HashMap::new();
    let (mut family, mut families) = (String::new(), BTreeSet::new());
    let mut lines = text.lines();
    while let Some(line) = lines.next() {
        if let Some(help) = line.strip_prefix("# HELP ") {
            let (name, help) = help.split_once(' ').expect("a name and its help");
            assert!(!help.is_empty() && families.insert(name.to_owned()), "{name} twice");
            let kind = lines.next().and_then(|line| line.strip_prefix("# TYPE "));
            let (typed, kind) = kind.and_then(|line| line.split_once(' ')).expect("a type");
            assert_eq!(typed, name);
            let total = name.ends_with("_total");
            assert_eq!(kind, if total { "counter" } else { "gauge" }, "{name}");
            family = name.to_owned();
            continue;
        }
        let (series, value) = line.rsplit_once(' ').expect("a series and its value");
        let name = series.split('{').next().expect("a name");
        assert_eq!(name, family, "samples stand under their family");
        assert!(name.chars().all(|c| c.is_ascii_lowercase() || c == '_'), "{name}");
        if let Some(labels) = series.strip_prefix(name).filter(|labels| !labels.is_empty()) {
            assert!(labels.starts_with('{') && labels.ends_with("\"}"), "{labels}");
        }
        let value = value.parse().expect("a number");
        assert!(samples.insert(series.to_owned(), value).is_none(), "{series} twice");
    }
    samples
}

#[test]
fn the_file_parses_and_says_what_is_known() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("verge.prom");
    let mut metrics = Metrics::new(&path);
    metrics.note(&report());
    metrics.note_turn(Duration::from_millis(125));
    metrics.write(&health(), &[Alarm::NoPicture, Alarm::Overheated], true);
    let text = std::fs::read_to_string(&path).expect("written");
    assert!(text.ends_with('\n') && !text.contains("\n\n"));
    let mode = std::os::unix::fs::MetadataExt::mode(&path.metadata().expect("written"));
    assert_eq!(mode & 0o777, 0o644, "node_exporter runs as another user");
    let samples = parsed(&text);
    let density = "verge_lane_density_vehicles_per_kilometre";
    for (series, value) in [
        ("verge_build_info{version=\"0.1.0\"}", 1.0),
        ("verge_uptime_seconds", 75.0),
        ("verge_clock_synchronized", 1.0),
        ("verge_broker_connected", 1.0),
        ("verge_status{status=\"oK\"}", 0.0),
        ("verge_status{status=\"poorContrast\"}", 1.0),
        ("verge_alarm_active{alarm=\"no_picture\"}", 1.0),
        ("verge_alarm_active{alarm=\"overheated\"}", 1.0),
        ("verge_alarm_active{alarm=\"board_fault\"}", 0.0),
        ("verge_alarm_active{alarm=\"frozen_picture\"}", 0.0),
        ("verge_alarm_active{alarm=\"camera_moved\"}", 0.0),
        ("verge_frames_total{outcome=\"missing\"}", 3.0),
        ("verge_frames_total{outcome=\"withheld\"}", 8.0),
        ("verge_messages_delivered_total", 4.0),
        ("verge_messages_waiting", 5.0),
        ("verge_messages_dropped_total", 6.0),
        ("verge_turn_duration_seconds", 0.125),
        ("verge_window_end_timestamp_seconds{window=\"60s\"}", 1_767_600_060.0),
        (&format!("{density}{{window=\"60s\",lane=\"1\",direction=\"away\"}}"), 20.25),
        ("verge_lane_completeness_ratio{window=\"60s\",lane=\"2\",direction=\"away\"}", 0.75),
    ] {
        let (name, labels) = series.split_once('{').unwrap_or((series, "}"));
        let comma = if labels == "}" { "" } else { "," };
        let series = format!("{name}{{site=\"a \\\"b\\\" \\\\\"{comma}{labels}");
        assert_eq!(samples.get(&series), Some(&value), "{series} in\n{text}");
    }
    let densities = samples.keys().filter(|series| series.starts_with(density)).count();
    assert_eq!(densities, 1, "a lane without density has no sample");
}

#[test]
fn the_reference_has_every_family() {
    let mut metrics = Metrics::new(Path::new("nowhere"));
    metrics.note(&report());
    metrics.note_turn(Duration::from_millis(125));
    let text = metrics.text(&health(), &Alarm::ALL, true);
    let mut page = String::from(
        "# Metrics\n\nWith `metrics.file` the daemon writes a file for the `textfile` \
         collector of node_exporter with each health message (each minute, and when the \
         status changes), whole or not at all; no socket is opened for it. A lane without \
         density has no sample; flow, speed, occupancy in time and queues are there where \
         vehicles are followed, the days of certificates with TLS, windows lost to a node with \
         one.\n\n\
         | metric | type | labels | what it is |\n|---|---|---|---|\n",
    );
    for family in text.split("# HELP ").skip(1) {
        let (name, help) = family.split_once(' ').expect("a name and its help");
        let (help, rest) = help.split_once('\n').expect("its own line");
        let kind = rest.lines().next().and_then(|line| line.rsplit(' ').next());
        let labels: BTreeSet<&str> = rest
            .lines()
            .skip(1)
            .filter_map(|line| line.split_once('{'))
            .flat_map(|(_, labels)| labels.split(','))
            .filter_map(|label| label.split_once("=\"").map(|(name, _)| name))
            .collect();
        // Families of lanes have the same labels, with a value in this window or without.
        let of_lanes = BTreeSet::from(["direction", "lane", "site", "window"]);
        let labels = if name.starts_with("verge_lane_") { of_lanes } else { labels };
        let labels: Vec<String> = labels.iter().map(|label| format!("`{label}`")).collect();
        let _ = writeln!(
            page,
            "| `{name}` | {} | {} | {help} |",
            kind.unwrap_or_default(),
            labels.join(", ")
        );
    }
    verge_desk::hold("metrics.md", &page);
}

#[test]
fn a_file_that_cannot_be_written_stops_nothing() {
    let mut metrics = Metrics::new(Path::new("/proc/no/such/folder/verge.prom"));
    metrics.write(&health(), &[], false);
    metrics.write(&health(), &[], false);
    assert!(metrics.failed);
}

#[test]
fn what_node_exporter_would_not_find_is_told() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let mode = |mode| {
        let mode = std::fs::Permissions::from_mode(mode);
        std::fs::set_permissions(folder.path(), mode).expect("chmod");
    };
    let file = folder.path().join("verge.prom");
    mode(0o755);
    assert_eq!(unseen(&file), None);
    let said = unseen(&folder.path().join("metrics.txt")).expect("another ending");
    assert!(said.contains(".prom"), "{said}");
    mode(0o750);
    assert!(unseen(&file).is_some_and(|said| said.contains("closed to other users")));
}

#[test]
fn the_file_is_for_everybody_and_a_link_to_it_stays() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let (link, file) = (folder.path().join("link.prom"), folder.path().join("own/verge.prom"));
    std::fs::create_dir(folder.path().join("own")).expect("made");
    std::os::unix::fs::symlink("own/verge.prom", &link).expect("a link");
    for _ in 0..2 {
        Metrics::new(&link).try_write(&health(), &[], true).expect("written");
        let there = std::fs::symlink_metadata(&file).expect("where the link leads");
        assert!(there.is_file() && there.permissions().mode() & 0o777 == 0o644);
        assert!(std::fs::symlink_metadata(&link).expect("there").is_symlink());
    }
}
