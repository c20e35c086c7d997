//! What every board's converter does in a tick, whatever the chip: four conversions of twelve bits against 3.3 V.

use crate::calibration::ConverterConfig;
use crate::tick::RigFacts;

/// A measured channel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Measured {
    /// The laser.
    Laser,
    /// The pressure.
    Pressure,
}

/// Sequence of the injected conversions. Mirrored, so that the means of both channels belong to the same instant.
pub const SAMPLING_SEQUENCE: [Measured; 4] = [Measured::Laser, Measured::Pressure, Measured::Pressure, Measured::Laser];
/// Conversions of each channel in a tick, summed.
pub const CONVERSIONS_PER_CHANNEL: u16 = 2;
/// Code of one conversion at the reference voltage.
pub const CONVERTER_FULL_SCALE: u16 = 4095;
/// Reference voltage of the converters.
pub const REFERENCE_V: f32 = 3.3;
/// What the logic needs to know of the converter.
pub const FACTS: RigFacts =
    RigFacts { converter: ConverterConfig { full_scale_code: CONVERTER_FULL_SCALE * CONVERSIONS_PER_CHANNEL, full_scale_v: REFERENCE_V } };
