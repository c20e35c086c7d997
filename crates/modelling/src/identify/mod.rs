//! Identification: physics models from recordings, by least squares with non-negative weights, with confidence intervals.
//!
//! Terms. The *bank* is a set of play operators on the input less the *rest input*, the value at which the actuator is taken to have
//! rested before the recording: eq. (2) starts its operators from zero, which is a rest input of 0 bar; a piezo that starts in the
//! middle of its range rests there. A *stop family* is a bank of stop operators, for forces of friction, which lead the motion.
//!
//! The fit is an output-error fit: the operators have no other input than the recorded one, so the error reported is that of the model
//! running freely. Recordings that start after an unknown history move the operators within their first reversals to where they
//! belong; [`FitConfig::skip_s`] keeps that time out of the fit, [`FitConfig::offsets`] fits a constant for each recording where a
//! sensor was set to zero anew.

mod bank;
pub mod choose;
mod config;
mod curve;
mod fit;
mod intervals;
mod start;
mod thresholds;

pub use crate::physics::{
    ChannelRange, CreepFilters, Curve, FORMAT_VERSION, InputPath, Kind, ModelError, PhysicsModel, Provenance, Source, input_path,
};
pub use identification::{linear, nnls};

pub use bank::{Family, Run};
pub use config::{Choice, FitConfig, IdentifyError, Thresholds};
pub use curve::{Bent, Rows, fit as fit_curve};
pub use fit::{Fit, fit};
pub use thresholds::{MOST_EQUATIONS, free_thresholds};

#[cfg(test)]
mod tests;
