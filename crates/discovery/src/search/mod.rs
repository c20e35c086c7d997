//! The search for the parameters of a form.

pub mod cross_entropy;
pub mod descent;
pub mod forms;
pub mod parallel;
pub mod simplex;
