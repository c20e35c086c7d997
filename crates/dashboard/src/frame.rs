//! Samples as the WebSocket carries them: little-endian, fixed places, many in a frame.
//!
//! ```text
//! offset  bytes  what (header)                    offset  bytes  what (each sample)
//!      0      2  version, now 1                        0      8  device time, ms (f64)
//!      2      2  bytes of a sample, now 56             8      4  sequence
//!      4      4  number of the frame                  12      4  late ticks since the start
//!      8      4  samples                              16      4  command, bar (f32)
//!     12      4  bound of the estimate, mm (f32)      20      4  output, bar (f32)
//!                                                     24      4  set-point, bar or mm (f32)
//!                                                     28      4  measured pressure, bar (f32)
//!                                                     32      4  displacement, mm (f32)
//!                                                     36      4  estimate, mm (f32)
//!                                                     40      4  notices, a bit each
//!                                                     44      2  laser code
//!                                                     46      2  pressure code
//!                                                     48      1  state, 0 boot to 5 fault
//!                                                     49      1  number of the first fault
//!                                                     50      2  zero
//!                                                     52      4  longest tick, cycles
//! ```
//! A value that is not there is NaN. Frames are numbered, so that a watcher knows what it missed.

use crate::rig::{Phase, Sample};

/// Version of the layout.
pub const VERSION: u16 = 1;
/// Bytes before the samples.
pub const HEADER_BYTES: usize = 16;
/// Bytes of a sample.
pub const SAMPLE_BYTES: usize = 56;

/// A frame of these samples.
pub(crate) fn encode(number: u32, bound_mm: Option<f32>, samples: &[Sample]) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(HEADER_BYTES + SAMPLE_BYTES * samples.len());
    bytes.extend(VERSION.to_le_bytes());
    bytes.extend(u16::try_from(SAMPLE_BYTES).unwrap_or_default().to_le_bytes());
    bytes.extend(number.to_le_bytes());
    bytes.extend(u32::try_from(samples.len()).unwrap_or_default().to_le_bytes());
    bytes.extend(bound_mm.unwrap_or(f32::NAN).to_le_bytes());
    for sample in samples {
        bytes.extend((sample.time_ms as f64).to_le_bytes());
        bytes.extend(sample.sequence.to_le_bytes());
        bytes.extend(sample.late_ticks.to_le_bytes());
        let missing = |value: Option<f32>| value.unwrap_or(f32::NAN);
        let values = [
            sample.command_bar,
            sample.output_bar,
            sample.set_point,
            missing(sample.pressure_bar),
            missing(sample.displacement_mm),
            missing(sample.estimate_mm),
        ];
        bytes.extend(values.into_iter().flat_map(f32::to_le_bytes));
        bytes.extend(sample.notices.to_le_bytes());
        bytes.extend(sample.laser_code.to_le_bytes());
        bytes.extend(sample.pressure_code.to_le_bytes());
        bytes.extend([sample.phase as u8, sample.fault, 0, 0]);
        bytes.extend(sample.longest_tick_cycles.to_le_bytes());
    }
    bytes
}

/// The samples of a frame that [`encode`] made.
pub(crate) fn samples(frame: &[u8]) -> impl Iterator<Item = Sample> + '_ {
    let (samples, _) = frame.get(HEADER_BYTES..).unwrap_or_default().as_chunks::<SAMPLE_BYTES>();
    samples.iter().map(decode)
}

fn decode(bytes: &[u8; SAMPLE_BYTES]) -> Sample {
    fn part<const N: usize>(bytes: &[u8; SAMPLE_BYTES], at: usize) -> [u8; N] {
        std::array::from_fn(|index| bytes[at + index])
    }
    let float = |at| f32::from_le_bytes(part(bytes, at));
    let whole = |at| u32::from_le_bytes(part(bytes, at));
    let there = |at| Some(float(at)).filter(|value| !value.is_nan());
    let time_ms = f64::from_le_bytes(part(bytes, 0));
    Sample {
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "it was a whole number of ms")]
        time_ms: time_ms as u64,
        sequence: whole(8),
        late_ticks: whole(12),
        command_bar: float(16),
        output_bar: float(20),
        set_point: float(24),
        pressure_bar: there(28),
        displacement_mm: there(32),
        estimate_mm: there(36),
        notices: whole(40),
        laser_code: u16::from_le_bytes(part(bytes, 44)),
        pressure_code: u16::from_le_bytes(part(bytes, 46)),
        phase: Phase::ALL.get(usize::from(bytes[48])).copied().unwrap_or_default(),
        fault: bytes[49],
        longest_tick_cycles: whole(52),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_value_stands_at_its_place() {
        let sample = Sample {
            sequence: 7,
            time_ms: 1 << 40,
            phase: Phase::Running,
            fault: 17,
            notices: 0x8000_0001,
            laser_code: 0x1234,
            pressure_code: 0x5678,
            command_bar: 1.5,
            output_bar: 1.25,
            set_point: 2.0,
            pressure_bar: None,
            displacement_mm: Some(3.5),
            estimate_mm: Some(-0.5),
            late_ticks: 9,
            longest_tick_cycles: 61_000,
        };
        let bytes = encode(3, Some(0.25), &[Sample::default(), sample]);
        assert_eq!(bytes.len(), HEADER_BYTES + 2 * SAMPLE_BYTES);
        let float = |at: usize| f32::from_le_bytes(bytes[at..at + 4].try_into().unwrap());
        let whole = |at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap());
        assert_eq!(bytes[..4], [1, 0, 56, 0]);
        assert_eq!((whole(4), whole(8), float(12)), (3, 2, 0.25));
        let at = HEADER_BYTES + SAMPLE_BYTES;
        assert_eq!(f64::from_le_bytes(bytes[at..at + 8].try_into().unwrap()), (1u64 << 40) as f64);
        assert_eq!((whole(at + 8), whole(at + 12)), (7, 9));
        assert_eq!([float(at + 16), float(at + 20), float(at + 24)], [1.5, 1.25, 2.0]);
        assert!(float(at + 28).is_nan());
        assert_eq!([float(at + 32), float(at + 36)], [3.5, -0.5]);
        assert_eq!(whole(at + 40), 0x8000_0001);
        assert_eq!(bytes[at + 44..at + 52], [0x34, 0x12, 0x78, 0x56, 4, 17, 0, 0]);
        assert_eq!(whole(at + 52), 61_000);
        assert_eq!(samples(&bytes).collect::<Vec<_>>(), [Sample::default(), sample]);
    }
}
