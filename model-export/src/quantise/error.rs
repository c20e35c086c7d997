//! What a network may have that fixed point has no place for.

/// Why a network has no fixed-point form.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum QuantiseError {
    /// The arrays do not fit the dimensions.
    Shape {
        /// The layer.
        layer: usize,
    },
    /// The state limit is not positive or above 128.
    StateLimit {
        /// The limit.
        limit: f32,
    },
    /// A weight too large for the row's multiplier.
    Weight {
        /// The layer.
        layer: usize,
        /// The row, in the order of the biases: gate times units plus unit.
        row: usize,
        /// Largest magnitude of the row.
        magnitude: f64,
        /// What would fit.
        limit: f64,
    },
    /// A bias too large for its format.
    Bias {
        /// The layer.
        layer: usize,
        /// The row.
        row: usize,
        /// The bias.
        value: f64,
    },
    /// A dense layer whose outputs exceed 128.
    Output {
        /// The layer.
        layer: usize,
        /// Its largest output in calibration.
        largest: f64,
    },
    /// A value that is not finite.
    NotFinite {
        /// The layer; one more than the last means the dense output.
        layer: usize,
    },
}

impl core::fmt::Display for QuantiseError {
    fn fmt(&self, formatter: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Shape { layer } => write!(formatter, "layer {layer}: the weight arrays do not fit the layer's dimensions"),
            Self::StateLimit { limit } => {
                write!(formatter, "state limit {limit} is not between 0 and 128; train with a smaller one")
            }
            Self::Weight { layer, row, magnitude, limit } => write!(
                formatter,
                "layer {layer}, row {row}: a weight of {magnitude:.3} exceeds what fixed point can scale, {limit:.3}; train with weight decay"
            ),
            Self::Bias { layer, row, value } => {
                write!(formatter, "layer {layer}, row {row}: the bias {value:.3} exceeds 8191; train with weight decay")
            }
            Self::Output { layer, largest } => write!(
                formatter,
                "layer {layer}: outputs up to {largest:.1} leave no margin to 128, the most that fixed point holds; train with normalised values"
            ),
            Self::NotFinite { layer } => write!(formatter, "layer {layer}: a weight is not finite; train the model again"),
        }
    }
}

impl core::error::Error for QuantiseError {}
