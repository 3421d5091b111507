//! Shared by every program at a desk: failures with an exit code, a `main`, files that are
//! there whole or not at all, reading with a path in the error, manual pages, tests that say
//! they skip, generated pages of the handbook, and for programs with a page ([`loopback`],
//! [`page`]) HTTP on loopback and what pages share.
//!
//! Owns the failures that all programs share ([`Failure`]) and the meaning of the exit codes
//! ([`sysexits`]). A program adds its own failures in an enum around [`Failure`] and gives each
//! a code by [`Exit`]. Knows nothing of cameras, messages or density.

mod failure;
mod free_port;
mod generated;
#[cfg(feature = "page")]
pub mod loopback;
pub mod manual;
#[cfg(feature = "page")]
pub mod page;
mod program;
mod read;
mod skip;
pub mod sysexits;
mod whole;
mod whole_folder;

pub use failure::Failure;
pub use free_port::free_port;
pub use generated::hold;
pub use program::{Exit, print, run_main, say};
pub use read::{read_bytes, read_text, text};
pub use skip::{shared, skip};
pub use whole::{Batch, make_parent, write_whole, write_whole_beside, write_whole_with};
pub use whole_folder::WholeFolder;
