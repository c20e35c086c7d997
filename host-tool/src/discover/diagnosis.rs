//! What kind of disagreement it is: whether the residual is white, what it goes with, and what opens the loop.
//!
//! A loop of output over input opens for three reasons that look alike: transport delay, lag and true hysteresis. Only the last is still
//! there when everything is done slowly. [`loop_area`] fits delay and lag beside the play operators and asks how much area each adds.

use serde::Serialize;

use super::catalogue::Form;
use super::model::{Model, Scope};
use super::session::{Role, Session};
use super::{effects, search, tail};

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
    let count: f64 = session.runs.iter().map(|run| run.keep.iter().filter(|keep| **keep).count() as f64).sum();
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
        for (value, _) in values.iter().zip(&run.keep).filter(|(_, keep)| **keep) {
            sum += value;
            count += 1.0;
        }
    }
    let mean = sum / count.max(1.0);
    for (run, values) in session.runs.iter().zip(&mut signal) {
        for (value, keep) in values.iter_mut().zip(&run.keep) {
            *value = if *keep { *value - mean } else { 0.0 };
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
pub fn loop_area(session: &Session, baseline: &Model) -> Option<LoopArea> {
    let (delay, lag): (&'static dyn Form, &'static dyn Form) =
        (*effects::dead_time::FORMS.first()?, *effects::pneumatic_lag::FORMS.first()?);
    if !baseline.slots.is_empty() {
        return None;
    }
    // Delay and lag stand in for each other: begin once with each alone, and keep what ends better.
    let residual = baseline.residuals(session);
    let alone = |form: &'static dyn Form, other: &'static dyn Form| {
        let with_one = search::fit_form(baseline, form, session, &residual)?.model;
        let mut both = search::polish(&with_one.with(other, vec![0.01]), session, 25).model;
        let (fit, _) = both.fit(session, Scope::Fit);
        Some((fit, both))
    };
    let (first, second) = (alone(delay, lag)?, alone(lag, delay)?);
    let fitted = if first.0 <= second.0 { first.1 } else { second.1 };
    let place = |name: &str| fitted.slots.iter().position(|slot| slot.form.name() == name);
    let (delay_at, lag_at) = (place(delay.name())?, place(lag.name())?);
    let residual = fitted.residuals(session);
    let deviations = search::parameter_deviations(&fitted, session, super::neighbour_correlation(session, &residual));
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
    let reach = |value: f64, deviation: f64| ((value - 1.96 * deviation).max(0.0), value + 1.96 * deviation);
    let (delay_low, delay_high) = reach(delay_s, deviations[delay_at]);
    let (lag_low, lag_high) = reach(lag_s, deviations[lag_at]);
    let (value, low, high) = (parts(delay_s, lag_s), parts(delay_low, lag_low), parts(delay_high, lag_high));
    let share = |value: f64, low: f64, high: f64| Share { value, low: low.min(value), high: high.max(value) };
    let rest = |parts: (f64, f64)| (1.0 - parts.0 - parts.1).clamp(0.0, 1.0);
    Some(LoopArea {
        dead_time: share(value.0, low.0, high.0),
        lag: share(value.1, low.1, high.1),
        hysteresis: share(rest(value), rest(high), rest(low)),
        dead_time_s: delay_s,
        lag_s,
    })
}

/// Area of the loops that a model draws, over the recordings that are fitted.
fn area_of(session: &Session, model: &Model) -> f64 {
    let runs = session.runs.iter().filter(|run| run.role.contains(&Role::Fit));
    let signed: f64 = runs
        .map(|run| {
            let output = model.predict(run);
            output.windows(2).zip(run.input.windows(2)).map(|(y, u)| 0.5 * (y[0] + y[1]) * (u[1] - u[0])).sum::<f64>()
        })
        .sum();
    // Clockwise in time: the output lags behind, so less comes out on the way up than on the way down.
    -signed
}
