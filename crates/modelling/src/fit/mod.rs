//! `catheter fit`: recordings in, the model out that will be best on the next recording, with the error to expect there.
//!
//! Terms. A *rung* is a kind of model; the *ladder* is all of them, simplest first. Its errors are those of nested cross-validation: each
//! recording is predicted, free running, by a model whose weights and settings it took no part in. [`identification::choice`] ships the simplest rung
//! that is as good as the best.
//!
//! Data flow: [`prepare`] puts recordings onto one even clock; the physics rungs of [`identification`] and those of
//! [`crate::identify`] are searched and judged; [`networks`] are trained where physics leaves more than the rig itself repeats;
//! [`crate::physics::chip`] turns what the microcontroller can hold into its own format; [`crate::physics`] is where the rest is kept, and [`folder`] all of it.

pub mod folder;
pub mod judging;
mod ladder;
pub mod networks;
pub mod nuisance;
mod operators;
pub mod prepare;
mod search;

pub use ladder::{LadderRung, Outcome, Progress, RungModel, Settings, Splits};
pub use search::fit;

#[cfg(test)]
mod tests;
