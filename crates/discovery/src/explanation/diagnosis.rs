//! What kind of disagreement it is: whether the residual is white, what it goes with, and what opens the loop.
//!
//! A loop of output over input opens for three reasons that look alike: transport delay, lag and true hysteresis. Only the last is still
//! there when everything is done slowly. [`loop_area`] fits delay and lag beside the play operators and asks how much area each adds.

use serde::Serialize;

use crate::chain::form::Form;
use crate::data::session::{Role, Run, Session};
use crate::data::statistics::tail;
use crate::effects::{dead_time, pneumatic_lag};
use crate::explanation::intervals;
use crate::model::structure::{Model, Order, Scope};
use crate::model::workspace::Workspace;
use crate::search::{forms, parallel, simplex};

/// A share of the loop's area with its 95 % interval.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub struct Share {
    /// Share, 0 to 1.
    pub value: f64,
    /// Lower end.
    pub low: f64,
    /// Upper end.
    pub high: f64,
}

/// What opens the loop.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub struct LoopArea {
    /// Transport delay: the same shape, later.
    pub dead_time: Share,
    /// A first-order lag.
    pub lag: Share,
    /// What remains at any speed.
    pub hysteresis: Share,
    /// The delay, s.
    pub dead_time_s: f64,
    /// The time constant, s.
    pub lag_s: f64,
}

/// The largest correlation of the residual with something, over delays up to a second.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub struct Correlation {
    /// Correlation, -1 to 1.
    pub value: f64,
    /// How much later the residual is, s.
    pub lag_s: f64,
    /// Probability of so much by chance, over all delays.
    pub p_value: f64,
}

/// How far a residual is from noise.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub struct Residual {
    /// Correlation of neighbouring samples; zero for white noise.
    pub neighbours: f64,
    /// Whether that is within what white noise shows (three deviations).
    pub white: bool,
    /// With the input.
    pub with_input: Correlation,
    /// With the input's rate.
    pub with_rate: Correlation,
    /// With the model's output.
    pub with_model: Correlation,
}

/// Examines a residual.
#[must_use]
pub fn examine(session: &Session, residual: &[Vec<f64>]) -> Residual {
    let count: f64 = session.runs.iter().map(|run| (0..run.keep.len()).filter(|&sample| run.counts(sample)).count() as f64).sum();
    let centred: Vec<Vec<f64>> = centred(session, residual.to_vec());
    let neighbours = own_correlation(&centred);
    let rates = session.runs.iter().map(|run| {
        let last = run.input.len() - 1;
        (0..=last).map(|at| (run.input[(at + 1).min(last)] - run.input[at.saturating_sub(1)]) / run.period_s).collect()
    });
    let inputs: Vec<Vec<f64>> = session.runs.iter().map(|run| run.input.clone()).collect();
    let outputs = session.runs.iter().zip(residual).map(|(run, residual)| run.output.iter().zip(residual).map(|(y, r)| y - r).collect());
    let with = |signal: Vec<Vec<f64>>| correlate(session, &centred, &self::centred(session, signal), count);
    Residual {
        neighbours,
        white: neighbours.abs() < 3.0 / count.max(1.0).sqrt(),
        with_input: with(inputs),
        with_rate: with(rates.collect()),
        with_model: with(outputs.collect()),
    }
}

/// Takes the mean away, and the samples that do not count.
fn centred(session: &Session, mut signal: Vec<Vec<f64>>) -> Vec<Vec<f64>> {
    let (mut sum, mut count) = (0.0, 0.0_f64);
    for (run, values) in session.runs.iter().zip(&signal) {
        for (_, value) in values.iter().enumerate().filter(|(sample, _)| run.counts(*sample)) {
            sum += value;
            count += 1.0;
        }
    }
    let mean = sum / count.max(1.0);
    for (run, values) in session.runs.iter().zip(&mut signal) {
        for (sample, value) in values.iter_mut().enumerate() {
            *value = if run.counts(sample) { *value - mean } else { 0.0 };
        }
    }
    signal
}

/// Correlation of neighbouring samples.
fn own_correlation(signal: &[Vec<f64>]) -> f64 {
    let square: f64 = signal.iter().flatten().map(|value| value * value).sum();
    let product: f64 = signal.iter().map(|values| values.windows(2).map(|pair| pair[0] * pair[1]).sum::<f64>()).sum();
    product / square.max(1e-30)
}

