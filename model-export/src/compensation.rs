//! What a controller must know of the actuator to compensate it: the second part of a blob's payload, since schema version 2.
//!
//! The parameters are in physical units and in continuous time, because a control law runs every millisecond and not at the model's
//! period. With `p` the commanded pressure the actuator is taken to be
//!
//! ```text
//! w   : tau_2 dw/dt = x - w,   tau dx/dt = delay(p, dead_time_s) - x,   tau = fill or vent time constant by the sign of dx/dt
//! u   = hinge(w - touch_bar) - hinge(-touch_bar)                        nothing moves before the bladder touches its sleeve
//! H_i = u less at most r_i (1 + friction_per_bar u) on either side      play operators whose friction grows with the pressure
//! s   = sum_i weights_i H_i + sum_j creep_gains_j C_j,   C_j follows sum_i weights_i H_i with its time constant
//! y   = constant_mm + s + square_per_mm s^2 + cube_per_mm2 s^3          displacement in mm
//! ```
//!
//! `hinge(d) = (d + sqrt(d^2 + touch_width_bar^2)) / 2`, which has an inverse without transcendental functions.
//!
//! # Bytes
//! ```text
//! u8  nested reversals, 255 for no domain      u8  operators of the plain inverse
//! u8  play operators, 0 for no compensation    u8  creep filters
//! f32 reversal depth, if there is a domain
//! f32 the numbers of `Compensation` in its order, then pairs: plain inverse, plays, creep; if there is compensation
//! ```
//! Little-endian throughout. Flat numbers, because their decoder is a loop: the firmware's flash is small.
//!
//! # Example
//! ```
//! use model_export::compensation::{Compensation, Domain, Extension, MAX_DEAD_TIME_S, MAX_TIME_CONSTANT_S};
//! use model_export::schema::Model;
//!
//! // A muscle with two play operators that answers after 20 ms and fills within 60 ms.
//! let compensation = Compensation {
//!     dead_time_s: 0.02,
//!     fill_time_constant_s: 0.06,
//!     vent_time_constant_s: 0.09,
//!     second_time_constant_s: 0.02,
//!     touch_width_bar: 0.02,
//!     highest_bar: 3.0,
//!     plain_inverse: [[0.0, 0.4], [0.25, -0.0625]].into_iter().collect(), // mm, bar/mm
//!     plays: [[0.0, 2.5], [0.1, 0.5]].into_iter().collect(),              // bar, mm/bar
//!     ..Compensation::default()
//! };
//! assert!(compensation.validate().is_ok());
//! let too_slow = Compensation { fill_time_constant_s: 1.1 * MAX_TIME_CONSTANT_S, ..compensation.clone() };
//! assert!(too_slow.validate().is_err() && compensation.dead_time_s < MAX_DEAD_TIME_S);
//!
//! let domain = Domain { nested_reversals: 4, reversal_depth: 0.05 }; // bar
//! let extension = Extension { compensation: Some(compensation), domain: Some(domain) };
//! assert!(extension.validate().is_ok());
//! # #[cfg(feature = "std")] {
//! let bytes = extension.encode();
//! assert_eq!(Extension::decode(&bytes)?, extension);
//! let mut place = Extension::default();
//! place.decode_into(&bytes)?;
//! assert_eq!(Model { extension: &bytes, ..Model::default() }.extension()?, place);
//! # }
//! # Ok::<(), model_export::validate::Invalid>(())
//! ```

use heapless::{Vec, VecView};

use crate::invalid::{Invalid, MAX_PARAMETER, require};
use crate::schema::{MAX_CREEP, MAX_PLAY, Model};

/// Longest dead time that a controller can look ahead, s.
pub const MAX_DEAD_TIME_S: f32 = 0.3;
/// Longest time constant of the way to the muscle, s.
pub const MAX_TIME_CONSTANT_S: f32 = 2.0;
/// Numbers of a [`Compensation`] beside its lists.
const NUMBERS: usize = 13;
/// Their bounds; the first three are checked together with what they belong to.
const BOUNDS: [(f32, f32); NUMBERS] = [
    (-MAX_PARAMETER, MAX_PARAMETER),
    (-MAX_PARAMETER, MAX_PARAMETER),
    (0.0, 10.0),
    (-MAX_PARAMETER, MAX_PARAMETER),
    (-MAX_PARAMETER, MAX_PARAMETER),
    (0.0, 10.0),
    (1e-3, 1.0),
    (0.0, MAX_DEAD_TIME_S),
    (1e-3, MAX_TIME_CONSTANT_S),
    (1e-3, MAX_TIME_CONSTANT_S),
    (1e-3, MAX_TIME_CONSTANT_S),
    (0.01, 20.0),
    (0.0, MAX_PARAMETER),
];
/// Stands for no domain where the number of nested reversals should be.
const NO_DOMAIN: u8 = u8::MAX;

