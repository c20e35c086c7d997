//! What a controller must know of the actuator, found from recordings of commanded pressure and displacement.
//!
//! The model is [`firmware::control::Actuator`] itself, run at 1 kHz with the recorded pressures held from sample to sample and the result
//! averaged over each sample period, as the device's decimation filter does. All parameters are fitted together by damped Gauss-Newton
//! steps on the output error (D. W. Marquardt, J. SIAM 11(2), 1963), from a start that knows nothing of the rig but the slope of its
//! recordings. Intervals come from the last Jacobian, widened for residuals that follow each other.

use firmware::control::{Actuator, ActuatorState};
use hysteresis::PrandtlIshlinskii;
use model_export::compensation::Compensation;
use model_export::schema::MAX_PLAY;

use crate::recording::Recording;

/// Ticks of 1 ms before each recording in which the actuator is taken to rest at its first pressure.
const LEAD_TICKS: usize = 500;
/// Longest sample period, ticks: what is slower shows no lag of a valve.
const LONGEST_TICKS: f64 = 1000.0;
/// Most steps of the fit.
const MOST_STEPS: usize = 30;
/// The fit ends when a step makes the squares smaller by less than this share.
const LEAST_GAIN: f64 = 2e-4;
/// Thresholds, as shares of the largest.
const THRESHOLDS: [f32; 12] = [0.0, 0.03, 0.07, 0.13, 0.2, 0.28, 0.37, 0.47, 0.58, 0.7, 0.84, 1.0];
/// Largest threshold as a share of the pressures' range.
const LARGEST_THRESHOLD: f64 = 0.3;
/// Retardation times of the creep, s.
const CREEP_TIMES_S: [f32; 3] = [0.8, 4.0, 20.0];

/// Why nothing can be identified.
#[derive(Debug, thiserror::Error)]
pub enum FitError {
    /// Nothing to fit.
    #[error("there are no recordings to identify from; give at least one")]
    NoData,
    /// Not pressure and displacement.
    #[error("{path}: measures {found}; controllers need pressure_bar and displacement_mm")]
    Signals {
        /// Which recording.
        path: String,
        /// What it measures.
        found: String,
    },
    /// A period that is no whole number of ticks, or too long to see a lag.
    #[error("{path}: its sample period is {period_s} s; a whole number of milliseconds is needed, 1000 at most; --resample makes one")]
    Period {
        /// Which recording.
        path: String,
        /// Its sample period.
        period_s: f64,
    },
    /// A signal that does not move.
    #[error("pressure or displacement never moves in these recordings: nothing can be identified")]
    Still,
    /// The best parameters are no actuator.
    #[error("what fits these recordings best is no actuator that could be inverted: {0}")]
    Parameters(String),
}

