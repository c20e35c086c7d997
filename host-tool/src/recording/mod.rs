//! Recordings: one run of input and output over time, and the errors of reading one.

use std::path::PathBuf;

/// Name and unit of one channel.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Signal {
    /// Quantity, for example `pressure`.
    pub quantity: String,
    /// Unit, for example `bar`.
    pub unit: String,
}

/// One run: input and output at common times, free of non-finite values.
#[derive(Clone, Debug)]
pub struct Recording {
    /// Where it came from; also its name in reports.
    pub path: PathBuf,
    /// Family of excitation, for example `a`; taken from the file name.
    pub family: String,
    /// What the input is.
    pub input_signal: Signal,
    /// What the output is.
    pub output_signal: Signal,
    /// Sample times in s, strictly increasing.
    pub time_s: Vec<f64>,
    /// Input, one value a sample.
    pub input: Vec<f64>,
    /// Output, one value a sample.
    pub output: Vec<f64>,
    /// Median sample period in s.
    pub sample_period_s: f64,
    /// Index of the first sample after each gap.
    pub gaps: Vec<usize>,
}
