//! Progress on standard error: a bar on a terminal, a plain line every few seconds in a log, nothing with `--quiet`.

use std::io::IsTerminal;
use std::time::Duration;

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};

use super::manner::{Loudness, loudness};
use super::piped::Piped;

/// Progress over parts of about equal length, with message and time left.
#[must_use]
pub fn progress(length: u64, label: &str) -> ProgressBar {
    bar(length, label, "{prefix:>12} [{bar:32}] {percent:>3}% {msg} {eta}", plain_style())
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
    ProgressStyle::with_template(template).unwrap_or_else(|_| ProgressStyle::default_bar())
}

/// A line of a log.
pub(super) fn plain_style() -> ProgressStyle {
    style("{prefix}: {percent} % {msg}, {eta} left")
}
