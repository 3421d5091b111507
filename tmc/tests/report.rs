//! `verge-tmc report` over an archive with known content.

mod common;

use common::{failure, made_day, made_day as day, stderr, succeed, text, tmc};
use serde_json::{Value, json};
use std::path::Path;
use verge_tmc::store::{self, Partition};

/// Monday 5 January 2026.
const MONDAY: i64 = 20_458;

fn read(path: &Path) -> String {
    std::fs::read_to_string(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

#[test]
fn tables_pages_and_pictures_tell_what_the_archive_holds() {
    let folder = tempfile::tempdir().expect("a folder");
    // A folder's name is not taken for a pattern.
    let (archive, out) = (folder.path().join("archive [1] *?"), folder.path().join("report"));
    day("north", MONDAY, &archive);
    day("north", MONDAY + 2, &archive);
    day("south", MONDAY, &archive);
    let said = succeed(&["report", "--archive", text(&archive), "--out", text(&out)]);
    assert!(said.starts_with("2 sites, 25920 rows"), "{said}");
    let csv = read(&out.join("sites/north/average_day_by_lane.csv"));
    // 1.645 times the root of 1/30 (sampling), 0.5 squared (calibration) and 1.5 squared (counting).
    let rows = "\n05:45,1,5.0000,30,2.3817,7.6183\n05:45,2,,0,,\n06:00,1,6.0000,30,3.3817,8.6183\n";
    assert!(csv.contains(rows), "{csv}");
    assert!(csv.contains("\n23:45,2,46.0000,30,43.3817,48.6183\n"));
    let csv = read(&out.join("sites/north/week.csv"));
    // Monday and Wednesday; at 12:00 lanes of 12 and 24.
    assert!(csv.contains("\n1,12:00,18.0000,30,15.3817,20.6183\n"), "{csv}");
    assert!(csv.contains("\n2,12:00,,0,,\n") && csv.contains("\n3,12:00,18.0000,30,"), "{csv}");
    let csv = read(&out.join("sites/north/along_the_road.csv"));
    assert!(csv.contains("\n1,0.0,5.7500,2880\n1,10.0,17.2500,2880\n"), "{csv}");
    let csv = read(&out.join("sites/north/average_day_by_position.csv"));
    assert!(csv.contains("\n12:00,1,0.0,6.0000,30\n12:00,1,10.0,18.0000,30\n"), "{csv}");
    assert!(csv.contains("\n12:00,2,0.0,12.0000,30\n12:00,2,10.0,36.0000,30\n"), "{csv}");
    let csv = read(&out.join("sites/north/completeness.csv"));
    assert!(csv.contains("\n2026-01-05,2,1440,1440,1080\n2026-01-07,1,1440,1440,1440\n"), "{csv}");
    let csv = read(&out.join("sites.csv"));
    // Two of three days; lane 2 has no density for a quarter of the day.
    assert!(csv.contains("north,2026-01-05,2026-01-07,2,2,66.67,58.33,"), "{csv}");
    let csv = read(&out.join("trouble.csv"));
    let silent =
        "south,2026-01-06T00:00:00.000Z,\"silent\"\nnorth,2026-01-08T00:00:00.000Z,\"silent\"\n";
    assert_eq!(csv, format!("site,since,reason\n{silent}"));
    assert!(read(&out.join("index.html")).contains("<h2>Trouble: 2 of 2 sites</h2>"));
    // At the end of Monday nothing was wrong.
    let monday = folder.path().join("monday");
    let args =
        ["report", "--archive", text(&archive), "--out", text(&monday), "--to", "2026-01-05"];
    succeed(&args);
    assert!(read(&monday.join("index.html")).contains("Nothing is wrong with any site."));
    for (page, charts) in
        // On the first page also the last day of each of two sites.
        [("index.html", 4), ("sites/north/index.html", 7), ("sites/south/index.html", 7)]
    {
        let html = read(&out.join(page));
        assert_eq!(html.matches("<svg").count(), charts, "{page}");
        assert_eq!(html.matches("</svg>").count(), charts, "{page}");
        // Every link leads somewhere.
        let to_files = |link: &&str| !link.starts_with(['#', 'd']);
        for link in html.split("href=\"").skip(1).filter(to_files) {
            let target = out
                .join(page)
                .parent()
                .expect("a folder")
                .join(link.split('"').next().expect("the link ends"));
            assert!(target.exists(), "{page}: {}", target.display());
        }
    }
    for picture in [
        "week.png",
        "sites/north/completeness.png",
        "sites/south/average_day_by_position_lane_2.png",
    ] {
        assert!(resvg::tiny_skia::Pixmap::load_png(out.join(picture)).is_ok(), "{picture}");
    }
    // The same archive gives the same report, whatever the number of threads.
    let again = folder.path().join("again");
    succeed(&["report", "--archive", text(&archive), "--out", text(&again), "--threads", "1"]);
    for file in ["index.html", "sites.csv", "sites/north/index.html", "sites/south/week.png"] {
        let bytes = |root: &Path| std::fs::read(root.join(file)).expect("a file");
        assert!(bytes(&out) == bytes(&again), "{file}");
    }
}

#[test]
fn sites_have_names_and_places() {
    let folder = tempfile::tempdir().expect("a folder");
    let (archive, out) = (folder.path().join("archive"), folder.path().join("report"));
    ["north", "south"].iter().for_each(|site| day(site, MONDAY, &archive));
    let sites = folder.path().join("sites.csv");
    let table = "site,name,road,direction,latitude,longitude,bearing\n\
                 north,\"=Bridge, <b>\",A 1,Harbour,22.25,114.5,90\nwest,,,,,,\n";
    std::fs::write(&sites, table).expect("writing a file");
    let args =
        ["report", "--archive", text(&archive), "--out", text(&out), "--sites", text(&sites)];
    let output = tmc(&args);
    assert!(output.status.success(), "{}", stderr(&output));
    assert!(stderr(&output).contains("1 sites are not in --sites, the first: south"));
    for page in ["index.html", "sites/north/index.html"] {
        assert!(read(&out.join(page)).contains("=Bridge, &lt;b&gt;, A 1, Harbour"), "{page}");
    }
    let map: Value = serde_json::from_str(&read(&out.join("sites.geojson"))).expect("JSON");
    let [north, south] = [0, 1].map(|index| &map["features"][index]);
    assert_eq!(north["geometry"]["coordinates"], json!([114.5, 22.25]));
    assert_eq!((&north["id"], &north["properties"]["bearing"]), (&json!("north"), &json!(90.0)));
    assert_eq!(north["properties"]["known_pct"], 87.5);
    let density = |end: &str| north["properties"][end].as_f64().expect("a number");
    assert!(density("low90_veh_km") < density("mean_density_veh_km"));
    assert_eq!((&south["geometry"], &south["properties"]["name"]), (&Value::Null, &Value::Null));
    std::fs::write(&sites, "name\nx\n").expect("writing a file");
    assert_eq!(failure(&args).0, 65);
}

#[test]
fn what_is_not_there_is_said() {
    let folder = tempfile::tempdir().expect("a folder");
    let (archive, out) = (folder.path().join("archive"), folder.path().join("report"));
    let report = |more: &[&str]| {
        let args = ["report", "--archive", text(&archive), "--out", text(&out)];
        failure(&[&args[..], more].concat())
    };
    assert_eq!(report(&[]).0, 66);
    day("north", MONDAY, &archive);
    for (more, code, said) in [
        (["--site", "west"], 65, "has no site \"west\"; it has 1: north"),
        (["--threads", "0"], 64, "0 is not in 1..=256"),
        (["--from", "2027-01-01"], 65, "--site, --from and --to"),
        (["--window", "900"], 65, "no window of that length"),
        (["--from", "yesterday"], 64, "give a day"),
        (["--to", "2026-01-04"], 65, "--site, --from and --to"),
        (["--utc-offset", "8"], 64, "+HH:MM"),
    ] {
        let (found, error) = report(&more);
        assert_eq!(found, code, "{error}");
        assert!(error.contains(said), "{error}");
    }
    // One of two sites is there: a report of that alone would be of less than was asked for.
    let (code, error) = report(&["--site", "north", "--site", "nroth"]);
    assert!(code == 65 && error.contains("has no site \"nroth\""), "{error}");
    let (code, error) = report(&["--from", "2026-01-06", "--to", "2026-01-05"]);
    assert!(code == 64 && error.contains("--from is after --to"), "{error}");
    let empty = folder.path().join("empty");
    std::fs::create_dir(&empty).expect("a folder");
    let (code, error) = failure(&["report", "--archive", text(&empty), "--out", text(&out)]);
    assert!(code == 65 && error.contains("has no site yet"), "{error}");
    let path = Partition { site: "north".into(), day: MONDAY }.path(&archive);
    std::fs::write(&path, "PAR1").expect("writing a file");
    let (code, error) = report(&[]);
    assert_eq!(code, 65, "{error}");
    assert!(error.contains("damaged"), "{error}");
}

/// Makes a file as it was before the interval of a density was kept, or before flow was: of 16 columns,
/// or of 20.
fn age(path: &Path, columns: usize) {
    use parquet::arrow::arrow_reader::ParquetRecordBatchReaderBuilder;
    use parquet::arrow::{ArrowWriter, ProjectionMask};
    let file = std::fs::File::open(path).expect("a file");
    let builder = ParquetRecordBatchReaderBuilder::try_new(file).expect("Parquet");
    let mask = ProjectionMask::leaves(builder.parquet_schema(), 0..columns);
    let batches: Vec<_> = builder.with_projection(mask).build().expect("a reader").collect();
    let mut bytes = Vec::new();
    let schema = batches[0].as_ref().expect("rows").schema();
    let mut writer = ArrowWriter::try_new(&mut bytes, schema, None).expect("a writer");
    batches.iter().for_each(|batch| writer.write(batch.as_ref().expect("rows")).expect("memory"));
    writer.close().expect("memory");
    std::fs::write(path, bytes).expect("writing a file");
}

#[test]
fn files_from_before_the_interval_are_read() {
    let folder = tempfile::tempdir().expect("a folder");
    let (archive, out) = (folder.path().join("archive"), folder.path().join("report"));
    for number in [MONDAY, MONDAY + 1] {
        day("north", number, &archive);
    }
    let path = Partition { site: "north".into(), day: MONDAY }.path(&archive);
    let mut rows = store::read(&path).expect("a file");
    // Nothing was followed on that day.
    age(&path, 20);
    assert!(store::read(&path).expect("a file") == rows);
    age(&path, 16);
    for row in &mut rows {
        (row.ci90, row.calibration_se, row.counting_se) = (None, None, None);
    }
    assert!(store::read(&path).expect("a file") == rows);
    succeed(&["report", "--archive", text(&archive), "--out", text(&out)]);
    let csv = read(&out.join("sites/north/week.csv"));
    assert!(csv.contains("\n1,12:00,18.0000,30,,\n"), "{csv}");
    assert!(csv.contains("\n2,12:00,18.0000,30,15.3817,20.6183\n"), "{csv}");
    let csv = read(&out.join("sites/north/average_day_by_lane.csv"));
    assert!(csv.contains("\n05:45,1,5.0000,30,,\n"), "not known of all its windows: {csv}");
}

/// A row as an archiver of before let it in.
fn spoil(site: &str, day: i64, archive: &Path, change: impl Fn(&mut store::Row)) {
    made_day(site, day, archive);
    let path = Partition { site: site.into(), day }.path(archive);
    let mut rows = store::read(&path).expect("a file");
    change(&mut rows[0]);
    rows.sort_by_key(store::Row::key);
    store::write(&path, &rows).expect("writing a file");
}

#[test]
fn one_bad_site_day_or_file_costs_its_own_page() {
    let folder = tempfile::tempdir().expect("a folder");
    let (archive, clean) = (folder.path().join("archive"), folder.path().join("clean"));
    let out = |name: &str| folder.path().join(name);
    for archive in [&archive, &clean] {
        made_day("honest", MONDAY, archive);
    }
    succeed(&["report", "--archive", text(&clean), "--out", text(&out("expected"))]);
    // Names that are files of the report, or none of a site; folders that are no day's.
    for site in ["index.html", "sites.csv", "week.png"] {
        made_day(site, MONDAY, &archive);
    }
    for name in ["site=<img src=x onerror=alert(1)>/date=2026-01-05", "site=honest/date=-000001-01"]
    {
        std::fs::create_dir_all(archive.join(name)).expect("a folder");
    }
    made_day("honest", 40_000, &archive);
    // Numbers that no box measures.
    spoil("inf", MONDAY, &archive, |row| row.density = Some(f32::INFINITY));
    spoil("minus", MONDAY, &archive, |row| row.density = Some(-1e30));
    spoil("second", MONDAY, &archive, |row| row.window_s = 1);
    spoil("old", MONDAY, &archive, |row| row.from_ms = -14_831_769_540_000);
    // One file of two is damaged, and the only one.
    for (site, days) in [("half", vec![MONDAY, MONDAY + 1]), ("lost", vec![MONDAY])] {
        days.iter().for_each(|day| made_day(site, *day, &archive));
        let path = Partition { site: site.into(), day: MONDAY }.path(&archive);
        let bytes = std::fs::read(&path).expect("a file");
        std::fs::write(&path, &bytes[..bytes.len() / 2]).expect("writing a file");
    }
    let made = out("report");
    let report = ["report", "--archive", text(&archive), "--out", text(&made)];
    let (code, said) = failure(&report);
    assert_eq!(code, 65, "{said}");
    for named in ["date=2026-01-05/density.parquet: is damaged", "site=lost", "2 sites or days"] {
        assert!(said.contains(named), "{said}");
    }
    assert!(said.contains("onerror") && said.contains("is passed over"), "{said}");
    let read = |root: &str, file: &str| read(&out(root).join(file));
    for file in ["index.html", "average_day_by_lane.csv", "week.csv"] {
        let file = format!("sites/honest/{file}");
        assert_eq!(read("report", &file), read("expected", &file), "{file}");
    }
    let index = read("report", "index.html");
    assert!(!index.contains("<img") && !index.contains("NaN"), "{index}");
    let sites = read("report", "sites.csv");
    for site in ["half", "honest", "index.html", "inf", "minus", "old", "second", "week.png"] {
        assert!(sites.contains(&format!("\n{site},2026-01-0")), "{site} in {sites}");
        assert!(out("report").join("sites").join(site).join("index.html").exists(), "{site}");
    }
    assert!(!sites.contains("\nlost,") && sites.contains("\nhalf,2026-01-06,2026-01-06,1,"));
    assert!(sites.contains("\nsecond,2026-01-05,2026-01-05,1,2,9"), "{sites}");
}
