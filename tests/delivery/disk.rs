//! The spool on disks of its own, in a mount namespace: one that is full, and one whose every
//! written sector is counted.

use super::{Arrived, CHILD, PATIENCE, collect, common, is_long, outlet, tend};
use common::mosquitto::Mosquitto;
use std::fs::{self, File};
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::Command;
use verge::daemon::publish::loopback::Subscriber;
use verge_desk::free_port;

/// Runs the test `name` of this program again, with a disk that `mount` has put into a folder,
/// whose path it gets. False where the kernel allows no mount: nothing that could be installed.
fn on_a_disk_of_its_own(name: &str, mount: &str) -> bool {
    let folder = common::folder();
    let disk = folder.path().join("disk");
    fs::create_dir(&disk).expect("a folder");
    let program = std::env::current_exe().expect("this program");
    let run = |options: &[&str], script: &str| {
        Command::new("unshare")
            .args(options)
            .args(["sh", "-ec", script, "sh"])
            .args([folder.path(), &disk, &program])
            .arg(name)
            .env(CHILD, &disk)
            .status()
    };
    let options = [&["--mount"][..], &["--mount", "--user", "--map-root-user"]];
    let allowed = |options: &&&[&str]| run(options, mount).is_ok_and(|status| status.success());
    let Some(options) = options.iter().find(allowed) else {
        eprintln!("skipped: the kernel allows no mount here");
        return false;
    };
    let status = run(options, &format!("{mount}; exec \"$3\" --exact \"$4\" --nocapture"));
    assert!(status.expect("it ran before").success(), "{name} in its namespace");
    true
}

/// The disk, in the process that has one.
fn disk() -> Option<PathBuf> {
    std::env::var_os(CHILD).map(PathBuf::from)
}

/// Takes all the room that is left.
fn fill(disk: &Path) -> PathBuf {
    let path = disk.join("filler");
    let mut file = File::create(&path).expect("a file");
    while file.write_all(&[0x55; 4096]).is_ok() {}
    while file.write_all(&[0x55]).is_ok() {}
    path
}

#[test]
fn on_a_full_disk_windows_wait_in_memory_and_none_is_lost() {
    if Mosquitto::installed().is_some() {
        on_a_disk_of_its_own("disk::child_full", "mount -t tmpfs -o size=3m tmpfs \"$2\"");
    }
}

#[test]
fn child_full() {
    let (Some(disk), Some(mosquitto)) = (disk(), Mosquitto::installed()) else { return };
    let port = free_port();
    let mut sent = 0;
    // Full before the spool is made: the broker gets everything from memory.
    let filler = fill(&disk);
    let mut outlet = outlet(port, &disk.join("spool"), 1000.0);
    let mut accept = |outlet: &mut verge::daemon::outlet::Outlet, windows| {
        for _ in 0..windows {
            sent += 1;
            super::accept(outlet, sent);
        }
        sent
    };
    accept(&mut outlet, 50);
    assert_eq!((outlet.counts().in_memory, outlet.counts().waiting), (50, 50));
    let mut broker = mosquitto.start(port);
    let mut subscriber = Subscriber::connect(port, "verge/#").expect("a subscription");
    tend(&mut outlet, "from memory", |outlet| outlet.counts().waiting == 0);
    let mut arrived = Arrived::default();
    while arrived.times.len() < 50 {
        let (topic, payload) = subscriber.next(PATIENCE).expect("all of them");
        arrived.note(&topic, &payload);
    }
    arrived.assert_complete(50);
    // Room again, an outage, and full in the middle of it.
    broker.kill();
    drop(subscriber);
    tend(&mut outlet, "the outage", |outlet| !outlet.is_open());
    fs::remove_file(&filler).expect("removed");
    accept(&mut outlet, 100);
    assert_eq!((outlet.counts().in_memory, outlet.counts().waiting), (0, 100));
    let filler = fill(&disk);
    let last = accept(&mut outlet, 1400);
    let counts = outlet.counts();
    println!("full: {counts:?}");
    assert!(counts.in_memory > 0 && counts.dropped == 0, "{counts:?}");
    assert_eq!(counts.waiting, 1500);
    // With room the next window takes all others along to the disk.
    fs::remove_file(&filler).expect("removed");
    let last = last.max(accept(&mut outlet, 1));
    assert_eq!((outlet.counts().in_memory, outlet.counts().waiting), (0, 1501));
    // The next life finds them there, and a broker that is back gets them.
    outlet.stop();
    let mut outlet = super::outlet(port, &disk.join("spool"), 1000.0);
    assert_eq!((outlet.counts().waiting, outlet.counts().damaged), (1501, 0));
    let _broker = mosquitto.start(port);
    // Debian's broker keeps a thousand messages for a slow subscriber and no more.
    let (stop, collected) = collect(Subscriber::connect(port, "verge/#").expect("a subscription"));
    tend(&mut outlet, "from the disk", |outlet| outlet.counts().waiting == 0);
    outlet.stop();
    drop(stop);
    arrived.times.extend(collected.recv_timeout(PATIENCE).expect("the subscriber ends").times);
    arrived.assert_complete(u64::try_from(last).expect("positive"));
}

