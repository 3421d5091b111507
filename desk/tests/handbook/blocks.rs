//! The command blocks of README, tutorial and how-to pages: they run here, or say why they do not.
//!
//! ` ```sh run ` runs in a folder that the blocks of a page share, in their order, with the
//! programs of this build on the path; `with=openssl` names a program that must be there, or the
//! block and the rest of its page are skipped; `numbers=about` compares output without its digits.
//! Of ` ```console run ` each line behind `$ ` runs, and must print the lines that follow it;
//! `[..]` is any text within a line and `...` any lines. ` ```sh needs=X ` does not run: X is one
//! of [`NEEDS`]. A block of another language with `file=NAME` is written to that file, before later
//! blocks run.

use crate::pages::{all, root};
use std::fs;
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use verge_desk::skip;

/// Why a block does not run here.
const NEEDS: [(&str, &str); 10] = [
    ("package", "installs a package"),
    ("build", "builds for a quarter of an hour"),
    ("camera", "looks at a camera of yours"),
    ("browser", "is worked by hand in a browser"),
    ("broker", "talks to a broker of yours"),
    ("service", "changes a service of systemd"),
    ("node", "talks to an I/O node"),
    ("node_exporter", "runs Prometheus' exporter"),
    ("minisign", "asks for a password"),
    ("centre", "needs the centre's program, whose own tests run it"),
];

/// A block of code.
struct Block<'t> {
    line: usize,
    info: &'t str,
    text: String,
}

fn blocks(text: &str) -> Vec<Block<'_>> {
    let mut blocks: Vec<Block<'_>> = Vec::new();
    let mut open: Option<(usize, Block<'_>)> = None;
    for (index, line) in text.lines().enumerate() {
        let trimmed = line.trim_start();
        let fence = trimmed.strip_prefix("```");
        match (&mut open, fence) {
            (None, Some(info)) => {
                let block = Block { line: index + 1, info, text: String::new() };
                open = Some((line.len() - trimmed.len(), block));
            }
            (Some(_), Some(_)) => blocks.extend(open.take().map(|(_, block)| block)),
            (Some((indent, block)), None) => {
                block.text.push_str(line.get(*indent..).unwrap_or_default());
                block.text.push('\n');
            }
            (None, None) => {}
        }
    }
    blocks
}

/// Whether a page shows how things are done, so that its blocks are run.
fn is_shown(path: &str) -> bool {
    path == "README.md" || path == "docs/tutorial.md" || path.starts_with("docs/how-to/")
}

fn is_shell(block: &Block<'_>) -> bool {
    block.info.starts_with("sh") || block.info.starts_with("console")
}

#[test]
fn every_block_runs_or_says_why_not() {
    let mut faults = Vec::new();
    for page in all().iter().filter(|page| is_shown(&page.path)) {
        for block in blocks(&page.text).iter().filter(|block| is_shell(block)) {
            let tag = block.info.split_whitespace().nth(1).unwrap_or_default();
            let known = NEEDS.iter().any(|(name, _)| tag.strip_prefix("needs=") == Some(name));
            // `.ci/run` runs these two of the README by their names.
            if !known && !["run", "demo", "tests"].contains(&tag) {
                faults.push(format!("{}:{}: ```{}", page.path, block.line, block.info));
            }
        }
        // Blocks that are only indented are neither marked nor run.
        let mut inside = false;
        for (index, line) in page.text.lines().enumerate() {
            inside ^= line.trim_start().starts_with("```");
            let line_is = |program: &str| line.trim_start().starts_with(program);
            let shell = ["verge ", "mvcalib ", "street ", "cargo ", "mosquitto_sub "].map(line_is);
            if !inside && line.starts_with("    ") && shell.contains(&true) {
                faults.push(format!("{}:{}: a command without a fence", page.path, index + 1));
            }
        }
    }
    assert!(faults.is_empty(), "{faults:#?}");
}

#[test]
fn what_is_shown_runs_as_it_is_printed() {
    let programs = programs();
    for name in ["verge", "mvcalib", "street"] {
        if !programs.join(name).exists() {
            skip(&format!("{} is not built", programs.join(name).display()));
            return;
        }
    }
    let mut ran = 0;
    for page in all().iter().filter(|page| is_shown(&page.path)) {
        ran += run_page(&page.path, &page.text, &programs);
    }
    assert!(ran > 5, "{ran} blocks ran");
}

