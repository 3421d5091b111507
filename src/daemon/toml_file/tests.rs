use super::*;
use crate::daemon::config::Config;
use crate::daemon::config::example;

/// A configuration of what most have.
const GOOD: &str = "site = \"a\"
[camera]
id = \"c\"
source = \"http://admin:s3cret@camera/?pwd=s3cret\"
interval_s = 2
[lane_table]
file = \"a.lut\"
[windows]
lengths_s = [60]
[mqtt]
port = 1883
";

fn fault(from: &str, to: &str) -> String {
    let text = GOOD.replacen(from, to, 1);
    assert_ne!(text, GOOD, "{from}");
    match parse::<Config>(&text, &example::names()) {
        Ok(_) => panic!("{to:?} is taken"),
        Err(fault) => fault.to_string(),
    }
}

/// People's mistakes, and the words that they read of them.
const TABLE: [(&str, &str, &str); 76] = [
    // Values of another kind.
    (
        "= 2\n",
        "= \"soon\"\n",
        "line 5: camera.interval_s must be a number of seconds, not the text \"soon\"",
    ),
    (
        "= 2\n",
        "= \"2\"\n",
        "line 5: camera.interval_s must be a number of seconds, not the text \"2\": leave the quotes away",
    ),
    ("= 2\n", "= true\n", "line 5: camera.interval_s must be a number of seconds, not true"),
    ("= 2\n", "= [2]\n", "line 5: camera.interval_s must be a number of seconds, not a list of 1"),
    (
        "= 2\n",
        "= 2026-01-05\n",
        "line 5: camera.interval_s must be a number of seconds, not a date or a time",
    ),
    ("= 2\n", "= 1e999\n", "line 5: camera.interval_s: the number is too large"),
    ("id = \"c\"", "id = 5", "line 3: camera.id must be text in quotes, not 5"),
    (
        "id = \"c\"",
        "id = \"c\"\nwatch = \"yes\"",
        "line 4: camera.watch must be true or false, not the text \"yes\": write true or false without quotes",
    ),
    ("id = \"c\"", "id = \"c\"\nwatch = 1", "line 4: camera.watch must be true or false, not 1"),
    (
        "id = \"c\"",
        "id = \"c\"\nredirect_hosts = \"x\"",
        "line 4: camera.redirect_hosts must be a list such as [\"x\"], not the text \"x\"",
    ),
    (
        "id = \"c\"",
        "id = \"c\"\npassword_file = 7",
        "line 4: camera.password_file must be text in quotes, not 7",
    ),
    ("= [60]", "= 60", "line 9: windows.lengths_s must be a list such as [60], not 60"),
    (
        "= [60]",
        "= [60, \"x\"]",
        "line 9: windows.lengths_s must be a whole number of seconds, 0 or more, not the text \"x\"",
    ),
    (
        "= [60]",
        "= [-60]",
        "line 9: windows.lengths_s must be a whole number of seconds, 0 or more, not -60",
    ),
    (
        "= [60]",
        "= [60.5]",
        "line 9: windows.lengths_s must be a whole number of seconds, 0 or more, not 60.5",
    ),
    ("= 1883", "= 99999", "line 11: mqtt.port must be a whole number from 0 to 65535, not 99999"),
    ("= 1883", "= -1", "line 11: mqtt.port must be a whole number from 0 to 65535, not -1"),
    ("= 1883", "= 1883.0", "line 11: mqtt.port must be a whole number from 0 to 65535, not 1883.0"),
    (
        "= 1883",
        "= \"1883\"",
        "line 11: mqtt.port must be a whole number from 0 to 65535, not the text \"1883\": leave the quotes away",
    ),
    (
        "= 1883",
        "= 99999999999999999999999999999999999999999",
        "line 11: mqtt.port: the number is too large",
    ),
    ("port = 1883", "version = 5", "line 11: mqtt.version must be text in quotes, not 5"),
    (
        "port = 1883",
        "version = \"3\"",
        "line 11: mqtt.version must be \"auto\", \"3.1.1\" or \"5\", not the text \"3\"",
    ),
    (
        "port = 1883",
        "format = \"xml\"",
        "line 11: mqtt.format must be \"json\" or \"postcard\", not the text \"xml\"",
    ),
    (
        "port = 1883",
        "[model]\nviews = \"near\"",
        "line 12: model.views must be \"auto\" or \"whole\", not the text \"near\"",
    ),
    (
        "port = 1883",
        "[model]\ninput = \"big\"",
        "line 12: model.input: \"big\": give auto, or columns and rows such as 800x608",
    ),
    (
        "port = 1883",
        "[traffic]\nsection_m = { 1 = \"a\" }",
        "line 12: traffic.section_m.1 must be a number, not the text \"a\"",
    ),
    (
        "port = 1883",
        "[traffic]\nsection_m = 5",
        "line 12: traffic.section_m must be a section: [traffic.section_m] on a line of its own, its keys below, not 5",
    ),
    (
        "site = \"a\"",
        "site = 3",
        "line 1: site must be the site's name in quotes, or a section [site] with its id and where it is, not 3",
    ),
    ("site = \"a\"", "camera = \"x\"\n[model]", "line 3: camera is there twice: keep one"),
    // Names.
    (
        "interval_s",
        "intervall_s",
        "line 5: camera.intervall_s is not known: do you mean camera.interval_s?",
    ),
    (
        "interval_s",
        "Interval_s",
        "line 5: camera.Interval_s is not known: do you mean camera.interval_s?",
    ),
    (
        "interval_s",
        "interval-s",
        "line 5: camera.interval-s is not known: do you mean camera.interval_s?",
    ),
    (
        "interval_s",
        "interval",
        "line 5: camera.interval is not known: do you mean camera.interval_s?",
    ),
    ("source", "url", "line 4: camera.url is not known: do you mean camera.source?"),
    (
        "id = \"c\"",
        "id = \"c\"\npassword = \"s3cret\"",
        "line 4: camera.password is not known: do you mean camera.password_file?",
    ),
    (
        "id = \"c\"",
        "id = \"c\"\nusername = \"x\"",
        "line 4: camera.username is not known: do you mean camera.user?",
    ),
    (
        "id = \"c\"",
        "id = \"c\"\nport = 3",
        "line 4: camera.port is not known: port stands below [mqtt]",
    ),
    (
        "id = \"c\"",
        "id = \"c\"\ncolour = 3",
        "line 4: camera.colour is not known: [camera] takes id, source, interval_s, timeout_s, user, password_file, ca_file, fingerprint, redirect_hosts, watch",
    ),
    ("[camera]", "[Camera]", "line 2: [Camera] is not known: do you mean [camera]?"),
    ("[mqtt]", "[mqt]", "line 10: mqt is not known: do you mean [mqtt]?"),
    (
        "[mqtt]",
        "[broker]",
        "line 10: broker is not known: the file takes site, [camera], [model], [lane_table], [windows], [traffic], [mqtt], [spool], [serial], [home_assistant], [metrics]",
    ),
    (
        "site = \"a\"",
        "site = \"a\"\nport = 1883",
        "line 2: port is not known: port stands below [mqtt]",
    ),
    (
        "site = \"a\"",
        "sight = \"a\"",
        "line 1: sight is not known: the file takes site, [camera], [model], [lane_table], [windows], [traffic], [mqtt], [spool], [serial], [home_assistant], [metrics]",
    ),
    ("port = 1883", "server = \"x\"", "line 11: mqtt.server is not known: do you mean mqtt.host?"),
    ("port = 1883", "topic = \"x\"", "line 11: mqtt.topic is not known: do you mean mqtt.root?"),
    ("port = 1883", "mqtt.port = 3", "line 11: below [mqtt] keys stand without \"mqtt.\" in front"),
    (
        "[lane_table]\nfile = \"a.lut\"",
        "lane_table = \"a.lut\"",
        "line 6: lane_table is a section: [lane_table] on a line of its own, its keys below",
    ),
    ("[camera]\n", "", "line 2: id is not known: id stands below [site] or below [camera]"),
    // What is missing.
    ("interval_s = 2\n", "", "line 2: camera.interval_s is missing: add it below [camera]"),
    ("site = \"a\"\n", "", "site is missing"),
    ("[lane_table]\nfile = \"a.lut\"\n", "", "the section [lane_table] is missing"),
    ("file = \"a.lut\"\n", "", "line 6: lane_table.file is missing: add it below [lane_table]"),
    ("site = \"a\"", "[site]\nname = \"a\"", "line 1: site.id is missing: add it below [site]"),
    (
        "site = \"a\"",
        "[site]\nid = \"a\"\nlattitude = 3",
        "line 3: site.lattitude is not known: do you mean site.latitude?",
    ),
    // No TOML.
    ("= 2\n", "= soon\n", "line 5: interval_s: text needs quotes"),
    ("= 2\n", "= 2 s\n", "line 5: interval_s: write a number without a unit, and text in quotes"),
    ("= 2\n", "= 75%\n", "line 5: interval_s: write a number without a unit, and text in quotes"),
    ("= 2\n", "= 2,5\n", "line 5: interval_s: a number has a point, no comma"),
    ("= 2\n", "= 02\n", "line 5: interval_s: a number has no 0 in front"),
    ("= 2\n", "= .5\n", "line 5: interval_s: a number has digits on both sides of its point: 0.5"),
    ("= 2\n", "=\n", "line 5: interval_s: no value stands behind the ="),
    ("interval_s =", "interval_s:", "line 5: write interval_s = with its value behind, no colon"),
    ("interval_s =", "interval_s", "line 5: a line has the form key = value, or [section]"),
    ("= 2\n", "= 2\ninterval_s = 3\n", "line 6: interval_s is there twice: keep one"),
    (
        "id = \"c\"",
        "id = \u{201c}c\u{201d}",
        "line 3: id: typographic quotes: write straight ones (\")",
    ),
    ("id = \"c\"", "id = \"c", "line 3: id: the text's closing quote is missing"),
    (
        "id = \"c\"",
        "id = \"c\"\nwatch = True",
        "line 4: watch: write true or false, in small letters",
    ),
    (
        "id = \"c\"",
        "id = \"C:\\cam\"",
        "line 3: id: a \\ has a meaning of its own between double quotes: write /, or take single quotes",
    ),
    ("[camera]", "[camera", "line 2: a section's name stands between [ and ] on a line of its own"),
    ("[camera]", "[camera]\n[camera]", "line 3: camera is there twice: keep one"),
    ("[camera]", "[[camera]]", "line 2: camera is there once, in single brackets: [camera]"),
    (
        "[60]",
        "[60 90]",
        "line 9: lengths_s: a list has its values between [ and ], texts in quotes, with commas between them",
    ),
    (
        "[60]",
        "[60",
        "line 9: lengths_s: a list has its values between [ and ], texts in quotes, with commas between them",
    ),
    (
        "site = \"a\"",
        "{\"site\": 1}",
        "line 1: this looks like JSON; here a line has the form key = value",
    ),
    (
        "site = \"a\"",
        "<html>",
        "line 1: this looks like XML or HTML; here a line has the form key = value",
    ),
    ("site = \"a\"", "hello", "line 1: a line has the form key = value, or [section]"),
];

