//! The sentences of the design on who may import what, checked on the source text.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::PathBuf;

/// Every Rust file under `folder`, with its text.
fn sources(folder: &str) -> Vec<(PathBuf, String)> {
    let mut found = Vec::new();
    let mut folders = vec![PathBuf::from(folder)];
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(&folder).expect("a folder of the project") {
            let path = entry.expect("an entry").path();
            if path.is_dir() && !path.ends_with("target") {
                folders.push(path);
            } else if path.extension().is_some_and(|extension| extension == "rs") {
                let text = fs::read_to_string(&path).expect("a source file");
                found.push((path, text));
            }
        }
    }
    assert!(!found.is_empty(), "{folder} has sources");
    found
}

/// The text without tests, comments and strings: what is compiled into the product.
fn code(text: &str) -> String {
    let product = text.split("#[cfg(test)]\nmod tests").next().unwrap_or_default();
    let plain = |line: &str| line.split("//").next().unwrap_or_default().to_owned();
    product.lines().map(plain).collect::<Vec<_>>().join("\n")
}

/// Whether `word` occurs in `code` as a whole path segment before `::`.
fn names(code: &str, word: &str) -> bool {
    code.match_indices(&format!("{word}::")).any(|(at, _)| {
        // `commands::detect` is a command and not the stage.
        let before = &code[..at];
        let last = before.chars().next_back();
        !before.ends_with("commands::") && last.is_none_or(|c| !c.is_alphanumeric() && c != '_')
    })
}

/// The name in a file of the core that must not be there.
fn wrong_in_core(code: &str) -> Option<&'static str> {
    let words = ["std", "alloc", "log", "Instant", "SystemTime", "daemon", "verge_messages"];
    words.into_iter().find(|word| names(code, word))
}

/// The files of the core that take the contract's words, alarms and statuses, and hand them on.
const WORDS: [&str; 2] = ["src/alarm.rs", "src/report.rs"];

#[test]
fn the_core_sees_no_std_log_clock_or_heap() {
    for (path, text) in sources("src") {
        // `messages` and `daemon` are not the core, and `lib` declares them.
        let is_core = !["src/daemon", "src/messages.rs", "src/lib.rs"]
            .into_iter()
            .any(|outside| path.starts_with(outside));
        let is_test = path.ends_with("tests.rs") || path.iter().any(|part| part == "tests");
        if is_core && !is_test {
            let code = match WORDS.into_iter().any(|file| path.ends_with(file)) {
                true => code(&text).replace("pub use verge_messages::", ""),
                false => code(&text),
            };
            assert_eq!(wrong_in_core(&code), None, "{}", path.display());
        }
    }
    for broken in [
        "use std::time::Duration;",
        "fn now() -> u64 { SystemTime::now() }",
        "use alloc::vec::Vec;",
        "fn f() { log::warn!(\"\") }",
        "use crate::daemon::clock;",
    ] {
        assert!(wrong_in_core(broken).is_some(), "{broken}");
    }
    assert_eq!(wrong_in_core("use core::time::Duration;\nuse libm::log10;"), None);
}

/// The stages of the line: modules of the daemon that do not know each other.
const STAGES: [&str; 6] = ["capture", "scene", "detect", "locate", "publish", "spool"];
/// The files that join stages.
const JOINS: [&str; 4] = ["line.rs", "tableless.rs", "outlet.rs", "assemble.rs"];

/// The paths of one `use` tree, braces expanded, names given by `as` left out.
fn expanded(tree: &str) -> Vec<String> {
    let Some((before, rest)) = tree.split_once('{') else {
        let path = tree.split(" as ").next().unwrap_or_default();
        return vec![path.split_whitespace().collect()];
    };
    let inside = rest.rsplit_once('}').map_or(rest, |(inside, _)| inside);
    let (mut depth, mut part, mut paths) = (0, String::new(), Vec::new());
    for character in inside.chars().chain([',']) {
        match character {
            ',' if depth == 0 => {
                let part = std::mem::take(&mut part);
                if !part.trim().is_empty() {
                    paths.extend(expanded(&format!("{}{}", before.trim(), part.trim())));
                }
                continue;
            }
            '{' => depth += 1,
            '}' => depth -= 1,
            _ => {}
        }
        part.push(character);
    }
    paths
}

/// The paths that a file imports, and whether it hands each on.
fn imports(code: &str) -> Vec<(bool, String)> {
    let mut found = Vec::new();
    for statement in code.split(';') {
        let line_starts = statement.match_indices("use ").filter(|&(at, _)| {
            let line = statement[..at].rsplit('\n').next().unwrap_or_default().trim();
            line.is_empty() || line.starts_with("pub")
        });
        let Some((at, _)) = line_starts.last() else { continue };
        let is_public = statement[..at]
            .trim_end()
            .rsplit('\n')
            .next()
            .is_some_and(|line| line.trim_start().starts_with("pub"));
        let tree = &statement[at + "use ".len()..];
        found.extend(expanded(tree).into_iter().map(|path| (is_public, path)));
    }
    found
}

