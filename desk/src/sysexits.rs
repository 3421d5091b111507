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

/// Code, name in `sysexits.h` and meaning of each.
pub const ALL: [(u8, &str, &str); 8] = [
    (USAGE, "EX_USAGE", "Wrong command line."),
    (DATAERR, "EX_DATAERR", "Wrong data in an input."),
    (NOINPUT, "EX_NOINPUT", "An input is missing or cannot be read."),
    (UNAVAILABLE, "EX_UNAVAILABLE", "A camera, broker or other service does not answer."),
    (SOFTWARE, "EX_SOFTWARE", "A fault of the program."),
    (CANTCREAT, "EX_CANTCREAT", "An output cannot be made."),
    (IOERR, "EX_IOERR", "Reading or writing broke off."),
    (CONFIG, "EX_CONFIG", "Wrong configuration."),
];

#[cfg(test)]
mod tests {
    use super::*;
    use std::fmt::Write;

    #[test]
    fn the_reference_has_every_code() {
        let mut text = String::from(
            "# Exit codes\n\nThe programs end with the codes of `sysexits.h`. Each command's manual \
             names those that it has.\n\n| code | name | meaning |\n|---|---|---|\n| 0 | | Success. |\n",
        );
        for (code, name, meaning) in ALL {
            let _ = writeln!(text, "| {code} | `{name}` | {meaning} |");
        }
        crate::hold("exit-codes.md", &text);
    }
}
