//! The modified Prandtl-Ishlinskii model: play operators for the memory, then dead zones for asymmetry and saturation.
//!
//! `y = S( sum_i w_i H_i(p) )`, with `S` the curve of [`crate::dead_zone`]. Where both parts can be inverted so can the whole, in the reverse
//! order: `p = P^-1( S^-1(y) )`.
//!
//! Source: K. Kuhnen, European Journal of Control 9(4), 2003.
//!
//! NaN: a NaN input holds the output, as in [`crate::prandtl_ishlinskii`]; in the inverse it does not move the memory either, and the output
//! is that of the memory as it stands.

use crate::{DeadZones, Error, Operator, PrandtlIshlinskii, PrandtlIshlinskiiState, Real};

/// A modified Prandtl-Ishlinskii model of at most `N` play operators and `M` dead zones.
///
/// ```
/// use hysteresis::{DeadZones, InverseModifiedPrandtlIshlinskii, ModifiedPrandtlIshlinskii, Operator, PrandtlIshlinskii};
///
/// let model = ModifiedPrandtlIshlinskii {
///     hysteresis: PrandtlIshlinskii::<f64, 2>::new(&[0.0, 0.2], &[0.5, 0.5])?,
///     curve: DeadZones::<f64, 1>::new(1.0, &[0.5], &[-0.5])?,
/// };
/// // The operators give 0.9 mm, the curve halves what is beyond 0.5 mm.
/// let displacement_mm = model.step(&mut model.start(), 1.0);
/// assert!((displacement_mm - 0.7).abs() < 1e-12);
///
/// let inverse: InverseModifiedPrandtlIshlinskii<f64, 2, 1> = model.inverse()?;
/// let pressure_bar = inverse.step(&mut inverse.start(), 0.7);
/// assert!((pressure_bar - 1.0).abs() < 1e-12);
/// # Ok::<(), hysteresis::Error>(())
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ModifiedPrandtlIshlinskii<T, const N: usize, const M: usize> {
    /// The memory, first.
    pub hysteresis: PrandtlIshlinskii<T, N>,
    /// The curve, on its output.
    pub curve: DeadZones<T, M>,
}

/// The inverse of a [`ModifiedPrandtlIshlinskii`] model: the inverse curve first, then the inverse memory.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct InverseModifiedPrandtlIshlinskii<T, const N: usize, const M: usize> {
    /// The inverse of the curve, first.
    pub curve: DeadZones<T, M>,
    /// The inverse of the memory, on its output.
    pub hysteresis: PrandtlIshlinskii<T, N>,
}

impl<T: Real, const N: usize, const M: usize> ModifiedPrandtlIshlinskii<T, N, M> {
    /// The inverse model. Matching states come from [`PrandtlIshlinskii::inverse_state`]; the start states match.
    ///
    /// # Errors
    /// When one of the parts has no inverse.
    pub fn inverse(&self) -> Result<InverseModifiedPrandtlIshlinskii<T, N, M>, Error> {
        Ok(InverseModifiedPrandtlIshlinskii { curve: self.curve.inverse()?, hysteresis: self.hysteresis.inverse()? })
    }
}

impl<T: Real, const N: usize, const M: usize> Operator<T> for ModifiedPrandtlIshlinskii<T, N, M> {
    type State = PrandtlIshlinskiiState<T, N>;

    fn start(&self) -> Self::State {
        self.hysteresis.start()
    }

    fn step(&self, state: &mut Self::State, input: T) -> T {
        self.curve.value(self.hysteresis.step(state, input))
    }
}

impl<T: Real, const N: usize, const M: usize> Operator<T> for InverseModifiedPrandtlIshlinskii<T, N, M> {
    type State = PrandtlIshlinskiiState<T, N>;

    fn start(&self) -> Self::State {
        self.hysteresis.start()
    }

    fn step(&self, state: &mut Self::State, input: T) -> T {
        self.hysteresis.step(state, self.curve.value(input))
    }
}
