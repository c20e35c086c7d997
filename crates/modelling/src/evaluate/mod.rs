//! How good a model is: errors on recordings, the ladder of models side by side, and the acceptance suite.
//!
//! Terms. *RMSE* is the root mean square of prediction less measurement, free running. *NRMSE* is the RMSE over the range (maximum less
//! minimum) of the recording's output, over the samples that count. The *mean RMSE* is the mean over files, each counting the same.

pub mod beyond;
pub mod compare;
mod judging;
pub mod ladder;
pub mod metrics;
pub mod statics;
pub mod suite;

pub use crate::parallel::for_each;
pub use judging::{Judged, Judging, judge};
pub use metrics::{Errors, FamilyErrors, FileErrors, by_family, mean_nrmse, mean_rmse, pooled_rmse};
pub use recording::simulation::{first_behind, set_zero};

#[cfg(test)]
mod tests;
