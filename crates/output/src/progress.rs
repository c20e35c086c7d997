//! Progress on standard error: a bar on a terminal, a plain line every few seconds in a log, nothing with `--quiet`.

use std::fmt::Write;
use std::io::IsTerminal;
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use indicatif::{HumanDuration, ProgressBar, ProgressDrawTarget, ProgressState, ProgressStyle};

use crate::manner::{Loudness, loudness};
use crate::piped::Piped;

/// Time between two drawings of what lasts, so that a long part is seen to live.
const DRAWN_EVERY: Duration = Duration::from_millis(500);

/// Progress over parts of about equal length, with message and time left; a length of 0 stands for one that is set later.
#[must_use]
pub fn progress(length: u64, label: &str) -> ProgressBar {
    // Of nothing, all would be done.
    bar(length.max(1), label, "{prefix:>12} [{bar:32}] {percent:>3}% {msg} {left}", plain_style())
}

/// Progress over stages of which nobody knows how many come: the time so far is reported, and the time left of the part under way. It vanishes
/// with the value.
#[must_use]
pub fn stages(label: &str) -> Stages {
    let plain = style("{prefix}: {msg}, {elapsed} so far");
    let bar = bar(1, label, "{prefix:>12} {spinner} {msg}, {elapsed} so far", plain);
    Stages { bar, under_way: Mutex::new(UnderWay { stage: String::new(), begun: Instant::now() }) }
}

/// Stages that are shown while this lives.
#[derive(Debug)]
pub struct Stages {
    bar: ProgressBar,
    under_way: Mutex<UnderWay>,
}

#[derive(Debug)]
struct UnderWay {
    stage: String,
    /// When its present part began.
    begun: Instant,
}

impl Stages {
    /// A stage begins.
    pub fn stage(&self, name: &str) {
        *self.under_way.lock().unwrap_or_else(PoisonError::into_inner) = UnderWay { stage: name.to_owned(), begun: Instant::now() };
        self.bar.set_message(name.to_owned());
    }

    /// Of the present part `done` of `all` units of about equal time are done; after the last, the next part begins.
    pub fn part(&self, done: u64, all: u64) {
        let mut under_way = self.under_way.lock().unwrap_or_else(PoisonError::into_inner);
        self.bar.set_message(part_of(&under_way.stage, under_way.begun.elapsed(), done, all));
        if done >= all {
            under_way.begun = Instant::now();
        }
    }
}

impl Drop for Stages {
    fn drop(&mut self) {
        self.bar.finish_and_clear();
    }
}

/// Least share of a part, and least time in it, that say something about its rest.
const TELLING: (f64, Duration) = (0.1, Duration::from_secs(1));

/// A stage with the time left of its present part, where that is known.
fn part_of(stage: &str, elapsed: Duration, done: u64, all: u64) -> String {
    let known = done as f64 >= TELLING.0 * all as f64 && elapsed >= TELLING.1 && done < all;
    match left(elapsed, done, Some(all)).filter(|_| known) {
        Some(left) => format!("{stage}, {} % of this part, about {} left in it", 100 * done / all, HumanDuration(left)),
        None => stage.to_owned(),
    }
}

/// Work in one piece; it vanishes with the value.
#[must_use]
pub fn working(label: &str, what: &str) -> Working {
    let plain = style("{prefix}: {msg}, {elapsed} so far");
    let bar = bar(1, label, "{prefix:>12} {spinner} {msg}, {elapsed} so far", plain);
    bar.set_message(what.to_owned());
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
    if loudness() == Loudness::Quiet {
        return bar_on(ProgressDrawTarget::hidden(), length, label, plain);
    }
    if std::io::stderr().is_terminal() {
        return bar_on(ProgressDrawTarget::stderr(), length, label, style(template).progress_chars("=> "));
    }
    bar_on(ProgressDrawTarget::term_like_with_hz(Box::new(Piped::stderr()), 1), length, label, plain)
}

/// A bar that is drawn anew while nothing changes, so that its times go on.
fn bar_on(target: ProgressDrawTarget, length: u64, label: &str, style: ProgressStyle) -> ProgressBar {
    let bar = ProgressBar::with_draw_target(Some(length), target).with_style(style);
    bar.set_prefix(label.to_owned());
    bar.enable_steady_tick(DRAWN_EVERY);
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
    use crate::piped::kept::Kept;

    #[test]
    fn time_left_is_proportional_to_what_is_left_however_long_the_part_under_way_takes() {
        let minutes = |count: u64| Duration::from_secs(60 * count);
        assert_eq!(left(minutes(6), 3, Some(4)), Some(minutes(2)));
        assert_eq!(left(minutes(60), 3, Some(4)), Some(minutes(20)));
        assert_eq!(left(minutes(1), 0, Some(4)), None, "nothing is known before the first part");
        assert_eq!(left(minutes(1), 4, Some(4)), Some(Duration::ZERO));
    }

    #[test]
    fn a_part_tells_its_time_left_when_enough_of_it_is_done() {
        let seconds = Duration::from_secs;
        assert_eq!(part_of("every effect", seconds(6), 30, 120), "every effect, 25 % of this part, about 18 seconds left in it");
        assert_eq!(part_of("every effect", seconds(60), 10, 120), "every effect", "a twelfth says little");
        assert_eq!(part_of("every effect", Duration::from_millis(900), 60, 120), "every effect", "too early");
        assert_eq!(part_of("every effect", seconds(6), 120, 120), "every effect", "the next part begins");
        assert_eq!(part_of("figures", seconds(6), 0, 0), "figures", "a part of nothing");
    }

    #[test]
    fn what_lasts_is_said_again_though_nobody_moves_the_bar() {
        let kept = Kept::default();
        let piped = Piped::new(kept.clone(), Duration::from_millis(700), Duration::from_millis(700));
        let bar = bar_on(ProgressDrawTarget::term_like_with_hz(Box::new(piped), 20), 1, "fit", style("{prefix}: {msg}, {elapsed} so far"));
        bar.set_message("one long part");
        // Nothing moves it; two lines are due after 700 and 1400 ms and the drawings that follow them.
        let begun = Instant::now();
        while kept.lines().len() < 2 && begun.elapsed() < Duration::from_secs(60) {
            std::thread::sleep(Duration::from_millis(20));
        }
        let lines = kept.lines();
        assert!(lines.len() >= 2 && lines.iter().all(|line| line.starts_with("fit: one long part, ")), "{lines:?}");
        assert!(begun.elapsed() >= Duration::from_millis(1400), "no line before it is due: {lines:?}");
        bar.finish_and_clear();
    }

    #[test]
    fn the_time_of_a_part_counts_from_its_own_beginning() {
        let stages = stages("discover");
        let begun = || stages.under_way.lock().expect("nobody panics").begun;
        stages.stage("every effect");
        let first = begun();
        stages.part(1, 2);
        assert_eq!(begun(), first, "the part goes on");
        stages.part(2, 2);
        assert!(begun() > first, "the next part begins");
    }
}
