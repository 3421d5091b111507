//! The documents that are generated: the JSON Schema of each message, and the AsyncAPI
//! document over all topics.
//!
//! Owns what they have beyond the types: titles, addresses and how channels are retained.
//! `--example documents` writes them below `docs/reference/`.

use crate::{Alarm, AlarmMessage, Density, Health, Presence, Topic, window_name};
use schemars::generate::SchemaSettings;
use schemars::transform::RecursiveTransform;
use schemars::{JsonSchema, Schema};
use serde_json::{Map, Value, json};
use std::time::Duration;

/// A file below `docs/reference/`, and its content.
pub type Document = (String, Value);

/// All documents.
pub fn documents() -> Vec<Document> {
    vec![
        schema::<AlarmMessage>("alarm"),
        schema::<Density>("density"),
        schema::<Health>("health"),
        schema::<Presence>("presence"),
        ("asyncapi.json".into(), asyncapi()),
    ]
}

/// A document as it is written.
pub fn text(document: &Value) -> String {
    serde_json::to_string_pretty(document).expect("it has string keys") + "\n"
}

fn schema_file(name: &str) -> String {
    format!("schemas/{name}.schema.json")
}

fn schema<T: JsonSchema>(name: &str) -> Document {
    let settings = SchemaSettings::draft2020_12()
        .for_serialize()
        .with_transform(RecursiveTransform(as_published));
    let schema = settings.into_generator().into_root_schema_for::<T>();
    (schema_file(name), schema.to_value())
}

/// Nothing but the fields that are named is published; one that was added later need not be
/// there; a list of constants is an enum; `format` tells nothing that the bounds do not.
fn as_published(schema: &mut Schema) {
    let Some(object) = schema.as_object_mut() else { return };
    object.remove("format");
    one_line(object);
    constants(object);
    let Some(Value::Object(properties)) = object.get_mut("properties") else { return };
    let mut added = Vec::new();
    for (name, property) in properties {
        let Some(since) = property.as_object_mut().and_then(|p| p.remove("x-since")) else {
            continue;
        };
        let since = since.as_str().unwrap_or_default();
        let described = property["description"].as_str().unwrap_or_default();
        let text = format!("{described} Absent in messages of versions before {since}.");
        property["description"] = text.trim().into();
        added.push(Value::from(name.as_str()));
    }
    if let Some(Value::Array(required)) = object.get_mut("required") {
        required.retain(|name| !added.contains(name));
    }
    object.insert("additionalProperties".into(), false.into());
}

/// Comments are wrapped; descriptions are not.
fn one_line(object: &mut Map<String, Value>) {
    if let Some(Value::String(text)) = object.get_mut("description") {
        *text = text.split_whitespace().collect::<Vec<_>>().join(" ");
    }
}

/// `oneOf` with a described constant each, as an `enum` of them.
fn constants(object: &mut Map<String, Value>) {
    let Some(Value::Array(variants)) = object.get("oneOf") else { return };
    let values: Option<Vec<Value>> = variants.iter().map(|one| one.get("const").cloned()).collect();
    if let Some(values) = values {
        object.remove("oneOf");
        object.insert("type".into(), "string".into());
        object.insert("enum".into(), values.into());
    }
}

/// A channel: its name, topic, message and what it is for.
struct Channel {
    name: &'static str,
    topic: Topic,
    message: &'static str,
    description: &'static str,
}

fn channels() -> [Channel; 6] {
    // The address states the kind; which one is a parameter of it.
    let (window, alarm) = (Duration::from_secs(60), Alarm::NoPicture);
    [
        Channel {
            name: "presence",
            topic: Topic::Presence,
            message: "presence",
            description: "Whether the sensor is there.",
        },
        Channel {
            name: "density",
            topic: Topic::Density(window),
            message: "density",
            description: "One message a window, as it closes. Its payload is JSON, or with \
                `mqtt.format = \"postcard\"` the binary form of src/wire.rs.",
        },
        Channel {
            name: "latest",
            topic: Topic::Latest(window),
            message: "density",
            description: "The latest live window of each length, the same bytes as on `density`, \
                for those who come later. Absent with `mqtt.latest = false`.",
        },
        Channel {
            name: "replay",
            topic: Topic::Replay(window),
            message: "density",
            description: "Windows that were measured while the broker was away, at a limited \
                rate, with the `seq` that they would have had live. `done` is true in the last \
                one.",
        },
        Channel {
            name: "health",
            topic: Topic::Health,
            message: "health",
            description: "The state of the sensor: at start, each minute, and when the status \
                changes.",
        },
        Channel {
            name: "alarm",
            topic: Topic::Alarm(alarm),
            message: "alarm",
            description: "An alarm, when it is raised and when it is over.",
        },
    ]
}

