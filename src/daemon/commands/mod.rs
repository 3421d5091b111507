//! What each command does. A command builds its line through `daemon/mod.rs` and names no
//! more than one stage itself.

pub mod bench;
pub mod check;
#[cfg(feature = "demo")]
pub mod demo;
pub mod detect;
mod recording;
pub mod replay;
pub mod run;
mod text;