/// An identified actuator.
#[derive(Clone, Debug)]
pub struct Fitted {
    /// Its parameters.
    pub compensation: Compensation,
    /// Every fitted number: name, value, half width of its 95 % interval.
    pub parameters: Vec<(&'static str, f64, f64)>,
    /// Root mean square error over all samples, mm.
    pub rmse_mm: f64,
    /// 95 % of the errors lie below this, mm.
    pub error_mm: f64,
    /// Slope and offset of the best straight line, mm/bar and mm.
    pub line: (f64, f64),
    /// Range of the displacements, mm.
    pub range_mm: (f64, f64),
    /// Samples.
    pub samples: usize,
}

/// Where each parameter lies in the vector of the fit.
const CONSTANT: usize = 0;
const FIRST_WEIGHT: usize = 1;
const SINGLE: usize = FIRST_WEIGHT + THRESHOLDS.len();
/// Names of the parameters behind the weights.
const SINGLES: [&str; 12] = [
    "friction_per_bar",
    "creep_gain_fast",
    "creep_gain_middle",
    "creep_gain_slow",
    "square_per_mm",
    "cube_per_mm2",
    "touch_bar",
    "touch_width_bar",
    "dead_time_s",
    "fill_time_constant_s",
    "vent_time_constant_s",
    "second_time_constant_s",
];
const PARAMETERS: usize = SINGLE + SINGLES.len();
const LOWEST: [f64; 12] = [0.0, 0.0, 0.0, 0.0, -0.03, -0.004, 0.0, 0.002, 0.0, 0.002, 0.002, 0.002];
const HIGHEST: [f64; 12] = [1.0, 0.5, 0.5, 0.5, 0.03, 0.004, 1.5, 0.2, 0.3, 1.0, 1.0, 1.0];
const START: [f64; 12] = [0.02, 0.01, 0.01, 0.01, 0.0, 0.0, 0.1, 0.03, 0.03, 0.06, 0.06, 0.02];
/// Steps of the differences that make the Jacobian.
const NUDGE: [f64; 12] = [0.005, 0.002, 0.002, 0.002, 2e-4, 2e-5, 0.005, 0.003, 0.001, 0.002, 0.002, 0.002];

/// One recording as the fit sees it.
struct Run {
    ticks_per_sample: usize,
    pressure_bar: Vec<f32>,
    displacement_mm: Vec<f64>,
}

/// Identifies the actuator; `watch` hears how many steps of the descent are done, and how many there are at most.
///
/// # Errors
/// See [`FitError`].
pub fn fit(recordings: &[Recording], watch: &dyn Fn(usize, usize)) -> Result<Fitted, FitError> {
    let runs = runs(recordings)?;
    let all_bar = || runs.iter().flat_map(|run| run.pressure_bar.iter().map(|bar| f64::from(*bar)));
    let all_mm = || runs.iter().flat_map(|run| run.displacement_mm.iter().copied());
    let (low_bar, high_bar) = all_bar().fold((f64::MAX, f64::MIN), |(low, high), value| (low.min(value), high.max(value)));
    let range_mm = all_mm().fold((f64::MAX, f64::MIN), |(low, high), value| (low.min(value), high.max(value)));
    if high_bar - low_bar < 1e-3 || range_mm.1 - range_mm.0 < 1e-6 {
        return Err(FitError::Still);
    }
    let samples = all_bar().count();
    let line = straight_line(all_bar().zip(all_mm()), samples);
    let problem = Problem { runs: &runs, largest_bar: LARGEST_THRESHOLD * (high_bar - low_bar), highest_bar: (high_bar * 1.2).max(0.1) };

    let mut values = vec![0.0; PARAMETERS];
    values[CONSTANT] = range_mm.0;
    // Half of the slope without memory, the rest spread over the operators.
    let share = 0.5 * line.0.max(0.05) / (THRESHOLDS.len() - 1) as f64;
    values[FIRST_WEIGHT..SINGLE].fill(share);
    values[FIRST_WEIGHT] = 0.5 * line.0.max(0.05);
    values[SINGLE..].copy_from_slice(&START);
    let free: Vec<usize> = (0..PARAMETERS).collect();
    let (residuals, gram) = problem.descend(&mut values, &free, &|step| watch(step, 2 * MOST_STEPS))?;

    let mut sizes: Vec<f64> = residuals.iter().map(|value| value.abs()).collect();
    sizes.sort_by(f64::total_cmp);
    let rmse_mm = (residuals.iter().map(|value| value * value).sum::<f64>() / samples as f64).sqrt();
    let error_mm = sizes[(0.95 * (samples - 1) as f64) as usize];
    let widths = widths(&gram, &residuals);
    let mut compensation = problem.compensation(&values);
    compensation.error_mm = error_mm as f32;
    problem.add_plain_inverse(&mut compensation, &values, &|step| watch(MOST_STEPS + step, 2 * MOST_STEPS))?;
    compensation.validate().map_err(|invalid| FitError::Parameters(invalid.to_string()))?;
    let parameters = SINGLES.iter().enumerate().map(|(index, name)| (*name, values[SINGLE + index], widths[SINGLE + index])).collect();
    Ok(Fitted { compensation, parameters, rmse_mm, error_mm, line, range_mm, samples })
}

fn runs(recordings: &[Recording]) -> Result<Vec<Run>, FitError> {
    if recordings.is_empty() {
        return Err(FitError::NoData);
    }
    let run = |recording: &Recording| {
        let path = recording.path.display().to_string();
        let found = format!("{} and {}", recording.input_signal.column(), recording.output_signal.column());
        if found != "pressure_bar and displacement_mm" {
            return Err(FitError::Signals { path, found });
        }
        let ticks = recording.sample_period_s * 1000.0;
        if (ticks - ticks.round()).abs() > 0.05 || !(0.95..=LONGEST_TICKS).contains(&ticks) {
            return Err(FitError::Period { path, period_s: recording.sample_period_s });
        }
        Ok(Run {
            ticks_per_sample: ticks.round() as usize,
            pressure_bar: recording.input.iter().map(|bar| *bar as f32).collect(),
            displacement_mm: recording.output.clone(),
        })
    };
    recordings.iter().map(run).collect()
}

fn straight_line(points: impl Iterator<Item = (f64, f64)>, samples: usize) -> (f64, f64) {
    let (mut x, mut y, mut xx, mut xy) = (0.0, 0.0, 0.0, 0.0);
    for (bar, mm) in points {
        (x, y, xx, xy) = (x + bar, y + mm, xx + bar * bar, xy + bar * mm);
    }
    let n = samples as f64;
    let slope = (n * xy - x * y) / (n * xx - x * x);
    (slope, (y - slope * x) / n)
}

/// The recordings and what is fixed.
struct Problem<'a> {
    runs: &'a [Run],
    largest_bar: f64,
    highest_bar: f64,
}

