//! Manual pages of `verge-detector`: exit codes and examples, which clap does not know.

use clap::Command;
use verge_desk::manual::{Manual, Page};
use verge_desk::sysexits::{CANTCREAT, DATAERR, NOINPUT};

const ENDS: &[u8] = &[DATAERR, NOINPUT, CANTCREAT];

const PAGES: &[Page] = &[
    Page {
        command: "",
        files: &[],
        exits: ENDS,
        examples: &[],
        see: &[
            "verge-detector-check(1)",
            "verge-detector-eval(1)",
            "verge-detector-mix(1)",
            "verge-detect(1)",
        ],
    },
    Page {
        command: "mix",
        files: &[
            ("OUT/mix.txt", "All pictures that were chosen, a path a line."),
            ("OUT/shares.txt", "The shares of the data sets, for training."),
        ],
        exits: ENDS,
        examples: &[(
            "verge-detector mix --set a=pictures/a --set b=pictures/b --seed 1 --least 20 --out mix",
            "Balance two data sets over day and night.",
        )],
        see: &["verge-detector-eval(1)"],
    },
    Page {
        command: "eval",
        files: &[],
        exits: ENDS,
        examples: &[(
            "verge-detector eval --truth road --detections boxes.jsonl --curves curves.png",
            "Score the boxes of `verge detect` against labels or a recording's truth.",
        )],
        see: &["verge-detect(1)"],
    },
    Page {
        command: "check",
        files: &[],
        exits: ENDS,
        examples: &[(
            "verge-detector check model.onnx",
            "What verge makes of a model, and a sidecar to start from.",
        )],
        see: &["verge-bench(1)"],
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
        super::manual(crate::Arguments::command()).hold("verge-detector.md");
    }
}
