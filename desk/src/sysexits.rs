//! Exit codes of BSD's `sysexits.h`, so that a supervisor or a script can tell a wrong file from
//! a missing one without reading the message.

/// Wrong arguments.
pub const USAGE: u8 = 64;
/// Wrong input data.
pub const DATAERR: u8 = 65;
/// An input file that is missing or cannot be read.
pub const NOINPUT: u8 = 66;
/// A service (broker, camera, cluster) that is not there.
pub const UNAVAILABLE: u8 = 69;
/// A fault of the program, or too little memory for it.
pub const SOFTWARE: u8 = 70;
/// An output file that cannot be made.
pub const CANTCREAT: u8 = 73;
/// Reading or writing failed half-way.
pub const IOERR: u8 = 74;
/// Wrong configuration.
pub const CONFIG: u8 = 78;
