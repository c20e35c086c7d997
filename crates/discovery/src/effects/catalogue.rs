//! What an effect must say of itself, and the list of all effects.
//!
//! An effect is known by its name. It may have several *forms* (before or behind the hysteresis, one law or another); each is fitted and
//! the best speaks for the effect. To add an effect, write one file in `effects/` with its forms and register them in [`forms`].

use std::sync::{Mutex, PoisonError};

pub use crate::chain::columns::Columns;
pub use crate::chain::form::{Drive, Form, LAW_PARAMETERS, OperatorLaw, Parameter, Place, Quantity, Spec, ThresholdLaw, Told};
use crate::effects::{
    activation_threshold, asymmetric_hysteresis, clock_skew, creep, dead_time, fill_vent_asymmetry, first_cycle_softening, gain_drift,
    hold_after_reversal, leakage, offset_drift, periodic_disturbance, pneumatic_lag, rate_dependent_hysteresis, resonance, sample_and_hold,
    setup_change, slew_limit, smooth_hysteresis, static_nonlinearity, stick_slip, supply_saturation, valve_dead_band,
};

/// Forms that were added while the program runs.
static ADDED: Mutex<Vec<&'static dyn Form>> = Mutex::new(Vec::new());

/// Adds forms from outside to the catalogue: from then on they take part in every discovery of this program, and models with them can be read.
/// A form that is there already, by name and form, stays as it is.
pub fn add(forms: impl IntoIterator<Item = &'static dyn Form>) {
    let mut added = ADDED.lock().unwrap_or_else(PoisonError::into_inner);
    for form in forms {
        let mut known = built_in().into_iter().chain(added.iter().copied());
        if !known.any(|other| (other.name(), other.key()) == (form.name(), form.key())) {
            added.push(form);
        }
    }
}

/// Every form of every effect, those that were [added](add) last.
#[must_use]
pub fn forms() -> Vec<&'static dyn Form> {
    let mut forms = built_in();
    forms.extend(ADDED.lock().unwrap_or_else(PoisonError::into_inner).iter());
    forms
}

/// The forms that come with the program: the registration.
fn built_in() -> Vec<&'static dyn Form> {
    [
        dead_time::FORMS,
        pneumatic_lag::FORMS,
        fill_vent_asymmetry::FORMS,
        slew_limit::FORMS,
        valve_dead_band::FORMS,
        sample_and_hold::FORMS,
        hold_after_reversal::FORMS,
        supply_saturation::FORMS,
        activation_threshold::FORMS,
        static_nonlinearity::FORMS,
        asymmetric_hysteresis::FORMS,
        rate_dependent_hysteresis::FORMS,
        creep::FORMS,
        first_cycle_softening::FORMS,
        stick_slip::FORMS,
        resonance::FORMS,
        periodic_disturbance::FORMS,
        offset_drift::FORMS,
        gain_drift::FORMS,
        setup_change::FORMS,
        clock_skew::FORMS,
        leakage::FORMS,
        smooth_hysteresis::FORMS,
    ]
    .concat()
}

/// Names of all effects, `outliers` (found by the mask, not by a fit) included.
pub const NAMES: [&str; 24] = [
    "dead-time",
    "pneumatic-lag",
    "fill-vent-asymmetry",
    "slew-limit",
    "valve-dead-band",
    "supply-saturation",
    "activation-threshold",
    "static-nonlinearity",
    "asymmetric-hysteresis",
    "rate-dependent-hysteresis",
    "creep",
    "first-cycle-softening",
    "stick-slip",
    "resonance",
    "periodic-disturbance",
    "offset-drift",
    "gain-drift",
    "setup-change",
    "clock-skew",
    "outliers",
    "leakage",
    "sample-and-hold",
    "hold-after-reversal",
    "smooth-hysteresis",
];
