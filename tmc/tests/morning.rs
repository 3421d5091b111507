//! The morning page over an archive with known content: what it says, what `serve` answers, that its
//! figures are DuckDB's, and how it looks and behaves in a browser.

mod common;

use common::{stderr, succeed, text};
use serde_json::Value;
use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use verge_desk::skip;
use verge_messages::Place;
use verge_tmc::store::events::{self, AlarmRow, PlaceRow};
use verge_tmc::store::{self, DAY_MS, Moving, Partition, Row};

/// Monday 9 March 2026, and 08:00 of it.
const TODAY: i64 = 20_521;
const NOW_MS: i64 = TODAY * DAY_MS + 8 * 3_600_000;
const QUARTER_MS: i64 = 900_000;
const SITES: [&str; 6] = ["north", "south", "east", "west", "bridge", "tunnel"];

/// Between 0 and 1, the same for the same arguments.
fn noise(parts: [i64; 4]) -> f64 {
    let mut state = 0x9e37_79b9_7f4a_7c15u64;
    for part in parts {
        state = (state ^ part as u64).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        state ^= state >> 29;
    }
    (state >> 11) as f64 / (1u64 << 53) as f64
}

/// A quarter of an hour of a lane.
fn row(site: usize, from_ms: i64, lane: i32) -> Option<Row> {
    let name = SITES[site];
    if name == "east" && from_ms >= TODAY * DAY_MS + 3 * 3_600_000 {
        return None;
    }
    let hour = (from_ms.rem_euclid(DAY_MS)) as f64 / 3_600_000.0;
    let peak = |at: f64| (-((hour - at) / 1.6).powi(2)).exp();
    let scatter = noise([site as i64, from_ms / QUARTER_MS, lane.into(), 1]);
    let mut density = (2.0 + 14.0 * peak(8.2) + 16.0 * peak(17.8) + 3.0 * peak(13.0))
        * (0.8 + 0.15 * site as f64 + 0.1 * f64::from(lane))
        * (0.85 + 0.3 * scatter);
    if name == "bridge" && from_ms >= TODAY * DAY_MS + 6 * 3_600_000 {
        density *= 2.0;
    }
    let moved = name == "south" && from_ms >= NOW_MS - 43 * QUARTER_MS;
    let error = if name == "tunnel" { 0.9 } else { 0.2 };
    let known = |value: f64| (!moved).then_some(value as f32);
    let speed = (95.0 * (1.0 - density / 90.0)).max(6.0);
    Some(Row {
        window_s: 900,
        from_ms,
        lane,
        cell: None,
        position_m: None,
        length_m: 120.0,
        density: known(density),
        se: known(density * 0.05),
        vehicles: None,
        occupancy: None,
        frames_used: if moved { 0 } else { 450 },
        frames_expected: 450,
        status: if moved { 13 } else { 2 },
        seq: from_ms / QUARTER_MS - 1_900_000,
        clock_synced: !(name == "west" && from_ms >= TODAY * DAY_MS + 6 * 3_600_000),
        rel_err: Some(0.02),
        ci90: (!moved).then_some([
            (density - (density * error + 1.0)).max(0.0) as f32,
            (density * (1.0 + error) + 1.0) as f32,
        ]),
        calibration_se: known(density * 0.02),
        counting_se: known(density * 0.1),
        traffic: Some(Moving {
            status: if moved { 13 } else { 2 },
            flow: known(density * speed),
            flow_ci90: None,
            speed: known(speed),
            speed_ci90: None,
            occupancy: known(density / 200.0),
            queue_m: known(0.0),
            passed: None,
        }),
    })
}

