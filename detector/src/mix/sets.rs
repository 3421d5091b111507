//! The pictures of each data set, sorted into scenarios.

use crate::light;
use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};
use verge_desk::{Failure, read_text};

/// The pictures of one data set in one scenario, sorted by path.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Cell {
    /// The data set.
    pub set: String,
    /// The scenario.
    pub scenario: String,
    /// Its pictures.
    pub pictures: Vec<PathBuf>,
}

/// Scenario by the ending of a picture's path.
pub type Scenarios = BTreeMap<String, String>;

/// Reads lines `path-ending scenario`; blank lines and `#` are skipped.
pub fn read_scenarios(path: &Path) -> Result<Scenarios, Failure> {
    let mut found = Scenarios::new();
    for (index, line) in read_text(path)?.lines().enumerate() {
        let line = line.trim();
        if line.is_empty() || line.starts_with('#') {
            continue;
        }
        let Some((ending, scenario)) = line.rsplit_once(char::is_whitespace) else {
            let reason = format!("`{line}` has no scenario; write `path-ending scenario`");
            return Err(Failure::content(path, index + 1, reason));
        };
        let (ending, scenario) = (ending.trim().to_owned(), scenario.to_owned());
        if found.insert(ending.clone(), scenario).is_some() {
            let reason = format!("`{ending}` stands twice; keep one line for it");
            return Err(Failure::content(path, index + 1, reason));
        }
    }
    Ok(found)
}

/// Data sets in the order given, and their cells of at least `least` pictures.
pub(super) fn gather(
    sets: &[String],
    scenarios: Option<&Scenarios>,
    least: usize,
) -> Result<(Vec<String>, Vec<Cell>), Failure> {
    let mut names = Vec::new();
    let mut cells = Vec::new();
    for set in sets {
        let (name, place) = set
            .split_once('=')
            .filter(|(name, place)| !name.is_empty() && !place.is_empty())
            .ok_or_else(|| Failure::Usage(format!("--set {set}: write NAME=DIR")))?;
        let odd = |c: char| !(c.is_alphanumeric() || "_-".contains(c));
        if name.contains(odd) {
            let text = format!("--set {set}: a name has letters, digits, `_` and `-`");
            return Err(Failure::Usage(text));
        }
        if names.iter().any(|known| known == name) {
            return Err(Failure::Usage(format!("--set {name} is given twice")));
        }
        let mut by_scenario: BTreeMap<String, Vec<PathBuf>> = BTreeMap::new();
        for picture in pictures(Path::new(place))? {
            let scenario = match scenarios.and_then(|known| named(known, &picture)) {
                Some(scenario) => scenario,
                None => light::of_file(&picture)?.name().to_owned(),
            };
            by_scenario.entry(scenario).or_default().push(picture);
        }
        cells.extend(
            by_scenario
                .into_iter()
                .filter(|(_, pictures)| pictures.len() >= least)
                .map(|(scenario, pictures)| Cell { set: name.to_owned(), scenario, pictures }),
        );
        names.push(name.to_owned());
    }
    Ok((names, cells))
}

fn named(scenarios: &Scenarios, picture: &Path) -> Option<String> {
    // The longest ending wins; endings are whole path components.
    let parts: Vec<_> = picture.iter().map(|part| part.to_string_lossy()).collect();
    (0..parts.len()).find_map(|from| scenarios.get(&parts[from..].join("/")).cloned())
}

/// Pictures below a folder, or listed in a text file, sorted.
fn pictures(place: &Path) -> Result<Vec<PathBuf>, Failure> {
    let kind = fs::metadata(place).map_err(|source| Failure::reading(place, source))?;
    if kind.is_file() {
        let list = read_text(place)?;
        return Ok(list.lines().map(str::trim).filter(|l| !l.is_empty()).map(Into::into).collect());
    }
    let mut found = Vec::new();
    let mut folders = vec![place.to_owned()];
    while let Some(folder) = folders.pop() {
        let entries = fs::read_dir(&folder).map_err(|source| Failure::reading(&folder, source))?;
        for entry in entries {
            let path = entry.map_err(|source| Failure::reading(&folder, source))?.path();
            if path.is_dir() {
                folders.push(path);
            } else if light::is_picture(&path) {
                found.push(path);
            }
        }
    }
    found.sort();
    Ok(found)
}

/// The scenarios that occur, `day` and `night` first.
pub(super) fn scenario_names(cells: &[Cell]) -> Vec<String> {
    let mut names: BTreeSet<&str> = cells.iter().map(|cell| cell.scenario.as_str()).collect();
    let mut order = Vec::new();
    for first in ["day", "night"] {
        if names.remove(first) {
            order.push(first.to_owned());
        }
    }
    order.extend(names.into_iter().map(str::to_owned));
    order
}

/// Pictures per data set (row) and scenario (column).
pub(super) fn counts(sets: &[String], scenarios: &[String], cells: &[Cell]) -> Vec<Vec<usize>> {
    let count = |set: &String, scenario: &String| {
        let here = |cell: &&Cell| &cell.set == set && &cell.scenario == scenario;
        cells.iter().find(here).map_or(0, |cell| cell.pictures.len())
    };
    sets.iter().map(|set| scenarios.iter().map(|name| count(set, name)).collect()).collect()
}
