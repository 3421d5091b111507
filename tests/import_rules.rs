//! The sentences of the design on who may import what, checked on the source text.

use std::fs;
use std::path::{Path, PathBuf};

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

/// Whether `word` stands in `code` as a whole path segment before `::`.
fn names(code: &str, word: &str) -> bool {
    code.match_indices(&format!("{word}::")).any(|(at, _)| {
        // `commands::detect` is a command and not the stage.
        let before = &code[..at];
        let last = before.chars().next_back();
        !before.ends_with("commands::") && last.is_none_or(|c| !c.is_alphanumeric() && c != '_')
    })
}

#[test]
fn the_core_sees_no_std_log_clock_or_heap() {
    let files = [
        "units", "lane", "density", "wire", "hal", "alarm", "health", "fault", "derate", "picture",
    ];
    let read = |file: &str| fs::read_to_string(format!("src/{file}.rs")).expect("a core file");
    let single = files.map(|file| (PathBuf::from(file), read(file)));
    let folders = ["src/scene", "src/density", "src/lane"].into_iter().flat_map(sources);
    let product = folders.filter(|(path, _)| !path.ends_with("tests.rs"));
    for (path, text) in single.into_iter().chain(product) {
        let code = code(&text);
        for word in ["std", "alloc", "log", "Instant", "SystemTime", "daemon"] {
            assert!(!names(&code, word), "{} names {word}", path.display());
        }
    }
}

/// The stages with the words by which other files would name them.
const STAGES: [&str; 5] = ["capture", "detect", "locate", "publish", "spool"];

#[test]
fn only_line_outlet_and_assembly_name_two_stages() {
    for (path, text) in sources("src/daemon") {
        // The exit codes map every stage's errors and use nothing else of them.
        let joins = ["line.rs", "outlet.rs", "assemble.rs", "exit.rs"];
        if joins.into_iter().any(|file| path == Path::new("src/daemon").join(file)) {
            continue;
        }
        let code = code(&text);
        let own = STAGES.into_iter().find(|stage| {
            path.starts_with(format!("src/daemon/{stage}")) || path.ends_with(format!("{stage}.rs"))
        });
        let stages: Vec<_> =
            STAGES.into_iter().filter(|stage| names(&code, stage) && Some(*stage) != own).collect();
        match own {
            Some(own) if path.starts_with(format!("src/daemon/{own}")) => {
                assert!(stages.is_empty(), "{} names {stages:?}", path.display());
            }
            _ => assert!(stages.len() <= 1, "{} names {stages:?}", path.display()),
        }
    }
}

#[test]
fn each_outside_crate_has_one_door() {
    let doors = [
        ("tract_onnx", "src/daemon/detect/"),
        ("verge_tract", "src/daemon/detect/"),
        ("verge_kernels", "src/daemon/detect/"),
        ("rumqttc", "src/daemon/publish/"),
        ("rumqttd", "src/daemon/publish/"),
        ("image", "src/daemon/capture/"),
        ("png", "src/daemon/capture/picture/"),
        ("rust_h264", "src/daemon/capture/rtsp/video.rs"),
        ("http_auth", "src/daemon/capture/network/"),
        ("flate2", "src/daemon/capture/"),
        ("v4l", "src/daemon/capture/v4l2.rs"),
        ("linux_embedded_hal", "boards/linux/"),
        ("nalgebra", "calib/"),
    ];
    for (path, text) in sources("src").into_iter().chain(sources("boards")) {
        let code = code(&text);
        for (outside, door) in doors {
            let allowed = path.starts_with(door) || path == Path::new(door);
            assert!(allowed || !names(&code, outside), "{} names {outside}", path.display());
        }
    }
}

#[test]
fn nothing_imports_a_board_and_calibration_and_daemon_do_not_meet() {
    for (path, text) in sources("src") {
        let code = code(&text);
        for word in ["boards", "mvcalib", "street"] {
            assert!(!names(&code, word), "{} names {word}", path.display());
        }
    }
    for (path, text) in sources("calib") {
        assert!(!code(&text).contains("verge::daemon"), "{} names the daemon", path.display());
    }
}

#[test]
fn unsafe_lives_at_doors_that_need_it() {
    let doors = [
        "src/daemon/clock.rs",
        "boards/mcu/src",
        "boards/linux/watchdog.rs",
        "kernels/src",
    ];
    for folder in ["src", "boards", "calib", "street", "detector", "kernels", "tmc"] {
        for (path, text) in sources(folder) {
            let is_door = doors.iter().any(|door| path.starts_with(door));
            let code = code(&text).replace("unsafe_", "");
            assert!(is_door || !code.contains("unsafe "), "{} is unsafe", path.display());
        }
    }
}
