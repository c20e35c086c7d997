//! Gains of the feedback: the best in simulation among those that keep their margins for every actuator within the intervals of the fit.

use firmware::certificate::STEEPEST;
use firmware::control::{Actuator, Compensator, FeedForward, FeedbackSensor, ObserverConfig, OutsideDomain, PidConfig, TrackingConfig};
use serde::Serialize;

use super::fit::{FitError, Fitted};
use super::margins::{Margins, Plant, WANTED, WANTED_BESIDE_FEED_FORWARD, margins};
use super::simulate::{Limits, simulate};
use crate::control::reference::{PERIOD_S, Reach, tuning};

/// Delay of the inverse's smoothing, s: three means of twelve ticks, and one tick to the valve.
const SMOOTHING_S: f64 = 0.018;
/// Largest correction as a share of the reach.
const LIMIT_SHARE: f64 = 0.25;

/// Gains with what they promise.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Gains {
    /// Correction per error, mm/mm.
    pub proportional: f64,
    /// Correction rate per error, 1/s.
    pub integral_per_s: f64,
    /// Correction per error rate, s.
    pub derivative_s: f64,
    /// Time constant of the derivative's filter, s.
    pub derivative_filter_s: f64,
    /// Largest correction, mm.
    pub limit_mm: f64,
    /// Margins on the identified actuator.
    pub margins: Margins,
    /// Least margins over the intervals of its parameters.
    pub worst_margins: Margins,
    /// Tracking error in simulation, mm.
    pub simulated_rmse_mm: f64,
}

impl Gains {
    /// As the firmware takes them.
    #[must_use]
    pub fn pid(&self) -> PidConfig {
        PidConfig {
            proportional: self.proportional as f32,
            integral_per_s: self.integral_per_s as f32,
            derivative_s: self.derivative_s as f32,
            derivative_filter_s: self.derivative_filter_s as f32,
            limit_mm: self.limit_mm as f32,
        }
    }
}

/// The identified plants that the loop must stand: the best one first, then the corners of the intervals that cost margin.
fn plants(fitted: &Fitted, inverted: bool) -> Vec<Plant> {
    let value =
        |name: &str| fitted.parameters.iter().find(|(known, ..)| *known == name).map_or((0.0, 0.0), |(_, value, half)| (*value, *half));
    let weights: f64 = fitted.compensation.plays.iter().map(|[_, weight]| f64::from(*weight)).sum();
    let creep: f64 = fitted.compensation.creep.iter().map(|[_, gain]| f64::from(*gain)).sum();
    let steepest = weights * (1.0 + creep);
    let (fill, fill_half) = value("fill_time_constant_s");
    let (vent, vent_half) = value("vent_time_constant_s");
    let (second, second_half) = value("second_time_constant_s");
    let (dead, dead_half) = value("dead_time_s");
    // A window's mean is half a window late, and its hold another half.
    let sampled_s = PERIOD_S;
    // Behind an inverse a wrong model shows as a wrong gain: the spread of the slopes that a reversal can show.
    let (gain, lags_s, smoothing_s) =
        if inverted { (1.0, [0.0; 2], SMOOTHING_S) } else { (steepest / fitted.line.0, [fill.max(vent), second], 0.0) };
    let best = Plant { gain, delay_s: dead + sampled_s + smoothing_s, lags_s };
    let half = fill_half.max(vent_half);
    let mut all = vec![best];
    for sign in [-1.0, 1.0] {
        let lags_s = if inverted { lags_s } else { [(lags_s[0] + sign * half).max(0.0), (lags_s[1] + sign * second_half).max(0.0)] };
        // Inverted lags that are longer than thought are a lag, shorter ones a lead; the former costs margin.
        let lag_error_s = if inverted { half + second_half } else { 0.0 };
        let steeper = if inverted { f64::from(STEEPEST) } else { 1.05 };
        all.push(Plant { gain: gain * steeper, delay_s: best.delay_s + dead_half + lag_error_s, lags_s });
    }
    all
}

/// Longest delay, s, from a correction in front of the inverse of the physics to the estimate, over the intervals of the fit.
#[must_use]
pub fn longest_delay_s(fitted: &Fitted) -> f64 {
    plants(fitted, true).iter().map(|plant| plant.delay_s).fold(0.0, f64::max)
}

