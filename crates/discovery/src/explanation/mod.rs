//! Where model and measurement disagree, how much memory the output needs, and how well parameters are known.

pub mod diagnosis;
pub mod horizon;
pub mod intervals;
pub mod residual_map;