/// The largest correlation over delays of a second either way.
fn correlate(session: &Session, residual: &[Vec<f64>], signal: &[Vec<f64>], count: f64) -> Correlation {
    const DELAYS: i32 = 12;
    let period_s = session.runs[0].period_s;
    let energy = |of: &[Vec<f64>]| of.iter().flatten().map(|value| value * value).sum::<f64>();
    let scale = (energy(residual) * energy(signal)).sqrt().max(1e-30);
    let at = |delay: i32| -> (f64, f64) {
        let samples = (f64::from(delay) / f64::from(DELAYS) / period_s).round() as i64;
        let product: f64 = residual
            .iter()
            .zip(signal)
            .map(|(residual, signal)| {
                let shift = samples.unsigned_abs() as usize;
                let (late, early) = if samples >= 0 { (residual, signal) } else { (signal, residual) };
                late.iter().skip(shift).zip(early).map(|(x, y)| x * y).sum::<f64>()
            })
            .sum();
        (product / scale, samples as f64 * period_s)
    };
    let (value, lag_s) = (-DELAYS..=DELAYS).map(at).max_by(|x, y| x.0.abs().total_cmp(&y.0.abs())).unwrap_or_default();
    // Two correlated series have fewer independent pairs than samples (Bartlett 1935, AR(1) on both sides).
    let both = (own_correlation(residual) * own_correlation(signal)).clamp(0.0, 0.9999);
    let pairs = (count * (1.0 - both) / (1.0 + both)).max(4.0);
    let p_value = (2.0 * f64::from(2 * DELAYS + 1) * tail(value.abs() * pairs.sqrt())).min(1.0);
    Correlation { value, lag_s, p_value }
}

/// Splits the area of the loops; `None` when the model will not take a delay and a lag, or there is no loop.
#[must_use]
pub fn loop_area(session: &Session, baseline: &Model, threads: usize) -> Option<LoopArea> {
    let (delay, lag): (&'static dyn Form, &'static dyn Form) = (*dead_time::FORMS.first()?, *pneumatic_lag::FORMS.first()?);
    if !baseline.slots.is_empty() {
        return None;
    }
    // Delay and lag stand in for each other: begin once with each alone, and keep what ends better.
    let residual = baseline.residuals(session);
    let alone = |form: &'static dyn Form, other: &'static dyn Form| {
        let started = forms::start_form(baseline, form, Order::Usual, session, &residual)?;
        let with_one = forms::refine_form(&started.model, form, session).model;
        let mut both = forms::polish(&with_one.with(other, vec![0.01]), session, Scope::Fit, 25).model;
        let (fit, _) = both.fit(session, Scope::Fit);
        Some((fit, both))
    };
    let begun = parallel::in_parallel(&[(delay, lag), (lag, delay)], threads, |&(form, other)| alone(form, other));
    let begun = begun.into_iter().collect::<Option<Vec<_>>>()?;
    let mut fitted = begun.into_iter().min_by(|x, y| x.0.total_cmp(&y.0))?.1;
    let place = |name: &str| fitted.slots.iter().position(|slot| slot.form.name() == name);
    let (delay_at, lag_at) = (place(delay.name())?, place(lag.name())?);
    let mut profile = profile(session, &fitted, [delay_at, lag_at], threads);
    if let Some((_, best)) = profile.iter().min_by(|x, y| x.0.total_cmp(&y.0)) {
        fitted = best.clone();
        fitted.fit(session, Scope::Both);
    }
    let residual = fitted.residuals(session);
    let correlation = neighbour_correlation(session, &residual);
    let half_widths = intervals::half_widths(&fitted, session, 0.0);
    // What is within 95 % of the best by the ratio of likelihoods, a chi square with one degree of freedom; correlated residuals tell less.
    let least = profile.iter().map(|entry| entry.0).fold(f64::MAX, f64::min);
    let pseudo_measurements = session.count(Role::Fit) as f64 * (1.0 - correlation) / (1.0 + correlation);
    profile.retain(|entry| pseudo_measurements * (entry.0 / least).ln() < 3.84);
    let (delay_s, lag_s) = (fitted.slots[delay_at].parameters[0], fitted.slots[lag_at].parameters[0]);
    let area = |delay_s: f64, lag_s: f64| {
        let mut model = fitted.clone();
        model.slots[delay_at].parameters[0] = delay_s.max(1e-6);
        model.slots[lag_at].parameters[0] = lag_s.max(1e-6);
        area_of(session, &model)
    };
    let whole = area(delay_s, lag_s);
    if whole <= 1e-9 {
        return None;
    }
    let parts = |delay_s: f64, lag_s: f64| {
        let with_lag = area(0.0, lag_s);
        (((area(delay_s, lag_s) - with_lag) / whole).clamp(0.0, 1.0), ((with_lag - area(0.0, 0.0)) / whole).clamp(0.0, 1.0))
    };
    // Both are searched in their logarithms and never reach zero: next to their lower limit they may as well be nothing.
    let ends = |at: usize| {
        let (value, reach) = (fitted.slots[at].parameters[0], half_widths[at]);
        let low = value - reach;
        [if low < 2.0 * fitted.slots[at].form.parameters()[0].low { 0.0 } else { low }, value + reach]
    };
    let lags = ends(lag_at);
    // Delay and lag stand in for each other: beside the ends of each, in any company, every pair on the valley's floor counts.
    let floor = profile.iter().map(|(_, model)| parts(model.slots[delay_at].parameters[0], model.slots[lag_at].parameters[0]));
    let corners: Vec<(f64, f64)> = ends(delay_at).into_iter().flat_map(|delay| lags.map(|lag| parts(delay, lag))).chain(floor).collect();
    let value = parts(delay_s, lag_s);
    let share = |of: &dyn Fn((f64, f64)) -> f64| {
        let value = of(value);
        let (low, high) = corners.iter().fold((value, value), |(low, high), &corner| (low.min(of(corner)), high.max(of(corner))));
        Share { value, low, high }
    };
    Some(LoopArea {
        dead_time: share(&|parts| parts.0),
        lag: share(&|parts| parts.1),
        hysteresis: share(&|parts| (1.0 - parts.0 - parts.1).clamp(0.0, 1.0)),
        dead_time_s: delay_s,
        lag_s,
    })
}

