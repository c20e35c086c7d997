//! The search for the parameters of a form.

pub mod descent;
pub mod forms;
pub mod parallel;
pub mod simplex;
