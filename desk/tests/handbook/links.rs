//! Links lead somewhere, and the contents name every page of the book once.

use crate::pages::{all, page, prose, root};
use std::path::{Component, Path, PathBuf};

/// Targets of the links in a line of prose.
fn targets(line: &str) -> impl Iterator<Item = &str> {
    line.match_indices("](").filter_map(|(at, _)| {
        let rest = &line[at + 2..];
        // Code spans may hold what looks like a link.
        let in_code = line[..at].matches('`').count() % 2 == 1;
        (!in_code).then(|| rest.split(')').next()).flatten()
    })
}

/// A path with `..` taken out.
fn plain(path: &Path) -> Option<PathBuf> {
    let mut plain = PathBuf::new();
    for part in path.components() {
        match part {
            Component::ParentDir => plain.pop().then_some(())?,
            Component::Normal(name) => plain.push(name),
            _ => {}
        }
    }
    Some(plain)
}

/// The anchor of a heading: lower case, blanks as hyphens, other signs left out.
fn anchor(heading: &str) -> String {
    let text = heading.trim_start_matches('#').trim().to_lowercase();
    text.chars()
        .filter_map(|c| match c {
            ' ' => Some('-'),
            c if c.is_alphanumeric() || c == '-' || c == '_' => Some(c),
            _ => None,
        })
        .collect()
}

/// The fault of a link from a page, if it has one.
fn fault(from: &str, target: &str) -> Option<String> {
    if target.starts_with("http://") || target.starts_with("https://") {
        return None;
    }
    let (file, wanted) = target.split_once('#').unwrap_or((target, ""));
    let folder = Path::new(from).parent().unwrap_or(Path::new(""));
    let Some(path) = plain(&folder.join(file)) else { return Some("leaves the tree".into()) };
    let path = if file.is_empty() { PathBuf::from(from) } else { path };
    if !root().join(&path).exists() {
        return Some(format!("{} is not there", path.display()));
    }
    if wanted.is_empty() {
        return None;
    }
    let text = page(&path.to_string_lossy());
    let mut headings = prose(&text).filter(|(_, line)| line.starts_with('#'));
    let there = headings.any(|(_, line)| anchor(line) == wanted);
    (!there).then(|| format!("{} has no heading #{wanted}", path.display()))
}

#[test]
fn every_link_leads_somewhere() {
    let mut faults = Vec::new();
    for page in all() {
        for (number, line) in prose(&page.text) {
            for target in targets(line) {
                if let Some(fault) = fault(&page.path, target) {
                    faults.push(format!("{}:{number}: {target}: {fault}", page.path));
                }
            }
        }
    }
    assert!(faults.is_empty(), "{faults:#?}");
}

#[test]
fn a_link_to_nothing_is_found() {
    for target in ["none.md", "#no-such-heading", "../../../etc/passwd", "reference/alarms.md#none"]
    {
        assert!(fault("docs/SUMMARY.md", target).is_some(), "{target}");
    }
    assert_eq!(fault("docs/SUMMARY.md", "reference/alarms.md#camera_moved"), None);
    assert_eq!(targets("see `[a](b)` and [c](d#e) and ![f](g)").collect::<Vec<_>>(), ["d#e", "g"]);
}

#[test]
fn the_contents_name_every_page_once() {
    let contents = page("docs/SUMMARY.md");
    let mut named: Vec<String> = prose(&contents)
        .flat_map(|(_, line)| targets(line))
        .filter_map(|target| plain(&Path::new("docs").join(target)))
        .map(|path| path.to_string_lossy().into_owned())
        .filter(|path| path.starts_with("docs/"))
        .collect();
    named.sort();
    let pages: Vec<String> = all()
        .into_iter()
        .map(|page| page.path)
        .filter(|path| path.starts_with("docs/") && path != "docs/SUMMARY.md")
        .collect();
    assert_eq!(named, pages, "docs/SUMMARY.md, and the pages that there are");
}
