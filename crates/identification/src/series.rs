//! What a fit sees of a recording: evenly sampled inputs and one output.

use std::ops::Range;

/// One recording on an even clock.
#[derive(Clone, Debug, PartialEq)]
pub struct Series {
    /// Its name in reports.
    pub name: String,
    /// Recordings of one group (a day, a load, an amplitude) are left out together.
    pub group: String,
    /// One vector an input, each as long as the output; in the units of the recording.
    pub inputs: Vec<Vec<f64>>,
    /// The output, in its unit.
    pub output: Vec<f64>,
    /// Index of the first sample behind each gap: memory starts anew there.
    pub gaps: Vec<usize>,
    /// Samples at the start of the recording that move the memory but do not count.
    pub skip: usize,
}

impl Series {
    /// Number of samples.
    #[must_use]
    pub fn len(&self) -> usize {
        self.output.len()
    }

    /// Whether there is no sample.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.output.is_empty()
    }

    /// The stretches between gaps.
    #[must_use]
    pub fn segments(&self) -> Vec<Range<usize>> {
        segments(self.len(), &self.gaps)
    }
}

/// The stretches of `length` samples between `gaps`, in order, empty ones left out.
pub(crate) fn segments(length: usize, gaps: &[usize]) -> Vec<Range<usize>> {
    let starts = std::iter::once(0).chain(gaps.iter().copied());
    let ends = gaps.iter().copied().chain(std::iter::once(length));
    starts.zip(ends).filter(|(start, end)| start < end).map(|(start, end)| start..end).collect()
}
