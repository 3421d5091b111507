//! The command line: exit codes and messages.

mod support;

use std::process::Command;

fn street(arguments: &[&str]) -> (Option<i32>, String) {
    let output =
        Command::new(env!("CARGO_BIN_EXE_street")).args(arguments).output().expect("it runs");
    (output.status.code(), String::from_utf8_lossy(&output.stderr).into_owned())
}

#[test]
fn exit_codes_follow_sysexits() {
    let base = support::scratch("exit_codes");
    let tiny = concat!(env!("CARGO_MANIFEST_DIR"), "/scenes/tiny.toml");
    let out = base.join("out").display().to_string();
    assert_eq!(street(&["record"]).0, Some(64));
    assert_eq!(street(&["--help"]).0, Some(0));
    let (code, said) =
        street(&["record", "--scene", "nowhere.toml", "--frames", "1", "--out", &out]);
    assert_eq!(code, Some(66), "{said}");
    assert!(said.contains("nowhere.toml"), "{said}");
    let bad =
        ["record", "--scene", tiny, "--frames", "1", "--set", "camera.height_m=0", "--out", &out];
    let (code, said) = street(&bad);
    assert_eq!(code, Some(65), "{said}");
    assert!(said.contains("camera.height_m"), "{said}");
    let good = ["record", "--scene", tiny, "--frames", "1", "--out", &out];
    assert_eq!(street(&good), (Some(0), String::new()));
    let (code, said) = street(&good);
    assert_eq!(code, Some(73), "{said}");
    assert!(said.contains("not empty"), "{said}");
}

#[test]
fn a_score_counts_the_intervals_that_hold_the_truth() {
    let base = support::scratch("score");
    let [truth, windows] = ["truth.jsonl", "windows.jsonl"].map(|name| base.join(name));
    // Two vehicles of 10 m/s on 100 m. What the frame at 60 s ends counts in the second minute.
    let frame = |s: u32| {
        let lane = r#""lane":1,"length_m":100.0,"distance_m":600.0,"time_s":60.0,"occupied_s":6.0"#;
        format!(
            r#"{{"time":"2026-01-05T08:{:02}:{:02}Z","lanes":[{{{lane},"passed":6}}]}}"#,
            s / 60,
            s % 60
        )
    };
    let frames = [0, 30, 60, 90].map(frame).join("\n");
    let window = |minute: u32, flow: &str| {
        let times = format!(
            r#""from":"2026-01-05T08:{minute:02}:00Z","to":"2026-01-05T08:{:02}:00Z""#,
            minute + 1
        );
        let lane = r#""lane":1,"density_veh_km":20.0,"density_ci90":[19.0,21.0],"speed_ci90":null"#;
        format!(r#"{{{times},"lanes":[{{{lane},"flow_veh_h":720.0,"flow_ci90":{flow}}}]}}"#)
    };
    let measured = [window(0, "[700.0,740.0]"), window(1, "[721.0,740.0]")].join("\n");
    std::fs::write(&truth, frames).expect("writing");
    std::fs::write(&windows, measured).expect("writing");
    let output = Command::new(env!("CARGO_BIN_EXE_street"))
        .args(["score", "--truth", &truth.display().to_string()])
        .args(["--windows", &windows.display().to_string()])
        .output()
        .expect("it runs");
    let said = String::from_utf8(output.stdout).expect("text");
    let held = "90 % intervals that hold the truth: flow 1 of 2, density 2 of 2.";
    assert_eq!(said.lines().last(), Some(held), "{said}");
    let rows: Vec<&str> = said.lines().filter(|line| line.starts_with("| 08:")).collect();
    assert!(
        rows.iter().all(|row| row.contains("| 1 | 720.0: 720.0 (+0.0 %) | 36.0: - | 20.0: 20.0"))
    );
    assert!(rows[0].contains("| 6: - |") && rows[1].contains("| 12: - |"), "{said}");
    // Nothing to score: no window, or those of another recording.
    let twice = [window(0, "null"), window(0, "null")].join("\n");
    let longer = window(0, "null").replace("\"lane\":1,", "\"lane\":1,\"frames_used\":30,");
    let nothing = "no window in it has a lane and a time of";
    for (other, expected) in [
        (String::new(), nothing),
        (window(7, "null"), nothing),
        (twice, "is in it twice"),
        (longer, "measured over 30 frames"),
    ] {
        std::fs::write(&windows, other).expect("writing");
        let output = Command::new(env!("CARGO_BIN_EXE_street"))
            .args(["score", "--truth", &truth.display().to_string()])
            .args(["--windows", &windows.display().to_string()])
            .output()
            .expect("it runs");
        assert_eq!(output.status.code(), Some(65));
        let said = String::from_utf8(output.stderr).expect("text");
        assert!(said.contains(expected), "{said}");
    }
}