/// Walks along the valley in which delay and lag stand in for each other: for a row of lags the best delay, and the mean square it leaves.
fn profile(session: &Session, fitted: &Model, [delay_at, lag_at]: [usize; 2], threads: usize) -> Vec<(f64, Model)> {
    let (delay_s, lag_s) = (fitted.slots[delay_at].parameters[0], fitted.slots[lag_at].parameters[0]);
    let [shortest_delay_s, shortest_lag_s] = [delay_at, lag_at].map(|at| fitted.slots[at].form.parameters()[0].low);
    let reach_s = lag_s.max(0.02);
    let shares = [-1.0, -0.8, -0.6, -0.4, -0.25, -0.1, 0.0, 0.1, 0.25, 0.5, 1.0];
    let at = |share: &f64| {
        let mut model = fitted.clone();
        let other_lag_s = (lag_s + share * reach_s).max(shortest_lag_s);
        model.slots[lag_at].parameters[0] = other_lag_s;
        // A short lag delays everything by itself.
        model.slots[delay_at].parameters[0] = (delay_s + lag_s - other_lag_s).max(shortest_delay_s);
        let effort = simplex::Effort { scope: Scope::Fit, size: 0.3, evaluations: 16, spread: 1e-8 };
        (simplex::simplex(&mut model, &mut Workspace::new(session), &[delay_at], effort), model)
    };
    parallel::in_parallel(&shares, threads, at)
}

/// Area of the loops that a model draws, over all recordings but those kept out.
fn area_of(session: &Session, model: &Model) -> f64 {
    let outputs = model.outputs(session, Run::is_worked_with);
    let signed: f64 = session
        .runs
        .iter()
        .zip(outputs)
        .map(|(run, output)| output.windows(2).zip(run.input.windows(2)).map(|(y, u)| 0.5 * (y[0] + y[1]) * (u[1] - u[0])).sum::<f64>())
        .sum();
    // Clockwise in time: the output lags behind, so less comes out on the way up than on the way down.
    -signed
}

