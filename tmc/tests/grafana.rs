//! The dashboards: as Grafana's own JSON has them, and every query names what the exporter has.
//!
//! Grafana is in no registry that the tests reach: its programs are not run here. What is checked is
//! its published schema (grafana-foundation-sdk) and what its documentation says of the JSON model and
//! of provisioning. That the archive answers what its dashboard asks is in `morning.rs`.

use serde_json::Value;
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::process::Command;
use verge_tmc::exporter::FAMILIES;

/// The dashboard that asks the archive, not Prometheus.
const PAST: &str = "past.json";

fn grafana(path: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("grafana").join(path)
}

fn dashboards() -> Vec<(String, Value)> {
    let folder = std::fs::read_dir(grafana("dashboards")).expect("it ships");
    folder
        .map(|entry| {
            let path = entry.expect("an entry").path();
            let text = std::fs::read_to_string(&path).expect("it can be read");
            let name = path.file_name().expect("a name").to_string_lossy().into_owned();
            (name, serde_json::from_str(&text).expect("JSON"))
        })
        .collect()
}

/// Every text under a key named `expr`, `query` or `definition`.
fn queries(value: &Value, found: &mut Vec<String>) {
    match value {
        Value::Object(fields) => {
            for (key, value) in fields {
                match value {
                    Value::String(text) if ["expr", "query", "definition"].contains(&&**key) => {
                        found.push(text.clone());
                    }
                    _ => queries(value, found),
                }
            }
        }
        Value::Array(items) => items.iter().for_each(|item| queries(item, found)),
        _ => {}
    }
}

/// Names of metrics in a query.
fn metrics(query: &str) -> Vec<&str> {
    query
        .split(|c: char| !c.is_ascii_alphanumeric() && c != '_')
        .filter(|word| word.starts_with("verge_"))
        .collect()
}

#[test]
fn every_query_names_a_metric_of_the_exporter() {
    let families: BTreeSet<&str> = FAMILIES.iter().map(|(name, ..)| *name).collect();
    assert_eq!(families.len(), FAMILIES.len(), "a family twice");
    let mut seen = BTreeSet::new();
    for (file, dashboard) in dashboards().into_iter().filter(|(file, _)| file != PAST) {
        let mut all = Vec::new();
        queries(&dashboard, &mut all);
        assert!(all.len() > 8, "{file}: {} queries", all.len());
        for query in &all {
            let named = metrics(query);
            assert!(!named.is_empty(), "{file}: {query} names no metric");
            for metric in named {
                assert!(families.contains(metric), "{file}: {query}: no {metric}");
                seen.insert(metric.to_owned());
            }
            let balanced = |open: char, close: char| {
                query.matches(open).count() == query.matches(close).count()
            };
            assert!(balanced('(', ')') && balanced('{', '}') && balanced('[', ']'), "{query}");
        }
    }
    assert!(seen.len() >= 12, "{seen:?}");
}

