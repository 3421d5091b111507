//! What the box's shell cannot say to the kernel: a control of a camera, a word to a sensor,
//! a thread that is to stand still.
//!
//! Compiled by `run` with nothing but the compiler:
//!
//!     guest control /dev/video0 0x00f0f040 100
//!     guest word /dev/i2c-0 0x48 0x00 0x8019
//!     guest hang 123

use std::fs::OpenOptions;
use std::io::Error;
use std::os::fd::AsRawFd;

/// `VIDIOC_S_CTRL`: `_IOWR('V', 28, struct v4l2_control)`.
const S_CTRL: u64 = 0xc008_561c;
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
    let device = device.unwrap_or_else(|error| panic!("{path}: {error}"));
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
        _ => panic!("guest control|word DEVICE NUMBER..., guest hang THREAD"),
    }
}
