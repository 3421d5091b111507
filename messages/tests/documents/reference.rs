//! The handbook's page of topics and messages, from the documents that the types generate.

use serde_json::Value;
use std::fmt::Write;
use verge_messages::Status;
use verge_messages::asyncapi::documents;

/// The page.
pub fn page() -> String {
    let mut text = String::from(
        "# Topics and messages\n\nEverything is published under one topic, `mqtt.root` \
         (`verge/<site>` unless it is set), with QoS 1. The sensor subscribes to nothing. A \
         message may arrive twice; `seq` tells. What is not known is `null`, never 0.\n\n\
         [asyncapi.json](asyncapi.json) has the same for programs, in AsyncAPI 3, and \
         [schemas/](schemas/) the JSON Schema of each message.\n\n## Topics\n\n",
    );
    let documents = documents();
    let find =
        |name: &str| documents.iter().find(|(path, _)| path.contains(name)).map(|(_, value)| value);
    topics(&mut text, find("asyncapi").expect("it is generated"));
    statuses(&mut text);
    for name in ["density", "health", "alarm"] {
        let schema = find(&format!("/{name}.")).expect("it is generated");
        let _ = writeln!(text, "## The {name} message\n\n{}\n", description(schema));
        let _ = writeln!(text, "| field | type | what it is |\n|---|---|---|");
        fields(&mut text, schema, schema, "");
        text.push('\n');
    }
    let presence = find("/presence.").expect("it is generated");
    let _ = writeln!(text, "## Presence\n\n{}", description(presence));
    text
}

fn topics(text: &mut String, api: &Value) {
    let _ = writeln!(text, "| topic | retained | what comes there |\n|---|---|---|");
    let operations = api["operations"].as_object().expect("an object");
    for (name, channel) in api["channels"].as_object().expect("an object") {
        let send = operations.values().find(|operation| {
            operation["channel"]["$ref"].as_str().is_some_and(|to| to.ends_with(name.as_str()))
        });
        let binding = send.and_then(|send| send["bindings"]["$ref"].as_str()).unwrap_or_default();
        let retained = if binding.ends_with("retained") { "yes" } else { "no" };
        let address = channel["address"]
            .as_str()
            .unwrap_or_default()
            .replace("{root}/", "")
            .replace("{alarm}", "{name}");
        let address = address.replace('{', "<").replace('}', ">");
        let _ = writeln!(text, "| `{address}` | {retained} | {} |", description(channel));
    }
    let window = &api["components"]["parameters"]["window"];
    let examples: Vec<String> = window["examples"]
        .as_array()
        .into_iter()
        .flatten()
        .filter_map(|name| Some(format!("`{}`", name.as_str()?)))
        .collect();
    let _ = writeln!(text, "\n`<window>`: {} {}.\n", description(window), examples.join(", "));
}

fn statuses(text: &mut String) {
    let _ = writeln!(
        text,
        "## Statuses\n\nThe names of NTCIP 1209 `sampleZoneStatus`:\n\n| name | number |\n|---|---|"
    );
    for status in Status::ALL {
        let _ = writeln!(text, "| `{}` | {} |", status.name(), status.number());
    }
    text.push('\n');
}

/// A row for each field of an object, and for those of the objects in it.
fn fields(text: &mut String, root: &Value, object: &Value, path: &str) {
    let required = object["required"].as_array();
    for (name, field) in object["properties"].as_object().into_iter().flatten() {
        let resolved = resolve(root, field);
        let path = format!("{path}{name}");
        let about = description(field);
        let about = if about.is_empty() { description(resolved) } else { about };
        let optional = required.is_none_or(|required| !required.iter().any(|one| one == name));
        let may = if optional { ", may be absent" } else { "" };
        let _ = writeln!(text, "| `{path}` | {}{may} | {about} |", kind(root, field));
        let inner = if resolved["items"].is_null() { resolved } else { &resolved["items"] };
        let brackets = if resolved["items"].is_null() { "" } else { "[]" };
        fields(text, root, resolve(root, inner), &format!("{path}{brackets}."));
    }
}

/// Resolves a schema: behind a reference, or the one of two that is not null.
fn resolve<'s>(root: &'s Value, schema: &'s Value) -> &'s Value {
    if let Some(name) = schema["$ref"].as_str().and_then(|to| to.strip_prefix("#/$defs/")) {
        return &root["$defs"][name];
    }
    match schema["anyOf"].as_array() {
        Some(any) => {
            any.iter().find(|one| one["type"] != "null").map_or(schema, |one| resolve(root, one))
        }
        None => schema,
    }
}

fn kind(root: &Value, schema: &Value) -> String {
    let nullable =
        schema["anyOf"].as_array().is_some_and(|any| any.iter().any(|one| one["type"] == "null"));
    let schema = resolve(root, schema);
    let names = schema["enum"].as_array().map(|names| {
        let names = names.iter().map(|name| match name.as_str() {
            Some(name) => format!("`{name}`"),
            None => name.to_string(),
        });
        names.collect::<Vec<_>>().join(", ")
    });
    let kinds: Vec<&str> = match &schema["type"] {
        Value::String(one) => vec![one],
        Value::Array(many) => many.iter().filter_map(Value::as_str).collect(),
        _ => Vec::new(),
    };
    let bounds = match (&schema["minimum"], &schema["maximum"]) {
        (Value::Number(least), Value::Number(most)) => format!(", {least} to {most}"),
        (Value::Number(least), _) => format!(", from {least}"),
        (_, Value::Number(most)) => format!(", to {most}"),
        _ => String::new(),
    };
    let constant = match &schema["const"] {
        Value::Null => String::new(),
        value => format!("always {value}"),
    };
    let null = if nullable { " or null" } else { "" };
    format!("{}{}{constant}{null}", names.unwrap_or_else(|| kinds.join(" or ")), bounds)
}

fn description(schema: &Value) -> String {
    schema["description"].as_str().unwrap_or_default().replace('|', "\\|")
}
