//! The frame of a program: arguments in, exit code and one line of error out.

use crate::failure::Failure;
use crate::sysexits::USAGE;
use std::error::Error;
use std::io::{self, Write};
use std::process::ExitCode;

/// A failure that ends a program.
pub trait Exit: Error {
    /// The code that the program ends with, of [`sysexits`](crate::sysexits).
    fn exit_code(&self) -> u8;
}

/// Reads the command line and runs the program: 0 for success, help and version, 64 for a wrong
/// command line, otherwise the failure's own code and one line on standard error.
pub fn run_main<A: clap::Parser, E: Exit>(run: impl FnOnce(A) -> Result<(), E>) -> ExitCode {
    let arguments = match A::try_parse() {
        Ok(arguments) => arguments,
        Err(error) => {
            // A closed terminal must not change the exit code.
            let _ = error.print();
            return ExitCode::from(if error.use_stderr() { USAGE } else { 0 });
        }
    };
    match run(arguments) {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => {
            say(&format!("{}: {failure}", A::command().get_name()));
            ExitCode::from(failure.exit_code())
        }
    }
}

/// Says a line on standard error. Where nobody hears it any more (`2>&1 | head`), that is no fault.
pub fn say(line: &str) {
    let _ = writeln!(io::stderr(), "{line}");
}

/// Prints to standard output.
///
/// # Errors
/// [`Failure::Print`]; a reader that has gone away (`head`) is not an error.
pub fn print(text: &str) -> Result<(), Failure> {
    let mut out = io::stdout().lock();
    match out.write_all(text.as_bytes()).and_then(|()| out.flush()) {
        Err(error) if error.kind() != io::ErrorKind::BrokenPipe => Err(Failure::Print(error)),
        _ => Ok(()),
    }
}
