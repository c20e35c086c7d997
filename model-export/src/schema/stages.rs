//! Further stages of the front end, for the effects that a lab finds in its rig; the equations are in [`super`].
//!
//! # Example
//! ```
//! use model_export::schema::{Curve, Filter, Flow, Growth, Stages};
//!
//! // A supply that gives no more than 0.8 of the scale, a muscle that vents at half the speed, a tip that overshoots.
//! let supply = Curve { slope: 1.0, bend_points: [0.8].into_iter().collect(), bends: [-1.0].into_iter().collect(), ..Curve::default() };
//! let stages = Stages {
//!     supply: Some(supply),
//!     flow: Some(Flow { fill: Curve { slope: 0.2, ..Curve::default() }, vent: Curve { slope: 0.1, ..Curve::default() } }),
//!     growth: Some(Growth { per_path: [0.3, 0.3], ..Growth::default() }),
//!     tip: Some(Filter { momentum: 0.9, gains: [0.02, 0.02, 0.0] }),
//!     ..Stages::default()
//! };
//! assert!(stages.validate().is_ok());
//! // A filter that swings up is none.
//! assert!(Stages { tip: Some(Filter { momentum: 1.0, gains: [0.1, 0.0, 0.0] }), ..Stages::default() }.validate().is_err());
//! ```

use serde::{Deserialize, Serialize};

use super::curve::Curve;

/// A flow that what is missing drives: `w += fill(a - w)` where `a` is above `w`, else `w -= vent(w - a)`; no farther than to `a`. A straight
/// line is a lag, a flat end limits the rate, a power law is an orifice.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Flow {
    /// By how much the signal rises in a sample, of what is missing.
    pub fill: Curve,
    /// By how much it falls, of what is too much.
    pub vent: Curve,
}

/// A stable second-order filter with a gain of one at rest:
/// `y(k) = y(k-1) + momentum (y(k-1) - y(k-2)) + sum_i gains_i (x(k-i) - y(k-1))`.
///
/// With the sum `B` of the gains its poles solve `z^2 - (1 + momentum - B) z + momentum = 0`. In this form a signal at rest stays what it is to
/// the last bit, and slow poles lose nothing.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Filter {
    /// Share of the last step that goes on.
    pub momentum: f32,
    /// Gains of this sample and of the two before.
    pub gains: [f32; 3],
}

/// How thresholds of the play operators hang on where the path `v` is and how fast it goes.
///
/// With `f = share * law(m)` and `e = extra * law(m) + apart_0 v + apart_1 v^2 + apart_2 v^3`, the operator of threshold `r` has the gap
/// `max((max(1 + per_path_b v, 0) + f) r + e, 0)` to the branch `b`, 0 where the path rises and 1 where it falls. `m` follows the size of
/// the path's step: `m += fading (|v(k) - v(k-1)| - m)`. In a sample the operator goes `follow` of the distance to its bound, and no farther.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Growth {
    /// Growth with the path, of the rising branch and of the falling one.
    pub per_path: [f32; 2],
    /// By how much the branches part: with the path, its square and its cube.
    pub apart: [f32; 3],
    /// What growth goes with at a size of step.
    pub law: Curve,
    /// Share of themselves that thresholds grow by, times the law.
    pub share: f32,
    /// What they grow by whatever they are, times the law.
    pub extra: f32,
    /// How fast the size of step is forgotten, above 0; 1 is at once.
    pub fading: f32,
    /// How far an operator goes towards its bound in a sample, of the distance; without it all the way.
    pub follow: Option<Curve>,
}

impl Default for Growth {
    fn default() -> Self {
        Self { per_path: [0.0; 2], apart: [0.0; 3], law: Curve::default(), share: 0.0, extra: 0.0, fading: 1.0, follow: None }
    }
}

/// Stages in the order of the signal: between dead time and operators, of the operators, behind the readout. A stage that is `None` does
/// nothing. A front end with stages has one input and no lag beside them.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Stages {
    /// What the supply gives of the command.
    pub supply: Option<Curve>,
    /// How fast the valve goes, and how the muscle fills and vents.
    pub flow: Option<Flow>,
    /// What swings in the line.
    pub line: Option<Filter>,
    /// What the muscle makes of its pressure.
    pub muscle: Option<Curve>,
    /// How the thresholds change.
    pub growth: Option<Growth>,
    /// What swings or lags behind the operators.
    pub tip: Option<Filter>,
}
