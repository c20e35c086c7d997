//! The simulation model under discovery, its fit and its residual.

pub mod changes;
pub mod fit;
pub mod grid;
pub mod initial_state;
pub mod least_squares;
pub mod line;
pub mod paths;
pub mod refine;
pub mod remembering;
pub mod structure;
pub mod walk;
pub mod workspace;
