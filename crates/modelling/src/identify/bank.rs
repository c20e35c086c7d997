//! What a fit sees of recordings: the input path, the bank of play operators, and how the operators depend on their thresholds.

use std::ops::Range;

use hysteresis::play;

use identification::linear::Compressed;

/// One recording as the fit sees it.
#[derive(Clone, Debug)]
pub struct Run {
    /// Input less the rest input, behind dead time and lag; in the input's unit.
    pub input: Vec<f64>,
    /// Output in its unit.
    pub output: Vec<f64>,
    /// Samples at the start that move the operators but do not count.
    pub skip: usize,
}

impl Run {
    /// The samples that count.
    #[must_use]
    pub fn counted(&self) -> Range<usize> {
        self.skip.min(self.input.len())..self.input.len()
    }
}

/// Which signals carry the non-negative weights.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Family {
    /// Play operators: the output lags behind (eq. (3), displacement of a muscle).
    Play,
    /// Stop operators, what play operators leave of the input: the output leads and levels off (friction force).
    Stop,
}

/// A bank of play operators with sensitivities to their thresholds.
pub struct Bank<'a> {
    thresholds: &'a [f64],
    family: Family,
    plays: Vec<f64>,
    slopes: Vec<f64>,
}

impl<'a> Bank<'a> {
    /// A bank at rest.
    #[must_use]
    pub fn new(thresholds: &'a [f64], family: Family) -> Self {
        Self { thresholds, family, plays: vec![0.0; thresholds.len()], slopes: vec![0.0; thresholds.len()] }
    }

    /// Moves to the next input; see [`Self::signal`] and [`Self::slope`].
    pub fn step(&mut self, input: f64) {
        for ((threshold, memory), slope) in self.thresholds.iter().zip(&mut self.plays).zip(&mut self.slopes) {
            let before = *memory;
            *memory = play::step(*threshold, input, before);
            // A driven operator is input -+ threshold; one that rests keeps the derivative of when it was driven.
            if *memory > before {
                *slope = -1.0;
            } else if *memory < before {
                *slope = 1.0;
            }
        }
    }

    /// Play or stop signal of an operator; of a stop family the operator of threshold zero is the input itself.
    #[must_use]
    pub fn signal(&self, index: usize, input: f64) -> f64 {
        match self.family {
            Family::Play => self.plays[index],
            Family::Stop if self.thresholds[index] == 0.0 => input,
            Family::Stop => input - self.plays[index],
        }
    }

    /// Derivative of the signal with respect to its threshold.
    #[must_use]
    pub fn slope(&self, index: usize) -> f64 {
        match self.family {
            Family::Play => self.slopes[index],
            Family::Stop if self.thresholds[index] == 0.0 => 0.0,
            Family::Stop => -self.slopes[index],
        }
    }
}

/// Folds the linear problem `sign * output = sum_i w_i signal_i + constant` of all runs into one system. The constant is the last
/// column; with `offsets` every run has its own, which is projected out, and there is no such column. Of the samples every one moves the
/// operators, and each `every`-th is an equation.
#[must_use]
pub fn linear_problem(runs: &[Run], thresholds: &[f64], family: Family, sign: f64, offsets: bool, every: usize) -> Compressed {
    let n = thresholds.len();
    let mut system = Compressed::new(if offsets { n } else { n + 1 });
    for run in runs {
        // The run's constant first: without the first row of its triangle the constant is gone.
        let mut own = Compressed::new(n + 1);
        let mut bank = Bank::new(thresholds, family);
        let mut row = vec![1.0; n + 1];
        for (index, &input) in run.input.iter().enumerate() {
            bank.step(input);
            if index < run.skip || !index.is_multiple_of(every) {
                continue;
            }
            if offsets {
                (0..n).for_each(|k| row[k + 1] = bank.signal(k, input));
                own.push(&row, sign * run.output[index]);
            } else {
                (0..n).for_each(|k| row[k] = bank.signal(k, input));
                system.push(&row, sign * run.output[index]);
            }
        }
        if offsets {
            for row in &own.into_rows()[1..] {
                system.push(&row[1..=n], row[n + 1]);
            }
        }
    }
    system
}

/// Samples that count in all runs.
#[must_use]
pub fn counted(runs: &[Run]) -> usize {
    runs.iter().map(|run| run.counted().len()).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn slopes_are_the_derivatives_of_the_signals() {
        let input: Vec<f64> = (0..400).map(|k| (f64::from(k) * 0.07).sin() * 2.0 * (-f64::from(k) * 0.005).exp()).collect();
        let thresholds = [0.1, 0.35, 0.8];
        let nudge = 1e-7;
        let nudged: Vec<f64> = thresholds.iter().map(|threshold| threshold + nudge).collect();
        for family in [Family::Play, Family::Stop] {
            let (mut bank, mut other) = (Bank::new(&thresholds, family), Bank::new(&nudged, family));
            for (sample, &value) in input.iter().enumerate() {
                bank.step(value);
                other.step(value);
                for index in 0..3 {
                    let difference = (other.signal(index, value) - bank.signal(index, value)) / nudge;
                    // At a turning point the nudged operator may turn a sample earlier: no sample of this input is that close.
                    assert!((difference - bank.slope(index)).abs() < 1e-6, "sample {sample}, operator {index}");
                }
            }
        }
    }
}