#[test]
fn what_is_wrong_is_told_in_plain_words() {
    let mut wrong = Vec::new();
    for (from, to, expected) in TABLE {
        let said = fault(from, to);
        if said != expected {
            wrong.push(format!("{to:?}\n  is:   {said}\n  want: {expected}"));
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn a_password_is_not_quoted() {
    for (from, to) in [
        ("id = \"c\"", "id = \"c\"\npassword = s3cret"),
        ("id = \"c\"", "id = \"c\"\npassword = \"s3cret"),
        ("source = \"http", "source = http"),
        ("source = \"http", "source = [\"http"),
        ("pwd=s3cret\"", "pwd=s3cret"),
        ("source = \"http", "watch = \"http"),
        ("source = \"http", "interval_s = \"http"),
        ("site = \"a\"", "s3cret@host: 5"),
    ] {
        let said = fault(from, to);
        assert!(!said.contains("s3cret"), "{said}");
    }
}

#[test]
fn any_change_of_a_file_is_told_in_words_of_our_own() {
    let jargon =
        ["expected", "invalid", "field", "variant", "struct", "sequence", "map", "f64", "u16"];
    let known = example::names();
    for at in 0..GOOD.len() {
        for put in ["", "\"", "[", "]", "{", "=", "#", "\n", " x ", "\\", "5", "\u{1b}"] {
            let text = format!("{}{put}{}", &GOOD[..at], &GOOD[at + usize::from(put.is_empty())..]);
            if let Err(fault) = parse::<Config>(&text, &known) {
                let said = fault.to_string();
                let own = jargon.iter().all(|word| !said.split([' ', ':']).any(|one| one == *word));
                assert!(own && !said.contains('`'), "{text}\n{said}");
                assert!(!said.contains("s3cret"), "{said}");
            }
        }
    }
}

#[test]
fn a_key_has_its_line() {
    assert_eq!(line_of(GOOD, "camera.interval_s"), Some(5));
    assert_eq!(line_of(GOOD, "site"), Some(1));
    assert_eq!(line_of(GOOD, "mqtt.host"), None);
    assert_eq!(line_of("a = 1\nmqtt.port = 2\n", "mqtt.port"), Some(2));
}
