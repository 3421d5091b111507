//! A command's section in the handbook: usage, arguments, files, examples, exit codes.

use super::{Page, ends};
use clap::{Arg, Command};
use std::fmt::Write;

/// Adds the section, and one for each command below it.
pub(super) fn section(text: &mut String, command: &Command, page: &Page) {
    described(text, command);
    let commands: Vec<&Command> =
        command.get_subcommands().filter(|below| !below.is_hide_set()).collect();
    if page.command.is_empty() {
        let names = commands.iter().map(|below| {
            let name = full_name(below);
            let about = below.get_about().map(ToString::to_string).unwrap_or_default();
            format!("| [`{name}`](#{}) | {} |\n", name.replace(' ', "-"), cell(&about))
        });
        let _ =
            writeln!(text, "| command | what it does |\n|---|---|\n{}", names.collect::<String>());
    } else {
        commands.iter().for_each(|below| described(text, below));
    }
    if !page.files.is_empty() {
        let files = page.files.iter().map(|(path, what)| format!("- `{path}`: {what}\n"));
        let _ = writeln!(text, "Files:\n\n{}", files.collect::<String>());
    }
    for (line, what) in page.examples {
        let _ = writeln!(text, "{what}\n\n```sh syntax\n{line}\n```\n");
    }
    let ends = ends(page).map(|(code, what)| format!("{code}: {what}"));
    let _ = writeln!(text, "Exit status: {}\n", ends.collect::<Vec<_>>().join(" "));
}

/// Title, what it does, usage and arguments.
fn described(text: &mut String, command: &Command) {
    let level = full_name(command).split(' ').count();
    let _ = writeln!(text, "{} {}\n", "#".repeat(level), full_name(command));
    let about = command.get_long_about().or(command.get_about());
    let about = about.map(ToString::to_string).unwrap_or_default();
    let _ = writeln!(text, "{about}\n");
    let usage = command.clone().render_usage().to_string();
    let usage = usage.trim_start_matches("Usage:").trim();
    let _ = writeln!(text, "```text\n{usage}\n```\n");
    let shown = |argument: &&Arg| {
        !argument.is_hide_set() && !matches!(argument.get_id().as_str(), "help" | "version")
    };
    let rows: String = command.get_arguments().filter(shown).map(row).collect();
    if !rows.is_empty() {
        let _ = writeln!(text, "| argument | what it is | default |\n|---|---|---|\n{rows}");
    }
}

fn row(argument: &Arg) -> String {
    let help = argument.get_long_help().or(argument.get_help());
    let mut help = help.map(ToString::to_string).unwrap_or_default();
    let values = argument.get_possible_values();
    let flag = !argument.get_action().takes_values();
    if !flag && !values.is_empty() {
        let names: Vec<String> = values.iter().map(|one| format!("`{}`", one.get_name())).collect();
        help = format!("{}: {}", help.trim_end_matches('.'), names.join(", "));
    }
    let defaults = argument.get_default_values();
    let default = match defaults.first() {
        Some(value) if !flag => format!("`{}`", value.to_string_lossy()),
        _ if argument.is_required_set() => "required".into(),
        _ => String::new(),
    };
    // As clap writes it, without the short form's blank and with all its values.
    let name = argument.to_string();
    format!("| `{}` | {} | {default} |\n", cell(&name), cell(&help))
}

fn full_name(command: &Command) -> String {
    command.get_bin_name().unwrap_or(command.get_name()).to_owned()
}

/// Text in a cell of a table.
fn cell(text: &str) -> String {
    text.split_whitespace().collect::<Vec<_>>().join(" ").replace('|', "\\|")
}
