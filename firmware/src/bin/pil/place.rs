//! The model in use: its weights packed for the fast kernel in a buffer, the rest of its blob in flash.

use core::ptr;
use core::slice;
use core::sync::atomic::{AtomicBool, Ordering};

use firmware::background::ModelPlace;
use firmware::control::Compensator;
use firmware::estimator::{MAX_PACKED_WORDS, Packed};
use firmware::model::{ModelFacts, RunningModel};
use firmware::tick::{Direction, ModelStep};
use model_export::link::fault::Fault;

static mut WORDS: [u32; MAX_PACKED_WORDS] = [0; MAX_PACKED_WORDS];
static TAKEN: AtomicBool = AtomicBool::new(false);

/// The buffer and what runs from it.
pub struct Buffer {
    running: RunningModel<'static, Packed<'static>>,
}

impl Buffer {
    /// The only one.
    pub fn take() -> Self {
        if TAKEN.swap(true, Ordering::Relaxed) {
            panic!("there is one buffer");
        }
        Self { running: RunningModel::default() }
    }
}

impl ModelStep for Buffer {
    fn step(&mut self, pressure_bar: f32) -> f32 {
        self.running.step(pressure_bar)
    }

    fn reset(&mut self) {
        self.running.reset();
    }

    fn is_present(&self) -> bool {
        self.running.is_present()
    }

    fn direction(&self) -> Direction {
        self.running.direction()
    }

    fn compensator(&self) -> Option<&Compensator> {
        self.running.compensator()
    }

    fn is_outside_domain(&self) -> bool {
        self.running.is_outside_domain()
    }

    fn identity(&self) -> [u8; 8] {
        self.running.identity()
    }
}

impl ModelPlace for Buffer {
    fn load(&mut self, blob: &[u8]) -> Result<ModelFacts, Fault> {
        // Nothing may borrow the buffer while it is written.
        self.running.forget();
        // SAFETY: `take` gave out one `Buffer`, and its model, the only borrower of the words, has just been forgotten.
        let words = unsafe { slice::from_raw_parts_mut(ptr::addr_of_mut!(WORDS).cast::<u32>(), MAX_PACKED_WORDS) };
        // SAFETY: the flash's blobs lie in the flash memory, which is always there; the device forgets its model before its slot is rewritten.
        let blob: &'static [u8] = unsafe { slice::from_raw_parts(blob.as_ptr(), blob.len()) };
        self.running.load(blob, words)
    }

    fn forget(&mut self) {
        self.running.forget();
    }
}
