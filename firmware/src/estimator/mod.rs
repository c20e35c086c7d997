//! The estimator: pressure in, displacement out, one sample at a time.
//!
//! [`FrontEnd`] is the physics in `f32`.

mod front_end;

pub use front_end::{FrontEnd, FrontEndOutput, FrontEndState};
