//! Manual pages of `verge`: files, exit codes and examples, which clap does not know.
//!
//! Owns the pages of `verge man` and of the handbook's reference. `manual/configuration.rs` makes
//! verge.toml(5) of the example configuration.

mod configuration;

use super::exit::Failure;
use clap::Command;
use std::path::Path;
use verge_desk::manual::{Manual, Page};
use verge_desk::sysexits::{CANTCREAT, CONFIG, DATAERR, NOINPUT, SOFTWARE, UNAVAILABLE};

const MODEL: (&str, &str) = (
    "/usr/share/verge/models/verge_nanodet_640x480.toml",
    "The model that is used where none is named.",
);
const CONFIGURATION: (&str, &str) =
    ("/etc/verge/verge.toml", "The configuration of the service; verge.toml(5).");
const OFFLINE: &[u8] = &[DATAERR, NOINPUT, SOFTWARE, CANTCREAT, CONFIG];

const PAGES: &[Page] = &[
    Page {
        command: "",
        files: &[CONFIGURATION, MODEL, ("/var/lib/verge", "State of the service: the spool.")],
        exits: &[DATAERR, NOINPUT, UNAVAILABLE, SOFTWARE, CANTCREAT, CONFIG],
        examples: &[],
        see: &[
            "verge-run(1)",
            "verge-check(1)",
            "verge-replay(1)",
            "verge-audit(1)",
            "verge-collect(1)",
            "verge-detect(1)",
            "verge-view(1)",
            "verge-convert(1)",
            "verge-node(1)",
            "verge-bench(1)",
            "verge.toml(5)",
            "mvcalib(1)",
        ],
    },
    Page {
        command: "run",
        files: &[
            CONFIGURATION,
            ("/var/lib/verge/spool", "Windows that the broker has not acknowledged yet."),
        ],
        exits: &[DATAERR, NOINPUT, UNAVAILABLE, SOFTWARE, CANTCREAT, CONFIG],
        examples: &[("verge run --config verge.toml", "Measure until Ctrl-C or SIGTERM.")],
        see: &["verge-check(1)", "verge.toml(5)"],
    },
    Page {
        command: "check",
        files: &[CONFIGURATION],
        exits: &[DATAERR, NOINPUT, UNAVAILABLE, SOFTWARE, CANTCREAT, CONFIG],
        examples: &[
            ("verge check --config verge.toml", "Try all that `verge run` opens."),
            (
                "verge check --config verge.toml --overlay now.png",
                "Also draw the present picture with lanes, boxes and counts.",
            ),
            (
                "verge check --config /etc/verge/verge.toml --after-update",
                "Decide whether a new system is kept: tried for up to five minutes.",
            ),
        ],
        see: &["verge-run(1)", "verge.toml(5)"],
    },
    Page {
        command: "replay",
        files: &[MODEL],
        exits: OFFLINE,
        examples: &[
            (
                "verge replay --table road.lut --frames frames --window 60",
                "One line for each lane and minute.",
            ),
            (
                "verge replay --table road.lut --frames frames --json > windows.jsonl",
                "The messages that `verge run` would publish.",
            ),
            (
                "verge replay --table road.lut --frames frames --overlay drawn",
                "Draw each frame with lanes, boxes, contact points and counts.",
            ),
        ],
        see: &["verge-audit(1)", "verge-convert(1)", "mvcalib-table(1)"],
    },
    Page {
        command: "audit",
        files: &[MODEL],
        exits: OFFLINE,
        examples: &[
            (
                "verge audit --table road.lut --frames frames --sheet sheet",
                "Choose ten frames, draw their lanes, and write counts.csv to fill in.",
            ),
            (
                "verge audit --table road.lut --frames frames --counts sheet/counts.csv --out road.audit.toml",
                "Learn the site's score and count bias from what was counted.",
            ),
        ],
        see: &["verge-replay(1)", "verge.toml(5)"],
    },
    Page {
        command: "collect",
        files: &[],
        exits: &[DATAERR, UNAVAILABLE, SOFTWARE, CANTCREAT, CONFIG],
        examples: &[(
            "verge collect --camera http://192.0.2.7/snapshot.jpg --frames frames --for 3600",
            "A picture every ten seconds, for an hour.",
        )],
        see: &["mvcalib-desk(1)", "verge-detect(1)"],
    },
    Page {
        command: "view",
        files: &[CONFIGURATION],
        exits: &[DATAERR, NOINPUT, UNAVAILABLE, SOFTWARE, CONFIG],
        examples: &[(
            "verge view --config verge.toml --port 8000",
            "Print the address of the page; elsewhere, open it through `ssh -L 8000:127.0.0.1:8000`.",
        )],
        see: &["verge-check(1)", "verge-run(1)"],
    },
    Page {
        command: "detect",
        files: &[MODEL],
        exits: OFFLINE,
        examples: &[(
            "verge detect --frames frames --detections boxes.jsonl",
            "Boxes of all vehicles, for `mvcalib calibrate --detections`.",
        )],
        see: &["mvcalib-calibrate(1)", "verge-detector-eval(1)"],
    },
    #[cfg(feature = "desk")]
    Page {
        command: "convert",
        files: &[],
        exits: &[DATAERR, NOINPUT, CANTCREAT],
        examples: &[
            (
                "mosquitto_sub -t verge/+/density/# | verge convert --to fiware",
                "Messages of all sites, as FIWARE TrafficFlowObserved.",
            ),
            (
                "verge convert windows.jsonl --to csv --out windows.csv",
                "A table of recorded windows.",
            ),
        ],
        see: &["verge-replay(1)"],
    },
    Page {
        command: "node",
        files: &[("/dev/serial/by-id", "Serial lines by the names of their adapters.")],
        exits: &[DATAERR, NOINPUT, UNAVAILABLE],
        examples: &[
            ("verge node --device /dev/ttyUSB0 settings", "Print what the node works by."),
            ("verge node --device /dev/ttyUSB0 set node.toml", "Send it settings."),
        ],
        see: &["verge.toml(5)"],
    },
    Page {
        command: "bench",
        files: &[MODEL],
        exits: &[DATAERR, NOINPUT, UNAVAILABLE, SOFTWARE],
        examples: &[(
            "verge bench --frames frames --table road.lut",
            "Median milliseconds of each stage on this machine.",
        )],
        see: &["verge-replay(1)"],
    },
    #[cfg(feature = "demo")]
    Page {
        command: "demo",
        files: &[],
        exits: &[NOINPUT, SOFTWARE],
        examples: &[("verge demo", "Three minutes of the simulated street, to a broker inside.")],
        see: &["verge-replay(1)"],
    },
];

/// Writes all pages into a folder: one of section 1 for each command, and verge.toml(5).
pub(super) fn write(program: Command, folder: &Path) -> Result<(), Failure> {
    let further = [("verge.toml.5".to_owned(), configuration::roff())];
    Manual::new(program, PAGES).write(folder, &further).map_err(|failure| match failure {
        verge_desk::Failure::Write { path, source } => Failure::Write { path, source },
        other => Failure::Internal(other.to_string()),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::daemon::cli::Cli;
    use clap::CommandFactory;

    #[test]
    fn every_command_has_a_page_and_examples_that_are_taken() {
        let faults = Manual::new(Cli::command(), PAGES).faults();
        assert!(faults.is_empty(), "{faults:#?}");
    }

    #[test]
    #[cfg(all(feature = "desk", feature = "demo"))]
    fn the_reference_is_that_of_the_commands() {
        verge_desk::hold("verge.md", &Manual::new(Cli::command(), PAGES).markdown());
    }
}
