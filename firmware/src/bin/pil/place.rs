//! The model in use: its weights packed for the fast kernel in a buffer, the rest of its blob in flash.

use core::ptr;
use core::slice;
use core::sync::atomic::{AtomicBool, Ordering};

use firmware::device::ModelPlace;
use firmware::estimator::{KernelSource, MAX_PACKED_WORDS, Packed};
use firmware::model::RunningModel;
use firmware::tick::ModelStep;

static mut WORDS: [u32; MAX_PACKED_WORDS] = [0; MAX_PACKED_WORDS];
static TAKEN: AtomicBool = AtomicBool::new(false);

/// The buffer and what runs from it.
pub struct Buffer {
    running: Option<RunningModel<'static, Packed<'static>>>,
}

impl Buffer {
    /// The only one.
    pub fn take() -> Self {
        if TAKEN.swap(true, Ordering::Relaxed) {
            panic!("there is one buffer");
        }
        Self { running: None }
    }

    /// The buffer, after the model that borrowed it has been forgotten.
    fn words(&mut self) -> &'static mut [u32] {
        self.running = None;
        // SAFETY: `take` gave out one `Buffer`, and its model, the only one that keeps a borrow, has just been dropped. A self-test's kernel
        // ends before the next call: it lives no longer than `SelfTest::run`.
        unsafe { slice::from_raw_parts_mut(ptr::addr_of_mut!(WORDS).cast::<u32>(), MAX_PACKED_WORDS) }
    }
}

impl ModelStep for Buffer {
    fn step(&mut self, pressure_bar: f32) -> f32 {
        self.running.as_mut().map_or(f32::NAN, |model| model.step(pressure_bar))
    }

    fn reset(&mut self) {
        self.running.iter_mut().for_each(ModelStep::reset);
    }
}

impl ModelPlace for Buffer {
    fn kernel(&mut self) -> impl KernelSource {
        self.words()
    }

    fn load(&mut self, blob: Option<&[u8]>) -> bool {
        let words = self.words();
        let Some(blob) = blob else { return true };
        // SAFETY: a blob that passed the self-test lies in the flash memory, which is always there; the device forgets its model before its slot is
        // rewritten.
        let blob: &'static [u8] = unsafe { slice::from_raw_parts(blob.as_ptr(), blob.len()) };
        self.running = RunningModel::load(blob, words).ok();
        self.running.is_some()
    }
}
