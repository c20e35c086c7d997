//! From a trained f32 model to the fixed-point blob, with proof and error report.
