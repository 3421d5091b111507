//! Manual pages of `verge-tmc`: files, exit codes and examples, which clap does not know.

use clap::Command;
use std::path::Path;
use verge_desk::Failure;
use verge_desk::manual::{Manual, Page};
use verge_desk::sysexits::{CANTCREAT, DATAERR, IOERR, NOINPUT, SOFTWARE, UNAVAILABLE};

const ENDS: &[u8] = &[DATAERR, NOINPUT, SOFTWARE, CANTCREAT, IOERR];
const FROM_BROKER: &[u8] = &[DATAERR, NOINPUT, UNAVAILABLE, SOFTWARE, CANTCREAT, IOERR];
const DENSITY: (&str, &str) = (
    "DIR/site=NAME/date=YYYY-MM-DD/density.parquet",
    "Windows of a site and day (UTC), a row for each lane and each cell of a lane.",
);
const EVENTS: (&str, &str) = (
    "DIR/alarms, DIR/health, DIR/places",
    "What all sites said of their alarms, their state and their place.",
);
const DAILY: (&str, &str) = (
    "DIR/daily/date=YYYY-MM-DD/daily.parquet",
    "Quarter hours of a day, kept so that what is usual is known quickly; made again when it is away.",
);

const PAGES: &[Page] = &[
    Page {
        command: "",
        files: &[("/etc/verge-centre/centre.conf", "Settings of the units of the package.")],
        exits: FROM_BROKER,
        examples: &[],
        see: &[
            "verge-tmc-archive(1)",
            "verge-tmc-exporter(1)",
            "verge-tmc-report(1)",
            "verge-tmc-serve(1)",
            "verge-tmc-points(1)",
            "verge-tmc-fit(1)",
            "verge-tmc-score(1)",
            "verge-run(1)",
        ],
    },
    Page {
        command: "archive",
        files: &[
            DENSITY,
            EVENTS,
            (
                "DIR/_journal",
                "What came since the last compaction. Names that begin with _ are the archivers' own.",
            ),
        ],
        exits: FROM_BROKER,
        examples: &[
            (
                "verge-tmc archive --broker localhost:1883 --out /var/lib/verge-centre/archive",
                "Keep what a broker on this machine gets.",
            ),
            (
                "verge-tmc archive --broker mqtt.example:8883 --ca ca.pem --user centre --password-file password --out archive",
                "The same over TLS, with a name and a password.",
            ),
        ],
        see: &["verge-tmc-report(1)", "verge-run(1)"],
    },
    Page {
        command: "exporter",
        files: &[],
        exits: FROM_BROKER,
        examples: &[(
            "verge-tmc exporter --broker localhost:1883 --bind 127.0.0.1:9187",
            "Serve the latest numbers at http://127.0.0.1:9187/metrics.",
        )],
        see: &["verge-tmc-serve(1)"],
    },
    Page {
        command: "points",
        files: &[],
        exits: ENDS,
        examples: &[
            (
                "verge-tmc points --from archive --input archive --site north --out points.csv",
                "A site's own densities and speeds.",
            ),
            (
                "verge-tmc points --from archive --input archive --site north --detector-csv loop.csv --out points.csv",
                "Its densities with the speeds of a detector, joined by window.",
            ),
        ],
        see: &["verge-tmc-fit(1)"],
    },
    Page {
        command: "fit",
        files: &[],
        exits: ENDS,
        examples: &[
            (
                "verge-tmc fit --points points.csv --plot diagram.pdf",
                "Compare all four forms, and draw the best.",
            ),
            (
                "verge-tmc fit --model newell --points points.csv --robust --json",
                "One form, whatever outliers there are, as JSON.",
            ),
        ],
        see: &["verge-tmc-points(1)"],
    },
    Page {
        command: "report",
        files: &[
            DENSITY,
            EVENTS,
            DAILY,
            (
                "OUT/index.html, OUT/sites/NAME/index.html",
                "The pages, with CSV and PNG beside them.",
            ),
        ],
        exits: FROM_BROKER,
        examples: &[
            (
                "verge-tmc report --archive archive --out report --sites sites.csv --utc-offset +01:00",
                "The morning page and all averages, with names from a table.",
            ),
            (
                "verge-tmc report --archive archive --out january --site north --from 2026-01-01 --to 2026-01-31",
                "A month of one site.",
            ),
        ],
        see: &["verge-tmc-archive(1)", "verge-tmc-serve(1)"],
    },
    Page {
        command: "serve",
        files: &[DENSITY, EVENTS, DAILY],
        exits: ENDS,
        examples: &[(
            "verge-tmc serve --archive archive --port 8088",
            "Show the morning page at http://127.0.0.1:8088/.",
        )],
        see: &["verge-tmc-report(1)"],
    },
    Page {
        command: "score",
        files: &[],
        exits: ENDS,
        examples: &[(
            "verge-tmc score --truth road/truth.jsonl --density windows.jsonl --json",
            "Compare windows of `verge replay --json` with the truth of their recording.",
        )],
        see: &["verge-replay(1)"],
    },
];

/// Writes all pages into a folder.
pub fn write(program: Command, folder: &Path) -> Result<(), Failure> {
    Manual::new(program, PAGES).write(folder, &[])
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::CommandFactory;

    #[test]
    fn every_command_has_a_page_and_the_reference_is_theirs() {
        let program = crate::Arguments::command().name("verge-tmc");
        let manual = Manual::new(program, PAGES);
        assert!(manual.faults().is_empty(), "{:#?}", manual.faults());
        verge_desk::hold("verge-tmc.md", &manual.markdown());
    }
}