/// Nine weeks of Sundays and Mondays, places, alarms.
fn archive(root: &Path) {
    for (index, site) in SITES.iter().enumerate() {
        for week in 0..=8 {
            for day in [TODAY - 1 - 7 * week, TODAY - 7 * week] {
                let quarters = (0..96).map(|quarter| day * DAY_MS + quarter * QUARTER_MS);
                let mut rows: Vec<Row> = quarters
                    .filter(|from| *from < NOW_MS)
                    .flat_map(|from| (1..=2).filter_map(move |lane| row(index, from, lane)))
                    .collect();
                rows.sort_by_key(Row::key);
                let partition = Partition { site: (*site).into(), day };
                store::write(&partition.path(root), &rows).expect("writing a day");
            }
        }
    }
    let alarm = |site: &str, time_ms, name: &str, active| AlarmRow {
        site: site.into(),
        time_ms,
        name: name.into(),
        active,
    };
    let since = NOW_MS - 43 * QUARTER_MS + 60_000;
    let rows = [
        alarm("north", since - 9_000_000, "blurred_picture", true),
        alarm("north", since - 8_000_000, "blurred_picture", false),
        alarm("south", since, "camera_moved", true),
    ];
    events::write_table(&events::alarms_path(root, TODAY - 1), &rows).expect("writing alarms");
    let place = |site: &str, name: &str, latitude, longitude, bearing| PlaceRow {
        site: site.into(),
        since_ms: 0,
        place: Place {
            name: Some(name.into()),
            road: Some("Tuen Mun Road".into()),
            direction: Some("to Kowloon".into()),
            latitude: Some(latitude),
            longitude: Some(longitude),
            bearing: Some(bearing),
        },
        lanes: "[{\"lane\":1,\"name\":\"slow lane\",\"order\":1}]".into(),
    };
    let rows = [
        place("bridge", "Ting Kau <Bridge>", 22.3635, 114.0782, 20.0),
        place("north", "Siu Lam", 22.3662, 114.0126, 285.0),
        place("south", "Sham Tseng", 22.3689, 114.0597, 95.0),
        place("tunnel", "Tai Lam Tunnel", 22.3981, 114.0571, 180.0),
        place("west", "So Kwun Wat", 22.3725, 113.9969, 300.0),
    ];
    events::write_table(&events::places_path(root), &rows).expect("writing places");
}

/// Runs verge-tmc at [`NOW_MS`].
fn at_eight(args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_verge-tmc"))
        .args(args)
        .env("SOURCE_DATE_EPOCH", (NOW_MS / 1000).to_string())
        .output()
        .expect("the program starts")
}

fn report(root: &Path) -> PathBuf {
    let out = root.join("report");
    let archive = root.join("archive");
    let output = at_eight(&[
        "report",
        "--archive",
        text(&archive),
        "--out",
        text(&out),
        "--utc-offset",
        "+08:00",
    ]);
    assert!(output.status.success(), "{}", stderr(&output));
    out
}

/// A folder with the archive and its report.
fn made() -> (tempfile::TempDir, PathBuf) {
    let folder = tempfile::tempdir().expect("a folder");
    archive(&folder.path().join("archive"));
    let out = report(folder.path());
    (folder, out)
}

