//! Adaptation: zero and gain of the estimate follow the laser slowly, so that the estimate is right when the laser is gone.
//!
//! Terms. The **raw estimate** is what the model says; `x` is its distance from the **pivot** in spans. The **adapted estimate** is
//!
//! ```text
//! y = pivot + span (zero + gain x)          gain = 1 + gain error
//! ```
//!
//! Zero, in spans, and gain error are the state of a Kalman filter with a random walk as its process and the laser's mean over a window as its
//! measurement. A window without a usable measurement is **frozen**: the state stays and the covariance grows up to its cap. The **excitation** is
//! the standard deviation of `x` over the recent past; below its threshold only the zero is adapted, by a gain of its own.
//!
//! # Formats
//! Everything is f32: single operations, none fused, no functions of a platform, hence the same bits everywhere. The covariance is in
//! units of the measurement's variance, so only the ratio of both noises counts. With `s` for window over time constant the process
//! noise is `s^2` for the zero and `GAIN_SHARE s^2` for the gain; the zero's steady Kalman gain is then `s`.
//!
//! # What holds for every input, numbers that are none included
//! 1. `|zero|` and the gain stay within their limits, and neither moves by more than its limit times `s` in a window.
//! 2. The covariance is positive definite and not above its caps: the Joseph form keeps it so for any gain in real numbers, and
//!    `Covariance::bounded` restores it after rounding. Without excitation nothing winds up.
//!
//! What follows from 1 for the closed loop is in [`crate::certificate`].
//!
//! Sources: the Joseph form and parameters that are considered and not estimated: G. J. Bierman, *Factorization Methods for Discrete Sequential
//! Estimation*, Academic Press 1977, chapters II and VIII. Why covariance winds up without excitation, and projection onto known bounds:
//! K. J. Astrom, B. Wittenmark, *Adaptive Control*, 2nd ed., section 11.5; P. A. Ioannou, J. Sun, *Robust Adaptive Control*, section 8.4.

mod filter;
mod watch;

#[cfg(test)]
pub(crate) use filter::tests::CONFIG as TEST_CONFIG;
pub use filter::{Adaptation, AdaptationConfig, AdaptationState, Correction, Covariance, GAIN_SHARE};
pub use watch::{TickFacts, WindowWatch};