#[test]
fn dashboards_are_as_grafana_has_them() {
    let mut uids = BTreeSet::new();
    for (file, dashboard) in dashboards() {
        let source = if file == PAST { "verge-archive" } else { "verge-prometheus" };
        assert!(uids.insert(dashboard["uid"].to_string()), "{file}: its uid is another's");
        for key in ["uid", "title", "timezone", "refresh", "description"] {
            assert!(dashboard[key].is_string(), "{file}: {key}");
        }
        assert!(dashboard["schemaVersion"].as_u64().is_some_and(|version| version >= 36));
        assert!(dashboard["id"].is_null(), "{file}: an id is of one installation");
        let variables: BTreeSet<&str> = dashboard["templating"]["list"]
            .as_array()
            .expect("a list")
            .iter()
            .map(|variable| variable["name"].as_str().expect("a name"))
            .collect();
        let (mut ids, mut taken) = (BTreeSet::new(), BTreeSet::new());
        for panel in dashboard["panels"].as_array().expect("panels") {
            let title = panel["title"].as_str().expect("a title");
            assert!(ids.insert(panel["id"].as_u64().expect("an id")), "{title}: its id");
            let known = ["timeseries", "stat", "table", "geomap"];
            assert!(known.contains(&panel["type"].as_str().expect("a type")), "{title}");
            assert_eq!(panel["datasource"]["uid"], source, "{title}");
            assert!(panel["fieldConfig"]["defaults"].is_object(), "{title}");
            // 24 columns, and no panel on another.
            let at = |key: &str| panel["gridPos"][key].as_u64().expect("a number");
            assert!(at("w") > 0 && at("x") + at("w") <= 24, "{title}");
            for x in at("x")..at("x") + at("w") {
                for y in at("y")..at("y") + at("h") {
                    assert!(taken.insert((x, y)), "{title} lies on another panel");
                }
            }
            let mut references = BTreeSet::new();
            for target in panel["targets"].as_array().expect("targets") {
                assert_eq!(target["datasource"]["uid"], source, "{title}");
                let name = target["refId"].as_str().expect("a reference");
                assert!(references.insert(name), "{title}: {name} twice");
                let key = if file == PAST { "url" } else { "expr" };
                let expression = target[key].as_str().expect("a query");
                for word in expression.split('$').skip(1) {
                    let word = word.trim_start_matches('{');
                    let end = word.find(|c: char| !c.is_ascii_alphanumeric() && c != '_');
                    let name = &word[..end.unwrap_or(word.len())];
                    // Two underscores are Grafana's own.
                    let known = name.starts_with("__") || variables.contains(name);
                    assert!(known, "{title}: ${name}");
                }
            }
        }
    }
}

#[test]
fn dashboards_are_of_grafanas_published_schema() {
    let has = Command::new("python3").args(["-c", "import grafana_foundation_sdk"]).output();
    if !has.is_ok_and(|output| output.status.success()) {
        return verge_desk::skip("python3 with grafana-foundation-sdk is not installed");
    }
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/grafana/schema.py");
    let check = |files: &[PathBuf]| {
        let output = Command::new("python3").arg(script).args(files).output().expect("it runs");
        (output.status.success(), String::from_utf8_lossy(&output.stderr).into_owned())
    };
    let files: Vec<_> =
        dashboards().iter().map(|(name, _)| grafana("dashboards").join(name)).collect();
    assert_eq!(check(&files), (true, String::new()));
    // A name that Grafana does not know is found.
    let folder = tempfile::tempdir().expect("a folder");
    let wrong = folder.path().join("wrong.json");
    let text = std::fs::read_to_string(&files[0]).expect("it can be read");
    std::fs::write(&wrong, text.replacen("\"gridPos\"", "\"gridpos\"", 1)).expect("writing it");
    let (passed, said) = check(&[wrong]);
    assert!(!passed && said.contains("gridpos: the schema does not know it"), "{said}");
}

#[test]
fn provisioning_names_what_there_is() {
    let read = |path: &str| std::fs::read_to_string(grafana(path)).expect("it ships");
    let source = read("provisioning/datasources/verge.yaml");
    for part in ["apiVersion: 1", "uid: verge-prometheus", "uid: verge-archive"] {
        assert!(source.contains(part), "{part}");
    }
    let provider = read("provisioning/dashboards/verge.yaml");
    assert!(provider.contains("path: $VERGE_GRAFANA/dashboards"));
    let start = read("start");
    assert!(start.contains("VERGE_GRAFANA=$here") && start.contains("dashboards/network.json"));
    // The exporter's own default, Prometheus' target and the script agree.
    for text in [&read("prometheus.yml"), &start] {
        assert!(text.contains("127.0.0.1:9187"));
    }
    assert!(source.contains("url: http://127.0.0.1:8088") && start.contains("--port 8088"));
    let syntax = Command::new("bash").arg("-n").arg(grafana("start")).status();
    assert!(syntax.expect("bash runs").success());
}
