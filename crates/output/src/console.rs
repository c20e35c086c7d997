//! Lines on standard output and standard error.

use std::fmt::Arguments;
use std::io::{ErrorKind, Write};
use std::sync::Mutex;

use anyhow::{Context, Result};

use crate::manner::{Loudness, loudness};
use crate::plain::plain;
use crate::provenance;

/// Prints a line on standard output like `println!`, but a reader that left early (`catheter inspect M.blob | head`) is no error: the
/// command goes on and still leaves its files.
#[macro_export]
macro_rules! say {
    () => { $crate::print_line(format_args!("")) };
    ($($argument:tt)*) => { $crate::print_line(format_args!($($argument)*)) };
}

/// The first error of standard output other than a closed pipe, for example a full disk behind `> report.txt`.
static STANDARD_OUTPUT_ERROR: Mutex<Option<std::io::Error>> = Mutex::new(None);

/// Prints a line on standard error with `--verbose`, with the time since the command began: what is read, written, decided on the way.
#[macro_export]
macro_rules! detail {
    ($($argument:tt)*) => { $crate::print_detail(format_args!($($argument)*)) };
}

/// Prints a line on standard output; see [`say!`]. Names from files may hold what a terminal obeys: it is shown, see [`plain`].
/// With `--quiet` only warnings and failed checks are printed, on standard error.
pub fn print_line(text: Arguments<'_>) {
    let text = text.to_string();
    if loudness() == Loudness::Quiet {
        if ["warning:", "FAILED", "DIFFERENT", "CUT"].iter().any(|word| text.trim_start().starts_with(word)) {
            // Nobody who reads it is no error.
            let _ = writeln!(std::io::stderr(), "{}", plain(&text));
        }
        return;
    }
    let mut output = std::io::stdout().lock();
    let result = output.write_all(plain(&text).as_bytes()).and_then(|()| output.write_all(b"\n"));
    remember(result);
}

/// Prints a line on standard error with `--verbose`; see [`detail!`].
pub fn print_detail(text: Arguments<'_>) {
    if loudness() == Loudness::Verbose {
        let line = format!("[{:8.2} s] {text}", provenance::elapsed_s());
        let _ = writeln!(std::io::stderr(), "{}", plain(&line));
    }
}

/// Prints bytes on standard output as they are, with `--quiet`, too; see [`say!`].
pub fn print_bytes(bytes: &[u8]) {
    remember(std::io::stdout().lock().write_all(bytes));
}

fn remember(result: std::io::Result<()>) {
    if let Err(error) = result
        && error.kind() != ErrorKind::BrokenPipe
        && let Ok(mut slot) = STANDARD_OUTPUT_ERROR.lock()
    {
        slot.get_or_insert(error);
    }
}

/// Flushes standard output and tells whether everything said so far arrived.
///
/// # Errors
/// When a line could not be written for any reason but a reader that left.
pub fn finish() -> Result<()> {
    remember(std::io::stdout().lock().flush());
    match STANDARD_OUTPUT_ERROR.lock().map(|mut slot| slot.take()) {
        Ok(Some(error)) => Err(error).context("standard output cannot be written; is the disk full?"),
        _ => Ok(()),
    }
}
