//! Physics models from recordings.

pub mod nnls;