/// The modules of `src/daemon` in which a file lies: `["publish", "mqtt"]`.
fn modules(file: &str) -> Vec<&str> {
    let file = file.strip_prefix("src/daemon/").unwrap_or(file);
    let file = file.strip_suffix(".rs").unwrap_or(file);
    file.strip_suffix("mod").unwrap_or(file).split('/').filter(|part| !part.is_empty()).collect()
}

/// The stage of the daemon to which a path leads from that file, if to one.
fn stage(file: &str, path: &str) -> Option<&'static str> {
    let mut at = modules(file);
    let mut segments = path.split("::").peekable();
    match segments.peek().copied() {
        Some("crate" | "verge") => {
            segments.next();
            if segments.next() != Some("daemon") {
                return None;
            }
            at.clear();
        }
        Some("super") => {
            while segments.next_if_eq(&"super").is_some() {
                at.pop();
            }
        }
        _ => return None,
    }
    let first = at.first().copied().or_else(|| segments.next());
    STAGES.into_iter().find(|stage| Some(*stage) == first)
}

/// The fault among the stages that a file of the daemon names: in imports, expanded, and in paths
/// where they are used.
fn wrong_stages(file: &str, code: &str) -> Option<String> {
    // The exit codes map every stage's errors and use nothing else of them.
    let joins = file == "src/daemon/exit.rs"
        || JOINS.into_iter().any(|join| {
            let folder = format!("src/daemon/{}/", join.trim_end_matches(".rs"));
            file == format!("src/daemon/{join}") || file.starts_with(&folder)
        });
    let own = modules(file).first().and_then(|own| STAGES.into_iter().find(|stage| stage == own));
    let mut named = BTreeSet::new();
    for (is_public, path) in imports(code) {
        let Some(stage) = stage(file, &path).filter(|stage| Some(*stage) != own) else { continue };
        if is_public {
            return Some(format!("hands on {path}: whoever imports it names {stage} unseen"));
        }
        named.insert(stage);
    }
    let words = code.split(|c: char| !(c.is_alphanumeric() || c == '_' || c == ':'));
    let inline = words.filter_map(|word| stage(file, word));
    named.extend(inline.filter(|stage| Some(*stage) != own));
    let most = if own.is_some() { 0 } else { 1 };
    (!joins && named.len() > most).then(|| format!("names {named:?}"))
}

#[test]
fn only_line_outlet_and_assembly_name_two_stages() {
    for (path, text) in sources("src/daemon") {
        let file = path.to_str().expect("UTF-8");
        let wrong = wrong_stages(file, &code(&text));
        assert_eq!(wrong, None, "{file}");
    }
}

#[test]
fn a_second_stage_is_found_however_it_is_named() {
    for (file, code) in [
        ("src/daemon/running/mod.rs", "use super::{detect::Detector, spool::Spool};"),
        ("src/daemon/metrics.rs", "use super::publish::Format;\nuse super::spool::Spool;"),
        ("src/daemon/metrics.rs", "use crate::daemon::{capture, scene::{Scene, View}};"),
        ("src/daemon/metrics.rs", "use super::locate;\nfn f() { super::detect::nms(); }"),
        ("src/daemon/detect/nms.rs", "use crate::daemon::locate::Locator;"),
        ("src/daemon/detect/nms.rs", "use super::super::capture::Source;"),
        ("src/daemon/scene.rs", "fn f(d: &crate::daemon::detect::Detector) {}"),
        ("src/daemon/line.rs", "pub use super::detect::Detector;"),
        ("src/daemon/line.rs", "pub(crate) use super::{scene::Scene, locate::Anchor};"),
    ] {
        assert!(wrong_stages(file, code).is_some(), "{file}: {code}");
    }
    for (file, code) in [
        ("src/daemon/line.rs", "use super::detect::Detector;\nuse super::locate::Anchor;"),
        ("src/daemon/detect/engine.rs", "use super::head::Head;\nuse crate::scene::Cell;"),
        ("src/daemon/commands/check.rs", "use super::detect;\nuse crate::daemon::publish;"),
        ("src/daemon/publish/mod.rs", "pub use mqtt::{Tls, probe};"),
    ] {
        assert_eq!(wrong_stages(file, code), None, "{file}: {code}");
    }
}

