//! A camera, a device and a broker that send anything, in front of the whole program: it goes on,
//! and its memory stays bounded.
//!
//! Some seconds as a test; `VERGE_LONG=1 cargo test --test fuzz hour -- --nocapture` takes an hour
//! and prints a line a minute: the most memory so far, memory now, processor time.

mod broker;
mod camera;
mod device;
mod video;

use super::common::mosquitto::Running;
use super::fake_broker::FakeBroker;
use super::{common, fake_broker, files, http, mutate, pictures, rtsp};
use std::fs::{self, File};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};
use verge::units::ImageSize;

/// Size of the packaged program, MB. The tests' own is ten times as large, and its pages are counted
/// with its memory; in place of those that it has touched, this is counted whole.
const PROGRAM_MB: f64 = 12.0;
/// Columns and rows of the pictures: the largest that are measured unscaled.
const SIZE: (u32, u32) = (3840, 2160);

fn is_long() -> bool {
    std::env::var_os("VERGE_LONG").is_some()
}

fn duration() -> Duration {
    if is_long() { Duration::from_secs(3600) } else { Duration::from_secs(6) }
}

/// `verge run`, and what is known of it from outside.
struct Watched {
    what: &'static str,
    process: Running,
    folder: tempfile::TempDir,
}

impl Watched {
    /// Starts it with sections of the configuration; `prepare` may add to the command.
    fn start(what: &'static str, sections: &str, prepare: impl FnOnce(&mut Command)) -> Self {
        let folder = common::folder();
        let path = folder.path().join("verge.toml");
        fs::write(&path, format!("site = \"hour\"\n{sections}")).expect("written");
        let log = File::create(folder.path().join("log")).expect("a log");
        let mut command = Command::new(env!("CARGO_BIN_EXE_verge"));
        command
            .args(["run", "--config", path.to_str().expect("UTF-8")])
            // Symbols for a backtrace are no memory of the program's.
            .env_remove("RUST_BACKTRACE")
            .stdout(Stdio::null())
            .stderr(log);
        prepare(&mut command);
        Self { what, process: command.spawn().map(Running).expect("it starts"), folder }
    }

    fn log(&self) -> String {
        String::from_utf8_lossy(&fs::read(self.folder.path().join("log")).expect("a log"))
            .into_owned()
    }

    /// Waits until it speaks to its broker: it is in work then.
    fn wait_for(&self, broker: &FakeBroker) {
        let begun = Instant::now();
        while broker.connections() == 0 {
            assert!(begun.elapsed() < Duration::from_secs(300), "{}: {}", self.what, self.log());
            std::thread::sleep(Duration::from_millis(50));
        }
    }

    /// A field of the process's status, MB.
    fn megabytes(&self, field: &str) -> f64 {
        let path = format!("/proc/{}/status", self.process.0.id());
        let status = fs::read_to_string(path).expect("it lives");
        let line = status.lines().find(|line| line.starts_with(field)).expect("a line");
        let kilobytes = line.split_whitespace().nth(1).and_then(|kb| kb.parse::<f64>().ok());
        kilobytes.expect("a number") / 1024.0
    }

    /// The most memory so far, MB, with the packaged program in place of the tests'.
    fn most_mb(&self) -> f64 {
        self.megabytes("VmHWM") - self.megabytes("RssFile") + PROGRAM_MB
    }

    /// Processor time, s.
    fn processor_s(&self) -> f64 {
        let path = format!("/proc/{}/stat", self.process.0.id());
        let stat = fs::read_to_string(path).expect("it lives");
        let behind = stat.rsplit_once(')').expect("a name").1;
        let ticks: f64 =
            behind.split_whitespace().skip(11).take(2).filter_map(|t| t.parse::<f64>().ok()).sum();
        ticks / 100.0
    }

    /// Watches for the hour, `often` a second, and ends with the most memory, MB.
    fn watch(&mut self, bound_mb: f64, mut often: impl FnMut(Duration)) {
        let (begun, mut minute) = (Instant::now(), 0);
        while begun.elapsed() < duration() {
            std::thread::sleep(Duration::from_millis(500));
            if let Some(status) = self.process.0.try_wait().expect("ours") {
                panic!("{} ended with {status}: {}", self.what, tail(&self.log()));
            }
            let most = self.most_mb();
            assert!(most < bound_mb, "{}: {most:.1} MB; {}", self.what, tail(&self.log()));
            often(begun.elapsed());
            if begun.elapsed().as_secs() / 60 > minute || begun.elapsed() >= duration() {
                minute += 1;
                println!(
                    "{}, minute {minute}: at most {most:.1} MB ({:.1} with the tests' program), now \
                     {:.1} MB, {:.0} s of processor",
                    self.what,
                    self.megabytes("VmHWM"),
                    self.megabytes("RssAnon") + PROGRAM_MB,
                    self.processor_s(),
                );
            }
        }
        // A panic that was caught cost a picture, and is a fault all the same.
        let log = self.log();
        println!("{}: {} lines in the log", self.what, log.lines().count());
        if !self.what.starts_with("device") {
            assert!(!log.contains("panicked at"), "{}: {}", self.what, tail(&log));
        }
    }
}

fn tail(log: &str) -> &str {
    let from = log.len().saturating_sub(3000);
    log.get(from..).unwrap_or(log)
}

/// The sections of a camera whose pictures are as large as they may be.
fn camera_sections(table: &Path, source: &str, interval_s: f64, port: u16) -> String {
    let (here, table) = (std::env::current_dir().expect("a folder"), table.display());
    format!(
        "[camera]\nid = \"camera\"\ninterval_s = {interval_s}\nsource = \"{source}\"\n\
         timeout_s = 5.0\n[model]\nfile = \"{}/{}\"\n[lane_table]\nfile = \"{table}\"\n\
         [windows]\nlengths_s = [10, 60]\n[mqtt]\nport = {port}\n",
        here.display(),
        common::MODEL,
    )
}

/// A lane table for pictures of the shape of [`SIZE`].
fn table(folder: &Path) -> PathBuf {
    let (path, size) = (folder.join("wide.lut"), ImageSize { width: 640, height: 360 });
    fs::write(&path, files::table(size, 10.0, None)).expect("written");
    path
}
