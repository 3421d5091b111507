//! What the manual says of `mvcalib` beyond its command line: exit codes and examples.

use clap::Command;
use verge_desk::manual::{Manual, Page};
use verge_desk::sysexits::{CANTCREAT, DATAERR, IOERR, NOINPUT};

const ENDS: &[u8] = &[DATAERR, NOINPUT, CANTCREAT, IOERR];

const PAGES: &[Page] = &[
    Page {
        command: "",
        files: &[],
        exits: ENDS,
        examples: &[],
        see: &[
            "mvcalib-desk(1)",
            "mvcalib-calibrate(1)",
            "mvcalib-verify(1)",
            "mvcalib-table(1)",
            "mvcalib-report(1)",
            "mvcalib-compare(1)",
            "verge(1)",
        ],
    },
    Page {
        command: "calibrate",
        files: &[],
        exits: ENDS,
        examples: &[
            (
                "mvcalib calibrate --method road --image-size 320x240 --lengths lengths.json --lane-lines lane_lines.json --camera-id road --out calibration.json",
                "From known lengths and lane lines, without a labelled vehicle.",
            ),
            (
                "mvcalib calibrate --images frames --labels labels --vehicles vehicles.json --out calibration.json",
                "From key points of labelled vehicles.",
            ),
        ],
        see: &["mvcalib-desk(1)", "mvcalib-verify(1)", "mvcalib-table(1)"],
    },
    Page {
        command: "verify",
        files: &[],
        exits: ENDS,
        examples: &[(
            "mvcalib verify --calibration calibration.json --marks marks.json",
            "The error on marks of known length, against the stated one.",
        )],
        see: &["mvcalib-calibrate(1)"],
    },
    Page {
        command: "table",
        files: &[],
        exits: ENDS,
        examples: &[(
            "mvcalib table --calibration calibration.json --lanes lanes.json --reference frames --out road.lut --overlay lanes.png",
            "The lane table, with a reference by which a moved camera is noticed, and a drawing.",
        )],
        see: &["mvcalib-calibrate(1)", "verge-replay(1)", "verge.toml(5)"],
    },
    Page {
        command: "desk",
        files: &[
            ("FOLDER/site/calibration.json", "The calibration."),
            ("FOLDER/site/lanes.lut", "The lane table."),
            ("FOLDER/site/verge.toml", "A configuration to start from."),
            ("FOLDER/site/site.json", "What was drawn, from which the page opens again."),
        ],
        exits: ENDS,
        examples: &[("mvcalib desk road", "Prints the address to open; Ctrl-C ends it.")],
        see: &["verge-check(1)", "verge-run(1)"],
    },
    Page {
        command: "report",
        files: &[],
        exits: ENDS,
        examples: &[(
            "mvcalib report --calibration calibration.json --image frames/a.jpg --lanes lanes.json --out report.png",
            "Draw a calibration over a picture.",
        )],
        see: &["mvcalib-calibrate(1)"],
    },
    Page {
        command: "compare",
        files: &[],
        exits: ENDS,
        examples: &[("mvcalib compare", "The methods side by side, over made scenes.")],
        see: &["mvcalib-calibrate(1)"],
    },
];

/// The manual of the program.
pub fn manual(program: Command) -> Manual {
    Manual::new(program, PAGES)
}

#[cfg(test)]
mod tests {
    use clap::CommandFactory;

    #[test]
    fn every_command_has_a_page_and_the_reference_is_theirs() {
        super::manual(crate::cli::Cli::command()).hold("mvcalib.md");
    }
}