/// The modules at the top of `root` that each of them names; in paths, that folder is `root_path`.
/// A folder is one module: a child may name its parent.
fn graph(root: &str, root_path: &str, skip: &str) -> BTreeMap<String, BTreeSet<String>> {
    let above: Vec<&str> = root_path.split("::").collect();
    let mut graph: BTreeMap<String, BTreeSet<String>> = BTreeMap::new();
    for (path, text) in sources(root) {
        let file = path.to_str().expect("UTF-8");
        let is_test = file.contains("/tests") || file.contains("_tests");
        if is_test || (!skip.is_empty() && file.starts_with(skip)) {
            continue;
        }
        let inside = file.strip_prefix(root).unwrap_or(file).trim_start_matches('/');
        let inside = inside.trim_end_matches(".rs").trim_end_matches("mod");
        let at: Vec<&str> = inside.split('/').filter(|part| !part.is_empty()).collect();
        // A re-export by `lib` or `mod` at the root is not a dependency of its source.
        let [own, ..] = at[..] else { continue };
        if ["lib", "main"].contains(&own) {
            continue;
        }
        let code = code(&text);
        let words = code.split(|c: char| !(c.is_alphanumeric() || c == '_' || c == ':'));
        let used = words.filter(|word| word.contains("::")).map(str::to_owned);
        for path in imports(&code).into_iter().map(|(_, path)| path).chain(used) {
            let mut from: Vec<&str> = above.iter().copied().chain(at.iter().copied()).collect();
            let mut segments = path.split("::").peekable();
            match segments.peek().copied() {
                Some("crate") => from.clear(),
                Some("super") => {
                    while segments.next_if_eq(&"super").is_some() {
                        from.pop();
                    }
                }
                _ => continue,
            }
            let full: Vec<&str> = from.into_iter().chain(segments).collect();
            if let Some([to, ..]) = full.strip_prefix(&above[..])
                && *to != own
            {
                graph.entry(own.to_owned()).or_default().insert((*to).to_owned());
            }
        }
    }
    graph
}

/// The modules that lie on a circle or name one: those left when all are taken away, again and
/// again, that name none of the rest.
fn circle(mut graph: BTreeMap<String, BTreeSet<String>>) -> BTreeSet<String> {
    loop {
        let left: BTreeSet<String> = graph.keys().cloned().collect();
        for named in graph.values_mut() {
            named.retain(|to| left.contains(to));
        }
        graph.retain(|_, named| !named.is_empty());
        if graph.len() == left.len() {
            return left;
        }
    }
}

#[test]
fn modules_import_each_other_in_one_direction() {
    for (root, path, skip) in [
        ("src", "crate", "src/daemon"),
        ("src/daemon", "crate::daemon", ""),
        ("kernels/src", "crate", ""),
        ("kernels/tract/src", "crate", ""),
        ("messages/src", "crate", ""),
        ("calib/src", "crate", ""),
        ("calib/src/desk", "crate::desk", ""),
        ("calib/src/joint", "crate::joint", ""),
        ("calib/src/road", "crate::road", ""),
        ("calib/src/road/fit", "crate::road::fit", ""),
        ("street/src", "crate", ""),
        ("detector/src", "crate", ""),
        ("tmc/src", "crate", ""),
    ] {
        let graph = graph(root, path, skip);
        assert!(!graph.is_empty(), "{root} has modules that name others");
        assert_eq!(circle(graph), BTreeSet::new(), "{root}");
    }
    let three = [("a", "b"), ("b", "c"), ("c", "a"), ("d", "a")];
    let three = three.map(|(from, to)| (from.to_owned(), BTreeSet::from([to.to_owned()])));
    let circle = circle(three.into());
    assert!(["a", "b", "c"].iter().all(|module| circle.contains(*module)), "{circle:?}");
}

#[test]
fn the_daemons_hub_takes_nothing_from_a_stage() {
    // Every module of the daemon sees what `mod.rs` declares.
    let text = fs::read_to_string("src/daemon/mod.rs").expect("the hub");
    let ours = |path: &str| !["std::", "crate::hal::"].iter().any(|start| path.starts_with(start));
    let taken: Vec<_> = imports(&code(&text)).into_iter().filter(|(_, path)| ours(path)).collect();
    assert_eq!(taken, []);
    for broken in ["use detect::Detector;", "pub use self::line::{Line, Stage};"] {
        assert!(imports(broken).iter().any(|(_, path)| ours(path)), "{broken}");
    }
}

