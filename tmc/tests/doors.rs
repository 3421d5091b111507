//! Each outside crate has one door, and the centre imports neither sensor nor calibration: of
//! `verge` the compact message alone, and how it becomes one of `verge_messages`.

use std::path::Path;

fn sources(folder: &Path, found: &mut Vec<(String, String)>) {
    for entry in std::fs::read_dir(folder).expect("a folder of the crate") {
        let path = entry.expect("an entry").path();
        if path.is_dir() {
            sources(&path, found);
        } else {
            let text = std::fs::read_to_string(&path).expect("a source file");
            // Code that only tests use is not part of the product.
            let product = text.split("#[cfg(test)]").next().unwrap_or_default().to_owned();
            found.push((path.to_string_lossy().into_owned(), product));
        }
    }
}

#[test]
fn each_outside_crate_has_one_door() {
    let mut found = Vec::new();
    sources(Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/src")), &mut found);
    assert!(found.len() > 20, "the crate has sources");
    let doors: [(&str, &[&str]); 12] = [
        // Density files are written by column; the morning reads a few columns of many files.
        ("parquet::", &["src/store/", "src/morning/day.rs"]),
        ("rumqttc::", &["src/broker/mod.rs"]),
        ("resvg::", &["src/chart/png.rs"]),
        ("quick_xml::", &["src/points/hk_raw.rs"]),
        ("signal_hook::", &["src/archive/mod.rs", "src/exporter/mod.rs", "src/serve/mod.rs"]),
        ("tiny_http::", &["src/exporter/mod.rs", "src/serve/mod.rs"]),
        ("rustls::", &["src/broker/tls.rs"]),
        ("datafusion::", &["src/report/cluster.rs"]),
        ("ballista::", &["src/report/cluster.rs"]),
        ("verge::", &["src/message.rs"]),
        ("mvcalib::", &[]),
        ("street::", &[]),
    ];
    for (path, text) in &found {
        for (outside, door) in doors {
            let is_door = door.iter().any(|door| path.contains(door));
            assert!(is_door || !text.contains(outside), "{path} names {outside}");
        }
    }
}
