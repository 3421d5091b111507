//! SECURITY.md's table of findings, held against the tests that it names.

use std::collections::BTreeSet;
use std::fs;

/// The rows of the table: a finding, and the files with the tests in them.
fn table() -> Vec<(String, Vec<(String, String)>)> {
    let text = fs::read_to_string("SECURITY.md").expect("it ships");
    let (_, section) =
        text.split_once("## The findings of an attack").expect("a section of its own");
    let section = section.split("\n## ").next().unwrap_or_default();
    let rows = section.lines().filter_map(|line| line.strip_prefix("| ")?.strip_suffix(" |"));
    let cells = rows.map(|row| row.split(" | ").collect::<Vec<_>>());
    cells
        .filter(|cells| cells.len() == 3 && cells[0] != "finding")
        .map(|cells| {
            let words: Vec<_> = cells[2].split('`').skip(1).step_by(2).map(str::to_owned).collect();
            let pair = |pair: &[String]| (pair[0].clone(), pair[1].clone());
            (cells[0].to_owned(), words.chunks(2).map(pair).collect())
        })
        .collect()
}

#[test]
fn every_finding_has_a_test_that_exists() {
    let table = table();
    let named: BTreeSet<_> = table.iter().map(|(finding, _)| finding.clone()).collect();
    let all = [('S', 8), ('M', 14), ('L', 15), ('N', 5)];
    let all = all.iter().flat_map(|(kind, most)| (1..=*most).map(move |n| format!("{kind}{n}")));
    assert_eq!(named, all.collect());
    for (finding, tests) in table {
        assert!(!tests.is_empty(), "{finding} has no test");
        for (file, test) in tests {
            let text = fs::read_to_string(&file).unwrap_or_else(|error| panic!("{file}: {error}"));
            let is_there = if file.ends_with(".rs") {
                let (_, behind) = text.split_once(&format!("fn {test}()")).unwrap_or_default();
                let before = text.len() - behind.len();
                // Above it stand its attributes.
                let above = text[..before].lines().rev().skip(1);
                let mut attributes = above.take_while(|line| line.trim().starts_with("#["));
                !behind.is_empty() && attributes.any(|line| line.trim() == "#[test]")
            } else {
                text.contains(&test)
            };
            assert!(is_there, "{finding}: there is no test {test} in {file}");
        }
    }
}

/// The TLS of rumqttc is what brought crates with known faults: the daemon has its own.
#[test]
fn the_daemon_takes_no_tls_from_its_mqtt_crate() {
    let text = fs::read_to_string("Cargo.toml").expect("it ships");
    let line = text.lines().find(|line| line.starts_with("rumqttc = ")).expect("a dependency");
    assert!(line.contains("default-features = false") && !line.contains("features = ["), "{line}");
    let recorded = fs::read_to_string("deny.toml").expect("it ships");
    for advisory in ["2026-0049", "2026-0098", "2026-0099", "2026-0104", "2025-0134"] {
        assert!(recorded.contains(&format!("RUSTSEC-{advisory}")), "{advisory} is not recorded");
    }
}
