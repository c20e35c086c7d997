//! What laws draw from, and what they come to.

use std::collections::BTreeMap;

use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use crate::command::Excitation;

/// Integration step, s.
pub(super) const STEP_S: f64 = 1e-3;
/// Which laws a case is drawn from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Set {
    /// Laws that choices may look at.
    Tuning,
    /// Laws that only judge.
    Reporting,
}

/// Where and when a step happens.
#[derive(Clone, Copy, Debug)]
pub(super) struct Moment {
    /// Time since the session began, s.
    pub(super) session_s: f64,
    /// Number of the recording.
    pub(super) recording: usize,
    /// Whether this is the first step of a recording: what a pause resets begins anew.
    pub(super) begins: bool,
}

/// What a signal passes: its value one integration step later.
pub(super) type Stage = Box<dyn FnMut(f64, &Moment) -> f64>;

/// What a law may draw from and must tell.
pub(super) struct Draw<'a> {
    pub(super) generator: &'a mut ChaCha8Rng,
    /// Largest command, bar.
    pub(super) span_bar: f64,
    /// Displacement at that, mm, roughly.
    pub(super) range_mm: f64,
    /// Length of the session, s.
    pub(super) session_s: f64,
    pub(super) excitation: Excitation,
    /// Values drawn, by the catalogue's names.
    pub(super) values: BTreeMap<String, f64>,
}

impl Draw<'_> {
    /// A value between `low` and `high`.
    pub(super) fn even(&mut self, low: f64, high: f64) -> f64 {
        self.generator.random_range(low..high)
    }

    /// A value between `low` and `high`, even in its logarithm.
    pub(super) fn log(&mut self, low: f64, high: f64) -> f64 {
        low * (high / low).powf(self.generator.random::<f64>())
    }

    pub(super) fn sign(&mut self) -> f64 {
        if self.generator.random_bool(0.5) { 1.0 } else { -1.0 }
    }

    pub(super) fn tell(&mut self, key: &str, value: f64) -> f64 {
        self.values.insert(key.to_owned(), value);
        value
    }
}

/// How the muscle deviates from a bank of plain play operators.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct ThresholdLaw {
    /// Loading and unloading envelopes: powers of the input over its span, one for plain.
    pub(super) powers: Option<[f64; 2]>,
    /// The same by `tanh(k u) / tanh(k)`: `k` of each.
    pub(super) saturations: Option<[f64; 2]>,
    /// Thresholds grow towards one end of the range by this share.
    pub(super) taper: f64,
    /// Thresholds grow by this times the logarithm of the rate over a bar per second.
    pub(super) logarithmic_rate: f64,
    /// Thresholds grow by this times the root of the rate over a bar per second.
    pub(super) root_of_rate: f64,
    /// Thresholds grow by this times the rate over a bar per second.
    pub(super) linear_rate: f64,
    /// Time constant of the operators' own motion at high load, s.
    pub(super) sliding_s: f64,
}
