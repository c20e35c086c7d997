//! The model blob: what a trained estimator looks like on its way to the microcontroller.
//!
//! [`schema`] holds the wire types, [`validate`] what they must satisfy, [`compensation`] what controllers
//! need besides, [`fixed`] the arithmetic they mean, [`blob`] the frame around
//! them (magic, version, length, CRC-32) and, with the feature `std`, `quantise` makes fixed-point networks of `f32` ones and
//! `headroom` proves that none of their sums overflows,
//! `certificate` whether a network forgets where it started. [`link`] holds what host and board say to each other. All of it is [postcard]
//! by serde's derives, the same on host and board.
//!
//! [postcard]: https://postcard.jamesmunns.com/wire-format
#![no_std]
#![forbid(unsafe_code)]

#[cfg(feature = "std")]
extern crate std;

pub mod blob;
#[cfg(feature = "std")]
pub mod certificate;
pub mod compensation;
pub mod fixed;
#[cfg(feature = "std")]
pub mod headroom;
mod invalid;
pub mod link;
#[cfg(feature = "std")]
pub mod quantise;
pub mod schema;
mod several_inputs;
pub mod validate;
mod version_2;
