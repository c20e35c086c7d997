//! Progress on standard error: a bar on a terminal, a plain line every few seconds in a log, nothing with `--quiet`.

use std::fmt::Write;
use std::io::IsTerminal;
use std::time::Duration;

use indicatif::{HumanDuration, ProgressBar, ProgressDrawTarget, ProgressState, ProgressStyle};

use crate::manner::{Loudness, loudness};
use crate::piped::Piped;

/// Progress over parts of about equal length, with message and time left.
#[must_use]
pub fn progress(length: u64, label: &str) -> ProgressBar {
    bar(length, label, "{prefix:>12} [{bar:32}] {percent:>3}% {msg} {left}", plain_style())
}

/// Progress over stages whose lengths nobody knows: no time left is promised, the time so far is told. Drawn anew twice a second, so that a long
/// stage is seen to live.
#[must_use]
pub fn stages(length: u64, label: &str) -> ProgressBar {
    let plain = style("{prefix}: stage {human_pos} of {human_len}: {msg}, {elapsed} so far");
    let bar = bar(length, label, "{prefix:>12} {spinner} stage {human_pos} of {human_len}: {msg}, {elapsed} so far", plain);
    bar.enable_steady_tick(Duration::from_millis(500));
    bar
}

/// Work in one piece; it vanishes with the value.
#[must_use]
pub fn working(label: &str, what: &str) -> Working {
    let plain = style("{prefix}: {msg}, {elapsed} so far");
    let bar = bar(1, label, "{prefix:>12} {spinner} {msg}, {elapsed} so far", plain);
    bar.set_message(what.to_owned());
    bar.enable_steady_tick(Duration::from_millis(500));
    Working(bar)
}

/// Work that is shown while this lives.
#[derive(Debug)]
pub struct Working(ProgressBar);

impl Working {
    /// Says what is done now.
    pub fn say(&self, what: &str) {
        self.0.set_message(what.to_owned());
    }
}

impl Drop for Working {
    fn drop(&mut self) {
        self.0.finish_and_clear();
    }
}

fn bar(length: u64, label: &str, template: &str, plain: ProgressStyle) -> ProgressBar {
    let bar = if loudness() == Loudness::Quiet {
        ProgressBar::with_draw_target(Some(length), ProgressDrawTarget::hidden())
    } else if std::io::stderr().is_terminal() {
        ProgressBar::new(length).with_style(style(template).progress_chars("=> "))
    } else {
        let target = ProgressDrawTarget::term_like_with_hz(Box::new(Piped::stderr()), 1);
        ProgressBar::with_draw_target(Some(length), target).with_style(plain)
    };
    bar.set_prefix(label.to_owned());
    bar
}

fn style(template: &str) -> ProgressStyle {
    ProgressStyle::with_template(template).unwrap_or_else(|_| ProgressStyle::default_bar()).with_key(
        "left",
        |state: &ProgressState, text: &mut dyn Write| match left(state.elapsed(), state.pos(), state.len()) {
            Some(left) => _ = write!(text, "about {}", HumanDuration(left)),
            None => _ = text.write_str("an unknown time"),
        },
    )
}

/// Time left, if the rest goes as what is done. The library's own estimate weighs the last moments most: in a part of ten minutes it says hours.
fn left(elapsed: Duration, done: u64, all: Option<u64>) -> Option<Duration> {
    let all = all.filter(|_| done > 0)?;
    Some(elapsed.mul_f64(all.saturating_sub(done) as f64 / done as f64))
}

/// A line of a log.
pub(super) fn plain_style() -> ProgressStyle {
    style("{prefix}: {percent} % {msg}, {left} left")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn time_left_is_proportional_to_what_is_left_however_long_the_part_under_way_takes() {
        let minutes = |count: u64| Duration::from_secs(60 * count);
        assert_eq!(left(minutes(6), 3, Some(4)), Some(minutes(2)));
        assert_eq!(left(minutes(60), 3, Some(4)), Some(minutes(20)));
        assert_eq!(left(minutes(1), 0, Some(4)), None, "nothing is known before the first part");
        assert_eq!(left(minutes(1), 4, Some(4)), Some(Duration::ZERO));
    }
}