impl Problem<'_> {
    fn compensation(&self, values: &[f64]) -> Compensation {
        let single = |name: &str| SINGLES.iter().position(|single| *single == name).map_or(0.0, |index| values[SINGLE + index] as f32);
        let weights = values[FIRST_WEIGHT..SINGLE].iter();
        let creep_gains = ["creep_gain_fast", "creep_gain_middle", "creep_gain_slow"].map(single);
        Compensation {
            plain_constant_mm: 0.0,
            constant_mm: values[CONSTANT] as f32,
            // Stands in until the plain model is fitted.
            plain_inverse: [[0.0, 1.0]].into_iter().collect(),
            plays: THRESHOLDS.iter().zip(weights).map(|(share, weight)| [share * self.largest_bar as f32, *weight as f32]).collect(),
            creep: CREEP_TIMES_S.into_iter().zip(creep_gains).map(|(time_s, gain)| [time_s, gain]).collect(),
            friction_per_bar: single("friction_per_bar"),
            square_per_mm: single("square_per_mm"),
            cube_per_mm2: single("cube_per_mm2"),
            touch_bar: single("touch_bar"),
            touch_width_bar: single("touch_width_bar"),
            dead_time_s: single("dead_time_s"),
            fill_time_constant_s: single("fill_time_constant_s"),
            vent_time_constant_s: single("vent_time_constant_s"),
            second_time_constant_s: single("second_time_constant_s"),
            highest_bar: self.highest_bar as f32,
            error_mm: 0.0,
        }
    }

    /// Measured less modelled, all samples; `None` when the parameters are no actuator.
    fn residuals(&self, values: &[f64]) -> Option<Vec<f64>> {
        let actuator = Actuator::new(self.compensation(values)).ok()?;
        let work = |run: &Run| {
            let modelled = simulate(&actuator, &run.pressure_bar, run.ticks_per_sample);
            run.displacement_mm.iter().zip(modelled).map(|(measured, modelled)| measured - modelled).collect::<Vec<f64>>()
        };
        Some(self.runs.iter().flat_map(work).collect())
    }

    /// Bounds of a parameter, and the step of its difference.
    fn bounds(index: usize) -> (f64, f64, f64) {
        match index {
            CONSTANT => (-1e3, 1e3, 0.01),
            FIRST_WEIGHT => (0.02, 1e3, 0.02),
            _ if index < SINGLE => (0.0, 1e3, 0.02),
            _ => (LOWEST[index - SINGLE], HIGHEST[index - SINGLE], NUDGE[index - SINGLE]),
        }
    }

    /// Makes the squares small over the `free` parameters; gives residuals and the Gram matrix of the Jacobian at the end.
    fn descend(&self, values: &mut Vec<f64>, free: &[usize], watch: &dyn Fn(usize)) -> Result<(Vec<f64>, Vec<f64>), FitError> {
        let impossible = || FitError::Parameters("the start is out of its domain".to_owned());
        let mut residuals = self.residuals(values).ok_or_else(impossible)?;
        let mut squares: f64 = residuals.iter().map(|value| value * value).sum();
        let mut damping = 1e-3;
        let n = free.len();
        let mut gram = vec![0.0; n * n];
        for step in 0..MOST_STEPS {
            watch(step);
            let jacobian = self.jacobian(values, free, &residuals);
            let mut gradient = vec![0.0; n];
            for row in 0..n {
                gradient[row] = dot(&jacobian[row], &residuals);
                for column in 0..=row {
                    gram[row * n + column] = dot(&jacobian[row], &jacobian[column]);
                    gram[column * n + row] = gram[row * n + column];
                }
            }
            let mut gain = 0.0;
            for _ in 0..8 {
                let step = solve(&gram, &gradient, damping);
                let mut trial = values.clone();
                for (place, index) in free.iter().enumerate() {
                    let (low, high, _) = Self::bounds(*index);
                    trial[*index] = (values[*index] + step[place]).clamp(low, high);
                }
                let found = self.residuals(&trial).map(|found| (found.iter().map(|value| value * value).sum::<f64>(), found));
                match found {
                    Some((less, found)) if less < squares => {
                        gain = 1.0 - less / squares;
                        (squares, residuals, *values) = (less, found, trial);
                        damping = (damping * 0.3).max(1e-9);
                        break;
                    }
                    _ => damping *= 6.0,
                }
            }
            if gain < LEAST_GAIN {
                break;
            }
        }
        Ok((residuals, gram))
    }

    fn jacobian(&self, values: &[f64], free: &[usize], residuals: &[f64]) -> Vec<Vec<f64>> {
        let column = |index: &usize| {
            let (_, high, nudge) = Self::bounds(*index);
            let step = if values[*index] + nudge <= high { nudge } else { -nudge };
            let mut moved = values.to_vec();
            moved[*index] += step;
            match self.residuals(&moved) {
                // The residual falls where the model rises.
                Some(there) => residuals.iter().zip(there).map(|(here, there)| (here - there) / step).collect(),
                None => vec![0.0; residuals.len()],
            }
        };
        let threads = std::thread::available_parallelism().map_or(1, usize::from);
        let chunk = free.len().div_ceil(threads).max(1);
        std::thread::scope(|scope| {
            let workers: Vec<_> = free.chunks(chunk).map(|part| scope.spawn(move || part.iter().map(column).collect::<Vec<_>>())).collect();
            workers.into_iter().flat_map(|worker| worker.join().unwrap_or_default()).collect()
        })
    }

    /// Fits a plain Prandtl-Ishlinskii model behind the same lags and adds its closed-form inverse.
    fn add_plain_inverse(&self, compensation: &mut Compensation, values: &[f64], watch: &dyn Fn(usize)) -> Result<(), FitError> {
        let mut plain = values.to_vec();
        for name in
            ["friction_per_bar", "creep_gain_fast", "creep_gain_middle", "creep_gain_slow", "square_per_mm", "cube_per_mm2", "touch_bar"]
        {
            if let Some(index) = SINGLES.iter().position(|single| *single == name) {
                plain[SINGLE + index] = 0.0;
            }
        }
        let free: Vec<usize> = (0..SINGLE).collect();
        self.descend(&mut plain, &free, watch)?;
        let plays = self.compensation(&plain).plays;
        let (thresholds, weights): (Vec<f32>, Vec<f32>) = plays.iter().map(|[threshold, weight]| (*threshold, *weight)).unzip();
        let inverse = PrandtlIshlinskii::<f32, MAX_PLAY>::new(&thresholds, &weights).and_then(|model| model.inverse());
        let inverse = inverse.map_err(|error| FitError::Parameters(error.to_string()))?;
        compensation.plain_inverse =
            inverse.thresholds().iter().zip(inverse.weights()).map(|(threshold, weight)| [*threshold, *weight]).collect();
        compensation.plain_constant_mm = plain[CONSTANT] as f32;
        Ok(())
    }
}

