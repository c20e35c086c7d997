//! Which physical effect does the simulation lack? From recordings to a verdict, a better model and the figures that show it.
//!
//! The baseline is a bank of play operators with weights that are not negative. Every effect of the [`catalogue`] is fitted on top of it,
//! its parameters by a grid and a simplex, the weights of everything linear inside (variable projection), on one half of the recordings;
//! the other half selects. Effects come in one at a time, are polished together and leave again when they stop paying. What is still
//! there in the end decides between `named` and `unknown`. Test recordings only give the final figures.
//!
//! The folders, in the order in which they build on each other: `data` (recordings made ready), `chain` (what forms of effects are made
//! of), `observers` (of what jumps), [`effects`], `model` (the simulation model and its fit), `search` (for parameters), `explanation`
//! (where model and measurement disagree), [`files`], `selection` (which effects come in, and the verdict).

mod chain;
mod data;
pub mod effects;
pub mod explanation;
pub mod files;
mod finding;
mod model;
mod observers;
mod result;
mod search;
mod selection;

pub use chain::columns::Columns;
pub use chain::form::OperatorLaw;
pub use data::session::{Beginning, Role, Run, Session, SessionError};
pub use effects::catalogue;
pub use explanation::diagnosis::{Correlation, LoopArea, Residual, Share};
pub use explanation::residual_map::Disagreement;
pub use explanation::{horizon, residual_map};
pub use files::file;
pub use finding::{Finding, Start, discover, discover_from};
pub use model::initial_state::InitialState;
pub use model::structure::{Model, Slot};
pub use result::{Candidate, DiscoverConfig, Discovery, Effect, Member, RunnerUp, Verdict};
pub use search::parallel::{Progress, Watch};
pub use selection::settings::HALF;

#[cfg(test)]
mod tests;
