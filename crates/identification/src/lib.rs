//! Identification of hysteretic and dynamic maps by models that are linear in their weights.
//!
//! The output is modelled as a weighted sum of *columns*, each computed from the inputs alone: polynomials of the input, play
//! operators, products of inputs, and all of these behind first-order lags. What is not linear in its parameter (dead time, lags,
//! the number of operators) is a [`Recipe`], found by search. Because the weights are linear, everything a fit or a
//! cross-validation needs of the data are the second [`Moments`] of the columns, one set a recording: leaving a recording out is a
//! subtraction, and a whole nested cross-validation costs no second look at the samples.
//!
//! Data flow: [`Series`] -> [`Partition`] (which recordings are left out together) -> [`search`] (recipe and ridge penalty, by
//! inner folds) -> [`LinearModel`], and the error on recordings that took no part, by outer folds -> [`choice`] (the simplest model
//! that is as good as the best) and [`interval`] (what the next recording may bring).
//!
//! Roles are types: weights come from a [`Fit`], settings are chosen on a [`Select`], and figures are made on a [`Test`]; only a
//! [`Partition`] makes them.
//!
//! # Example
//! ```
//! use identification::nnls::{Normal, solve};
//!
//! // Weights of two columns, none below zero: the second would like to be.
//! let mut normal = Normal::new(2);
//! for (row, output_mm) in [([1.0, 0.0], 0.5), ([1.0, 1.0], 0.4), ([2.0, 1.0], 0.9)] {
//!     normal.add(&row, output_mm);
//! }
//! normal.complete();
//! let weights = solve(&normal.gram, &normal.right, &[true, true]);
//! assert_eq!(weights[1], 0.0);
//! // What the first alone makes of it: (0.5 + 0.4 + 2 * 0.9) / (1 + 1 + 4).
//! assert!((weights[0] - 0.45).abs() < 1e-12);
//! ```

pub mod choice;
mod columns;
mod filters;
pub mod interval;
pub mod linear;
mod model;
mod moments;
pub mod nnls;
mod nuisance;
mod recipe;
mod regression;
mod rungs;
pub mod search;
mod series;
mod split;

pub use columns::{Basis, Column, Lag, OutputPath, Scaling, Structure, Widening};
pub use model::{LinearModel, ModelFault};
pub use moments::Moments;
pub use nuisance::{Covariate, Nuisances};
pub use recipe::{Bound, Recipe, Spectrum};
pub use regression::{BOUND_PENALTIES, PENALTIES, Signs, Weights};
pub use rungs::{Rung, physics_rungs};
pub use series::Series;
pub use split::{Fit, Partition, Select, SplitKind, Test, Training, Unit};
