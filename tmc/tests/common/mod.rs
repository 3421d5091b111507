//! Shared by the command's tests: running it, made points, where data lies, how to skip.
#![allow(dead_code, reason = "each test file uses its own part")]

use serde_json::Value;
use std::path::Path;
use std::process::{Command, Output};
use verge_tmc::store::{self, Partition, Row};

/// Runs verge-tmc.
pub fn tmc(args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_verge-tmc"))
        .args(args)
        // A page says when it was made: always at the same time.
        .env("SOURCE_DATE_EPOCH", "1800000000")
        .output()
        .expect("the program starts")
}

/// Runs verge-tmc, which must succeed; its standard output.
pub fn succeed(args: &[&str]) -> String {
    let output = tmc(args);
    assert!(output.status.success(), "{args:?}: {}", stderr(&output));
    String::from_utf8(output.stdout).expect("UTF-8")
}

/// Runs verge-tmc, which must succeed and print JSON.
pub fn json(args: &[&str]) -> Value {
    serde_json::from_str(&succeed(args)).expect("JSON")
}

/// Exit code and standard error of a run that fails.
pub fn failure(args: &[&str]) -> (i32, String) {
    let output = tmc(args);
    (output.status.code().expect("an exit code"), stderr(&output))
}

/// The standard error of a finished program.
pub fn stderr(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// A path as text.
pub fn text(path: &Path) -> &str {
    path.to_str().expect("UTF-8")
}

/// A day of minutes: lane 1 has the hour of the day as density, lane 2 twice that and nothing
/// before 06:00; two cells of 10 m with half and one and a half of the lane's density.
pub fn made_day(site: &str, day: i64, root: &Path) {
    let mut rows = Vec::new();
    for minute in 0..1440 {
        for lane in 1..=2 {
            let known = lane == 1 || minute >= 360;
            let density = known.then_some((minute / 60 * lane) as f32);
            let row = Row {
                window_s: 60,
                from_ms: day * store::DAY_MS + i64::from(minute) * 60_000,
                lane,
                cell: None,
                position_m: None,
                length_m: 20.0,
                density,
                se: known.then_some(1.0),
                vehicles: None,
                occupancy: None,
                frames_used: 30,
                frames_expected: 30,
                status: if known { 2 } else { 10 },
                seq: i64::from(minute) + 1,
                clock_synced: true,
                rel_err: None,
                ci90: density.map(|density| [0.5 * density, 1.5 * density]),
                calibration_se: known.then_some(0.5),
                counting_se: known.then_some(1.5),
                traffic: None,
            };
            for (cell, share) in [0.5, 1.5].into_iter().enumerate() {
                rows.push(Row {
                    cell: Some(cell as i32),
                    position_m: Some(cell as f32 * 10.0),
                    length_m: 10.0,
                    density: density.map(|density| density * share),
                    se: None,
                    ci90: None,
                    calibration_se: None,
                    counting_se: None,
                    ..row.clone()
                });
            }
            rows.push(row);
        }
    }
    rows.sort_by_key(Row::key);
    let partition = Partition { site: site.into(), day };
    store::write(&partition.path(root), &rows).expect("writing a file");
}

/// Numbers between 0 and 1, the same for the same seed (xorshift64*).
pub struct Numbers(pub u64);

impl Numbers {
    /// The next one.
    pub fn uniform(&mut self) -> f64 {
        self.0 ^= self.0 >> 12;
        self.0 ^= self.0 << 25;
        self.0 ^= self.0 >> 27;
        (self.0.wrapping_mul(0x2545_f491_4f6c_dd1d) >> 11) as f64 / (1u64 << 53) as f64
    }

    /// Normal by Box and Muller.
    pub fn normal(&mut self) -> f64 {
        let radius = (-2.0 * (1.0 - self.uniform()).ln()).sqrt();
        radius * (2.0 * std::f64::consts::PI * self.uniform()).cos()
    }
}
