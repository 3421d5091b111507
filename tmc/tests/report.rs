//! `verge-tmc report` over an archive with known content.

mod common;

use common::{failure, made_day as day, succeed, text};
use std::path::Path;
use verge_tmc::store::Partition;

/// Monday 5 January 2026.
const MONDAY: i64 = 20_458;

fn read(path: &Path) -> String {
    std::fs::read_to_string(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

#[test]
fn tables_pages_and_pictures_tell_what_the_archive_holds() {
    let folder = tempfile::tempdir().expect("a folder");
    // A folder's name is no pattern.
    let (archive, out) = (folder.path().join("archive [1] *?"), folder.path().join("report"));
    day("north", MONDAY, &archive);
    day("north", MONDAY + 2, &archive);
    day("south", MONDAY, &archive);
    let said = succeed(&["report", "--archive", text(&archive), "--out", text(&out)]);
    assert!(said.starts_with("2 sites, 25920 rows"), "{said}");
    let csv = read(&out.join("north/average_day_by_lane.csv"));
    assert!(csv.contains("\n05:45,1,5.0000,30\n05:45,2,,0\n06:00,1,6.0000,30\n"), "{csv}");
    assert!(csv.contains("\n23:45,2,46.0000,30\n"));
    let csv = read(&out.join("north/week.csv"));
    // Monday and Wednesday; at 12:00 lanes of 12 and 24.
    assert!(csv.contains("\n1,12:00,18.0000,30\n") && csv.contains("\n2,12:00,,0\n"), "{csv}");
    assert!(csv.contains("\n3,12:00,18.0000,30\n"));
    let csv = read(&out.join("north/along_the_road.csv"));
    assert!(csv.contains("\n1,0.0,5.7500,2880\n1,10.0,17.2500,2880\n"), "{csv}");
    let csv = read(&out.join("north/average_day_by_position.csv"));
    assert!(csv.contains("\n12:00,1,0.0,6.0000,30\n12:00,1,10.0,18.0000,30\n"), "{csv}");
    assert!(csv.contains("\n12:00,2,0.0,12.0000,30\n12:00,2,10.0,36.0000,30\n"), "{csv}");
    let csv = read(&out.join("north/completeness.csv"));
    assert!(csv.contains("\n2026-01-05,2,1440,1440,1080\n2026-01-07,1,1440,1440,1440\n"), "{csv}");
    let csv = read(&out.join("sites.csv"));
    // Two of three days; lane 2 has no density for a quarter of the day.
    assert!(csv.contains("north,2026-01-05,2026-01-07,2,2,66.67,58.33,"), "{csv}");
    for (page, charts) in [("index.html", 2), ("north/index.html", 6), ("south/index.html", 6)] {
        let html = read(&out.join(page));
        assert_eq!(html.matches("<svg").count(), charts, "{page}");
        assert_eq!(html.matches("</svg>").count(), charts, "{page}");
        // Every link leads somewhere.
        for link in html.split("href=\"").skip(1) {
            let target = out
                .join(page)
                .parent()
                .expect("a folder")
                .join(link.split('"').next().expect("the link ends"));
            assert!(target.exists(), "{page}: {}", target.display());
        }
    }
    for picture in
        ["week.png", "north/completeness.png", "south/average_day_by_position_lane_2.png"]
    {
        assert!(tiny_skia::Pixmap::load_png(out.join(picture)).is_ok(), "{picture}");
    }
    // The same archive gives the same report, whatever the number of threads.
    let again = folder.path().join("again");
    succeed(&["report", "--archive", text(&archive), "--out", text(&again), "--threads", "1"]);
    for file in ["index.html", "sites.csv", "north/index.html", "south/week.png"] {
        let bytes = |root: &Path| std::fs::read(root.join(file)).expect("a file");
        assert!(bytes(&out) == bytes(&again), "{file}");
    }
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
        (["--site", "west"], 65, "--site, --from and --to"),
        (["--from", "2027-01-01"], 65, "--site, --from and --to"),
        (["--window", "900"], 65, "no window of that length"),
        (["--from", "yesterday"], 64, "give a day"),
        (["--utc-offset", "8"], 64, "+HH:MM"),
    ] {
        let (found, error) = report(&more);
        assert_eq!(found, code, "{error}");
        assert!(error.contains(said), "{error}");
    }
    let path = Partition { site: "north".into(), day: MONDAY }.path(&archive);
    std::fs::write(&path, "PAR1").expect("writing a file");
    let (code, error) = report(&[]);
    assert_eq!(code, 65, "{error}");
    assert!(error.contains("damaged"), "{error}");
}
