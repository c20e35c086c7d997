//! Where models run: a place in RAM that the background fills and lends to the tick, with the weights in the core-coupled memory.

use core::mem::MaybeUninit;

use cortex_m::peripheral::DWT;
use model_export::link::fault::Fault;
use model_export::schema::Model;
use rtic::Mutex;

use crate::background::ModelPlace;
use crate::board::chip::registers::ThisBoard;
use crate::board::contract::Board;
use crate::control::Compensator;
use crate::estimator::{EstimatorState, MAX_PACKED_WORDS, Packed, StepBudget, StepTimer};
use crate::model::{ModelFacts, RunningModel, STEP_SHARE_PERCENT};
use crate::tick::{Direction, ModelStep};

/// A place for a model as the board runs it.
pub type BoardModel = RunningModel<'static, Packed<'static>, &'static mut EstimatorState, &'static mut Model<'static>>;

/// Weights in the order in which the kernel reads them. Start-up code does not touch this memory, and nobody does where it is missing: no
/// model is let in before everything else has passed.
#[unsafe(link_section = ".ccm")]
static mut WEIGHTS: MaybeUninit<[u32; MAX_PACKED_WORDS]> = MaybeUninit::uninit();

/// The tick's side: a model while there is one.
#[derive(Debug, Default)]
pub struct LoadedModel(Option<&'static mut BoardModel>);

impl LoadedModel {
    /// Without a model.
    pub const fn none() -> Self {
        Self(None)
    }
}

impl ModelStep for LoadedModel {
    fn step(&mut self, pressure_bar: f32) -> f32 {
        self.0.as_mut().map_or(f32::NAN, |model| model.step(pressure_bar))
    }

    fn reset(&mut self) {
        if let Some(model) = &mut self.0 {
            model.reset();
        }
    }

    fn is_present(&self) -> bool {
        self.0.as_ref().is_some_and(|model| model.is_present())
    }

    fn direction(&self) -> Direction {
        self.0.as_ref().map_or(Direction::Estimator, |model| model.direction())
    }

    fn compensator(&self) -> Option<&Compensator> {
        self.0.as_ref()?.compensator()
    }

    fn is_outside_domain(&self) -> bool {
        self.0.as_ref().is_some_and(|model| model.is_outside_domain())
    }

    fn identity(&self) -> [u8; 8] {
        self.0.as_ref().map_or([0; 8], |model| model.identity())
    }
}

/// The background's side.
#[derive(Debug)]
pub struct ModelSlot<X> {
    loaded: X,
    place: Option<&'static mut BoardModel>,
    budget: StepBudget<Counter>,
}

/// The debug unit's cycle counter, which the tick has switched on.
#[derive(Debug)]
struct Counter;

impl StepTimer for Counter {
    fn cycles(&self) -> u32 {
        DWT::cycle_count()
    }
}

impl<X: Mutex<T = LoadedModel>> ModelSlot<X> {
    /// Over the tick's resource and the place for a model.
    ///
    /// # Safety
    /// One slot for the whole program, and bytes of the models' sectors that were admitted must not change from [`ModelPlace::load`] to
    /// [`ModelPlace::forget`]. [`crate::background`] keeps that: it forgets a model before its slot can be written, and flash in use refuses to be.
    pub const unsafe fn new(loaded: X, place: Option<&'static mut BoardModel>, cycles_per_tick: u32) -> Self {
        let budget = StepBudget { timer: Counter, cycles: cycles_per_tick / 100 * STEP_SHARE_PERCENT };
        Self { loaded, place, budget }
    }
}

impl<X: Mutex<T = LoadedModel>> ModelPlace for ModelSlot<X> {
    fn load(&mut self, blob: &[u8]) -> Result<ModelFacts, Fault> {
        self.forget();
        let Some(place) = &mut self.place else { return Err(Fault::InternalInconsistent) };
        if !is_in_model_sectors(blob) {
            return Err(Fault::InternalInconsistent);
        }
        // SAFETY: it lies within the models' sectors, as has just been checked: mapped flash, which is readable for ever and no object of Rust's.
        // The model that reads it goes in `forget` at the latest, until when nobody changes it, by the contract of `new`.
        let blob: &'static [u8] = unsafe { core::slice::from_raw_parts(blob.as_ptr(), blob.len()) };
        // SAFETY: the only access to this memory, by the only slot. The model that had it before has just gone. Zeroed, hence initialised.
        let weights = unsafe {
            let words = (&raw mut WEIGHTS).cast::<u32>();
            words.write_bytes(0, MAX_PACKED_WORDS);
            core::slice::from_raw_parts_mut(words, MAX_PACKED_WORDS)
        };
        let facts = place.load_within(blob, weights, &self.budget)?;
        if let Some(place) = self.place.take() {
            self.loaded.lock(|loaded| loaded.0 = Some(place));
        }
        Ok(facts)
    }

    fn forget(&mut self) {
        if let Some(place) = self.loaded.lock(|loaded| loaded.0.take()) {
            self.place = Some(place);
        }
        if let Some(place) = &mut self.place {
            place.forget();
        }
    }
}

fn is_in_model_sectors(bytes: &[u8]) -> bool {
    let range = bytes.as_ptr_range();
    <ThisBoard as Board>::MODEL_SLOTS
        .into_iter()
        .any(|first| range.start.addr() >= first && range.end.addr() <= first + <ThisBoard as Board>::SLOT_BYTES)
}
