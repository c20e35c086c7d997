//! The scalar of every operator: `f32` or `f64`, with the few functions the equations need.
//!
//! A trait of our own instead of `num-traits`: eight functions do, none of them depends on `std`, and sealing it lets the documentation
//! promise what happens with rounding, infinities and NaN.

use core::fmt::{Debug, Display};
use core::ops::{Add, AddAssign, Div, Mul, Neg, Sub};

mod sealed {
    pub trait Sealed {}
    impl Sealed for f32 {}
    impl Sealed for f64 {}
}

/// A floating-point number: `f32` or `f64`. Sealed.
///
/// The power function comes from `libm` with and without `std`, so that a host and a microcontroller compute the same bits.
///
/// ```
/// use hysteresis::Real;
///
/// /// One function for both precisions.
/// fn root_mean_square<T: Real>(values: &[T]) -> T {
///     let (mut squares, mut count) = (T::ZERO, T::ZERO);
///     for value in values.iter().filter(|value| value.is_finite()) {
///         squares += value.abs().powf(T::from_f64(2.0));
///         count += T::ONE;
///     }
///     (squares / count).powf(T::from_f64(0.5))
/// }
/// assert!((root_mean_square(&[3.0_f64, -4.0]) - 12.5_f64.sqrt()).abs() < 4.0 * f64::EPSILON);
/// assert!(root_mean_square(&[3.0_f32, -4.0]).to_f64() - 12.5_f64.sqrt() < 4.0 * <f32 as Real>::EPSILON.to_f64());
/// ```
pub trait Real:
    sealed::Sealed
    + Copy
    + Debug
    + Default
    + Display
    + PartialEq
    + PartialOrd
    + Add<Output = Self>
    + AddAssign
    + Div<Output = Self>
    + Mul<Output = Self>
    + Neg<Output = Self>
    + Sub<Output = Self>
    + Send
    + Sync
    + 'static
{
    /// 0.
    const ZERO: Self;
    /// 1.
    const ONE: Self;
    /// Distance from 1 to the next larger number.
    const EPSILON: Self;

    /// The nearest number of this type.
    fn from_f64(value: f64) -> Self;

    /// The same number in double precision, exactly.
    fn to_f64(self) -> f64;

    /// Magnitude.
    fn abs(self) -> Self;

    /// Neither infinite nor NaN.
    fn is_finite(self) -> bool;

    /// `self` to the power `exponent`.
    fn powf(self, exponent: Self) -> Self;
}

impl Real for f32 {
    const ZERO: Self = 0.0;
    const ONE: Self = 1.0;
    const EPSILON: Self = f32::EPSILON;

    fn from_f64(value: f64) -> Self {
        value as f32
    }

    fn to_f64(self) -> f64 {
        f64::from(self)
    }

    fn abs(self) -> Self {
        f32::abs(self)
    }

    fn is_finite(self) -> bool {
        f32::is_finite(self)
    }

    fn powf(self, exponent: Self) -> Self {
        libm::powf(self, exponent)
    }
}

impl Real for f64 {
    const ZERO: Self = 0.0;
    const ONE: Self = 1.0;
    const EPSILON: Self = f64::EPSILON;

    fn from_f64(value: f64) -> Self {
        value
    }

    fn to_f64(self) -> f64 {
        self
    }

    fn abs(self) -> Self {
        f64::abs(self)
    }

    fn is_finite(self) -> bool {
        f64::is_finite(self)
    }

    fn powf(self, exponent: Self) -> Self {
        libm::pow(self, exponent)
    }
}