/// Crates that are not ours, each with the places that may name it.
const DOORS: [(&str, &str); 16] = [
    ("tract_onnx", "src/daemon/detect/"),
    ("verge_tract", "src/daemon/detect/"),
    ("verge_kernels", "src/daemon/detect/"),
    ("rumqttc", "src/daemon/publish/"),
    ("rumqttd", "src/daemon/publish/"),
    // Decoded in capture, encoded in overlays.
    ("image", "src/daemon/capture/ src/daemon/overlay/"),
    ("embedded_graphics", "src/daemon/overlay/"),
    ("png", "src/daemon/capture/picture/"),
    ("jpeg_decoder", "src/daemon/capture/picture/half.rs"),
    ("rust_h264", "src/daemon/capture/rtsp/video/h264.rs"),
    ("rusty_h265", "src/daemon/capture/rtsp/video/h265.rs"),
    ("http_auth", "src/daemon/capture/network/"),
    // In answers of cameras, and in messages that are piped into `convert`.
    ("flate2", "src/daemon/capture/ src/daemon/commands/convert.rs"),
    ("v4l", "src/daemon/capture/v4l2"),
    ("linux_embedded_hal", "boards/linux/"),
    ("nalgebra", "calib/"),
];

/// The crate that a file names outside its door.
fn wrong_door(file: &str, code: &str) -> Option<&'static str> {
    let is_door = |doors: &str| doors.split(' ').any(|door| file.starts_with(door));
    DOORS.into_iter().find(|(outside, doors)| !is_door(doors) && names(code, outside)).map(|d| d.0)
}

#[test]
fn each_outside_crate_has_one_door() {
    for (path, text) in sources("src").into_iter().chain(sources("boards")) {
        let file = path.to_str().expect("UTF-8");
        assert_eq!(wrong_door(file, &code(&text)), None, "{file}");
    }
    for (file, broken) in [
        ("src/daemon/line.rs", "use tract_onnx::prelude::*;"),
        ("src/daemon/exit.rs", "Mqtt(#[from] rumqttc::ConnectionError)"),
        ("src/daemon/detect/letterbox.rs", "fn f(picture: &image::RgbImage) {}"),
        ("src/daemon/capture/mjpeg.rs", "use v4l::Device;"),
        ("boards/jetson.rs", "use linux_embedded_hal::I2cdev;"),
        ("src/lane.rs", "use nalgebra::Vector3;"),
    ] {
        assert!(wrong_door(file, broken).is_some(), "{file}: {broken}");
    }
    assert_eq!(wrong_door("src/daemon/detect/load.rs", "use tract_onnx::tract_core;"), None);
}

/// The name in a file of `src`, or of `calib`, that must not be there.
fn wrong_neighbour(file: &str, code: &str) -> Option<&'static str> {
    let words: &[&str] =
        if file.starts_with("calib") { &["daemon"] } else { &["boards", "mvcalib", "street"] };
    words.iter().find(|word| names(code, word)).copied()
}

#[test]
fn nothing_imports_a_board_and_calibration_and_daemon_do_not_meet() {
    for (path, text) in sources("src").into_iter().chain(sources("calib")) {
        let file = path.to_str().expect("UTF-8");
        assert_eq!(wrong_neighbour(file, &code(&text)), None, "{file}");
    }
    for (file, broken) in [
        ("src/daemon/board.rs", "use crate::boards::linux::Gpio;"),
        ("src/daemon/audit/fit.rs", "use mvcalib::Camera;"),
        ("src/scene/guard.rs", "fn f(scene: &street::Scene) {}"),
        ("calib/src/desk/mod.rs", "use verge::daemon::capture::decode;"),
    ] {
        assert!(wrong_neighbour(file, broken).is_some(), "{file}: {broken}");
    }
}

/// Whether a file outside the doors has unsafe code.
fn is_unsafe_outside(file: &str, code: &str) -> bool {
    let doors = [
        "src/daemon/clock.rs",
        "src/daemon/memory.rs",
        "boards/mcu/src",
        "boards/linux/watchdog.rs",
        "kernels/src",
    ];
    let is_door = doors.iter().any(|door| file.starts_with(door));
    !is_door && code.replace("unsafe_", "").contains("unsafe ")
}

#[test]
fn unsafe_lives_at_doors_that_need_it() {
    let folders =
        ["src", "boards", "calib", "desk", "street", "detector", "kernels", "messages", "tmc"];
    for (path, text) in folders.into_iter().flat_map(sources) {
        let file = path.to_str().expect("UTF-8");
        assert!(!is_unsafe_outside(file, &code(&text)), "{file} is unsafe");
    }
    let broken = "fn f() { unsafe { libc::sync() } }";
    assert!(is_unsafe_outside("src/daemon/spool/mod.rs", broken));
    assert!(!is_unsafe_outside("src/daemon/clock.rs", broken));
    // That each has its SAFETY line is clippy's: a warning there is an error in the manifest.
    let manifest = fs::read_to_string("Cargo.toml").expect("the manifest");
    assert!(manifest.contains("undocumented_unsafe_blocks = \"deny\""));
}
