//! A port of this machine for a program that a test starts. For tests alone.

use std::net::{Ipv4Addr, TcpListener};
use std::sync::atomic::{AtomicU16, Ordering};

/// A free port, another one each time: below those that the system gives to outgoing connections,
/// of which a flood in another test has a thousand. Programs of tests that run beside each other
/// start at ports of their own.
///
/// # Panics
/// Where no port is free.
pub fn free_port() -> u16 {
    static GIVEN: AtomicU16 = AtomicU16::new(0);
    let first = (std::process::id() % 100) as u16 * 200;
    (0..20_000)
        .map(|_| 10_000 + (first + GIVEN.fetch_add(1, Ordering::Relaxed)) % 20_000)
        .find(|&port| TcpListener::bind((Ipv4Addr::LOCALHOST, port)).is_ok())
        .expect("a free port")
}
