//! Programs whose reader has gone away (`2>&1 | head`): they end as others do, without a panic.

mod common;

use std::process::Command;

/// Runs verge with both of its outputs into a pipe that nobody reads; returns the exit code.
fn unread(arguments: &[&str]) -> Option<i32> {
    let (reader, writer) = std::io::pipe().expect("a pipe");
    drop(reader);
    Command::new(env!("CARGO_BIN_EXE_verge"))
        .args(arguments)
        .stdout(writer.try_clone().expect("the same pipe"))
        .stderr(writer)
        .status()
        .expect("it runs")
        .code()
}

#[test]
fn a_reader_that_has_gone_away_is_no_panic() {
    let recording = ["--table", common::STREET_TABLE, "--frames", common::STREET_FRAMES];
    assert_eq!(unread(&[&["replay", "--json"], &recording[..]].concat()), Some(0));
    assert_eq!(unread(&[&["bench", "--count", "1"], &recording[..]].concat()), Some(0));
    // Nobody hears the reason; the exit code tells it.
    let missing = ["replay", "--table", "missing.lut", "--frames", common::STREET_FRAMES];
    assert_eq!(unread(&missing), Some(66));
    let folder = common::folder();
    let file = |name: &str, text: &str| {
        let path = folder.path().join(name);
        std::fs::write(&path, text).expect("written");
        path.to_str().expect("UTF-8").to_owned()
    };
    assert_eq!(unread(&["check", "--config", &file("wrong.toml", "sight = 1")]), Some(78));
    #[cfg(feature = "desk")]
    {
        assert_eq!(unread(&["convert", "--to", "json", &file("empty", "")]), Some(0));
        let bad = file("bad", "{'schema': 1}\n");
        assert_eq!(unread(&["convert", "--to", "json", &bad]), Some(65));
    }
}
