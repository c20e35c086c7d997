//! Nuisances: what moves the output of a whole recording, or of its rest, and is no part of the map from inputs to output.
//!
//! Terms. A recording's *zero* is its constant. A *step* is one place in a recording behind which its zero is another. A *covariate* is
//! a slow signal beside the inputs, such as session time or temperature, to which the zero answers in proportion; its coefficient is
//! one for all recordings.
//!
//! One principle decides on all of them, on the recordings of a fit alone:
//!
//! 1. A flexible reference predicts each recording from the others. Its weights come from normal equations out of which the zero on
//!    each side of each candidate step is projected, so that no nuisance can hide in them.
//! 2. What it leaves is tested: a step by the means of blocks on its two sides, zeros by the means of the two halves of each
//!    recording (analysis of variance with random effects, R. A. Fisher, 1925: the scatter between the halves is what slow errors of
//!    the model explain), a covariate by the line through the recordings' means. Each test has the level [`statistics::LEVEL`].
//! 3. What is significant must also matter. Recordings left out must be predicted clearly better: zeros from the *other* half of the
//!    recording, a covariate from the other recordings, both against a reference that knows of no nuisance. A recording cannot win by
//!    having a constant of its own, and a memory that only looks like a zero is already explained by the reference without.

mod covariates;
mod halves;
mod named;
mod place;
mod statistics;
mod steps;
mod zeros;

pub(crate) use covariates::{estimate_covariates, name_covariate};
pub(crate) use named::{Candidates, Left, shape_residuals};
pub use named::{Covariate, Nuisances};
pub(crate) use steps::decide_on_steps;
pub(crate) use zeros::{decide_on_zeros, estimate};
