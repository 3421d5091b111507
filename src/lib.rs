//! verge turns a traffic camera into a calibrated sensor of density, lane by lane.
//!
//! The core (`units`, `lane`, `density`, `evidence`, `hidden`, `wire`, `hal`, `alarm`, `health`, `fault`, `derate`,
//! `picture`, `scene`, `track`, `traffic`, `sensor`, `node`) is `no_std` and never allocates: time and temperature come in as
//! arguments, effects go out as returned values. Behind the features of their names, `messages` turns the
//! core's values into messages, and `daemon` is the line from camera to broker.
#![cfg_attr(not(feature = "messages"), no_std)]

#[cfg(test)]
extern crate std;

pub mod alarm;
pub mod density;
pub mod derate;
pub mod evidence;
pub mod fault;
pub mod hal;
pub mod health;
pub mod hidden;
pub mod lane;
#[cfg(feature = "messages")]
pub mod messages;
pub mod node;
pub mod picture;
pub mod refresh;
mod report;
pub mod scene;
pub mod sensor;
pub mod track;
pub mod traffic;
pub mod units;
pub mod wire;

#[cfg(feature = "daemon")]
pub mod daemon;