/// Where this build has its programs.
fn programs() -> PathBuf {
    let test = std::env::current_exe().expect("a test program");
    test.parent().and_then(Path::parent).expect("target/debug/deps").to_owned()
}

fn run_page(path: &str, text: &str, programs: &Path) -> usize {
    let runs =
        |block: &Block<'_>| is_shell(block) && block.info.split_whitespace().nth(1) == Some("run");
    let blocks = blocks(text);
    if !blocks.iter().any(runs) {
        return 0;
    }
    let folder = tempfile::tempdir().expect("a temporary folder");
    let share = given(folder.path());
    let mut groups = Groups::default();
    let mut ran = 0;
    for block in &blocks {
        let named = block.info.split_whitespace().find_map(|word| word.strip_prefix("file="));
        if let Some(name) = named {
            let content = block.text.replace("/usr/share/verge", &share);
            fs::write(folder.path().join(name), content).expect("written");
        }
        if !runs(block) {
            continue;
        }
        let missing = block.info.split_whitespace().filter_map(|word| word.strip_prefix("with="));
        let missing: Vec<&str> = missing.filter(|program| !is_there(program)).collect();
        if !missing.is_empty() {
            skip(&format!("{path}:{}: {missing:?} is not installed", block.line));
            break;
        }
        let steps = if block.info.starts_with("console") {
            session(&block.text)
        } else {
            vec![(block.text.clone(), None)]
        };
        for (command, expected) in steps {
            let command = command.replace("/usr/share/verge", &share);
            let (group, passed, printed) = run(&command, folder.path(), programs);
            groups.0.push(group);
            let at = format!("{path}:{}", block.line);
            assert!(passed, "{at}: {command}\n{printed}");
            let printed = printed.replace(&share, "/usr/share/verge");
            if let Some(expected) = expected {
                let about = block.info.contains("numbers=about");
                let read = |text: &str| if about { without_digits(text) } else { text.to_owned() };
                let (wanted, came) = (read(&expected), read(&printed));
                let fits = fits(&lines(&wanted), &lines(&came));
                assert!(fits, "{at}: {command}\nprints\n{printed}\nand not\n{expected}");
            }
        }
        ran += 1;
    }
    ran
}

/// Process groups, ended with what a block left running in the background, where a step fails too.
#[derive(Default)]
struct Groups(Vec<u32>);

impl Drop for Groups {
    fn drop(&mut self) {
        for group in &self.0 {
            let group = format!("-{group}");
            let _ = Command::new("kill").args(["--", &group]).stderr(Stdio::null()).status();
        }
    }
}

/// The files that packages install below `/usr/share/verge`, and recordings of the tests.
fn given(folder: &Path) -> String {
    let tree = root().canonicalize().expect("the tree");
    let share = folder.join("share");
    fs::create_dir(&share).expect("a folder");
    let link = |from: &str, to: PathBuf| {
        std::os::unix::fs::symlink(tree.join(from), to).expect("a link");
    };
    link("models", share.join("models"));
    link("street/scenes", share.join("scenes"));
    link("tests/data/curve.lut", folder.join("curve.lut"));
    // One minute of the recording is enough.
    let frames = folder.join("curve/frames");
    fs::create_dir_all(&frames).expect("a folder");
    let recorded = fs::read_dir(tree.join("tests/data/curve/frames")).expect("it ships");
    let mut names: Vec<String> = recorded
        .map(|entry| entry.expect("an entry").file_name().to_string_lossy().into_owned())
        .collect();
    names.sort();
    for name in names.iter().take(30) {
        link(&format!("tests/data/curve/frames/{name}"), frames.join(name));
    }
    share.to_string_lossy().into_owned()
}

fn is_there(program: &str) -> bool {
    let path = std::env::var_os("PATH").unwrap_or_default();
    let mut folders = std::env::split_paths(&path).chain([PathBuf::from("/usr/sbin")]);
    folders.any(|folder| folder.join(program).exists())
}

