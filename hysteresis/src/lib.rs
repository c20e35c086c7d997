//! Hysteresis operators and the effects that travel with them.
#![no_std]
#![forbid(unsafe_code)]
