//! The model blob: what a trained estimator looks like on its way to the microcontroller.
//!
//! [`schema`] holds the wire types, [`validate`] what they must satisfy.
#![no_std]
#![forbid(unsafe_code)]

#[cfg(feature = "std")]
extern crate std;

pub mod schema;
pub mod validate;
