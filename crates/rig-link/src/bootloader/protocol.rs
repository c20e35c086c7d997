//! The bytes that both ends share (AN3155).

/// Acknowledged.
pub(super) const ACK: u8 = 0x79;
/// Refused.
pub(super) const NACK: u8 = 0x1f;
/// What the bootloader measures the speed of the line by.
pub(super) const SYNCHRONISE: u8 = 0x7f;