#[test]
fn what_a_window_costs_the_disk() {
    if !is_long() || Mosquitto::installed().is_none() {
        return;
    }
    // Blocks as large as on every card of more than 512 MB.
    let mount = "[ -e \"$1/image\" ] || \
                 { truncate -s 64M \"$1/image\"; mkfs.ext4 -qb 4096 \"$1/image\"; }; \
                 mount -o loop,noatime \"$1/image\" \"$2\"";
    on_a_disk_of_its_own("disk::child_counted", mount);
}

/// Bytes that were written to the disk's device, all of them.
fn written(disk: &Path) -> u64 {
    let synced = Command::new("sync").arg("-f").arg(disk).status().expect("sync runs");
    assert!(synced.success());
    let device = Command::new("findmnt").args(["-no", "SOURCE"]).arg(disk).output();
    let device = String::from_utf8(device.expect("findmnt runs").stdout).expect("text");
    let name = device.trim().trim_start_matches("/dev/");
    let stat = fs::read_to_string(format!("/sys/block/{name}/stat")).expect("a block device");
    // Documentation/block/stat.rst: the seventh is sectors written, of 512 bytes.
    let sectors: u64 = stat.split_whitespace().nth(6).expect("a field").parse().expect("a number");
    sectors * 512
}

/// As a box does it: a window, its acknowledgement, and then a minute in which the system
/// writes all that it still holds.
#[test]
fn child_counted() {
    let (Some(disk), Some(mosquitto)) = (disk(), Mosquitto::installed()) else { return };
    let port = free_port();
    let _broker = mosquitto.start(port);
    let mut outlet = outlet(port, &disk.join("spool"), 1000.0);
    tend(&mut outlet, "a session", |outlet| outlet.is_open());
    // The first makes the segment.
    super::accept(&mut outlet, 1);
    tend(&mut outlet, "delivery", |outlet| outlet.counts().waiting == 0);
    let (before, counts) = (written(&disk), outlet.counts());
    let windows = 1000;
    for n in 0..windows {
        super::accept(&mut outlet, n + 2);
        tend(&mut outlet, "delivery", |outlet| outlet.counts().waiting == 0);
        written(&disk);
    }
    let (bytes, after) = (written(&disk) - before, outlet.counts());
    let per_window = |bytes: u64| bytes as f64 / windows as f64;
    assert!(bytes < 8 * 4096 * windows as u64, "{bytes} bytes for {windows} windows");
    println!(
        "{windows} windows: {:.0} bytes a window handed to the file, {:.0} written to the \
         device with all that the file system adds; {} syncs",
        per_window(after.written_bytes - counts.written_bytes),
        per_window(bytes),
        after.syncs - counts.syncs,
    );
    outlet.stop();
}