/// Mean displacement over each sample, mm, for pressures held over `ticks_per_sample` ms, bar.
#[must_use]
pub fn simulate(actuator: &Actuator, pressure_bar: &[f32], ticks_per_sample: usize) -> Vec<f64> {
    let dead_ticks = f64::from(actuator.parameters().dead_time_s) * 1000.0;
    let (whole, share) = (dead_ticks.floor() as usize, dead_ticks.fract());
    let mut state = ActuatorState::default();
    let mut rest_mm = 0.0;
    let first_bar = pressure_bar.first().copied().unwrap_or(0.0);
    for _ in 0..LEAD_TICKS {
        rest_mm = f64::from(actuator.step(&mut state, first_bar));
    }
    let mut path = Vec::with_capacity(pressure_bar.len() * ticks_per_sample);
    for bar in pressure_bar {
        for _ in 0..ticks_per_sample {
            path.push(f64::from(actuator.step(&mut state, *bar)));
        }
    }
    let at = |tick: usize, delay: usize| if tick >= delay { path[tick - delay] } else { rest_mm };
    let late = |tick: usize| at(tick, whole) + share * (at(tick, whole + 1) - at(tick, whole));
    (0..pressure_bar.len())
        .map(|sample| (0..ticks_per_sample).map(|tick| late(sample * ticks_per_sample + tick)).sum::<f64>() / ticks_per_sample as f64)
        .collect()
}

