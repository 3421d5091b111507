//! Each measured figure is in one place: the same value with the same unit is on one page.
//!
//! Figures of three digits and more are compared, which chance seldom repeats, with their unit, and
//! three decimals without one (scores). Settings and sizes that are not measured are left out by name.

use crate::pages::{all, prose};
use std::collections::BTreeMap;

const UNITS: [&str; 11] = ["ms", "us", "MB", "kB", "KiB", "GB", "%", "points", "s", "minutes", "m"];

/// Not measured, or the same by chance, each with the reason.
const ALLOWED: [(&str, &str); 6] = [
    ("0.315", "the model's threshold, a setting"),
    ("0.689", "two recalls, of the street and of a test camera"),
    ("0.790", "two recalls, of the street and of a mix"),
    ("0.872", "a recall of the street and a precision of a mean of weights"),
    ("0.931", "a recall of the street and a precision on topview"),
    ("15.2 %", "an error of counts and one of a calibration"),
];

/// The figures of a line: value and unit.
fn figures(line: &str) -> Vec<String> {
    let words: Vec<&str> = line.split_whitespace().collect();
    let mut figures = Vec::new();
    for (index, word) in words.iter().enumerate() {
        let trim = |word: &str| {
            word.trim_matches(|c: char| !c.is_ascii_alphanumeric() && c != '%').to_owned()
        };
        let value = trim(word);
        let number = value.trim_end_matches('%');
        let is_number = number.chars().all(|c| c.is_ascii_digit() || c == '.' || c == ',')
            && number.starts_with(|c: char| c.is_ascii_digit());
        let digits = number.chars().filter(char::is_ascii_digit).collect::<String>();
        if !is_number || digits.trim_start_matches('0').len() < 3 {
            continue;
        }
        let unit = words.get(index + 1).map(|word| trim(word)).unwrap_or_default();
        if value.ends_with('%') {
            figures.push(format!("{number} %"));
        } else if UNITS.contains(&unit.as_str()) && number.contains('.') {
            figures.push(format!("{number} {unit}"));
        } else if number.starts_with("0.") && digits.len() == 4 {
            figures.push(number.to_owned());
        }
    }
    figures
}

#[test]
fn each_figure_is_on_one_page() {
    let mut pages: BTreeMap<String, Vec<String>> = BTreeMap::new();
    for page in all() {
        // Generated from the code, or what a user notices.
        if page.path.starts_with("docs/reference/") || page.path == "CHANGELOG.md" {
            continue;
        }
        for (_, line) in prose(&page.text) {
            for figure in figures(line) {
                let of = pages.entry(figure).or_default();
                if !of.contains(&page.path) {
                    of.push(page.path.clone());
                }
            }
        }
    }
    let is_allowed = |figure: &str| ALLOWED.iter().any(|(allowed, _)| *allowed == figure);
    let doubles: Vec<_> =
        pages.iter().filter(|(figure, of)| of.len() > 1 && !is_allowed(figure)).collect();
    assert!(doubles.is_empty(), "figures on two pages: keep one, and link to it: {doubles:#?}");
    let unused: Vec<_> = ALLOWED
        .iter()
        .filter(|(figure, _)| pages.get(*figure).is_none_or(|of| of.len() < 2))
        .collect();
    assert!(unused.is_empty(), "no longer doubles: {unused:?}");
}

/// The sections of a page with a table of numbers that do not say when it was measured, and at
/// which commit.
fn undated(text: &str) -> Vec<&str> {
    let is_measured = |line: &str| {
        line.strip_prefix("*Measured on ")
            .and_then(|line| line.strip_suffix(".*")?.rsplit_once(" at "))
            .is_some_and(|(_, commit)| {
                commit.len() == 7 && commit.chars().all(|c| c.is_ascii_hexdigit())
            })
    };
    let has_numbers =
        |line: &str| line.starts_with('|') && line.contains(|c: char| c.is_ascii_digit());
    let sections = text.split("\n## ").skip(1);
    let undated = sections
        .filter(|section| section.lines().any(has_numbers) && !section.lines().any(is_measured));
    undated.filter_map(|section| section.lines().next()).collect()
}

#[test]
fn each_measured_table_names_its_day_and_commit() {
    for page in all().into_iter().filter(|page| page.path.starts_with("docs/measured/")) {
        assert!(undated(&page.text).is_empty(), "{}: {:?}", page.path, undated(&page.text));
    }
    let dated = "\n## A\n\n*Measured on 3 May 2026, last at 0ab147a.*\n\n| 1 |";
    assert!(undated(dated).is_empty());
    for wrong in ["\n## B\n\n| 1 |", "\n## B\n*Measured on 3 May 2026, at home.*\n| 1 |"] {
        assert_eq!(undated(wrong), ["B"]);
    }
}

#[test]
fn figures_are_read_with_their_unit() {
    let read =
        figures("| peak | 18.5 MB, 14.8 ms; AP 0.766 (12.5%), seed 21 and 24 frames of 2.0 s |");
    assert_eq!(read, ["18.5 MB", "14.8 ms", "0.766", "12.5 %"]);
}
