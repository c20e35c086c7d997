//! Check vectors: what the framework computed, and whether the imported network computes the same.

use std::path::Path;

use super::ImportError;
use crate::network::TrainedModel;
use recording::Signal;

/// Largest difference from the framework's output, in its range: what is left is the rounding of `f32` on both sides.
pub const PARITY: f64 = 1e-6;

/// Input samples with the framework's output.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct CheckVectors {
    /// One row an input of the plant, in its unit.
    pub inputs: Vec<Vec<f64>>,
    /// In the output's unit; none where nothing is to be compared.
    pub expected: Vec<Option<f64>>,
    /// Where sequences after the first start, from zero state.
    pub starts: Vec<usize>,
}

/// How a comparison went.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct Parity {
    /// Samples compared.
    pub samples: usize,
    /// Largest difference, in the output's unit.
    pub largest: f64,
    /// The same in the range of the expected output.
    pub largest_of_range: f64,
    /// Sample with the largest difference, from zero.
    pub at_sample: usize,
    /// What was expected there.
    pub expected: f64,
    /// What the model gives there.
    pub computed: f64,
    /// Whether [`PARITY`] holds.
    pub passed: bool,
}

fn ends(values: impl Iterator<Item = f64>) -> Option<[f64; 2]> {
    let (low, high) = values.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), value| (low.min(value), high.max(value)));
    (low < high).then_some([low, high])
}

impl CheckVectors {
    /// Reads a CSV file with the columns `input` (and `input2` and so on, one for each of `inputs`) and `output`, or those of the channels such
    /// as `pressure_bar`, and optionally `sequence` (another number starts from zero state) and `time_s` (not used).
    ///
    /// # Errors
    /// What is wrong, with the line.
    pub fn parse(bytes: &[u8], path: &Path, inputs: &[Option<&Signal>], output: Option<&Signal>) -> Result<Self, ImportError> {
        let problem = |line: u64, problem: String| ImportError::Check { problem: format!("{}:{line}: {problem}", path.display()) };
        let mut reader = csv::ReaderBuilder::new().trim(csv::Trim::All).from_reader(bytes);
        let header = reader.headers().map_err(|error| problem(1, format!("not a CSV file ({error})")))?.clone();
        let column = |role: &str, signal: Option<&Signal>| {
            let own = signal.map(Signal::column);
            header.iter().position(|name| name == role || Some(name) == own.as_deref()).ok_or_else(|| {
                let also = own.map_or_else(String::new, |own| format!(" or `{own}`"));
                let found = header.iter().collect::<Vec<_>>().join(",");
                problem(1, format!("there is no column `{role}`{also} (the file has `{found}`); rename the column"))
            })
        };
        let role = |index: usize| if index == 0 { "input".to_owned() } else { format!("input{}", index + 1) };
        let inputs = inputs.iter().enumerate().map(|(index, signal)| column(&role(index), *signal)).collect::<Result<Vec<_>, _>>()?;
        let output = column("output", output)?;
        let sequence = header.iter().position(|name| name == "sequence");
        for (index, name) in header.iter().enumerate() {
            if !inputs.contains(&index) && index != output && Some(index) != sequence && name != "time_s" {
                return Err(problem(1, format!("the column `{name}` is not known; remove it")));
            }
        }
        let mut vectors = Self { inputs: vec![Vec::new(); inputs.len()], ..Self::default() };
        let mut last = None;
        for record in reader.records() {
            let record =
                record.map_err(|error| problem(error.position().map_or(0, csv::Position::line), format!("damaged row ({error})")))?;
            let line = record.position().map_or(0, csv::Position::line);
            let cell = |index: usize| record.get(index).unwrap_or("");
            let value = |index: usize| {
                let text = cell(index);
                text.parse().ok().filter(|value: &f64| value.is_finite()).ok_or_else(|| {
                    problem(line, format!("column `{}` holds `{text}`, a finite number is wanted", header.get(index).unwrap_or("")))
                })
            };
            if let Some(index) = sequence {
                if last.as_deref().is_some_and(|last| last != cell(index)) {
                    vectors.starts.push(vectors.expected.len());
                }
                last = Some(cell(index).to_owned());
            }
            for (values, column) in vectors.inputs.iter_mut().zip(&inputs) {
                values.push(value(*column)?);
            }
            vectors.expected.push(if cell(output).is_empty() { None } else { Some(value(output)?) });
        }
        if vectors.output_range().is_none() {
            return Err(problem(1, "fewer than two different expected outputs: nothing can be compared".to_owned()));
        }
        Ok(vectors)
    }

    /// Smallest and largest value of an input.
    #[must_use]
    pub fn input_range(&self, channel: usize) -> Option<[f64; 2]> {
        ends(self.inputs.get(channel)?.iter().copied())
    }

    /// Smallest and largest expected output.
    #[must_use]
    pub fn output_range(&self) -> Option<[f64; 2]> {
        ends(self.expected.iter().flatten().copied())
    }

    /// Largest change of an input from one sample to the next.
    #[must_use]
    pub fn largest_step(&self, channel: usize) -> Option<f64> {
        let steps = self.inputs.get(channel)?.windows(2).enumerate().filter(|(index, _)| self.starts.binary_search(&(index + 1)).is_err());
        let largest = steps.map(|(_, pair)| (pair[1] - pair[0]).abs()).fold(0.0, f64::max);
        (largest > 0.0).then_some(largest)
    }

    /// Runs the model over the input and compares.
    ///
    /// # Errors
    /// When the model is out of its domain.
    pub fn compare(&self, model: &TrainedModel) -> Result<Parity, ImportError> {
        let computed = model
            .predict(&self.inputs.iter().map(Vec::as_slice).collect::<Vec<_>>(), &self.starts)
            .map_err(|invalid| ImportError::Value { name: "the network".to_owned(), problem: invalid.to_string() })?;
        let range = self.output_range().map_or(f64::NAN, |[low, high]| high - low);
        let mut worst = Parity {
            samples: self.expected.iter().flatten().count(),
            largest: 0.0,
            largest_of_range: 0.0,
            at_sample: 0,
            expected: 0.0,
            computed: 0.0,
            passed: true,
        };
        for (index, (expected, computed)) in self.expected.iter().zip(computed).enumerate() {
            let Some(expected) = *expected else { continue };
            let difference = (expected - computed).abs();
            // A NaN is worse than any number.
            if difference > worst.largest || difference.is_nan() {
                worst = Parity { largest: difference, at_sample: index, expected, computed, ..worst };
            }
        }
        worst.largest_of_range = worst.largest / range;
        worst.passed = worst.largest_of_range <= PARITY;
        Ok(worst)
    }
}
