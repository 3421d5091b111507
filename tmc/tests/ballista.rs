//! `verge-tmc report --cluster`: a scheduler and two executors give the report of one process.

mod common;

use common::{failure, made_day, succeed, text};
use std::collections::BTreeMap;
use std::io::{BufRead, BufReader};
use std::net::TcpListener;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

/// Long enough for a machine that is busy with other things.
const PATIENCE: Duration = Duration::from_secs(120);
/// Monday 5 January 2026.
const MONDAY: i64 = 20_458;

/// A process of the cluster, ended when it is dropped.
struct Part(Child);

impl Part {
    fn start(args: &[&str]) -> Self {
        let mut command = Command::new(env!("CARGO_BIN_EXE_verge-tmc-cluster"));
        // The standard input stays open as long as this test lives.
        command.args(args).arg("--with-parent").stdin(Stdio::piped()).stdout(Stdio::piped());
        Self(command.spawn().expect("the program starts"))
    }
}

impl Drop for Part {
    fn drop(&mut self) {
        // Either may fail where it has ended already.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

fn scheduler() -> (Part, String) {
    let mut part = Part::start(&["scheduler", "--bind", "127.0.0.1:0"]);
    let mut line = String::new();
    let said = part.0.stdout.take().expect("it is piped");
    BufReader::new(said).read_line(&mut line).expect("it says where it listens");
    assert!(!line.is_empty(), "the scheduler ended");
    (part, line.trim().to_owned())
}

/// An executor that listens. A port that is free now may be taken a moment later: then another.
fn executor(scheduler: &str, work: &Path) -> Part {
    let begun = Instant::now();
    while begun.elapsed() < PATIENCE {
        let free = TcpListener::bind("127.0.0.1:0").expect("a free port");
        let address = free.local_addr().expect("an address").to_string();
        drop(free);
        let work = ["--work", text(work), "--cores", "2"];
        let args = [&["executor", "--scheduler", scheduler, "--bind", &address], &work[..]];
        let mut part = Part::start(&args.concat());
        while begun.elapsed() < PATIENCE && part.0.try_wait().expect("a child").is_none() {
            if std::net::TcpStream::connect(&address).is_ok() {
                return part;
            }
            std::thread::sleep(Duration::from_millis(50));
        }
    }
    panic!("no executor in {PATIENCE:?}");
}

/// Every file of a report.
fn files(folder: &Path) -> BTreeMap<String, Vec<u8>> {
    let mut found = BTreeMap::new();
    for entry in std::fs::read_dir(folder).expect("a folder") {
        let path = entry.expect("an entry").path();
        if path.is_dir() {
            found.extend(files(&path));
        } else {
            found.insert(text(&path).to_owned(), std::fs::read(&path).expect("a file"));
        }
    }
    found
}

/// Sums of densities are exact whatever their order (`report/summary.rs`), so the reports of one
/// process and of a cluster are compared byte by byte.
#[test]
fn a_cluster_gives_the_report_of_one_process() {
    let folder = tempfile::tempdir().expect("a folder");
    let archive = folder.path().join("archive");
    for (site, days) in [("north", 0..9), ("south", 3..5), ("west", 0..1)] {
        days.for_each(|day| made_day(site, MONDAY + day, &archive));
    }
    let (_scheduler, address) = scheduler();
    let work = ["a", "b"].map(|name| folder.path().join(name));
    let _executors = work.each_ref().map(|work| executor(&address, work));
    let report = |name: &str, more: &[&str]| -> BTreeMap<String, Vec<u8>> {
        let out = folder.path().join(name);
        let args = ["report", "--archive", text(&archive), "--out", text(&out)];
        let said =
            succeed(&[&args[..], &["--utc-offset", "+08:00", "--threads", "3"], more].concat());
        assert!(said.starts_with("3 sites, 103680 rows"), "{said}");
        let prefix = text(&out).to_owned();
        let files = files(&out).into_iter();
        files.map(|(name, bytes)| (name[prefix.len()..].to_owned(), bytes)).collect()
    };
    let one = report("one", &[]);
    // Until both executors had a part in it and left results in their folders: one may be slow
    // to begin.
    let begun = Instant::now();
    for run in 0.. {
        let cluster = report(&format!("cluster{run}"), &["--cluster", &address]);
        assert!(one.keys().eq(cluster.keys()), "{:?} {:?}", one.keys(), cluster.keys());
        let differ: Vec<_> = one.keys().filter(|name| one[*name] != cluster[*name]).collect();
        assert!(differ.is_empty(), "{differ:?}");
        if work.iter().all(|work| !files(work).is_empty()) {
            return;
        }
        assert!(begun.elapsed() < PATIENCE, "an executor has nothing to do");
    }
}

#[test]
fn a_cluster_that_is_not_there_is_said() {
    let folder = tempfile::tempdir().expect("a folder");
    let archive = folder.path().join("archive");
    made_day("north", MONDAY, &archive);
    let free = TcpListener::bind("127.0.0.1:0").expect("a free port");
    let address = free.local_addr().expect("an address").to_string();
    drop(free);
    let out = folder.path().join("report");
    let args = ["report", "--archive", text(&archive), "--out", text(&out), "--cluster", &address];
    let (code, said) = failure(&args);
    assert_eq!(code, 69, "{said}");
    assert!(said.contains(&address) && said.contains("scheduler and executors"), "{said}");
}
