use super::*;
use crate::units::{Direction, LaneId};

fn made() -> Vec<Announcement> {
    of_site(false)
}

fn of_site(follows: bool) -> Vec<Announcement> {
    let lane = |number| Lane {
        id: LaneId::new(number).expect("in range"),
        direction: Direction::Away,
        length_m: 100.0,
    };
    let windows = [900, 60].map(Duration::from_secs);
    let lanes = [lane(1), lane(2)];
    let site = Site { id: "k 109/f".into(), ..Site::default() };
    announcements("homeassistant", &site, "verge/k109f", &lanes, &windows, follows)
}

#[test]
fn topics_are_those_of_discovery() {
    let topics: Vec<_> = made().into_iter().map(|message| message.topic).collect();
    let expected = [
        "homeassistant/binary_sensor/verge_k_109_f_ID/connectivity/config",
        "homeassistant/sensor/verge_k_109_f_ID/lane1_density/config",
        "homeassistant/sensor/verge_k_109_f_ID/lane2_density/config",
    ];
    assert_eq!(topics, expected.map(|topic| topic.replace("verge_k_109_f_ID", &id())));
}

fn id() -> String {
    device_id("k 109/f")
}

#[test]
fn ids_are_unique_for_any_site() {
    assert_eq!(device_id("k109-F_2"), "verge_k109-F_2", "a plain name stays as it is");
    let long = |end: &str| "a".repeat(47) + end;
    let plain =
        ["k1", "K1", "k_1", "k-1", "_", "__", "-", "k1_lane1_density", &long("a"), &long("b")];
    let odd = [
        "k 1",
        "k/1",
        "k.1",
        "k\u{e4}1",
        "k\u{f6}1",
        "ka\u{308}1",
        "\u{4e2d}",
        "\u{6587}",
        "...",
        "..,",
        "!",
        "?",
        "k1 ",
        &long("."),
        &long(","),
        &"\u{e4}".repeat(24),
    ];
    let mut names: Vec<_> = plain.iter().chain(&odd).map(|name| (*name).to_owned()).collect();
    // Names that are the ids of others, without what stands before each.
    names.extend(odd.map(|name| device_id(name).split_off("verge_".len())));
    let ids: BTreeSet<_> = names.iter().map(|name| device_id(name)).collect();
    assert_eq!(ids.len(), names.len());
    assert!(ids.iter().all(|id| id.is_ascii() && !id.contains(['/', '.', ' '])));
}

#[test]
fn what_was_given_up_is_known_until_the_broker_has_emptied_it() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let all = made();
    let open = || Announced::open(folder.path());
    let topics = |given_up: Vec<Announcement>| -> Vec<String> {
        given_up.into_iter().map(|one| one.topic).collect()
    };
    assert!(open().given_up(&all).is_empty());
    open().note(&all);
    // A lane is gone. A power cut before the broker has taken that forgets nothing.
    let mut announced = open();
    let gone = announced.given_up(&all[..2]);
    assert_eq!(gone, [Announcement { topic: all[2].topic.clone(), payload: Vec::new() }]);
    announced.note(&all[..2]);
    assert_eq!(topics(open().given_up(&all[..2])), [all[2].topic.clone()]);
    let mut announced = open();
    announced.cleared(&topics(gone), &all[..2]);
    assert!(open().given_up(&all[..2]).is_empty(), "another box may have the topic now");
    // Turned off: all of it goes.
    let gone = topics(open().given_up(&[]));
    assert_eq!(gone.len(), 2);
    // Turned on again before that came back: it stays.
    let mut announced = open();
    announced.cleared(&gone, &all[..1]);
    assert_eq!(topics(open().given_up(&[])), [all[0].topic.clone()]);
    announced.cleared(&gone, &[]);
    assert!(open().given_up(&[]).is_empty());
}

