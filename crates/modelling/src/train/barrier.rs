//! A meeting point for the training threads: spins briefly, then sleeps, and fails loudly instead of hanging when a thread panics.

use std::hint::spin_loop;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Condvar, Mutex, PoisonError};

/// Checks before a waiting thread goes to sleep, about a tenth of a millisecond: the threads of one optimiser step meet within that,
/// and the pauses between steps (validation, checkpoints) are longer and should cost nothing.
const SPINS: u32 = 4000;

/// A reusable barrier for a fixed number of threads.
pub struct Barrier {
    threads: usize,
    arrived: AtomicUsize,
    generation: AtomicUsize,
    failed: AtomicBool,
    sleepers: Mutex<()>,
    wake: Condvar,
}

impl Barrier {
    /// A barrier that opens when `threads` threads have arrived.
    pub fn new(threads: usize) -> Self {
        Self {
            threads,
            arrived: AtomicUsize::new(0),
            generation: AtomicUsize::new(0),
            failed: AtomicBool::new(false),
            sleepers: Mutex::new(()),
            wake: Condvar::new(),
        }
    }

    /// Waits until all threads have arrived.
    ///
    /// # Panics
    /// When another thread panicked and will never arrive.
    pub fn wait(&self) {
        let generation = self.generation.load(Ordering::Acquire);
        if self.arrived.fetch_add(1, Ordering::AcqRel) + 1 == self.threads {
            self.arrived.store(0, Ordering::Release);
            self.open(|| self.generation.store(generation.wrapping_add(1), Ordering::Release));
            return;
        }
        let done = || self.generation.load(Ordering::Acquire) != generation || self.failed.load(Ordering::Acquire);
        for _ in 0..SPINS {
            if done() {
                break;
            }
            spin_loop();
        }
        if !done() {
            let mut guard = self.sleepers.lock().unwrap_or_else(PoisonError::into_inner);
            while !done() {
                guard = self.wake.wait(guard).unwrap_or_else(PoisonError::into_inner);
            }
        }
        assert!(!self.failed.load(Ordering::Acquire), "another training thread failed");
    }

    /// A guard that releases the other threads (to panic in turn) when the holder panics.
    pub fn watch(&self) -> impl Drop + '_ {
        struct Watch<'a>(&'a Barrier);
        impl Drop for Watch<'_> {
            fn drop(&mut self) {
                if std::thread::panicking() {
                    self.0.open(|| self.0.failed.store(true, Ordering::Release));
                }
            }
        }
        Watch(self)
    }

    /// Changes what the sleepers wait for, under their lock so that none misses it, and wakes them.
    fn open(&self, change: impl FnOnce()) {
        let guard = self.sleepers.lock().unwrap_or_else(PoisonError::into_inner);
        change();
        drop(guard);
        self.wake.notify_all();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_thread_passes_before_all_have_arrived() {
        const THREADS: usize = 4;
        let barrier = Barrier::new(THREADS);
        let count = AtomicUsize::new(0);
        std::thread::scope(|scope| {
            for _ in 0..THREADS {
                scope.spawn(|| {
                    for round in 1..=500 {
                        count.fetch_add(1, Ordering::SeqCst);
                        barrier.wait();
                        assert_eq!(count.load(Ordering::SeqCst), round * THREADS);
                        barrier.wait();
                    }
                });
            }
        });
    }

    #[test]
    fn a_panic_in_one_thread_releases_the_others() {
        let barrier = Barrier::new(2);
        let waiting = std::thread::scope(|scope| {
            let waiting = scope.spawn(|| barrier.wait());
            let failing = scope.spawn(|| {
                let _watch = barrier.watch();
                panic!("as intended by this test");
            });
            assert!(failing.join().is_err());
            waiting.join()
        });
        assert!(waiting.is_err());
    }
}