/// Proportional, integral and derivative gains that are tried.
fn grid() -> impl Iterator<Item = (f64, f64, f64)> {
    [0.0, 0.1, 0.2, 0.35, 0.5, 0.7, 0.9, 1.2].into_iter().flat_map(|proportional| {
        [0.5, 1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 6.5, 8.0, 10.0].into_iter().flat_map(move |integral_per_s| {
            [0.0, 0.02, 0.05].into_iter().map(move |derivative_s| (proportional, integral_per_s, derivative_s))
        })
    })
}

/// What the loop is built of.
pub struct Bench<'a> {
    /// The identified actuator.
    pub fitted: &'a Fitted,
    /// Where references lie.
    pub reach: Reach,
    /// The limiter.
    pub limits: Limits,
}

impl Bench<'_> {
    /// A law for simulation.
    #[must_use]
    pub fn law(&self, feed_forward: FeedForward, pid: PidConfig) -> TrackingConfig {
        TrackingConfig {
            period_ms: core::num::NonZeroU16::MIN.saturating_add((PERIOD_S * 1000.0) as u16 - 1),
            feed_forward,
            sensor: if pid == PidConfig::default() { FeedbackSensor::None } else { FeedbackSensor::Laser },
            linear_mm_per_bar: self.fitted.line.0 as f32,
            linear_offset_mm: self.fitted.line.1 as f32,
            learned_look_ahead_ms: 0,
            pid,
            observer: ObserverConfig { time_constant_s: 0.3, estimate_bound_mm: 1.0, widening_mm_per_s: 0.01 },
            transfer_s: 0.2,
            outside_domain: OutsideDomain::FallBack,
            estimate_by_physics: true,
        }
    }

    /// The best gains on top of a feed-forward; `watch` hears how many are simulated, and of how many.
    ///
    /// # Errors
    /// When the actuator cannot be inverted.
    pub fn gains(&self, feed_forward: FeedForward, seed: u64, watch: &dyn Fn(usize, usize)) -> Result<Gains, FitError> {
        let invalid = |invalid: model_export::validate::Invalid| FitError::Parameters(invalid.to_string());
        let compensator = Compensator::new(self.fitted.compensation.clone()).map_err(invalid)?;
        let plant = Actuator::new(self.fitted.compensation.clone()).map_err(invalid)?;
        let inverted = feed_forward == FeedForward::Physics;
        let plants = plants(self.fitted, inverted);
        let reference = tuning(self.reach, seed);
        let limit_mm = match feed_forward {
            // Without a feed-forward the correction is everything.
            FeedForward::None => 2.0 * self.reach.high_mm.abs().max(self.reach.high_mm - self.reach.low_mm),
            _ => LIMIT_SHARE * (self.reach.high_mm - self.reach.low_mm),
        };
        let wanted = if feed_forward == FeedForward::None { &WANTED } else { &WANTED_BESIDE_FEED_FORWARD };
        let of_gains = |(proportional, integral_per_s, derivative_s)| {
            let gains = Gains {
                proportional,
                integral_per_s,
                derivative_s,
                derivative_filter_s: 0.04,
                limit_mm,
                margins: WANTED,
                worst_margins: WANTED,
                simulated_rmse_mm: f64::INFINITY,
            };
            let each: Vec<Margins> = plants.iter().map(|plant| margins(&gains.pid(), plant)).collect();
            let worst_margins = each.iter().copied().reduce(Margins::worse).unwrap_or(WANTED);
            worst_margins.reach(wanted).then_some(Gains { margins: each[0], worst_margins, ..gains })
        };
        let candidates: Vec<Gains> = grid().filter_map(of_gains).collect();
        let mut best: Option<Gains> = None;
        for (index, candidate) in candidates.iter().enumerate() {
            watch(index, candidates.len());
            // On an exact model the feed-forward leaves nothing to feed back: there the fastest integral that keeps its margins
            // rejects disturbances best, and simulation only breaks ties.
            let law = self.law(feed_forward, candidate.pid()).build();
            let figures = simulate(&law, &compensator, &plant, self.limits, &reference.points_mm);
            let gains = Gains { simulated_rmse_mm: figures.rmse_mm, ..*candidate };
            let better = |than: &Gains| match feed_forward {
                FeedForward::None => gains.simulated_rmse_mm < than.simulated_rmse_mm,
                _ => {
                    (gains.integral_per_s, -gains.proportional - gains.derivative_s)
                        > (than.integral_per_s, -than.proportional - than.derivative_s)
                }
            };
            if best.as_ref().is_none_or(better) {
                best = Some(gains);
            }
        }
        best.ok_or_else(|| FitError::Parameters("no gains keep the margins; the dead time may be too long for feedback".to_owned()))
    }
}