/// The actuator as a controller sees it; see the module documentation for the equations.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Compensation {
    /// Displacement at rest of the plain inverse's model, mm.
    pub plain_constant_mm: f32,
    /// Displacement at rest, mm.
    pub constant_mm: f32,
    /// Growth of every threshold, per bar.
    pub friction_per_bar: f32,
    /// Square part of the curve, 1/mm.
    pub square_per_mm: f32,
    /// Cubic part of the curve, 1/mm^2.
    pub cube_per_mm2: f32,
    /// Pressure at which the actuator begins to move, bar.
    pub touch_bar: f32,
    /// Width of that transition, bar.
    pub touch_width_bar: f32,
    /// Dead time, s.
    pub dead_time_s: f32,
    /// Time constant while the pressure rises, s.
    pub fill_time_constant_s: f32,
    /// Time constant while the pressure falls, s.
    pub vent_time_constant_s: f32,
    /// Time constant of the second lag, s.
    pub second_time_constant_s: f32,
    /// Highest pressure that the supply reaches, bar.
    pub highest_bar: f32,
    /// 95 % of the model's errors on the recordings lie below this, mm.
    pub error_mm: f32,
    /// The closed-form inverse of a plain Prandtl-Ishlinskii model fitted for itself: thresholds in mm, the first zero, ascending, and
    /// weights in bar/mm.
    pub plain_inverse: Vec<[f32; 2], MAX_PLAY>,
    /// The play operators: thresholds in bar, the first zero, ascending, and weights in mm/bar, not negative.
    pub plays: Vec<[f32; 2], MAX_PLAY>,
    /// The creep: time constants in s, and gains.
    pub creep: Vec<[f32; 2], MAX_CREEP>,
}

/// What the training data covered beyond [`crate::schema::Envelope`].
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Domain {
    /// Reversals of the input that were nested in each other, at most.
    pub nested_reversals: u8,
    /// A turn of the input counts as a reversal from this depth on, in input units.
    pub reversal_depth: f32,
}

/// The second part of the payload.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Extension {
    /// For the controllers; absent when the model was exported for estimation only.
    pub compensation: Option<Compensation>,
    /// For the domain guard.
    pub domain: Option<Domain>,
}

/// Bytes that are still to be read.
struct Reader<'a>(&'a [u8]);

impl Reader<'_> {
    fn number(&mut self) -> Option<f32> {
        let (bytes, rest) = self.0.split_first_chunk()?;
        self.0 = rest;
        Some(f32::from_le_bytes(*bytes))
    }

    fn pairs(&mut self, count: u8, into: &mut VecView<[f32; 2]>) -> Option<()> {
        for _ in 0..count {
            let pair = [self.number()?, self.number()?];
            into.push(pair).ok()?;
        }
        Some(())
    }
}

impl Extension {
    /// Reads and checks the bytes behind a model; no bytes are an empty extension.
    ///
    /// # Errors
    /// When there are too many or too few bytes, or a field is out of its domain.
    pub fn decode(bytes: &[u8]) -> Result<Self, Invalid> {
        let mut extension = Self::default();
        extension.decode_into(bytes)?;
        Ok(extension)
    }

    /// As [`Self::decode`], over an extension that is there already: it is long for a small stack. After an error it means nothing.
    ///
    /// # Errors
    /// As [`Self::decode`].
    pub fn decode_into(&mut self, bytes: &[u8]) -> Result<(), Invalid> {
        (self.compensation, self.domain) = (None, None);
        if bytes.is_empty() {
            return Ok(());
        }
        let mut reader = Reader(bytes);
        let read = self.read(&mut reader).is_some() && reader.0.is_empty();
        require(read, "extension", 0, "as long as its counts say")?;
        self.validate()
    }

    fn read(&mut self, reader: &mut Reader<'_>) -> Option<()> {
        let (&[nested_reversals, plain, plays, creep], rest) = reader.0.split_first_chunk()?;
        reader.0 = rest;
        if nested_reversals != NO_DOMAIN {
            self.domain = Some(Domain { nested_reversals, reversal_depth: reader.number()? });
        }
        if plays == 0 {
            return Some(());
        }
        let compensation = self.compensation.insert(Compensation::default());
        for number in compensation.numbers_mut() {
            *number = reader.number()?;
        }
        reader.pairs(plain, &mut compensation.plain_inverse)?;
        reader.pairs(plays, &mut compensation.plays)?;
        reader.pairs(creep, &mut compensation.creep)
    }

