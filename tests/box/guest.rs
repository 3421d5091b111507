//! Kernel calls that the box's shell has no command for: a camera's control, a write to a sensor, a
//! thread that is stopped, pictures for a camera that plays them.
//!
//! Compiled by `run` with nothing but the compiler:
//!
//!     guest control /dev/video0 0x00f0f040 100
//!     guest word /dev/i2c-0 0x48 0x00 0x8019
//!     guest hang 123
//!     guest play /dev/video9 320 240 5000 a.jpg b.jpg

use std::fs::{File, OpenOptions};
use std::io::{Error, Write};
use std::os::fd::AsRawFd;
use std::time::{Duration, Instant};

/// `VIDIOC_S_CTRL`: `_IOWR('V', 28, struct v4l2_control)`.
const S_CTRL: u64 = 0xc008_561c;
/// `VIDIOC_S_FMT`: `_IOWR('V', 5, struct v4l2_format)`.
const S_FMT: u64 = 0xc0d0_5605;
/// `V4L2_BUF_TYPE_VIDEO_OUTPUT`, `V4L2_FIELD_NONE`, and the format of JPEG after JPEG.
const OUTPUT: u32 = 2;
const FIELD_NONE: u32 = 1;
const MJPG: u32 = u32::from_le_bytes(*b"MJPG");
/// Time between two frames of a played camera.
const FRAME_TIME: Duration = Duration::from_millis(200);
/// `I2C_SLAVE_FORCE`: also where a driver holds the address.
const I2C_SLAVE_FORCE: u64 = 0x0706;
/// `I2C_SMBUS`.
const I2C_SMBUS: u64 = 0x0720;
/// `I2C_SMBUS_WORD_DATA`.
const WORD_DATA: u32 = 3;
/// `PTRACE_SEIZE` and `PTRACE_INTERRUPT`: one thread, and no signal that the others hear.
const SEIZE: u64 = 0x4206;
const INTERRUPT: u64 = 0x4207;

unsafe extern "C" {
    fn ioctl(fd: i32, request: u64, ...) -> i32;
    fn ptrace(request: u64, thread: i32, address: u64, data: u64) -> i64;
}

#[repr(C)]
struct Control {
    id: u32,
    value: i32,
}

/// `struct v4l2_format` with the beginning of its `v4l2_pix_format`.
#[repr(C, align(8))]
struct Format {
    kind: u64,
    width: u32,
    height: u32,
    pixels: u32,
    field: u32,
    line_bytes: u32,
    picture_bytes: u32,
    rest: [u32; 44],
}

#[repr(C)]
struct Smbus {
    read: u8,
    command: u8,
    size: u32,
    data: *mut u16,
}

fn number(text: &str) -> u32 {
    let parsed = match text.strip_prefix("0x") {
        Some(digits) => u32::from_str_radix(digits, 16),
        None => text.parse(),
    };
    parsed.unwrap_or_else(|error| panic!("{text}: {error}"))
}

fn ok(outcome: i32, what: &str) {
    assert!(outcome >= 0, "{what}: {}", Error::last_os_error());
}

/// How many have v4l2loopback's devices open, this program among them.
fn users() -> u32 {
    let count = std::fs::read_to_string("/sys/module/v4l2loopback/refcnt");
    count.ok().and_then(|count| count.trim().parse().ok()).unwrap_or(0)
}

/// Plays pictures in a loop as a camera's MJPG: each stands for `milliseconds`, in which it is
/// sent as often as a camera would. Who opens the camera finds a picture in the middle of its
/// time, so that one who takes a picture in every `milliseconds` from then on takes each once,
/// up to half of them early or late.
fn play(device: &mut File, [width, height, milliseconds]: [u32; 3], files: &[&str]) -> ! {
    let pictures: Vec<Vec<u8>> = files
        .iter()
        .map(|file| std::fs::read(file).unwrap_or_else(|e| panic!("{file}: {e}")))
        .collect();
    let mut format = Format {
        kind: u64::from(OUTPUT),
        width,
        height,
        pixels: MJPG,
        field: FIELD_NONE,
        line_bytes: 0,
        picture_bytes: width * height * 2,
        rest: [0; 44],
    };
    // SAFETY: the request takes a v4l2_format, which lives through the call.
    ok(unsafe { ioctl(device.as_raw_fd(), S_FMT, &raw mut format) }, "VIDIOC_S_FMT");
    let half = Duration::from_millis(u64::from(milliseconds) / 2);
    let (mut opened, mut known) = (Instant::now(), users());
    loop {
        let users = users();
        if users > known {
            opened = Instant::now();
        }
        known = users;
        let number = (opened.elapsed() + half).as_millis() / u128::from(milliseconds);
        let picture = &pictures[number as usize % pictures.len()];
        device.write_all(picture).unwrap_or_else(|error| panic!("a picture: {error}"));
        std::thread::sleep(FRAME_TIME);
    }
}

/// Stops a thread for as long as this program lives.
fn hang(thread: i32) -> ! {
    for request in [SEIZE, INTERRUPT] {
        // SAFETY: neither request takes a pointer.
        let outcome = unsafe { ptrace(request, thread, 0, 0) };
        assert!(outcome == 0, "ptrace {request:#x}: {}", Error::last_os_error());
    }
    loop {
        std::thread::park();
    }
}

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let arguments: Vec<&str> = arguments.iter().map(String::as_str).collect();
    if let ["hang", thread] = arguments[..] {
        hang(number(thread) as i32);
    }
    let [what, path, numbers @ ..] = &arguments[..] else { panic!("guest WHAT DEVICE NUMBER...") };
    let device = OpenOptions::new().read(true).write(true).open(path);
    let mut device = device.unwrap_or_else(|error| panic!("{path}: {error}"));
    let fd = device.as_raw_fd();
    match (*what, numbers) {
        ("control", [id, value]) => {
            let mut control = Control { id: number(id), value: number(value) as i32 };
            // SAFETY: the request takes a v4l2_control, which lives through the call.
            ok(unsafe { ioctl(fd, S_CTRL, &raw mut control) }, "VIDIOC_S_CTRL");
        }
        ("word", [address, command, word]) => {
            // SAFETY: the request takes a number.
            ok(unsafe { ioctl(fd, I2C_SLAVE_FORCE, u64::from(number(address))) }, "I2C_SLAVE");
            // The kernel copies a union of 34 bytes.
            let mut data = [0u16; 17];
            data[0] = number(word) as u16;
            let mut write = Smbus {
                read: 0,
                command: number(command) as u8,
                size: WORD_DATA,
                data: data.as_mut_ptr(),
            };
            // SAFETY: the request takes an i2c_smbus_ioctl_data; it and its data live through.
            ok(unsafe { ioctl(fd, I2C_SMBUS, &raw mut write) }, "I2C_SMBUS");
        }
        ("play", [width, height, milliseconds, files @ ..]) => {
            play(&mut device, [width, height, milliseconds].map(|n| number(n)), files);
        }
        _ => panic!("guest control|word|play DEVICE NUMBER..., guest hang THREAD"),
    }
}
