//! How far an export is: it runs the model over its data several times, and each sample of each run is a piece of the work.

use std::cell::Cell;

use crate::network::{Mode, TrainedModel};

/// Samples from one word to the next.
const WORD: u64 = 512;

/// The runs over the data, of which somebody hears.
pub(super) struct Work<'a> {
    told: &'a dyn Fn(u64, u64),
    samples: u64,
    /// Steps for one sample: a window is run as a whole.
    steps: u64,
    all: Cell<u64>,
    done: Cell<u64>,
}

impl<'a> Work<'a> {
    /// The work for so many samples, where both ways of rounding are tried; a model without a network is not looked into.
    pub(super) fn of(model: &TrainedModel, samples: usize, told: &'a dyn Fn(u64, u64)) -> Self {
        let steps = if let Mode::Window { length } = model.mode { length as u64 } else { 1 };
        let work = Self { told, samples: samples as u64, steps, all: Cell::new(0), done: Cell::new(0) };
        work.expect(if model.network.is_some() { 2 } else { 1 }, model.network.is_some());
        work
    }

    /// So many candidates are compared after the calibration, which is done: outside, and inside the network.
    pub(super) fn expect(&self, candidates: u64, network: bool) {
        let compared = candidates * (self.steps + u64::from(network));
        self.all.set(self.samples * (self.steps + compared));
    }

    /// The model was run on a sample as it is used.
    pub(super) fn run(&self) {
        self.add(self.steps);
    }

    /// A network was looked into at a sample.
    pub(super) fn looked_into(&self) {
        self.add(1);
    }

    fn add(&self, steps: u64) {
        let before = self.done.get();
        self.done.set(before + steps);
        if before / WORD != (before + steps) / WORD || before + steps == self.all.get() {
            (self.told)(before + steps, self.all.get());
        }
    }
}
