//! How large a model may be: what the firmware reserves memory for.
//!
//! # Example
//! ```
//! use model_export::schema::{MAX_BENDS, MAX_CREEP, MAX_DEAD_TIME_SAMPLES, MAX_FEATURES, MAX_GOLDEN, MAX_INPUTS, MAX_LAYERS, MAX_MORE_INPUTS};
//! use model_export::schema::{MAX_PLAY, MAX_UNITS, MAX_WIDTH, MAX_WINDOW_VALUES};
//!
//! // The largest estimator: every input, layer and signal of the front end at once.
//! assert_eq!(MAX_INPUTS, 1 + MAX_MORE_INPUTS);
//! assert!(MAX_PLAY + MAX_CREEP + 3 <= MAX_FEATURES && MAX_FEATURES <= MAX_WIDTH);
//! assert_eq!((MAX_LAYERS, MAX_UNITS, MAX_BENDS), (4, 64, 8));
//! // Dead time of 0.64 s and golden vectors of 10 s at 50 Hz; a window of 50 samples may hold 20 features.
//! assert_eq!((MAX_DEAD_TIME_SAMPLES, MAX_GOLDEN, MAX_WINDOW_VALUES / 50), (32, 512, 20));
//! ```

/// Most inputs a model may have.
pub const MAX_INPUTS: usize = 4;
/// The same without the first.
pub const MAX_MORE_INPUTS: usize = MAX_INPUTS - 1;
/// Most play operators a front end may have.
pub const MAX_PLAY: usize = 24;
/// Most creep filters a front end may have.
pub const MAX_CREEP: usize = 5;
/// Most bends of the readout's curve.
pub const MAX_BENDS: usize = 8;
/// Longest dead time of the input path, in samples.
pub const MAX_DEAD_TIME_SAMPLES: usize = 32;
/// Most features the network may see: input, difference, path value, path difference, plays, readout, creeps.
pub const MAX_FEATURES: usize = 32;
/// Most layers before the dense output.
pub const MAX_LAYERS: usize = 4;
/// Most units of a layer.
pub const MAX_UNITS: usize = 64;

/// Widest input of a layer: features of the first, units of the one below for the others.
pub const MAX_WIDTH: usize = 64;
/// Most feature values a window may hold: length times features.
pub const MAX_WINDOW_VALUES: usize = 1024;
/// Most golden samples.
pub const MAX_GOLDEN: usize = 512;
