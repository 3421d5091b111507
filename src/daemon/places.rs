//! Where files that come with verge are looked for: models, lane tables.
//!
//! Owns the order of the places. A path from the root is taken as it stands.

use std::path::{Path, PathBuf};

/// Where packages put what belongs to no machine.
const SHARED: &str = "/usr/share/verge";

/// The file that `path` means: from `folder` (of the configuration, or the working one), else
/// beside the program, in the `share/verge` of its installation, in `/usr/share/verge`, in the tree
/// that it was built in (`../..`). The first where it is nowhere, for the message.
pub fn find(folder: &Path, path: &Path) -> PathBuf {
    let program = std::env::current_exe().ok();
    find_from(folder, path, &shared(program.as_deref()))
}

/// The folders behind the first, for a program at this place.
fn shared(program: Option<&Path>) -> Vec<PathBuf> {
    let beside = program.and_then(Path::parent);
    let installed = beside.and_then(Path::parent).map(|root| root.join("share/verge"));
    let tree = beside.and_then(Path::parent).and_then(Path::parent).map(Path::to_owned);
    let known = [beside.map(Path::to_owned), installed, Some(SHARED.into()), tree];
    known.into_iter().flatten().collect()
}

fn find_from(folder: &Path, path: &Path, shared: &[PathBuf]) -> PathBuf {
    let first = folder.join(path);
    // A path that leads out of its folder has one meaning alone.
    let is_plain = path.components().all(|part| matches!(part, std::path::Component::Normal(_)));
    if first.exists() || !is_plain {
        return first;
    }
    shared.iter().map(|place| place.join(path)).find(|file| file.is_file()).unwrap_or(first)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_nearest_place_counts_and_a_path_from_the_root_is_taken_as_it_stands() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let here = |name: &str| folder.path().join(name);
        let write = |name: &str| {
            std::fs::create_dir_all(here(name).parent().expect("a folder")).expect("made");
            std::fs::write(here(name), "x").expect("written");
        };
        let program = here("local/bin/verge");
        let places = shared(Some(&program));
        let found = |path: &str| find_from(&here("etc"), Path::new(path), &places);
        assert_eq!(found("models/a.toml"), here("etc/models/a.toml"), "nowhere");
        write("local/share/verge/models/a.toml");
        assert_eq!(found("models/a.toml"), here("local/share/verge/models/a.toml"));
        write("local/bin/models/a.toml");
        assert_eq!(found("models/a.toml"), here("local/bin/models/a.toml"));
        assert_eq!(found("../models/a.toml"), here("etc/../models/a.toml"));
        assert_eq!(found("/models/a.toml"), Path::new("/models/a.toml"));
        write("etc/models/a.toml");
        assert_eq!(found("models/a.toml"), here("etc/models/a.toml"));
        assert!(places.contains(&PathBuf::from(SHARED)));
    }
}
