//! Manual pages of `street`: files, exit codes and examples, which clap does not know.

use clap::Command;
use verge_desk::manual::{Manual, Page};
use verge_desk::sysexits::{CANTCREAT, DATAERR, IOERR, NOINPUT};

const ENDS: &[u8] = &[DATAERR, NOINPUT, CANTCREAT, IOERR];
const SCENES: (&str, &str) = ("/usr/share/verge/scenes", "Scenes that come with the program.");

const PAGES: &[Page] = &[
    Page {
        command: "",
        files: &[SCENES],
        exits: ENDS,
        examples: &[],
        see: &["street-record(1)", "street-score(1)", "street-bench(1)", "verge-replay(1)"],
    },
    Page {
        command: "record",
        files: &[SCENES],
        exits: ENDS,
        examples: &[
            (
                "street record --scene /usr/share/verge/scenes/curve.toml --frames 90 --seed 3 --out road",
                "Three minutes of an urban road, a picture each two seconds.",
            ),
            (
                "street record --scene /usr/share/verge/scenes/curve.toml --frames 90 --set light.daylight=night --out night",
                "The same by night.",
            ),
        ],
        see: &["street-score(1)", "verge-replay(1)"],
    },
    Page {
        command: "score",
        files: &[],
        exits: ENDS,
        examples: &[(
            "street score --truth road/truth.jsonl --windows windows.jsonl",
            "Compare windows of `verge replay --json` with the truth of their recording.",
        )],
        see: &["street-record(1)", "verge-replay(1)"],
    },
    Page {
        command: "bench",
        files: &[SCENES],
        exits: ENDS,
        examples: &[(
            "street bench --scene /usr/share/verge/scenes/curve.toml",
            "Frames a second on this machine, as JSON.",
        )],
        see: &["street-record(1)"],
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
        super::manual(crate::Cli::command().name("street")).hold("street.md");
    }
}
