//! The files below `docs/reference/` are those that the types generate, and a schema refuses what
//! the check refuses.

// A message with everything in it is one `json!`.
#![recursion_limit = "256"]

mod reference;

use serde_json::{Value, json};
use std::fs;
use std::path::PathBuf;
use verge_messages::asyncapi::documents;
use verge_messages::{Alarm, Density, read};

fn docs(path: &str) -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../docs/reference").join(path)
}

#[test]
fn the_files_are_those_of_the_types() {
    for (path, generated) in documents() {
        let text = fs::read_to_string(docs(&path)).unwrap_or_default();
        let file: Value = serde_json::from_str(&text).unwrap_or_default();
        assert_eq!(
            file, generated,
            "docs/reference/{path} is not what the types say: \
             cargo run -p verge-messages --features schema --example documents"
        );
    }
    let there = fs::read_dir(docs("schemas")).expect("it ships").count();
    assert_eq!(there, documents().len() - 1, "a schema without a type");
}

#[test]
fn each_alarm_has_its_section_and_no_other() {
    let text = fs::read_to_string(docs("alarms.md")).expect("it ships");
    let described: Vec<&str> =
        text.lines().filter_map(|line| line.strip_prefix("## `")?.strip_suffix('`')).collect();
    assert_eq!(described, Alarm::ALL.map(Alarm::name), "docs/reference/alarms.md");
    for section in text.split("\n## ").skip(1) {
        for part in ["- **Raised**", "- **Cause**", "- **Cure**", "- **Over**"] {
            assert!(section.contains(part), "no {part} in {section}");
        }
    }
}

#[test]
fn the_reference_is_that_of_the_types() {
    verge_desk::hold("messages.md", &reference::page());
}

/// A message with everything in it.
fn message() -> Value {
    let sha256 = "0a".repeat(32);
    let place = json!({"name": "Siu Lam", "road": "Tuen Mun Road", "direction": "to Kowloon",
        "latitude": 22.5, "longitude": 114.0, "bearing": 120.0});
    json!({
        "schema": 2, "site": "k109f", "place": place,
        "seq": 7, "window_s": 60,
        "from": "2026-01-05T08:00:00.000Z", "to": "2026-01-05T08:01:00.000Z",
        "clock_synced": true,
        "lanes": [{
            "lane": 1, "lane_name": "slow lane", "lane_order": 1, "direction": "away", "density_veh_km": 24.25, "density_se": 3.5,
            "vehicles_mean": 3.0,
            "by_class": {"vehicle": 0.0, "car": 1.0, "van": 2.0, "bus": 3.0, "truck": 4.0,
                "motorcycle": 5.0},
            "space_occupancy": 0.125, "length_m": 124.0, "frames_used": 57,
            "frames_expected": 60, "status": "oK",
            "cells": {"length_m": 62.0, "density_veh_km": [32.5, 16.0]},
            "density_ci90": [16.0, 32.5], "calibration_se": 0.5, "counting_se": 3.5,
            "traffic_status": "oK", "flow_veh_h": 875.5, "flow_ci90": [800.0, 950.0],
            "speed_kmh": 36.0, "speed_ci90": [34.0, 38.0], "time_occupancy": 0.125,
            "time_occupancy_ci90": [0.0625, 0.25],
            "passed": {"vehicle": 0, "car": 10, "van": 1, "bus": 0, "truck": 1, "motorcycle": 0},
            "section_flow_veh_h": 720.0, "speed_time_mean_kmh": 37.0, "headway_s": 5.0,
            "headway_sd_s": 2.0, "queue_m": 15.0, "queue_max_m": 30.0, "density_difference": -0.5,
        }],
        "calibration": {"id": "c", "sha256": sha256, "rel_err": 0.02},
        "model": {"name": "m", "sha256": sha256},
        "done": true,
    })
}

/// Values that a place with this schema must not hold, from its bounds.
fn wrong_values(schema: &Value) -> Vec<Value> {
    let mut wrong = Vec::new();
    if let Some(least) = schema["minimum"].as_f64() {
        wrong.push(json!(least - 1.0));
    }
    if let Some(least) = schema["exclusiveMinimum"].as_f64() {
        wrong.extend([json!(least), json!(least - 1.0)]);
    }
    if let Some(most) = schema["maximum"].as_f64() {
        wrong.extend([json!(most + 1.0), json!(1e39)]);
    }
    if let Some(most) = schema["maxLength"].as_u64() {
        wrong.push(json!("x".repeat(most as usize + 1)));
    }
    if schema["enum"].is_array() || schema["pattern"].is_string() {
        wrong.push(json!("other"));
    }
    if schema["const"].is_number() {
        wrong.push(json!(4711));
    }
    // A count has no fraction to be written with.
    let integer = schema["type"] == "integer" || schema["type"][0] == "integer";
    let whole = |value: Value| match value.as_f64() {
        Some(number) if integer && number < 1e18 => json!(number as i64),
        _ => value,
    };
    wrong.into_iter().map(whole).collect()
}

