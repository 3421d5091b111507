//! `verge-tmc score`: tables by hand, and the street's own truth against itself.

mod common;

use common::{failure, json, succeed, text};
use std::path::Path;

fn write(folder: &Path, name: &str, content: &str) -> std::path::PathBuf {
    let path = folder.join(name);
    std::fs::write(&path, content).expect("writing a file");
    path
}

const TRUTH: &str = "from,lane,density_veh_km\n\
    2026-01-05T08:00:00Z,1,2\n2026-01-05T08:01:00Z,1,10\n\
    2026-01-05T08:00:00Z,2,20\n2026-01-05T08:01:00Z,2,0\n2026-01-05T08:02:00Z,2,5\n";

#[test]
fn two_tables_are_scored_by_lane() {
    let folder = tempfile::tempdir().expect("a folder");
    let truth = write(folder.path(), "truth.csv", TRUTH);
    let density = write(
        folder.path(),
        "density.csv",
        "lane,from,density_veh_km\n1,2026-01-05T08:00:00Z,1\n1,2026-01-05T08:01:00Z,13\n\
         2,2026-01-05T08:00:00Z,20\n2,2026-01-05T08:01:00Z,1\n2,2026-01-05T08:02:00Z,\n\
         2,2026-01-05T09:00:00Z,4\n",
    );
    let args = ["score", "--truth", text(&truth), "--density", text(&density)];
    let found = json(&[&args[..], &["--json"]].concat());
    let near = |found: &serde_json::Value, expected: f64| {
        let found = found.as_f64().expect("a number");
        assert!((found - expected).abs() < 1e-9, "{found}, expected {expected}");
    };
    near(&found["lanes"][0]["rmse_veh_km"], 5f64.sqrt());
    near(&found["lanes"][0]["mae_veh_km"], 2.0);
    near(&found["lanes"][0]["mape_pct"], 40.0);
    near(&found["lanes"][1]["mape_pct"], 0.0);
    near(&found["lanes"][1]["truth_zero"], 1.0);
    near(&found["average"]["mae_veh_km"], 1.25);
    // The road: truth 11 and 5, found 10.5 and 7.
    near(&found["road"]["mae_veh_km"], 1.25);
    near(&found["left_out"]["without_density"], 1.0);
    near(&found["left_out"]["without_truth"], 1.0);
    let table = succeed(&args);
    assert!(table.contains("#1               2     2.24     2.00   40.00 %"), "{table}");
}

#[test]
fn the_streets_truth_is_averaged_over_the_windows() {
    let recording = Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/data/curve/truth.jsonl");
    let folder = tempfile::tempdir().expect("a folder");
    let mut sums = std::collections::BTreeMap::<(String, u64), (f64, f64)>::new();
    for line in std::fs::read_to_string(&recording).expect("it ships").lines() {
        let frame: serde_json::Value = serde_json::from_str(line).expect("JSON");
        let minute = frame["time"].as_str().expect("a time")[..16].to_owned();
        for lane in frame["lanes"].as_array().expect("lanes") {
            let key = (minute.clone(), lane["lane"].as_u64().expect("a number"));
            let sum = sums.entry(key).or_default();
            sum.0 += lane["density_veh_km"].as_f64().expect("a density");
            sum.1 += 1.0;
        }
    }
    // Messages whose densities are the truth and 1 veh/km more.
    let mut messages = String::new();
    let minutes: std::collections::BTreeSet<_> = sums.keys().map(|key| key.0.clone()).collect();
    for (seq, minute) in minutes.iter().enumerate() {
        let lanes: Vec<_> = sums
            .iter()
            .filter(|(key, _)| key.0 == *minute)
            .map(|(key, (sum, n))| {
                serde_json::json!({"lane": key.1, "direction": "away", "density_veh_km": sum / n + 1.0,
                    "density_se": 0.1, "length_m": 50.0, "frames_used": 30,
                    "frames_expected": 30, "status": "oK"})
            })
            .collect();
        let from: jiff::Timestamp = format!("{minute}:00Z").parse().expect("a minute");
        let to = from + jiff::SignedDuration::from_secs(60);
        let sha256 = "0".repeat(64);
        let message = serde_json::json!({"schema": 1, "site": "street", "seq": seq + 1,
            "window_s": 60, "from": from.to_string(), "to": to.to_string(), "clock_synced": true,
            "lanes": lanes, "calibration": {"id": "street", "sha256": sha256, "rel_err": null},
            "model": {"name": "truth", "sha256": sha256}});
        messages += &format!("{message}\n");
    }
    let density = write(folder.path(), "density.jsonl", &messages);
    let args = ["score", "--json", "--truth", text(&recording), "--density", text(&density)];
    let found = json(&args);
    for lane in found["lanes"].as_array().expect("lanes") {
        for name in ["rmse_veh_km", "mae_veh_km"] {
            assert!((lane[name].as_f64().expect("a number") - 1.0).abs() < 1e-3, "{lane}");
        }
    }
    // Estimates without a window length do not go with frame by frame truth.
    let table = write(folder.path(), "a.csv", TRUTH);
    let (code, error) = failure(&["score", "--truth", text(&recording), "--density", text(&table)]);
    assert_eq!(code, 65, "{error}");
    assert!(error.contains("how long a window is"), "{error}");
}

#[test]
fn bad_input_is_said() {
    let folder = tempfile::tempdir().expect("a folder");
    let truth = write(folder.path(), "truth.csv", TRUTH);
    let head = "from,lane,density_veh_km\n";
    for (content, said) in [
        (format!("{head}08:00,1,2\n"), "line 2: column from: \"08:00\" is not a time"),
        (format!("{head}2026-01-05T08:00:00Z,left,2\n"), "column lane: \"left\" is not a lane"),
        (format!("{head}2026-01-05T08:00:00Z,1,-2\n"), "\"-2\" is negative"),
        (format!("{head}{0}{0}", "2026-01-05T08:00:00Z,1,2\n"), "line 3"),
        (format!("{head}2020-01-05T08:00:00Z,1,2\n"), "no window and lane in common"),
        ("{\"schema\":1}\n".into(), "line 1: not a density message: site is missing"),
    ] {
        let density = write(folder.path(), "density", &content);
        let args = ["score", "--truth", text(&truth), "--density", text(&density)];
        let (code, error) = failure(&args);
        assert_eq!(code, 65, "{error}");
        assert!(error.contains(said), "{error}");
    }
}
