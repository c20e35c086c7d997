//! A curve without memory, in pieces.
//!
//! # Example
//! ```
//! use model_export::schema::Curve;
//!
//! // Straight up to one half, flat beyond.
//! let curve = Curve { slope: 1.0, bend_points: [0.5].into_iter().collect(), bends: [-1.0].into_iter().collect(), ..Curve::default() };
//! assert!(curve.validate().is_ok());
//! ```

use heapless::Vec;
use serde::{Deserialize, Serialize};

use super::MAX_BENDS;

/// A continuous, piecewise straight curve: `offset + slope * p + sum_k bends_k * max(p - bend_points_k, 0)`, the superposition of
/// one-sided dead zones of the modified Prandtl-Ishlinskii model (K. Kuhnen, European Journal of Control 9, 2003).
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Curve {
    /// Value at `p = 0` of the part below the first bend.
    pub offset: f32,
    /// Slope below the first bend.
    pub slope: f32,
    /// Where the slope changes, ascending.
    pub bend_points: Vec<f32, MAX_BENDS>,
    /// By how much it changes there.
    pub bends: Vec<f32, MAX_BENDS>,
}
