//! Makes an archive of a city and times the report over it.
//!
//! `cargo run --profile centre -p verge-tmc --example city -- DIR [SITES [DAYS [CELLS [WINDOW_S]]]]`: by
//! default 100 sites, 90 days, four lanes, no cells, one-minute windows: 51.8 million rows. `DIR 1000 365 0
//! 900` is a year of a city at 15 minutes, 140 million rows. Prints the seconds for archive and report,
//! for the morning page alone (first without, then with what is usual kept), and the largest memory. DIR
//! must not be there yet.

use clap::Parser;
use std::f64::consts::PI;
use std::path::{Path, PathBuf};
use std::time::Instant;
use verge_tmc::morning::places::Places;
use verge_tmc::morning::{Morning, Options};
use verge_tmc::report;
use verge_tmc::store::{self, DAY_MS, Partition, Row};

const LANES: i32 = 4;
/// Monday 5 January 2026.
const FIRST_DAY: i64 = 20_458;

#[derive(Parser)]
struct Arguments {
    folder: PathBuf,
    #[arg(default_value_t = 100)]
    sites: usize,
    #[arg(default_value_t = 90)]
    days: i64,
    /// Cells of a lane.
    #[arg(default_value_t = 0)]
    cells: i32,
    /// Length of the windows, s.
    #[arg(default_value_t = 60)]
    window_s: i32,
}

#[derive(Parser)]
struct Report {
    #[command(flatten)]
    arguments: report::Arguments,
}

fn main() {
    let Arguments { folder, sites, days, cells, window_s } = Arguments::parse();
    std::fs::create_dir(&folder).expect("a folder that is not there yet");
    let begun = Instant::now();
    for site in 0..sites {
        for day in 0..days {
            write_day(&folder.join("archive"), site, day, cells, window_s);
        }
    }
    println!("archive made in {:.1} s", begun.elapsed().as_secs_f64());
    let begun = Instant::now();
    let (archive, out) = (folder.join("archive"), folder.join("report"));
    // All of them: a report stops at today, and the year ends in 2027.
    let last = store::date(FIRST_DAY + days - 1);
    let report = Report::parse_from([
        "report".as_ref(),
        "--to".as_ref(),
        last.as_ref(),
        "--archive".as_ref(),
        archive.as_os_str(),
        "--out".as_ref(),
        out.as_os_str(),
        "--threads".as_ref(),
        "2".as_ref(),
    ]);
    if let Err(failure) = report::run(&report.arguments) {
        eprintln!("{failure}");
        std::process::exit(1);
    }
    println!("report in {:.1} s", begun.elapsed().as_secs_f64());
    let last_ms = (FIRST_DAY + days) * DAY_MS;
    let options =
        Options { only: Vec::new(), made_ms: last_ms, now_ms: last_ms, offset_ms: 0, threads: 2 };
    for what in ["the morning page, made of files", "the morning page again"] {
        let begun = Instant::now();
        let morning = Morning::of(&archive, &Places::new(), &options).expect("an archive");
        let bytes = morning.body(None).len();
        println!("{what}: {:.2} s, {bytes} bytes", begun.elapsed().as_secs_f64());
    }
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    status.lines().filter(|line| line.starts_with("VmHWM")).for_each(|line| println!("{line}"));
}

/// A day with two peaks, lower on Sunday; one window in 200 has no density.
fn write_day(root: &Path, site: usize, day: i64, cells: i32, window_s: i32) {
    let partition = Partition { site: format!("camera{site:04}"), day: FIRST_DAY + day };
    let mut state = (site as u64 + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15) ^ (day as u64 + 1);
    let mut noise = move || {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        (state >> 40) as f64 / f64::from(1 << 24)
    };
    let week = if day % 7 == 6 { 0.5 } else { 1.0 };
    let mut rows = Vec::with_capacity(1440 * (LANES * (1 + cells)) as usize);
    for index in 0..86_400 / window_s {
        let hour = f64::from(index * window_s) / 3600.0;
        let peak = |at: f64| (-((hour - at) / 1.5).powi(2)).exp();
        let level =
            week * (6.0 + 25.0 * peak(8.0) + 32.0 * peak(18.0) + 8.0 * (hour / 24.0 * PI).sin());
        for lane in 1..=LANES {
            let is_known = noise() > 0.005;
            let density =
                (level * (0.7 + 0.1 * f64::from(lane) + 0.3 * noise()) * 1e4).round() / 1e4;
            let known = |value: f64| is_known.then_some(value as f32);
            let row = Row {
                window_s,
                from_ms: partition.day * DAY_MS + i64::from(index * window_s) * 1000,
                lane,
                cell: None,
                position_m: None,
                length_m: 100.0,
                density: known(density),
                se: known((density * 500.0).round() / 1e4),
                vehicles: known(density / 10.0),
                occupancy: known((density * 45.0).round() / 1e4),
                frames_used: 30,
                frames_expected: 30,
                status: 2,
                seq: day * i64::from(86_400 / window_s) + i64::from(index) + 1,
                clock_synced: true,
                rel_err: Some(0.02),
                ci90: is_known.then_some([0.7, 1.3].map(|share| (density * share) as f32)),
                calibration_se: known(density * 0.02),
                counting_se: known(density * 0.15),
                traffic: None,
            };
            for cell in 0..cells {
                // Counts of 30 frames in a cell: few values, as boxes have them.
                let count = (density * (0.5 + noise()) * 3.0 / f64::from(cells)).round();
                let cell_m = 100.0 / cells as f32;
                let density = known(f64::from(count as f32 / 30.0 / cell_m * 1000.0));
                rows.push(Row {
                    cell: Some(cell),
                    position_m: Some(cell as f32 * cell_m),
                    length_m: cell_m,
                    density,
                    se: None,
                    vehicles: density.map(|density| density * cell_m / 1000.0),
                    occupancy: None,
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
    store::write(&partition.path(root), &rows).expect("room for the archive");
}
