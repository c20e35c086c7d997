//! The audit log: who asked for what and what came of it, a line of JSON each.

use std::fs::{File, OpenOptions};
use std::io::Write;
use std::path::Path;
use std::time::{SystemTime, UNIX_EPOCH};

use serde_json::json;

/// Where the lines go.
#[derive(Debug)]
pub(crate) struct Audit {
    file: File,
}

impl Audit {
    /// Appends to this file.
    pub fn open(path: &Path) -> std::io::Result<Self> {
        Ok(Self { file: OpenOptions::new().create(true).append(true).open(path)? })
    }

    /// Writes a line. A log that cannot be written must not keep anybody from venting: the line goes to standard error instead.
    pub fn note(&mut self, who: &str, what: &str, outcome: &str) {
        let line = json!({ "time": now(), "who": who, "what": what, "outcome": outcome });
        if writeln!(self.file, "{line}").is_err() {
            let _ = writeln!(std::io::stderr(), "audit: {line}");
        }
    }
}

/// Now as `2026-01-31T12:00:00.000Z`.
pub(crate) fn now() -> String {
    let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    in_words(since.as_secs(), since.subsec_millis())
}

fn in_words(seconds: u64, milliseconds: u32) -> String {
    let (day, second) = (seconds / 86_400, seconds % 86_400);
    // Days to a civil date by Howard Hinnant's algorithm: years begin in March, so that the leap day is their last.
    let shifted = day + 719_468;
    let (era, day_of_era) = (shifted / 146_097, shifted % 146_097);
    let year_of_era = (day_of_era - day_of_era / 1460 + day_of_era / 36_524 - day_of_era / 146_096) / 365;
    let day_of_year = day_of_era - (365 * year_of_era + year_of_era / 4 - year_of_era / 100);
    let from_march = (5 * day_of_year + 2) / 153;
    let day_of_month = day_of_year - (153 * from_march + 2) / 5 + 1;
    let month = if from_march < 10 { from_march + 3 } else { from_march - 9 };
    let year = era * 400 + year_of_era + u64::from(month <= 2);
    let (hour, minute) = (second / 3600, second / 60 % 60);
    format!("{year:04}-{month:02}-{day_of_month:02}T{hour:02}:{minute:02}:{:02}.{milliseconds:03}Z", second % 60)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_are_written_as_the_calendar_has_them() {
        assert_eq!(in_words(0, 0), "1970-01-01T00:00:00.000Z");
        assert_eq!(in_words(951_782_399, 7), "2000-02-28T23:59:59.007Z");
        assert_eq!(in_words(951_782_400, 7), "2000-02-29T00:00:00.007Z");
        assert_eq!(in_words(1_798_761_599, 999), "2026-12-31T23:59:59.999Z");
    }
}