fn read(path: &Path) -> String {
    std::fs::read_to_string(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

#[test]
fn trouble_comes_first_with_its_reason_and_since_when() {
    let (_folder, out) = made();
    let csv = read(&out.join("trouble.csv"));
    let lines: Vec<&str> = csv.lines().collect();
    let since = verge_messages::rfc3339(NOW_MS - 43 * QUARTER_MS + 60_000);
    assert_eq!(lines[0], "site,since,reason");
    assert!(lines.contains(&format!("south,{since},\"the camera has moved\"").as_str()), "{csv}");
    assert!(lines.contains(&"east,2026-03-09T03:00:00.000Z,\"silent\""), "{csv}");
    assert!(lines.contains(&"west,2026-03-09T06:00:00.000Z,\"its clock is not set\""), "{csv}");
    let wide = |line: &&&str| line.starts_with("tunnel,") && line.contains("wider than half");
    assert_eq!(lines.iter().filter(wide).count(), 1, "{csv}");
    assert_eq!(lines.len(), 5, "the blurred picture is over, and a lane's status told once: {csv}");
    let html = read(&out.join("index.html"));
    assert!(html.contains("<h2>Trouble: 4 of 6 sites</h2>"));
    // Local time.
    assert!(html.contains("As of <b>2026-03-09 16:00</b> (UTC+08:00), made at 2026-03-09 16:00."));
    let order: Vec<usize> = ["tunnel", "south", "east", "west", "bridge", "north"]
        .map(|site| html.rfind(&format!("<tr><td><a href=\"sites/{site}/index.html\"")))
        .map(|at| at.expect("a row"))
        .to_vec();
    let all_sites = html.find("<h2>All sites</h2>").expect("the table");
    let averages = html.find("<h2>Averages</h2>").expect("the averages");
    assert!(order.iter().all(|at| *at > all_sites), "{order:?}");
    let _ = averages;
    // The bridge has twice its usual density, and its name is not taken for a tag.
    assert!(html.contains("denser <span class=\"muted\">(+"));
    assert!(html.contains("Ting Kau &lt;Bridge&gt;") && !html.contains("<Bridge>"));
    assert!(html.contains("<svg class=\"map\"") && html.contains("aria-label=\"Map of 5 sites\""));
    for forbidden in ["<script", "http://", "https://", "<link rel=\"style"] {
        let found = html.replace("http://www.w3.org/2000/svg", "");
        assert!(!found.contains(forbidden), "{forbidden}");
    }
    let site = read(&out.join("sites/bridge/index.html"));
    assert!(site.contains("<h1>Ting Kau &lt;Bridge&gt; (bridge)</h1>"));
    assert!(site.contains("slow lane") && site.matches("<figure>").count() == 3);
}

/// An answer's status line and body.
fn asked(port: u16, request: &str) -> (String, String) {
    let mut stream = TcpStream::connect(("127.0.0.1", port)).expect("it listens");
    stream.write_all(request.as_bytes()).expect("it reads");
    let mut answer = String::new();
    stream.read_to_string(&mut answer).expect("it answers");
    let (head, body) = answer.split_once("\r\n\r\n").expect("a head");
    (head.to_owned(), body.to_owned())
}

struct Served(Child, u16);

impl Served {
    fn of(archive: &Path) -> Self {
        let mut child = Command::new(env!("CARGO_BIN_EXE_verge-tmc"))
            .args(["serve", "--archive", text(archive), "--port", "0", "--utc-offset", "+08:00"])
            .env("SOURCE_DATE_EPOCH", (NOW_MS / 1000).to_string())
            .stdout(Stdio::piped())
            .spawn()
            .expect("the program starts");
        let mut line = String::new();
        let out = child.stdout.take().expect("piped");
        BufReader::new(out).read_line(&mut line).expect("its address");
        let port =
            line.trim().trim_end_matches('/').rsplit(':').next().and_then(|it| it.parse().ok());
        Self(child, port.unwrap_or_else(|| panic!("{line:?}")))
    }
}

impl Drop for Served {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

#[test]
fn serve_answers_loopback_alone_and_changes_nothing() {
    let folder = tempfile::tempdir().expect("a folder");
    let root = folder.path().join("archive");
    archive(&root);
    let served = Served::of(&root);
    let port = served.1;
    let get = |path: &str, host: &str| {
        asked(port, &format!("GET {path} HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n\r\n"))
    };
    let here = format!("127.0.0.1:{port}");
    let (head, body) = get("/", &here);
    assert!(head.starts_with("HTTP/1.1 200"), "{head}");
    assert!(head.contains("Content-Security-Policy: default-src 'none'"), "{head}");
    assert!(
        body.contains("<h2>Trouble: 4 of 6 sites</h2>") && body.contains("http-equiv=\"refresh\"")
    );
    assert!(get("/sites/bridge/index.html", &here).1.contains("Ting Kau"));
    assert!(get("/trouble.csv", &here).1.starts_with("site,since,reason\n"));
    assert!(get("/sites/../../etc/passwd", &here).0.starts_with("HTTP/1.1 404"));
    assert!(get("/", "evil.example").0.starts_with("HTTP/1.1 403"));
    let post = format!(
        "POST / HTTP/1.1\r\nHost: {here}\r\nContent-Length: 0\r\nConnection: close\r\n\r\n"
    );
    assert!(asked(port, &post).0.starts_with("HTTP/1.1 405"));
    let missing = at_eight(&["serve", "--archive", "/no/such", "--port", "0"]);
    assert_eq!(missing.status.code(), Some(66), "{}", stderr(&missing));
}

/// Grafana's dashboard of the past asks for nothing that is not answered, and reads no field that is not
/// there; what it reads are means over the archive's rows.
#[test]
fn the_dashboard_of_the_past_is_answered() {
    let folder = tempfile::tempdir().expect("a folder");
    let root = folder.path().join("archive");
    archive(&root);
    let served = Served::of(&root);
    let get = |path: &str| {
        let port = served.1;
        let head = format!("Host: 127.0.0.1:{port}\r\nConnection: close\r\n\r\n");
        asked(port, &format!("GET {path} HTTP/1.1\r\n{head}"))
    };
    let json = |path: &str| -> Vec<Value> {
        let (head, body) = get(path);
        assert!(head.starts_with("HTTP/1.1 200") && head.contains("application/json"), "{head}");
        serde_json::from_str(&body).expect("JSON rows")
    };
    let day = [TODAY - 1, TODAY].map(|day| (day * DAY_MS).to_string());
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/grafana/dashboards/past.json");
    let dashboard: Value = serde_json::from_str(&read(Path::new(path))).expect("JSON");
    let panels = dashboard["panels"].as_array().expect("panels");
    let variable = &dashboard["templating"]["list"][0]["query"]["infinityQuery"];
    let targets = panels.iter().map(|panel| &panel["targets"][0]).chain([variable]);
    for target in targets {
        let url = target["url"].as_str().expect("a URL").to_owned();
        let url = url.replace("${site}", "north").replace("${__interval_ms}", "60000");
        let rows = json(&url.replace("${__from}", &day[0]).replace("${__to}", &day[1]));
        for column in target["columns"].as_array().expect("columns") {
            let name = column["selector"].as_str().expect("a name");
            assert!(rows.iter().all(|row| row.get(name).is_some()), "{url}: {name}");
        }
    }
    let rows = json(&format!("/data/density?site=north&from={}&to={}", day[0], day[1]));
    assert_eq!((rows.len(), &rows[0]["time"]), (96, &Value::from((TODAY - 1) * DAY_MS)));
    let of = |quarter: i64, lanes: std::ops::RangeInclusive<i32>| {
        let from = (TODAY - 1) * DAY_MS + quarter * QUARTER_MS;
        let known = lanes.map(|lane| f64::from(row(0, from, lane).unwrap().density.unwrap()));
        let known: Vec<f64> = known.collect();
        known.iter().sum::<f64>() / known.len() as f64
    };
    let density = |row: &Value| row["density_veh_km"].as_f64().expect("it is known");
    assert!((density(&rows[33]) - of(33, 1..=2)).abs() < 1e-5, "{}", rows[33]);
    let by =
        |more: &str| json(&format!("/data/density?site=north&from={}&to={}{more}", day[0], day[1]));
    assert!((density(&by("&lane=2")[33]) - of(33, 2..=2)).abs() < 1e-5);
    let hours = by("&step_ms=3600000");
    let hour: f64 = (32..36).map(|quarter| of(quarter, 1..=2)).sum::<f64>() / 4.0;
    assert!(hours.len() == 24 && (density(&hours[8]) - hour).abs() < 1e-5, "{}", hours[8]);
    assert!(json(&format!("/data/density?site=north&from=0&to={DAY_MS}")).is_empty());
    assert!(get("/data/density?site=nowhere&from=0&to=1").0.starts_with("HTTP/1.1 404"));
    assert!(get("/data/density?site=north").1.contains("from is missing"));
    assert!(get("/data/passwords").0.starts_with("HTTP/1.1 404"));
}

/// Whether Python has a package.
fn python_has(package: &str) -> bool {
    let has = Command::new("python3").args(["-c", &format!("import {package}")]).output();
    has.is_ok_and(|output| output.status.success())
}

#[test]
fn figures_are_those_of_duckdb() {
    if !python_has("duckdb") {
        return skip("python3 with duckdb is not installed");
    }
    let (folder, out) = made();
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/morning/figures.py");
    let archive = folder.path().join("archive");
    let output = Command::new("python3")
        .args([script, text(&archive), text(&out), &NOW_MS.to_string()])
        .output()
        .expect("python3 runs");
    assert!(output.status.success(), "{}", stderr(&output));
    let said = String::from_utf8_lossy(&output.stdout);
    assert!(said.starts_with("576 quarter hours"), "{said}");
}

#[test]
fn a_browser_shows_it_light_dark_small_and_on_paper() {
    let chromium = ["chromium", "chromium-browser"];
    let has_chromium = chromium.iter().any(|name| {
        Command::new(name).arg("--version").output().is_ok_and(|output| output.status.success())
    });
    if !has_chromium || !python_has("playwright") {
        return skip("chromium with python3's playwright is not installed");
    }
    let (folder, out) = made();
    let served = Served::of(&folder.path().join("archive"));
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/morning/browser.py");
    let mut args =
        vec![script.to_owned(), text(&out).to_owned(), format!("http://127.0.0.1:{}/", served.1)];
    args.extend(std::env::var("VERGE_SHOTS"));
    let output = Command::new("python3").args(&args).output().expect("python3 runs");
    assert!(output.status.success(), "{}", stderr(&output));
}

#[test]
fn what_is_usual_is_kept_and_made_again_when_a_day_changes() {
    let folder = tempfile::tempdir().expect("a folder");
    let root = folder.path().join("archive");
    archive(&root);
    let first = report(folder.path());
    let daily = root.join("daily/date=2026-03-02/daily.parquet");
    let made = daily.metadata().expect("it was kept").modified().expect("a time");
    let before = read(&first.join("last_day.csv"));
    report(folder.path());
    assert_eq!(daily.metadata().expect("it is there").modified().expect("a time"), made);
    // A replay arrives late: the day's file is younger than the table.
    let partition = Partition { site: "north".into(), day: TODAY - 7 };
    let mut rows = store::read(&partition.path(&root)).expect("a day");
    rows.iter_mut().for_each(|row| row.density = row.density.map(|density| density * 3.0));
    store::write(&partition.path(&root), &rows).expect("writing a day");
    let again = report(folder.path());
    assert!(daily.metadata().expect("it is there").modified().expect("a time") > made);
    assert_ne!(read(&again.join("last_day.csv")), before);
    let said = succeed(&["report", "--help"]);
    assert!(said.contains("--tiles"), "{said}");
}
