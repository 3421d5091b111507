//! A camera at the box that sends anything, through a driver that keeps the kernel's promises.
//!
//! The driver is `device.c`: it is put in front of the C library's `open`, `ioctl` and `poll`, so
//! that the daemon's own V4L2 door is what is attacked. The pictures lie in files.

use super::camera::Pictures;
use super::fake_broker::{FakeBroker, Manners};
use super::{Watched, camera_sections, common, table, tail};
use std::path::Path;
use std::process::Command;

/// Most memory that the daemon may take, MB.
const BOUND_MB: f64 = 128.0;
/// Pictures, right and wrong, between which the camera changes.
const PICTURES: usize = 64;

#[test]
fn a_device_may_send_anything() {
    let folder = tempfile::tempdir_in("/dev/shm").expect("shared memory");
    let driver = folder.path().join("driver.so");
    let built = Command::new("cc")
        .args(["-shared", "-fPIC", "-O1", "-Wall", "-Werror", "-o"])
        .args([&driver, Path::new("tests/fuzz/hour/device.c")])
        .args(["-ldl"])
        .status();
    if !built.is_ok_and(|status| status.success()) {
        return common::skip("there is no C compiler with the kernel's videodev2.h");
    }
    let (pictures, mut rng) = (Pictures::shared(), fastrand::Rng::with_seed(4));
    for number in 0..PICTURES {
        let path = folder.path().join(format!("picture{number}"));
        std::fs::write(path, pictures.any(&mut rng)).expect("written");
    }
    let device = folder.path().join("video0");
    std::fs::write(&device, []).expect("a file");
    let table = table(folder.path());
    let broker = FakeBroker::start(Manners::default());
    let source = device.to_str().expect("UTF-8");
    let sections = camera_sections(&table, source, 1.0, broker.port);
    let mut daemon = Watched::start("device", &sections, |command| {
        command.env("LD_PRELOAD", &driver).env("VERGE_FAKE_CAMERA", folder.path());
    });
    daemon.wait_for(&broker);
    daemon.watch(BOUND_MB, |_| ());
    println!("{}", tail(&daemon.log()));
}
