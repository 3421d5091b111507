//! The documents: every Markdown file of the tree that is ours.

use std::fs;
use std::path::{Path, PathBuf};

/// A document.
#[derive(Debug)]
pub struct Page {
    /// Path from the root of the tree, with `/`.
    pub path: String,
    /// Its Markdown.
    pub text: String,
}

/// The root of the tree.
pub fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

/// All documents, in the order of their paths.
pub fn all() -> Vec<Page> {
    let mut pages = Vec::new();
    walk(&root(), "", &mut pages);
    pages.sort_by(|a, b| a.path.cmp(&b.path));
    assert!(pages.len() > 20, "the documents were not found");
    pages
}

/// One of them.
pub fn page(path: &str) -> String {
    fs::read_to_string(root().join(path)).unwrap_or_else(|error| panic!("{path}: {error}"))
}

fn walk(folder: &Path, path: &str, pages: &mut Vec<Page>) {
    for entry in fs::read_dir(folder).expect("a folder of the tree").map_while(Result::ok) {
        let name = entry.file_name().to_string_lossy().into_owned();
        let path = format!("{path}{name}");
        let kind = entry.file_type().expect("its kind");
        let foreign = ["target", "third_party", "node_modules", "shared"].contains(&name.as_str());
        if kind.is_dir() && !foreign && !name.starts_with('.') {
            walk(&entry.path(), &format!("{path}/"), pages);
        } else if kind.is_file() && name.ends_with(".md") {
            let text = fs::read_to_string(entry.path()).expect("text");
            pages.push(Page { path, text });
        }
    }
}

/// The lines outside of blocks of code, with their numbers from 1.
pub fn prose(text: &str) -> impl Iterator<Item = (usize, &str)> {
    let mut inside = false;
    text.lines().enumerate().filter_map(move |(index, line)| {
        let fence = line.trim_start().starts_with("```");
        inside ^= fence;
        let indented = line.starts_with("    ") && !line.trim_start().starts_with(['-', '|']);
        (!inside && !fence && !indented).then_some((index + 1, line))
    })
}

/// A line's code spans.
pub fn spans(line: &str) -> impl Iterator<Item = &str> {
    line.split('`').skip(1).step_by(2)
}