/// Correlation of neighbouring residuals.
fn neighbour_correlation(session: &Session, residual: &[Vec<f64>]) -> f64 {
    let (mut square, mut product) = (1e-30, 0.0);
    for (run, residual) in session.runs.iter().zip(residual) {
        for (pair, keep) in residual.windows(2).zip(run.keep.windows(2)) {
            if keep[0] && keep[1] {
                square += pair[0] * pair[0];
                product += pair[0] * pair[1];
            }
        }
    }
    (product / square).clamp(0.0, 0.98)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::initial_state::InitialState;
    use crate::model::structure::Model;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;
    use recording::{Recording, Signal};
    use std::path::Path;

    const PERIOD_S: f64 = 0.02;
    /// Steps of the simulation in a sample.
    const STEPS: usize = 20;

    /// A delay, a lag and five plays at 1 kHz, sampled; then the area of its loop.
    fn rig(frequency_hz: f64, delay_s: f64, lag_s: f64) -> (Vec<f64>, Vec<f64>, f64) {
        let step_s = PERIOD_S / STEPS as f64;
        let command = |time_s: f64| {
            let time_s = (time_s - 1.0).max(0.0);
            (-0.08 * time_s).exp() * (0.5 - 0.5 * (std::f64::consts::TAU * frequency_hz * time_s).cos())
        };
        let plays = [(0.0, 0.5), (0.07, 0.2), (0.16, 0.2), (0.33, 0.15), (0.5, 0.1)];
        let (mut pressure, mut states) = (0.0, [0.0_f64; 5]);
        let (mut input, mut output) = (Vec::new(), Vec::new());
        for step in 0..800 * STEPS {
            let now_s = step as f64 * step_s;
            let late = command(now_s - delay_s);
            pressure = if lag_s > 0.0 { pressure + (1.0 - (-step_s / lag_s).exp()) * (late - pressure) } else { late };
            let mut sum = 0.0;
            for ((gap, weight), state) in plays.iter().zip(&mut states) {
                *state = state.clamp(pressure - gap, pressure + gap);
                sum += weight * *state;
            }
            if step % STEPS == 0 {
                input.push(command(now_s));
                output.push(sum);
            }
        }
        let area = output.windows(2).zip(input.windows(2)).map(|(y, u)| -0.5 * (y[0] + y[1]) * (u[1] - u[0])).sum();
        (input, output, area)
    }

    #[test]
    fn nine_of_ten_intervals_of_the_loop_area_hold_the_truth() {
        let (mut held, mut pseudo_measurements) = (0, 0);
        let mut misses = Vec::new();
        for (seed, (delay_s, lag_s)) in (520_u64..).zip([(0.08, 0.0), (0.0, 0.12), (0.06, 0.1), (0.03, 0.03), (0.15, 0.05), (0.0, 0.0)]) {
            let mut generator = ChaCha8Rng::seed_from_u64(seed);
            let frequencies = [0.2, 0.35, 0.5, 0.65, 0.8, 0.95];
            let area = |delay_s: f64, lag_s: f64| frequencies.iter().map(|&hz| rig(hz, delay_s, lag_s).2).sum::<f64>();
            let whole = area(delay_s, lag_s);
            let truth = [(whole - area(0.0, lag_s)) / whole, (area(0.0, lag_s) - area(0.0, 0.0)) / whole, area(0.0, 0.0) / whole];
            let recordings: Vec<Recording> = frequencies
                .iter()
                .map(|&hz| {
                    let (input, mut output, _) = rig(hz, delay_s, lag_s);
                    for value in &mut output {
                        // Twelve even deviates less six: a normal one. Half a percent of the range.
                        *value += 0.005 * ((0..12).map(|_| generator.random::<f64>()).sum::<f64>() - 6.0);
                    }
                    let time_s = (0..input.len()).map(|sample| sample as f64 * PERIOD_S).collect();
                    Recording::new(Path::new("run.csv"), Signal::pressure_bar(), Signal::displacement_mm(), time_s, input, output)
                        .expect("a recording")
                })
                .collect();
            let session = Session::new(&recordings, &recordings[..1]).expect("a session");
            let mut baseline = Model::baseline(InitialState::Fresh, false);
            baseline.fit_all(&session);
            let found = loop_area(&session, &baseline, 1).expect("loops");
            for (share, truth) in [found.dead_time, found.lag, found.hysteresis].into_iter().zip(truth) {
                pseudo_measurements += 1;
                // A share is told to a percent.
                if (share.low - 0.01..=share.high + 0.01).contains(&truth) {
                    held += 1;
                } else {
                    misses.push((delay_s, lag_s, truth, share));
                }
                assert!(share.high - share.low < 0.35, "an interval that says nothing: {share:?} of {delay_s} s and {lag_s} s");
            }
        }
        assert!(10 * held >= 9 * pseudo_measurements, "{held} of {pseudo_measurements}: {misses:?}");
    }
}