/// Every place in `value` with the schema that the document has for it.
fn places(root: &Value, schema: &Value, value: &Value, at: &str, found: &mut Vec<(String, Value)>) {
    let reference = schema["$ref"].as_str().and_then(|path| root.pointer(&path[1..]));
    let schema = reference.unwrap_or(schema);
    let alternatives = schema["anyOf"].as_array();
    let schema = alternatives.and_then(|all| all.first()).unwrap_or(schema);
    let reference = schema["$ref"].as_str().and_then(|path| root.pointer(&path[1..]));
    let schema = reference.unwrap_or(schema);
    found.push((at.to_owned(), schema.clone()));
    match value {
        Value::Object(fields) => {
            for (name, value) in fields {
                let schema = &schema["properties"][name];
                assert!(!schema.is_null(), "{at}/{name} is in the message, not in the schema");
                places(root, schema, value, &format!("{at}/{name}"), found);
            }
            let named = schema["properties"].as_object().expect("an object").len();
            assert_eq!(named, fields.len(), "{at}: the example has every field");
        }
        Value::Array(items) => {
            for (index, item) in items.iter().enumerate() {
                places(root, &schema["items"], item, &format!("{at}/{index}"), found);
            }
        }
        _ => {}
    }
}

fn density_schema() -> Value {
    let all = documents();
    let (_, schema) = all.into_iter().find(|(path, _)| path.contains("density")).expect("it is");
    schema
}

#[test]
fn what_the_schema_refuses_the_check_refuses() {
    let (schema, right) = (density_schema(), message());
    let validator = jsonschema::validator_for(&schema).expect("a right schema");
    let is_read = |value: &Value| read(value.to_string().as_bytes());
    assert!(validator.is_valid(&right), "{:?}", validator.iter_errors(&right).next());
    assert!(is_read(&right).is_ok(), "{:?}", is_read(&right));
    let mut all = Vec::new();
    places(&schema, &schema, &right, "", &mut all);
    let mut tried = 0;
    for (at, schema) in all {
        let mut values = wrong_values(&schema);
        if schema["maxItems"].is_u64() {
            let one = right.pointer(&at).expect("it is there")[0].clone();
            let many = schema["maxItems"].as_u64().expect("a number") as usize + 1;
            values.extend([json!([]), json!(vec![one; many])]);
        }
        for wrong in values {
            let mut message = right.clone();
            *message.pointer_mut(&at).expect("it is there") = wrong.clone();
            assert!(!validator.is_valid(&message), "the schema takes {wrong} at {at}");
            let error = is_read(&message).expect_err(&format!("{wrong} at {at}")).to_string();
            let field = at.rsplit('/').find(|part| part.parse::<usize>().is_err());
            // The parser itself refuses a third bound or (with serde_json's float_roundtrip) a
            // number that does not fit an f32, and gives its position.
            let by_parser = ["there is more text after its end (", "the number is too large ("];
            let known = error.contains(field.unwrap_or_default())
                || by_parser.iter().any(|reason| error.contains(reason));
            assert!(known, "{wrong} at {at}: {error}");
            tried += 1;
        }
    }
    assert!(tried > 60, "{tried} wrong values tried");
}

#[test]
fn each_field_that_is_required_is_missed() {
    let (schema, right) = (density_schema(), message());
    let validator = jsonschema::validator_for(&schema).expect("a right schema");
    let mut all = Vec::new();
    places(&schema, &schema, &right, "", &mut all);
    for (at, schema) in all {
        for name in schema["required"].as_array().into_iter().flatten() {
            let name = name.as_str().expect("a name");
            let mut message = right.clone();
            let object = message.pointer_mut(&at).and_then(Value::as_object_mut);
            object.expect("an object").remove(name);
            assert!(!validator.is_valid(&message), "the schema needs {at}/{name}");
        }
        for (name, property) in schema["properties"].as_object().into_iter().flatten() {
            let is_optional = property["description"]
                .as_str()
                .is_some_and(|text| text.contains("Absent in messages of versions before"));
            let mut message = right.clone();
            let object = message.pointer_mut(&at).and_then(Value::as_object_mut);
            object.expect("an object").remove(name);
            if is_optional {
                assert!(validator.is_valid(&message), "{at}/{name} may be absent");
                assert!(read(message.to_string().as_bytes()).is_ok(), "{at}/{name} may be absent");
            }
        }
    }
}

#[test]
fn what_is_written_is_valid() {
    let message: Density = serde_json::from_value(message()).expect("right");
    let written: Value = serde_json::from_slice(&verge_messages::json(&message)).expect("JSON");
    let schema = density_schema();
    let validator = jsonschema::validator_for(&schema).expect("a right schema");
    assert!(validator.is_valid(&written), "{:?}", validator.iter_errors(&written).next());
}
