//! Progress for who is no terminal: a plain line every few seconds in a log, instead of a bar that redraws itself.

use std::fmt;
use std::io::{self, Write};
use std::sync::Mutex;
use std::time::{Duration, Instant};

use indicatif::TermLike;

/// Nothing is said of what takes less than this.
const FIRST_AFTER: Duration = Duration::from_secs(3);
/// Time between two lines.
const EVERY: Duration = Duration::from_secs(5);
/// Letters of a line.
const WIDTH: u16 = 120;

/// A place for a bar that prints the newest line now and then.
pub struct Piped<W> {
    state: Mutex<State<W>>,
}

struct State<W> {
    writer: W,
    line: String,
    due: Instant,
    every: Duration,
}

impl Piped<io::Stderr> {
    /// On standard error.
    pub fn stderr() -> Self {
        Self::new(io::stderr(), FIRST_AFTER, EVERY)
    }
}

impl<W> Piped<W> {
    /// On this writer: nothing before `first_after`, then a line in `every`.
    pub(crate) fn new(writer: W, first_after: Duration, every: Duration) -> Self {
        Self { state: Mutex::new(State { writer, line: String::new(), due: Instant::now() + first_after, every }) }
    }

    fn with(&self, work: impl FnOnce(&mut State<W>)) -> io::Result<()> {
        if let Ok(mut state) = self.state.lock() {
            work(&mut state);
        }
        Ok(())
    }
}

impl<W> fmt::Debug for Piped<W> {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str("Piped")
    }
}

impl<W: Write + Send> TermLike for Piped<W> {
    fn width(&self) -> u16 {
        WIDTH
    }

    fn move_cursor_up(&self, _n: usize) -> io::Result<()> {
        Ok(())
    }

    fn move_cursor_down(&self, _n: usize) -> io::Result<()> {
        Ok(())
    }

    fn move_cursor_right(&self, _n: usize) -> io::Result<()> {
        Ok(())
    }

    fn move_cursor_left(&self, _n: usize) -> io::Result<()> {
        Ok(())
    }

    fn write_line(&self, text: &str) -> io::Result<()> {
        self.with(|state| state.line.push_str(text))
    }

    fn write_str(&self, text: &str) -> io::Result<()> {
        self.with(|state| state.line.push_str(text))
    }

    fn clear_line(&self) -> io::Result<()> {
        self.with(|state| state.line.clear())
    }

    fn flush(&self) -> io::Result<()> {
        self.with(|state| {
            let line = std::mem::take(&mut state.line);
            let now = Instant::now();
            if !line.trim().is_empty() && now >= state.due {
                state.due = now + state.every;
                // Nobody who reads it is no error.
                let _ = writeln!(state.writer, "{}", line.trim());
            }
        })
    }
}

#[cfg(test)]
pub(crate) mod kept {
    use std::io::{self, Write};
    use std::sync::{Arc, Mutex};

    /// A writer that the test reads.
    #[derive(Clone, Default)]
    pub(crate) struct Kept(Arc<Mutex<Vec<u8>>>);

    impl Kept {
        /// What was written, line by line.
        pub(crate) fn lines(&self) -> Vec<String> {
            let bytes = self.0.lock().map(|kept| kept.clone()).unwrap_or_default();
            String::from_utf8_lossy(&bytes).lines().map(str::to_owned).collect()
        }
    }

    impl Write for Kept {
        fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
            if let Ok(mut kept) = self.0.lock() {
                kept.extend_from_slice(bytes);
            }
            Ok(bytes.len())
        }

        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }
}

#[cfg(test)]
mod tests {
    use super::kept::Kept;
    use super::*;

    fn lines(first_after: Duration, every: Duration) -> Vec<String> {
        let kept = Kept::default();
        let target = indicatif::ProgressDrawTarget::term_like_with_hz(Box::new(Piped::new(kept.clone(), first_after, every)), 100);
        let bar = indicatif::ProgressBar::with_draw_target(Some(30), target);
        bar.set_style(crate::progress::plain_style());
        bar.set_prefix("count");
        for _ in 0..30 {
            bar.inc(1);
            std::thread::sleep(Duration::from_millis(20));
        }
        bar.finish_and_clear();
        kept.lines()
    }

    #[test]
    fn a_log_gets_whole_lines_now_and_then_and_short_work_none() {
        let some = lines(Duration::ZERO, Duration::from_millis(150));
        // 600 ms and more, on a busy machine much more.
        assert!(some.len() >= 2 && some.len() < 30, "{some:?}");
        assert!(some.iter().all(|line| line.starts_with("count") && line.contains('%')), "{some:?}");
        assert_eq!(lines(Duration::from_secs(60), EVERY), Vec::<String>::new());
    }
}
