//! Long computations on a thread of their own, so that Python goes on: other threads run, Ctrl-C is heard, progress is reported.
//!
//! A fit cannot be told to stop; it can only be left from inside when it tells its progress. After Ctrl-C the exception is raised at once, and
//! the computation unwinds at its next report.

use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{self, RecvTimeoutError, Sender};
use std::time::Duration;

use pyo3::exceptions::{PyRuntimeError, PyValueError};
use pyo3::prelude::*;

pyo3::create_exception!(
    catheter,
    CatheterError,
    PyValueError,
    "What was given cannot be used; the message says what is wrong and what to do."
);

/// How often Ctrl-C is looked for.
const LOOK: Duration = Duration::from_millis(50);
/// That of a main thread: on it the same computations run in the command.
const STACK_BYTES: usize = 8 << 20;

/// The way out of a computation that nobody waits for any more.
struct Interrupted;

enum Message<T> {
    Said(String),
    Done(Option<anyhow::Result<T>>),
}

/// Where a computation tells its progress.
pub struct Teller {
    say: Box<dyn Fn(String) + Send + Sync>,
    stop: Arc<AtomicBool>,
}

impl Teller {
    /// Tells progress; does not come back when the computation is to end.
    pub fn tell(&self, text: String) {
        self.go_on();
        (self.say)(text);
    }

    /// Does not come back when the computation is to end.
    pub fn go_on(&self) {
        if self.stop.load(Ordering::Relaxed) {
            // Not a panic: nothing is to be printed.
            resume_unwind(Box::new(Interrupted));
        }
    }
}

/// The exception for a refusal of the library.
pub fn refused(error: impl Into<anyhow::Error>) -> PyErr {
    CatheterError::new_err(format!("{:#}", error.into()))
}

/// The exception for a refusal in words.
pub fn refusal(text: impl Into<String>) -> PyErr {
    CatheterError::new_err(text.into())
}

/// Runs `work` while Python goes on; `progress` is called with each line of progress.
pub fn compute<T: Send + 'static>(
    py: Python<'_>,
    progress: Option<&Bound<'_, PyAny>>,
    work: impl FnOnce(&Teller) -> anyhow::Result<T> + Send + 'static,
) -> PyResult<T> {
    let (sender, mut receiver) = mpsc::channel();
    let stop = Arc::new(AtomicBool::new(false));
    let teller = Teller { say: Box::new(say(sender.clone())), stop: stop.clone() };
    let body = move || {
        let result = catch_unwind(AssertUnwindSafe(|| work(&teller))).ok();
        // Nobody may be waiting any more.
        let _ = sender.send(Message::Done(result));
    };
    std::thread::Builder::new().name("catheter".to_owned()).stack_size(STACK_BYTES).spawn(body).map_err(refused)?;
    let wait = || -> PyResult<T> {
        loop {
            let message;
            (receiver, message) = py.detach(|| {
                let message = receiver.recv_timeout(LOOK);
                (receiver, message)
            });
            py.check_signals()?;
            match message {
                Ok(Message::Done(Some(result))) => return result.map_err(refused),
                Ok(Message::Said(text)) => progress.map_or(Ok(()), |progress| progress.call1((text,)).map(drop))?,
                Ok(Message::Done(None)) | Err(RecvTimeoutError::Disconnected) => return Err(internal()),
                Err(RecvTimeoutError::Timeout) => {}
            }
        }
    };
    wait().inspect_err(|_| stop.store(true, Ordering::Relaxed))
}

fn say<T: Send + 'static>(sender: Sender<Message<T>>) -> impl Fn(String) + Send + Sync {
    move |text| {
        let _ = sender.send(Message::Said(text));
    }
}

/// Runs something short while other threads of Python go on.
pub fn briefly<T: Send>(py: Python<'_>, work: impl FnOnce() -> anyhow::Result<T> + Send) -> PyResult<T> {
    py.detach(|| catch_unwind(AssertUnwindSafe(work))).map_err(|_| internal())?.map_err(refused)
}

fn internal() -> PyErr {
    PyRuntimeError::new_err("internal error, see standard error; this is a fault of the program: please report it with the data")
}
