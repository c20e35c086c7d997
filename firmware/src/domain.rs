//! The domain guard: whether the model's input lies within what the model was trained on.
//!
//! Terms. The **envelope** is the range and the largest rate of the training inputs. **Nested reversals** are turns of the input that have
//! not yet been wiped out by a larger swing: what a hysteresis operator can remember. A model that has never seen five loops inside each
//! other knows nothing about the sixth.
//!
//! Wiping out and counting follow the memory of the Preisach model (I. D. Mayergoyz, *Mathematical Models of Hysteresis*, 1991, section 1.3).

use heapless::Vec;
use model_export::compensation::Domain;
use model_export::schema::Envelope;

/// Most nested reversals that are counted; more are as many.
pub const MOST_REVERSALS: usize = 32;
/// Share of the range by which an input may leave it: sensors have noise.
const MARGIN: f32 = 0.02;
/// Factor on the largest rate that is still within, for the same reason.
const RATE_MARGIN: f32 = 1.1;

/// The turns of a signal that are still remembered.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct NestedReversals {
    turns: Vec<f32, MOST_REVERSALS>,
    extreme: Option<f32>,
    rising: bool,
}

impl NestedReversals {
    /// Takes a sample; a turn counts once the signal has gone back by `depth`. Gives the number of nested reversals.
    ///
    /// # Deadline
    /// Every turn is wiped out once at most.
    pub fn step(&mut self, value: f32, depth: f32) -> u8 {
        let Some(extreme) = self.extreme else {
            self.extreme = Some(value);
            return 0;
        };
        let further = if self.rising { value >= extreme } else { value <= extreme };
        if further {
            self.extreme = Some(value);
            self.wipe_out(value);
        } else if (value - extreme).abs() >= depth {
            // The first turn is only where the signal began.
            // Beyond the capacity there are as many reversals as it holds.
            let _ = self.turns.push(extreme);
            self.rising = value > extreme;
            self.extreme = Some(value);
            self.wipe_out(value);
        }
        u8::try_from(self.turns.len()).unwrap_or(u8::MAX)
    }

    fn wipe_out(&mut self, value: f32) {
        while let [.., before, last] = self.turns.as_slice() {
            if (value - last).abs() < (last - before).abs() {
                break;
            }
            self.turns.pop();
            self.turns.pop();
        }
    }
}

/// What a model was trained on, ready to check against.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct DomainGuard {
    minimum: f32,
    maximum: f32,
    largest_step: f32,
    reversals: Option<Domain>,
}

/// The memory of a [`DomainGuard`].
#[derive(Clone, Debug, Default, PartialEq)]
pub struct DomainGuardState {
    last: Option<f32>,
    reversals: NestedReversals,
}

impl DomainGuardState {
    /// Forgets everything, in place.
    pub fn reset(&mut self) {
        (self.last, self.reversals.extreme, self.reversals.rising) = (None, None, false);
        self.reversals.turns.clear();
    }
}

impl DomainGuard {
    /// A guard for a model that steps every `period_s`.
    pub fn new(envelope: &Envelope, domain: Option<Domain>, period_s: f32) -> Self {
        let margin = MARGIN * (envelope.maximum - envelope.minimum);
        Self {
            minimum: envelope.minimum - margin,
            maximum: envelope.maximum + margin,
            largest_step: RATE_MARGIN * envelope.maximum_rate * period_s + margin,
            reversals: domain,
        }
    }

    /// Whether this input of the model is outside of what it was trained on.
    ///
    /// # Deadline
    /// That of [`NestedReversals::step`].
    pub fn is_outside(&self, state: &mut DomainGuardState, input: f32) -> bool {
        // What is not a number is in no range.
        let in_range = (self.minimum..=self.maximum).contains(&input);
        let slow = state.last.is_none_or(|last| (input - last).abs() <= self.largest_step);
        state.last = Some(input).filter(|input| input.is_finite());
        let known = self
            .reversals
            .is_none_or(|domain| input.is_finite() && state.reversals.step(input, domain.reversal_depth) <= domain.nested_reversals);
        !(in_range && slow && known)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const ENVELOPE: Envelope = Envelope { minimum: 0.0, maximum: 3.0, maximum_rate: 10.0 };

    fn reversals(values: &[f32]) -> u8 {
        let mut nested = NestedReversals::default();
        values.iter().map(|value| nested.step(*value, 0.1)).last().unwrap()
    }

    #[test]
    fn shrinking_swings_nest_and_a_larger_one_wipes_them_out() {
        assert_eq!(reversals(&[0.0, 3.0]), 1, "the beginning is the first turn");
        assert_eq!(reversals(&[0.0, 3.0, 1.0, 2.0, 1.4, 1.8]), 5);
        assert_eq!(reversals(&[0.0, 3.0, 1.0, 2.0, 1.4, 2.1]), 3);
        assert_eq!(reversals(&[0.0, 3.0, 1.0, 2.0, 1.4, 1.8, 0.9]), 2);
    }

    #[test]
    fn noise_below_the_depth_is_no_reversal() {
        assert_eq!(reversals(&[0.0, 1.0, 0.95, 1.05, 0.99, 2.0]), 1);
    }

    #[test]
    fn any_number_of_reversals_is_survived() {
        let mut nested = NestedReversals::default();
        let mut size = 3.0;
        for turn in 0..100u8 {
            nested.step(if turn % 2 == 0 { size } else { -size }, 1e-6);
            size *= 0.95;
        }
        assert_eq!(usize::from(nested.step(0.0, 1e-6)), MOST_REVERSALS);
    }

    #[test]
    fn leaves_its_domain_by_pressure_by_rate_and_by_reversals() {
        let domain = Domain { nested_reversals: 3, reversal_depth: 0.1 };
        let guard = DomainGuard::new(&ENVELOPE, Some(domain), 0.02);
        let outside = |values: &[f32]| {
            let mut state = DomainGuardState::default();
            values.iter().map(|value| guard.is_outside(&mut state, *value)).last().unwrap()
        };
        // A step of 0.28 bar in 20 ms is the largest: 10 bar/s with their margin, and the margin of the range.
        assert!(!outside(&[0.0, 0.27]) && outside(&[0.0, 0.3]));
        assert!(!outside(&[3.05]) && outside(&[3.07]) && outside(&[-0.07]));
        assert!(outside(&[f32::NAN]) && outside(&[f32::INFINITY]));
        assert!(!outside(&[1.0, 1.2, 1.0, 1.15]));
        assert!(outside(&[1.0, 1.25, 1.01, 1.2, 1.05, 1.18]));
    }
}