#[test]
fn a_file_that_came_to_harm_empties_no_others_topics() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let file = folder.path().join("announced");
    for text in [&b"home/light/config\nverge/k1/health\n#\n\n"[..], b"\xff\0", b""] {
        std::fs::write(&file, text).expect("written");
        assert!(Announced::open(folder.path()).given_up(&[]).is_empty());
    }
    // As the versions before have written it.
    std::fs::write(&file, "ha/sensor/verge_a/lane1_density/config\n").expect("written");
    assert_eq!(Announced::open(folder.path()).given_up(&[]).len(), 1);
}

/// Keys that the documentation of the MQTT `sensor` and `binary_sensor` has.
const DOCUMENTED: [&str; 19] = [
    "availability",
    "device",
    "device_class",
    "entity_category",
    "expire_after",
    "icon",
    "json_attributes_template",
    "json_attributes_topic",
    "name",
    "origin",
    "payload_off",
    "payload_on",
    "qos",
    "state_class",
    "state_topic",
    "suggested_display_precision",
    "unique_id",
    "unit_of_measurement",
    "value_template",
];

#[test]
fn keys_are_documented_and_ids_unique() {
    let mut ids = BTreeSet::new();
    for message in of_site(true) {
        let payload: Value = serde_json::from_slice(&message.payload).expect("JSON");
        for key in payload.as_object().expect("an object").keys() {
            assert!(DOCUMENTED.contains(&key.as_str()), "{key}");
        }
        // Required, and required for a device to be made.
        assert!(payload["state_topic"].is_string() && payload["origin"]["name"].is_string());
        assert_eq!(payload["device"]["identifiers"][0], id());
        assert!(ids.insert(payload["unique_id"].to_string()), "{payload:#}");
    }
}

#[test]
fn a_place_names_device_and_lanes() {
    let lane =
        Lane { id: LaneId::new(2).expect("in range"), direction: Direction::Away, length_m: 1.0 };
    let place = verge_messages::Place {
        name: Some("Siu Lam".into()),
        road: Some("Tuen Mun Road".into()),
        ..Default::default()
    };
    let fast = verge_messages::LaneName { lane: 2, name: Some("Fast lane".into()), order: None };
    let site = Site { id: "k".into(), place: Some(place), lanes: vec![fast] };
    let windows = [Duration::from_secs(60)];
    let all = announcements("homeassistant", &site, "verge/k", &[lane], &windows, false);
    let payload: Value = serde_json::from_slice(&all[1].payload).expect("JSON");
    assert_eq!(payload["device"]["name"], "Siu Lam");
    assert_eq!(payload["device"]["suggested_area"], "Tuen Mun Road");
    assert_eq!(payload["device"]["identifiers"][0], "verge_k", "an id stays");
    assert_eq!(payload["name"], "Fast lane density");
}

#[test]
fn flow_and_speed_are_announced_where_vehicles_are_followed() {
    let all = of_site(true);
    assert_eq!(all.len(), made().len() + 4);
    let speed = all.iter().find(|m| m.topic.contains("lane2_speed")).expect("announced");
    let payload: Value = serde_json::from_slice(&speed.payload).expect("JSON");
    assert_eq!(
        payload["value_template"],
        "{{ value_json.lanes | selectattr('lane', 'eq', 2) | map(attribute='speed_kmh') | first }}"
    );
    assert_eq!(payload["unit_of_measurement"], "km/h");
    assert_eq!(payload["json_attributes_topic"], Value::Null);
}

#[test]
fn a_lane_reads_its_density_from_the_shortest_window() {
    let payload: Value = serde_json::from_slice(&made()[2].payload).expect("JSON");
    assert_eq!(payload["state_topic"], "verge/k109f/density/60s");
    assert_eq!(
        payload["value_template"],
        "{{ value_json.lanes | selectattr('lane', 'eq', 2) | \
         map(attribute='density_veh_km') | first }}"
    );
    assert_eq!(payload["unit_of_measurement"], "veh/km");
    assert_eq!(payload["expire_after"], 180);
    assert_eq!(payload["unique_id"], format!("{}_lane2_density", id()));
}