    /// The bytes to put behind a model.
    #[cfg(feature = "std")]
    #[must_use]
    pub fn encode(&self) -> std::vec::Vec<u8> {
        let count = |pairs: &[[f32; 2]]| u8::try_from(pairs.len()).unwrap_or(u8::MAX);
        let part = self.compensation.as_ref();
        let mut bytes = std::vec![
            self.domain.map_or(NO_DOMAIN, |domain| domain.nested_reversals.min(NO_DOMAIN - 1)),
            part.map_or(0, |part| count(&part.plain_inverse)),
            part.map_or(0, |part| count(&part.plays)),
            part.map_or(0, |part| count(&part.creep)),
        ];
        let mut numbers: std::vec::Vec<f32> = self.domain.iter().map(|domain| domain.reversal_depth).collect();
        if let Some(part) = part {
            numbers.extend(part.numbers());
            numbers.extend(part.plain_inverse.iter().chain(&part.plays).chain(&part.creep).flatten());
        }
        bytes.extend(numbers.iter().flat_map(|number| number.to_le_bytes()));
        bytes
    }

    /// Checks every field.
    ///
    /// # Errors
    /// The first field out of its domain.
    pub fn validate(&self) -> Result<(), Invalid> {
        if let Some(compensation) = &self.compensation {
            compensation.validate()?;
        }
        let deep = |domain: Domain| domain.reversal_depth > 0.0 && domain.reversal_depth <= MAX_PARAMETER;
        require(self.domain.is_none_or(deep), "domain.reversal_depth", 0, "above zero, and at most a million")
    }
}

/// Thresholds ascend from zero, and the slopes that the curve runs through on its first loading, sums of the weights so far, are positive.
fn bank(pairs: &[[f32; 2]], field: &'static str) -> Result<(), Invalid> {
    let (mut last, mut slope) = (0.0, 0.0);
    for (index, [threshold, weight]) in pairs.iter().enumerate() {
        slope += weight;
        let ascends = if index == 0 { *threshold == 0.0 } else { *threshold > last };
        let bounded = *threshold <= MAX_PARAMETER && weight.abs() <= MAX_PARAMETER;
        require(
            ascends && bounded && slope >= 1e-6,
            field,
            index,
            "thresholds ascending from zero, and weights that sum up to positive slopes",
        )?;
        last = *threshold;
    }
    require(!pairs.is_empty(), field, 0, "one operator at least")
}

impl Compensation {
    /// In the order of [`Self::numbers_mut`]; a test holds that.
    fn numbers(&self) -> [f32; NUMBERS] {
        [
            self.plain_constant_mm,
            self.constant_mm,
            self.friction_per_bar,
            self.square_per_mm,
            self.cube_per_mm2,
            self.touch_bar,
            self.touch_width_bar,
            self.dead_time_s,
            self.fill_time_constant_s,
            self.vent_time_constant_s,
            self.second_time_constant_s,
            self.highest_bar,
            self.error_mm,
        ]
    }

    fn numbers_mut(&mut self) -> [&mut f32; NUMBERS] {
        [
            &mut self.plain_constant_mm,
            &mut self.constant_mm,
            &mut self.friction_per_bar,
            &mut self.square_per_mm,
            &mut self.cube_per_mm2,
            &mut self.touch_bar,
            &mut self.touch_width_bar,
            &mut self.dead_time_s,
            &mut self.fill_time_constant_s,
            &mut self.vent_time_constant_s,
            &mut self.second_time_constant_s,
            &mut self.highest_bar,
            &mut self.error_mm,
        ]
    }

    /// Checks every field; what passes can be inverted everywhere.
    ///
    /// # Errors
    /// The first field out of its domain.
    pub fn validate(&self) -> Result<(), Invalid> {
        for (index, (number, (low, high))) in self.numbers().into_iter().zip(BOUNDS).enumerate() {
            // What is not a number is in no range.
            require((low..=high).contains(&number), "compensation", index, "within the bounds of its field")?;
        }
        bank(&self.plain_inverse, "compensation.plain_inverse")?;
        bank(&self.plays, "compensation.plays")?;
        let mut weights = 0.0;
        for (index, [threshold, weight]) in self.plays.iter().enumerate() {
            // A threshold that grew as fast as the pressure would swallow it.
            let moves = *weight >= 0.0 && threshold * self.friction_per_bar < 1.0;
            require(moves, "compensation.plays", index, "not negative, with a friction that the pressure overcomes")?;
            weights += weight;
        }
        let mut creep = 0.0;
        for (index, [time_s, gain]) in self.creep.iter().enumerate() {
            let known = (0.05..=600.0).contains(time_s) && (0.0..=2.0).contains(gain);
            require(known, "compensation.creep", index, "0.05 to 600 s with gains from 0 to 2")?;
            creep += gain;
        }
        // The curve must rise over everything that the operators can sum up to.
        let reach = weights * self.highest_bar * (1.0 + creep);
        let mut share = 0.0;
        while share <= 1.0 {
            let sum = share * reach;
            let slope = 1.0 + 2.0 * self.square_per_mm * sum + 3.0 * self.cube_per_mm2 * sum * sum;
            require(slope >= 0.05, "compensation.square_per_mm", 0, "such that the curve rises up to the highest pressure")?;
            share += 0.0625;
        }
        Ok(())
    }
}

