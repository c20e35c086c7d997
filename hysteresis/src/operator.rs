//! What all operators have in common: one sample at a time, or a batch, with the state kept by the caller.

use crate::error::same_length;
use crate::{Error, Real};

/// A causal operator on sampled signals. Parameters are immutable and live in `self`; all memory is in [`Operator::State`], so one set
/// of parameters serves any number of signals, and a state can be copied, stored and put back.
///
/// ```
/// use hysteresis::{Lag, Operator, Play};
///
/// // Any operator, alone or in series, one sample at a time or in a batch.
/// fn last<O: Operator<f64>>(operator: &O, pressure_bar: &[f64]) -> f64 {
///     let mut state = operator.start();
///     let mut output = vec![0.0; pressure_bar.len()];
///     operator.process(&mut state, pressure_bar, &mut output).expect("as long as each other");
///     operator.reset(&mut state);
///     let mut again = pressure_bar.to_vec();
///     operator.process_in_place(&mut state, &mut again);
///     assert_eq!(output, again);
///     operator.step(&mut state, 0.0)
/// }
/// assert_eq!(last(&Play::new(0.25)?, &[0.0, 1.0]), 0.25);
/// assert_eq!(last(&(Play::new(0.25)?, Lag::from_coefficient(0.5)?), &[0.0, 1.0]), 0.3125);
/// # Ok::<(), hysteresis::Error>(())
/// ```
pub trait Operator<T: Real> {
    /// The memory.
    type State: Clone;

    /// The state before the first sample; each operator says what its first sample then does.
    fn start(&self) -> Self::State;

    /// One sample in, one sample out.
    fn step(&self, state: &mut Self::State, input: T) -> T;

    /// Back to [`Operator::start`].
    fn reset(&self, state: &mut Self::State) {
        *state = self.start();
    }

    /// A batch: `output[k]` is the answer to `input[k]`; the state carries over to the next call.
    ///
    /// # Errors
    /// When `input` and `output` differ in length; nothing has been computed then.
    fn process(&self, state: &mut Self::State, input: &[T], output: &mut [T]) -> Result<(), Error> {
        same_length(input.len(), output.len())?;
        for (output, input) in output.iter_mut().zip(input) {
            *output = self.step(state, *input);
        }
        Ok(())
    }

    /// A batch that replaces each sample of `signal` by the operator's answer to it.
    fn process_in_place(&self, state: &mut Self::State, signal: &mut [T]) {
        for sample in signal {
            *sample = self.step(state, *sample);
        }
    }
}

/// Two operators in series: the second acts on the output of the first.
impl<T: Real, First: Operator<T>, Second: Operator<T>> Operator<T> for (First, Second) {
    type State = (First::State, Second::State);

    fn start(&self) -> Self::State {
        (self.0.start(), self.1.start())
    }

    fn step(&self, state: &mut Self::State, input: T) -> T {
        let between = self.0.step(&mut state.0, input);
        self.1.step(&mut state.1, between)
    }
}