/// A topic's address, and the parameters in it.
fn address(topic: Topic) -> (String, Value) {
    let root = json!({ "$ref": "#/components/parameters/root" });
    let window = json!({ "$ref": "#/components/parameters/window" });
    let concrete = topic.under("{root}");
    let (kind, _) = concrete.rsplit_once('/').unwrap_or_default();
    match topic {
        Topic::Presence | Topic::Health => (concrete, json!({ "root": root })),
        Topic::Density(_) | Topic::Latest(_) | Topic::Replay(_) => {
            (format!("{kind}/{{window}}"), json!({ "root": root, "window": window }))
        }
        Topic::Alarm(_) => {
            let names = Alarm::ALL.map(Alarm::name);
            let alarm = json!({ "description": "Which alarm.", "enum": names });
            (format!("{kind}/{{alarm}}"), json!({ "root": root, "alarm": alarm }))
        }
    }
}

fn asyncapi() -> Value {
    let (mut all, mut operations, mut messages) = (Map::new(), Map::new(), Map::new());
    for Channel { name, topic, message, description } in channels() {
        let (address, parameters) = address(topic);
        let reference = json!({ "$ref": format!("#/components/messages/{message}") });
        all.insert(
            name.into(),
            json!({
                "address": address,
                "description": description,
                "parameters": parameters,
                "messages": { message: reference },
            }),
        );
        let binding = if topic.is_retained() { "retained" } else { "passing" };
        let initial = name[..1].to_uppercase();
        operations.insert(
            format!("send{initial}{}", &name[1..]),
            json!({
                "action": "send",
                "channel": { "$ref": format!("#/channels/{name}") },
                "bindings": { "$ref": format!("#/components/operationBindings/{binding}") },
            }),
        );
        messages.insert(message.into(), described_message(message));
    }
    let windows = [20, 60, 300, 900].map(|seconds| window_name(Duration::from_secs(seconds)));
    let binding =
        |retain: bool| json!({ "mqtt": { "qos": 1, "retain": retain, "bindingVersion": "0.2.0" } });
    json!({
        "asyncapi": "3.0.0",
        "info": {
            "title": "verge",
            "version": crate::SCHEMA.to_string(),
            "description": "What a density sensor publishes over MQTT. It subscribes to nothing. \
                Discovery messages for Home Assistant, where asked for, stand outside the root \
                (docs/reference/formats.md). All messages have QoS 1 and may arrive twice: \
                `seq` tells.",
            "license": { "name": "Apache-2.0 OR MIT" },
        },
        "defaultContentType": "application/json",
        "channels": all,
        "operations": operations,
        "components": {
            "parameters": {
                "root": {
                    "description": "Topic under which a site's topics stand, `mqtt.root`.",
                    "default": "verge/<site>",
                    "examples": ["verge/k109f"],
                },
                "window": {
                    "description": "Length of the window: seconds below five minutes, else whole \
                        minutes where it is some.",
                    "examples": windows,
                },
            },
            "messages": messages,
            "operationBindings": { "passing": binding(false), "retained": binding(true) },
        },
    })
}

fn described_message(name: &str) -> Value {
    let mut message = json!({
        "payload": {
            "schemaFormat": "application/schema+json;version=draft-2020-12",
            "schema": { "$ref": format!("./{}", schema_file(name)) },
        },
    });
    if name == "presence" {
        message["contentType"] = "text/plain".into();
    }
    message
}