impl Model<'_> {
    /// What the controllers need of the model, read; empty for a model that was exported for estimation only.
    ///
    /// # Errors
    /// When the bytes do not decode or a field is out of its domain.
    pub fn extension(&self) -> Result<Extension, Invalid> {
        Extension::decode(self.extension)
    }
}

#[cfg(all(test, feature = "std"))]
mod tests {
    use super::*;

    fn extension() -> Extension {
        let compensation = Compensation {
            plain_constant_mm: 1.5,
            constant_mm: 2.0,
            friction_per_bar: 0.1,
            square_per_mm: -0.004,
            touch_bar: 0.2,
            touch_width_bar: 0.02,
            dead_time_s: 0.02,
            fill_time_constant_s: 0.06,
            vent_time_constant_s: 0.09,
            second_time_constant_s: 0.02,
            highest_bar: 3.0,
            error_mm: 0.05,
            plain_inverse: [[0.0, 0.4], [0.25, -0.0625]].into_iter().collect(),
            plays: [[0.0, 2.5], [0.1, 0.5]].into_iter().collect(),
            creep: [[5.0, 0.03]].into_iter().collect(),
            ..Compensation::default()
        };
        Extension { compensation: Some(compensation), domain: Some(Domain { nested_reversals: 7, reversal_depth: 0.15 }) }
    }

    #[test]
    fn what_was_written_is_read_with_and_without_each_part() {
        let whole = extension();
        for extension in [
            whole.clone(),
            Extension { compensation: None, ..whole.clone() },
            Extension { domain: None, ..whole.clone() },
            Extension::default(),
        ] {
            assert_eq!(Extension::decode(&extension.encode()), Ok(extension));
        }
        assert_eq!(Extension::decode(&[]), Ok(Extension::default()));
    }

    #[test]
    fn bytes_missing_at_any_place_and_one_too_many_are_refused() {
        let bytes = extension().encode();
        assert_eq!(bytes.len(), 4 + 4 * (1 + NUMBERS + 2 * 5));
        for length in 1..bytes.len() {
            assert!(Extension::decode(&bytes[..length]).is_err(), "{length} bytes");
        }
        assert!(Extension::decode(&[&bytes[..], &[0]].concat()).is_err());
        for (place, count) in [(1, 25), (2, 25), (3, 5)] {
            let mut more = [&bytes[..], &[0; 400]].concat();
            more[place] = count;
            assert!(Extension::decode(&more).is_err(), "more than there is room for");
        }
    }

    #[test]
    fn every_number_that_is_none_and_every_list_that_has_no_inverse_is_refused() {
        let bytes = extension().encode();
        for number in 0..(bytes.len() - 4) / 4 {
            let mut broken = bytes.clone();
            broken[4 + 4 * number..][..4].copy_from_slice(&f32::NAN.to_le_bytes());
            assert!(Extension::decode(&broken).is_err(), "number {number}");
        }
        let refused = |change: &dyn Fn(&mut Compensation)| {
            let mut changed = extension();
            changed.compensation.as_mut().map(change);
            Extension::decode(&changed.encode()).is_err()
        };
        assert!(refused(&|part| part.plays[1][0] = 0.0), "thresholds that do not ascend");
        assert!(refused(&|part| part.plays[0][0] = 0.1), "no threshold of zero");
        assert!(refused(&|part| part.plays[0][1] = 0.0), "no slope to begin with");
        assert!(refused(&|part| part.plays[1][1] = -0.1), "a negative weight");
        assert!(refused(&|part| part.plain_inverse[1][1] = -0.4), "an inverse that stands still");
        assert!(refused(&|part| part.friction_per_bar = 10.0), "friction that grows as fast as the pressure");
        assert!(refused(&|part| part.square_per_mm = -0.07), "a curve that turns back");
        assert!(!refused(&|part| part.plain_inverse[1][1] = 0.4), "a softer inverse is as good");
    }
}
