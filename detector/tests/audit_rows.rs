//! The audited frames are whole: every row names a region, every vehicle lies in it, once.

use serde_json::Value;
use std::collections::HashSet;
use std::path::{Path, PathBuf};

fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("data/audit")
}

fn rows(path: &Path) -> Vec<Value> {
    let text = std::fs::read_to_string(path).unwrap();
    text.lines().map(|line| serde_json::from_str(line).unwrap()).collect()
}

fn numbers(list: &Value) -> Vec<f64> {
    let list = list.as_array().unwrap();
    list.iter().filter_map(Value::as_f64).collect()
}

/// Even-odd rule, with `slack` px for points on the edge.
fn inside(polygon: &Value, x: f64, y: f64, slack: f64) -> bool {
    let points: Vec<_> = polygon.as_array().unwrap().iter().map(numbers).collect();
    let mut odd = false;
    for (i, a) in points.iter().enumerate() {
        let b = &points[(i + 1) % points.len()];
        if (a[1] > y) != (b[1] > y) && x < a[0] + (y - a[1]) * (b[0] - a[0]) / (b[1] - a[1]) {
            odd = !odd;
        }
        let (dx, dy) = (b[0] - a[0], b[1] - a[1]);
        let t = ((x - a[0]) * dx + (y - a[1]) * dy) / (dx * dx + dy * dy);
        let t = t.clamp(0.0, 1.0);
        if (x - a[0] - t * dx).hypot(y - a[1] - t * dy) <= slack {
            return true;
        }
    }
    odd
}

#[test]
fn every_vehicle_lies_in_the_region_of_its_frame() {
    let regions = std::fs::read_to_string(folder().join("regions.json")).unwrap();
    let regions: Value = serde_json::from_str(&regions).unwrap();
    let mut frames = HashSet::new();
    let mut vehicles = 0;
    for entry in std::fs::read_dir(folder()).unwrap() {
        let path = entry.unwrap().path();
        if path.extension().is_none_or(|e| e != "jsonl") {
            continue;
        }
        let mut roles = HashSet::new();
        for row in rows(&path) {
            let frame = row["frame"].as_str().unwrap();
            assert!(frames.insert(frame.to_owned()), "{frame} is there twice");
            let camera = row["camera"].as_str().unwrap();
            assert_eq!(path.file_stem().unwrap(), camera, "{frame}");
            assert!(matches!(row["light"].as_str(), Some("day" | "dusk" | "night")));
            roles.insert(row["role"].as_str().unwrap().to_owned());
            let region = &regions[row["region"].as_str().unwrap()];
            let polygons = region["polygons"].as_array().unwrap();
            let size = numbers(&region["size"]);
            for vehicle in row["vehicles"].as_array().unwrap() {
                let at = numbers(vehicle);
                assert!(at[0] < at[2] && at[1] < at[3], "{frame}: {vehicle}");
                assert!(at[0] >= -1.0 && at[2] <= size[0] + 1.0 && at[3] <= size[1] + 1.0);
                let x = (at[0] + at[2]) / 2.0;
                let held = polygons.iter().any(|p| inside(p, x, at[3], 0.5));
                assert!(held, "{frame}: {vehicle} stands outside of {}", row["region"]);
                assert!(vehicle[5].is_boolean(), "{frame}: {vehicle}");
                vehicles += 1;
            }
        }
        let known: HashSet<_> = ["audit", "check"].map(str::to_owned).into();
        assert_eq!(roles, known, "{}", path.display());
    }
    assert!(frames.len() >= 144 && vehicles >= 800, "{} frames", frames.len());
}