/// Half widths of the 95 % intervals.
fn widths(gram: &[f64], residuals: &[f64]) -> Vec<f64> {
    let n = (gram.len() as f64).sqrt() as usize;
    let samples = residuals.len() as f64;
    let variance = dot(residuals, residuals) / (samples - n as f64).max(1.0);
    // Residuals that follow each other hold less information: first-order autocorrelation r leaves (1 - r) / (1 + r) of the samples.
    let neighbours: f64 = residuals.windows(2).map(|pair| pair[0] * pair[1]).sum();
    let correlation = (neighbours / dot(residuals, residuals).max(f64::MIN_POSITIVE)).clamp(0.0, 0.999);
    let widening = ((1.0 + correlation) / (1.0 - correlation)).sqrt();
    (0..n)
        .map(|index| {
            let mut unit = vec![0.0; n];
            unit[index] = 1.0;
            // A hair of damping, so that a parameter that the data do not show gets a wide interval and no failure.
            1.96 * widening * (variance * solve(gram, &unit, 1e-9)[index].max(0.0)).sqrt()
        })
        .collect()
}

fn dot(first: &[f64], second: &[f64]) -> f64 {
    first.iter().zip(second).map(|(a, b)| a * b).sum()
}

/// Solves `(G + damping diag(G)) x = right` by Cholesky's decomposition.
fn solve(gram: &[f64], right: &[f64], damping: f64) -> Vec<f64> {
    let n = right.len();
    let largest = (0..n).map(|index| gram[index * n + index]).fold(f64::MIN_POSITIVE, f64::max);
    let mut factor = gram.to_vec();
    for index in 0..n {
        factor[index * n + index] += damping * gram[index * n + index] + 1e-12 * largest;
    }
    for row in 0..n {
        for column in 0..=row {
            let sum: f64 = (0..column).map(|k| factor[row * n + k] * factor[column * n + k]).sum();
            let value = factor[row * n + column] - sum;
            factor[row * n + column] = if row == column { value.max(1e-14 * largest).sqrt() } else { value / factor[column * n + column] };
        }
    }
    let mut x = right.to_vec();
    for row in 0..n {
        let sum: f64 = (0..row).map(|k| factor[row * n + k] * x[k]).sum();
        x[row] = (x[row] - sum) / factor[row * n + row];
    }
    for row in (0..n).rev() {
        let sum: f64 = (row + 1..n).map(|k| factor[k * n + row] * x[k]).sum();
        x[row] = (x[row] - sum) / factor[row * n + row];
    }
    x
}
