//! A page for `man`: what clap says of a command, and the sections that it has not.

use super::{Page, ends};
use clap::Command;
use clap_mangen::Man;

/// File name and text.
pub(super) fn page(command: &Command, page: &Page) -> (String, String) {
    let man = Man::new(command.clone()).manual("verge");
    let mut out = Vec::new();
    let mut written = man
        .render_title(&mut out)
        .and_then(|()| man.render_name_section(&mut out))
        .and_then(|()| man.render_synopsis_section(&mut out))
        .and_then(|()| man.render_description_section(&mut out))
        .and_then(|()| man.render_options_section(&mut out));
    if command.get_subcommands().any(|command| !command.is_hide_set()) {
        written = written.and_then(|()| man.render_subcommands_section(&mut out));
    }
    written.expect("memory takes it");
    let mut text = String::from_utf8(out).expect("roff is text");
    if !page.files.is_empty() {
        text += &format!(".SH FILES\n{}", list(page.files.iter().copied()));
    }
    let ends: Vec<(String, &str)> = ends(page).map(|(c, what)| (c.to_string(), what)).collect();
    let ends = list(ends.iter().map(|(code, what)| (code.as_str(), *what)));
    text += &format!(".SH \"EXIT STATUS\"\n{ends}");
    if !page.examples.is_empty() {
        text += &format!(".SH EXAMPLES\n{}", list(page.examples.iter().copied()));
    }
    if !page.see.is_empty() {
        text += &format!(".SH \"SEE ALSO\"\n{}\n", escaped(&page.see.join(", ")));
    }
    (man.get_filename(), text)
}

/// Paragraphs with a term in front.
pub fn list<'a>(entries: impl Iterator<Item = (&'a str, &'a str)>) -> String {
    entries
        .map(|(term, what)| format!(".TP\n\\fB{}\\fR\n{}\n", escaped(term), escaped(what)))
        .collect()
}

/// Text in which roff finds no request and no escape.
pub fn escaped(text: &str) -> String {
    let text = text.replace('\\', "\\e").replace('-', "\\-");
    let request = text.starts_with(['.', '\'']);
    if request { format!("\\&{text}") } else { text }
}
