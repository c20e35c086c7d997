//! Work on several threads, the longest first.

use std::sync::atomic::{AtomicUsize, Ordering};

use crate::chain::form::Form;
use crate::model::structure::Model;

/// How far a discovery is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Progress<'a> {
    /// A stage of this name begins. How many follow depends on what is found.
    Stage(&'a str),
    /// Of a part of the stage so much is done, in units of about equal time.
    Part {
        /// Done.
        done: usize,
        /// Done and to do.
        all: usize,
    },
}

/// Hears how far a discovery is, from any of its threads.
pub type Watch<'a> = &'a (dyn Fn(Progress<'_>) + Sync);

/// Forms that search in smaller steps than this lie in valleys narrower than their grids: those say little about them.
const NARROW: f64 = 0.05;

/// Whether a form lies in a valley narrower than its grid.
pub fn is_narrow(form: &dyn Form) -> bool {
    (0..form.parameters().len()).any(|parameter| form.step(parameter) < NARROW)
}

/// How long a form is searched, next to others: by its parameters, and where its valley is narrow by all that lies about it.
pub fn labour(form: &dyn Form) -> usize {
    let count = form.parameters().len();
    if is_narrow(form) { 10 * count } else { count }
}

/// How long the parameters of a model are searched, next to others.
pub fn labour_of_all(model: &Model) -> usize {
    model.slots.iter().map(|slot| labour(slot.form)).sum()
}

/// Both at once, where there is more than one thread.
pub fn both<A: Send, B>(threads: usize, one: impl FnOnce() -> A + Send, other: impl FnOnce() -> B) -> (A, B) {
    if threads < 2 {
        return (one(), other());
    }
    std::thread::scope(|scope| {
        let one = scope.spawn(one);
        let other = other();
        (one.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic)), other)
    })
}

/// Runs `work` for every item on several threads; results in the order of the items, whatever the number of threads.
pub fn in_parallel<T: Send, I: Sync>(items: &[I], threads: usize, work: impl Fn(&I) -> T + Sync) -> Vec<T> {
    in_parallel_by(items, threads, |_| 0, work)
}

/// As [`in_parallel`]; items of the greatest `length` begin first, for a long one that begins last leaves all other threads waiting.
pub fn in_parallel_by<T: Send, I: Sync>(
    items: &[I],
    threads: usize,
    length: impl Fn(&I) -> usize,
    work: impl Fn(&I) -> T + Sync,
) -> Vec<T> {
    let mut order: Vec<usize> = (0..items.len()).collect();
    order.sort_by_key(|&index| std::cmp::Reverse(length(&items[index])));
    let next = AtomicUsize::new(0);
    let mut results: Vec<Option<T>> = items.iter().map(|_| None).collect();
    let chunks = std::thread::scope(|scope| {
        let workers: Vec<_> = (0..threads.clamp(1, items.len().max(1)))
            .map(|_| {
                scope.spawn(|| {
                    let mut done = Vec::new();
                    loop {
                        let place = next.fetch_add(1, Ordering::Relaxed);
                        let Some(&index) = order.get(place) else { break done };
                        done.push((index, work(&items[index])));
                    }
                })
            })
            .collect();
        workers.into_iter().map(|worker| worker.join()).collect::<Vec<_>>()
    });
    for chunk in chunks {
        match chunk {
            Ok(done) => done.into_iter().for_each(|(index, value)| results[index] = Some(value)),
            Err(panic) => std::panic::resume_unwind(panic),
        }
    }
    results.into_iter().flatten().collect()
}
