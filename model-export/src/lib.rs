//! The model blob: what a trained estimator looks like on its way to the microcontroller.
//!
//! [`schema`] holds the wire types, [`blob`] the frame around them (magic, version, length, CRC-32).
#![no_std]
#![forbid(unsafe_code)]

#[cfg(feature = "std")]
extern crate std;

pub mod schema;
