//! The manual of a program: its pages for `man` and its page of the handbook, from one source.
//!
//! Owns how commands, files, exit codes and examples are set out in both. What they are comes
//! from the program: its clap command, and a [`Page`] for it and for each of its commands.

mod markdown;
mod roff;

pub use roff::{escaped, list};

use crate::failure::Failure;
use crate::generated::hold;
use crate::sysexits;
use crate::whole::{make_parent, write_whole};
use clap::Command;
use std::path::Path;

/// The part of a command's manual page that clap does not know.
#[derive(Clone, Copy, Debug)]
pub struct Page {
    /// Name of the command; empty for the program itself.
    pub command: &'static str,
    /// Files that it reads and writes beside those that are named on its command line, each
    /// with what it is.
    pub files: &'static [(&'static str, &'static str)],
    /// Codes that it ends with, of [`sysexits`], without success and a wrong command line.
    pub exits: &'static [u8],
    /// Command lines, each with what it does.
    pub examples: &'static [(&'static str, &'static str)],
    /// Other pages of the manual, with their section in parentheses.
    pub see: &'static [&'static str],
}

/// A program's manual.
#[derive(Debug)]
pub struct Manual {
    program: Command,
    pages: &'static [Page],
}

impl Manual {
    /// The manual of a program, with a page for the program and one for each command.
    pub fn new(program: Command, pages: &'static [Page]) -> Self {
        let mut program = program.disable_help_subcommand(true);
        program.build();
        Self { program, pages }
    }

    /// Writes a page of section 1 for the program and one for each of its commands, and the
    /// `further` pages, into a folder.
    ///
    /// # Errors
    /// [`Failure::Write`].
    pub fn write(&self, folder: &Path, further: &[(String, String)]) -> Result<(), Failure> {
        for (name, text) in self.man_pages().iter().chain(further) {
            let path = folder.join(name);
            make_parent(&path)?;
            write_whole(&path, text.as_bytes())?;
        }
        Ok(())
    }

    /// File name and text of each page for `man`.
    pub fn man_pages(&self) -> Vec<(String, String)> {
        self.commands().map(|(command, page)| roff::page(command, page)).collect()
    }

    /// The program's page of the handbook.
    pub fn markdown(&self) -> String {
        let mut text = String::new();
        for (command, page) in self.commands() {
            markdown::section(&mut text, command, page);
        }
        text
    }

    /// Holds `docs/reference/PAGE` to the pages, of which none may be at fault. For tests alone.
    ///
    /// # Panics
    /// Where something is wrong with the pages, or the handbook says otherwise: [`hold`].
    pub fn hold(&self, page: &str) {
        let faults = self.faults();
        assert!(faults.is_empty(), "{faults:#?}");
        hold(page, &self.markdown());
    }

    /// All faults of the pages: a command without one, a page without a command, and
    /// examples that the program would not take.
    pub fn faults(&self) -> Vec<String> {
        let mut faults = Vec::new();
        for command in self.visible().filter(|command| self.page(command).is_none()) {
            faults.push(format!("no page for the command {}", command.get_name()));
        }
        for page in self.pages {
            if page.command.is_empty() {
                continue;
            }
            if !self.visible().any(|command| command.get_name() == page.command) {
                faults.push(format!("a page for {}, which is not a command", page.command));
            }
            if page.examples.is_empty() {
                faults.push(format!("no example of {}", page.command));
            }
        }
        for (line, _) in self.pages.iter().flat_map(|page| page.examples) {
            let words = self.own_words(line);
            let taken = words.map(|words| self.program.clone().try_get_matches_from(words));
            match taken {
                None => faults.push(format!("{line:?} does not call {}", self.program.get_name())),
                Some(Err(error)) => faults.push(format!("{line:?}: {error}")),
                Some(Ok(_)) => {}
            }
        }
        faults
    }

    /// The words of the part of a pipe that calls this program.
    fn own_words<'l>(&self, line: &'l str) -> Option<Vec<&'l str>> {
        let parts = line.split('|').map(|part| part.split('>').next().unwrap_or_default());
        let mut words = parts.map(|part| part.split_whitespace().collect::<Vec<_>>());
        words.find(|words| words.first() == Some(&self.program.get_name()))
    }

    fn visible(&self) -> impl Iterator<Item = &Command> {
        self.program.get_subcommands().filter(|command| !command.is_hide_set())
    }

    fn page(&self, command: &Command) -> Option<&'static Page> {
        self.pages.iter().find(|page| page.command == command.get_name())
    }

    /// The program and its commands, each with its page.
    fn commands(&self) -> impl Iterator<Item = (&Command, &'static Page)> {
        let program = self.pages.iter().find(|page| page.command.is_empty());
        let own = program.map(|page| (&self.program, page));
        own.into_iter()
            .chain(self.visible().filter_map(|command| Some((command, self.page(command)?))))
    }
}

/// Code and meaning of each way to end: success and a wrong command line always belong to it.
fn ends(page: &Page) -> impl Iterator<Item = (u8, &'static str)> {
    let known = move |code| page.exits.contains(&code) || code == sysexits::USAGE;
    let others = sysexits::ALL.into_iter().filter(move |&(code, _, _)| known(code));
    std::iter::once((0, "Success.")).chain(others.map(|(code, _, meaning)| (code, meaning)))
}

#[cfg(test)]
mod tests {
    use super::*;

    const PAGES: &[Page] = &[
        Page { command: "", files: &[], exits: &[], examples: &[], see: &["a-go(1)"] },
        Page {
            command: "go",
            files: &[("/etc/a\\b", "What it reads.")],
            exits: &[sysexits::DATAERR],
            examples: &[("cat x | a go --far M | less", ".A dot in front.")],
            see: &["a(1)"],
        },
    ];

    fn program() -> Command {
        let far = clap::Arg::new("far").long("far").value_name("M").help("How far, 1|2");
        let near = clap::Arg::new("near").value_name("N").default_value("3").help("How near");
        let go = Command::new("go").about("Goes").arg(far).arg(near);
        Command::new("a").about("Moves").subcommand(go).subcommand(Command::new("man").hide(true))
    }

    #[test]
    fn pages_have_every_section() {
        let manual = Manual::new(program(), PAGES);
        assert!(manual.faults().is_empty(), "{:?}", manual.faults());
        let pages = manual.man_pages();
        let names: Vec<&str> = pages.iter().map(|(name, _)| name.as_str()).collect();
        assert_eq!(names, ["a.1", "a-go.1"]);
        let text = &pages[1].1;
        for part in [
            ".SH NAME",
            ".SH FILES",
            "/etc/a\\eb",
            ".SH \"EXIT STATUS\"",
            ".SH EXAMPLES",
            "\\&.A dot",
        ] {
            assert!(text.contains(part), "{part} in\n{text}");
        }
        let page = manual.markdown();
        for part in ["## a go", "| `--far <M>` | How far, 1\\|2 |", "`3`", "```sh", "65"] {
            assert!(page.contains(part), "{part} in\n{page}");
        }
    }

    #[test]
    fn what_does_not_fit_the_program_is_named() {
        const WRONG: &[Page] = &[
            Page { command: "", files: &[], exits: &[], examples: &[], see: &[] },
            Page {
                command: "stay",
                files: &[],
                exits: &[],
                examples: &[("a go --fast", ""), ("b go", "")],
                see: &[],
            },
        ];
        let faults = Manual::new(program(), WRONG).faults();
        assert_eq!(faults.len(), 4, "{faults:?}");
    }
}