/// Runs a script; its process group, whether it succeeded, and what it printed.
fn run(script: &str, folder: &Path, programs: &Path) -> (u32, bool, String) {
    let log = folder.join(".printed");
    let out = fs::File::create(&log).expect("a file");
    let path = std::env::var("PATH").unwrap_or_default();
    let mut child = Command::new("bash")
        .args(["-euo", "pipefail", "-c", script])
        .current_dir(folder)
        .env("PATH", format!("{}:{path}:/usr/sbin", programs.display()))
        .env_remove("RUST_LOG")
        .stdin(Stdio::null())
        .stderr(out.try_clone().expect("a file"))
        .stdout(out)
        .process_group(0)
        .spawn()
        .expect("bash");
    let status = child.wait().expect("bash ends");
    (child.id(), status.success(), fs::read_to_string(&log).expect("text"))
}

/// The commands of a session with what each prints.
fn session(text: &str) -> Vec<(String, Option<String>)> {
    let mut steps: Vec<(String, Option<String>)> = Vec::new();
    let mut goes_on = false;
    for line in text.lines() {
        let command = line.strip_prefix("$ ");
        match (command, steps.last_mut()) {
            (Some(command), _) => steps.push((command.to_owned(), Some(String::new()))),
            (None, Some((before, _))) if goes_on => {
                before.push('\n');
                before.push_str(line);
            }
            (None, Some((_, Some(printed)))) => {
                printed.push_str(line);
                printed.push('\n');
            }
            _ => panic!("a session begins with a command: {text}"),
        }
        goes_on = (command.is_some() || goes_on) && line.ends_with('\\');
    }
    steps
}

/// Text with each number as `0`, and one blank where there are several: figures that follow the
/// model, or the machine's speed, may change while the form stays.
fn without_digits(text: &str) -> String {
    let mut out = String::new();
    // A difference may change its sign.
    for c in text.replace("(+", "(").replace("(-", "(").chars() {
        let number = c.is_ascii_digit() || (c == '.' && out.ends_with('0'));
        let c = if number { '0' } else { c };
        let again = (number && out.ends_with('0')) || (c == ' ' && out.ends_with(' '));
        if !again {
            out.push(c);
        }
    }
    out
}

fn lines(text: &str) -> Vec<&str> {
    text.lines().map(str::trim_end).collect()
}

/// Whether lines are the expected ones.
fn fits(expected: &[&str], printed: &[&str]) -> bool {
    match (expected.split_first(), printed.split_first()) {
        (None, None) => true,
        (Some((&"...", rest)), _) => {
            (0..=printed.len()).any(|skipped| fits(rest, &printed[skipped..]))
        }
        (Some((line, rest)), Some((first, others))) => line_fits(line, first) && fits(rest, others),
        _ => false,
    }
}

fn line_fits(expected: &str, printed: &str) -> bool {
    let mut parts = expected.split("[..]");
    let Some(mut rest) = parts.next().and_then(|first| printed.strip_prefix(first)) else {
        return false;
    };
    let mut parts = parts.peekable();
    if parts.peek().is_none() {
        return rest.is_empty();
    }
    while let Some(part) = parts.next() {
        if parts.peek().is_none() {
            return rest.ends_with(part);
        }
        let Some(at) = rest.find(part) else { return false };
        rest = &rest[at + part.len()..];
    }
    true
}

#[test]
fn output_is_compared_line_by_line() {
    let printed = ["a 1", "b", "c 2.50 end"];
    for (expected, right) in [
        (vec!["a [..]", "b", "c [..] end"], true),
        (vec!["a 1", "..."], true),
        (vec!["...", "c [..]"], true),
        (vec!["a 1", "b"], false),
        (vec!["a 2", "..."], false),
        (vec!["a [..]", "...", "d"], false),
    ] {
        assert_eq!(fits(&expected, &printed), right, "{expected:?}");
    }
    assert_eq!(without_digits("a 1.25 +- 30 s,   7"), without_digits("a 12.5 +- 9 s, 7"));
    assert_ne!(without_digits("a 1 b"), without_digits("a 1 c"));
    let steps = session("$ a \\\n  b\nout\n$ c\n");
    assert_eq!(steps[0], ("a \\\n  b".into(), Some("out\n".into())));
    assert_eq!(steps[1], ("c".into(), Some(String::new())));
}
