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

/// The samples of a run that a search looks at.
pub(super) enum Samples<'a> {
    /// Every one.
    All(&'a Run),
    /// Those that are equations, and those between them that the operators must see: where the input turns. On the way from one to the next
    /// the input rises or falls throughout, and an operator that follows it ends where the end alone would have brought it.
    Thinned {
        /// Inputs in their order.
        input: Vec<f64>,
        /// The output where the sample is an equation.
        output: Vec<Option<f64>>,
    },
}

impl<'a> Samples<'a> {
    /// Of the samples that count each `every`-th is an equation.
    pub(super) fn of(run: &'a Run, every: usize) -> Self {
        if every == 1 {
            return Self::All(run);
        }
        let mut thinned = (Vec::new(), Vec::new());
        let mut keep = |index: usize, output: Option<f64>| {
            thinned.0.push(run.input[index]);
            thinned.1.push(output);
        };
        let (mut rises, mut kept) = (None, false);
        for index in 0..run.input.len() {
            let change = if index > 0 { run.input[index] - run.input[index - 1] } else { 0.0 };
            if change != 0.0 {
                // The sample before was the last of its direction.
                if !kept && rises != Some(change > 0.0) {
                    keep(index - 1, None);
                }
                rises = Some(change > 0.0);
            }
            kept = index >= run.skip && index.is_multiple_of(every);
            if kept {
                keep(index, Some(run.output[index]));
            }
        }
        Self::Thinned { input: thinned.0, output: thinned.1 }
    }

    /// Shows the inputs in turn, with the output of those that are equations.
    #[inline]
    pub(super) fn each(&self, mut see: impl FnMut(f64, Option<f64>)) {
        match self {
            Self::All(run) => {
                let output = |index: usize| (index >= run.skip).then(|| run.output[index]);
                run.input.iter().enumerate().for_each(|(index, &input)| see(input, output(index)));
            }
            Self::Thinned { input, output } => input.iter().zip(output).for_each(|(&input, &output)| see(input, output)),
        }
    }
}

/// Folds the linear problem `sign * output = sum_i w_i signal_i + constant` of all runs into one system. The constant is the last
/// column; with `offsets` every run has its own, which is projected out, and there is no such column.
#[must_use]
pub(super) fn linear_problem(runs: &[Samples<'_>], thresholds: &[f64], family: Family, sign: f64, offsets: bool) -> Compressed {
    let n = thresholds.len();
    let mut system = Compressed::new(if offsets { n } else { n + 1 });
    for run in runs {
        // The run's constant first: without the first row of its triangle the constant is gone.
        let mut own = Compressed::new(n + 1);
        let mut bank = Bank::new(thresholds, family);
        let mut row = vec![1.0; n + 1];
        run.each(|input, output| {
            bank.step(input);
            let Some(output) = output else { return };
            if offsets {
                (0..n).for_each(|k| row[k + 1] = bank.signal(k, input));
                own.push(&row, sign * output);
            } else {
                (0..n).for_each(|k| row[k] = bank.signal(k, input));
                system.push(&row, sign * output);
            }
        });
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
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::*;

    #[test]
    fn operators_that_see_the_turns_alone_are_where_those_are_that_see_everything() {
        let mut random = ChaCha8Rng::seed_from_u64(61);
        // Slow and fast, with noise, with steps of the resolution, and standing still.
        for (every, noise, step) in [(7, 0.0, 0.0), (10, 0.05, 0.0), (3, 0.0, 0.02), (50, 0.02, 0.1), (9, 0.0, 0.5)] {
            let wave = |k: u32| 1.5 + (f64::from(k) * 0.013).sin() + 0.4 * (f64::from(k) * 0.17).sin();
            let mut value = |k: u32| wave(k) + noise * (random.random::<f64>() - 0.5);
            let input: Vec<f64> =
                (0..3000).map(&mut value).map(|value| if step > 0.0 { (value / step).round() * step } else { value }).collect();
            let run = Run { output: (0..3000).map(f64::from).collect(), input, skip: 100 };
            let thresholds = [0.0, 0.03, 0.2, 0.7];
            let seen = |samples: &Samples<'_>| {
                let mut bank = Bank::new(&thresholds, Family::Play);
                let (mut seen, mut count) = (Vec::new(), 0);
                samples.each(|input, output| {
                    bank.step(input);
                    count += 1;
                    if output.is_some_and(|output| (output as usize).is_multiple_of(every)) {
                        seen.push((output, (0..4).map(|k| (bank.signal(k, input), bank.slope(k))).collect::<Vec<_>>()));
                    }
                });
                (seen, count)
            };
            let (all, thinned) = (seen(&Samples::All(&run)), seen(&Samples::of(&run, every)));
            assert_eq!(all.0, thinned.0, "every {every}, noise {noise}, step {step}");
            assert!(thinned.0.len() > 50 && thinned.1 < all.1, "{} of {}", thinned.1, all.1);
        }
    }

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
