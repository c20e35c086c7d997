//! The certificate of adaptation: that the feedback loop stays stable whatever adaptation does within its limits.
//!
//! # What is assumed
//!
//! The feedback loop is the linearised one that `catheter tune` keeps margins for: beside the inverse of the physics the raw estimate follows
//! the correction `c` after a delay, with an incremental gain `kappa` between `1 / STEEPEST` and [`STEEPEST`]; whatever else moves it is a bounded
//! disturbance `w`. Time `k` counts windows of [`WINDOW_MS`], `d` is the delay in windows, `C` the PID of [`crate::control::PidConfig`] as it runs:
//!
//! ```text
//! x_k = kappa c_(k-d) + w_k        c = C (r - x - Delta_k x - zero_k)        |Delta_k| <= delta, |zero_k| <= Z
//! ```
//!
//! `x` is the raw estimate's distance from the pivot, `Delta_k` the gain error and `zero_k` the zero at time `k`.
//!
//! # Theorem
//!
//! Let `T` be the loop's complementary sensitivity without adaptation and `|T|` the sum of the magnitudes of its impulse response. If the loop without
//! adaptation is stable and `q = f delta |T| < 1`, then for *every* sequence of gain errors and zeros within the limits
//!
//! ```text
//! sup |x| <= (sup |x without adaptation| + |T| Z) / (1 - q)
//! ```
//!
//! with `f = 1` for feedback on the estimate and `f = 2` for laser and estimate blended.
//!
//! *Proof.* By linearity `x = x_0 - T (Delta x + zero)` with `x_0` the signal without adaptation. Over any finite time the largest magnitude of
//! `T u` is at most `|T|` times that of `u`, so `sup |x| <= sup |x_0| + |T| (delta sup |x| + Z)`; solve for `sup |x|`, which is finite over a finite time. It is the
//! small-gain theorem with the induced norm of bounded sequences. The blend adds to the estimate an offset that is a convex combination of past
//! differences of laser and estimate, also when the laser comes and goes: what `Delta x` adds to the blend is at most `2 delta sup |x|`. ∎
//!
//! The sequence may depend on everything, so the way from the laser through the filter to zero and gain, which closes a second and nonlinear loop,
//! needs no analysis of its own. The limits hold for every input ([`super`]), hence so does this.
//!
//! # What is asked for
//!
//! Each condition has a number and a text in [`AdaptationCondition`]; the first that fails is named.
//!
//! 1. The span lies within the laser's range: what is learned from is measured there.
//! 2. `Z + delta / 2 <= FARTHEST_SHARE`: within the span the adapted estimate stays that near to the raw one, in spans.
//! 3. Feedback on the estimate stands beside the inverse of the physics, which undoes the lags.
//! 4. The loop without adaptation is proven stable, for both extreme incremental gains.
//! 5. `q <= LARGEST_GAIN`.
//! 6. The time constant is at least [`SLOWER`] times what the loop takes to settle, so that a set-point has settled before zero or gain have moved by
//!    a tenth of their limits. The theorem does not need it; it keeps transients of the loop from being learned.
//!
//! Without feedback on the estimate only the first two are asked for: nothing of the loop depends on adaptation then.
//!
//! # How `|T|` is bounded
//!
//! The loop is run for `N` windows from each unit vector of its state. With `rho` the largest row sum of magnitudes after that time, `rho < 1` proves that
//! it is stable, and what an impulse response still adds after `N` windows is at most the largest entry of its state times the sum of all these
//! outputs' magnitudes over `1 - rho`. `N` is doubled until `rho` is small.
//!
//! Sources: G. Zames, "On the input-output stability of time-varying nonlinear feedback systems", parts I and II, IEEE Trans. Automatic Control 11,
//! 1966; C. A. Desoer, M. Vidyasagar, *Feedback Systems: Input-Output Properties*, Academic Press 1975, chapter III; the norm of impulse responses:
//! M. A. Dahleh, I. J. Diaz-Bobillo, *Control of Uncertain Systems: A Linear Programming Approach*, Prentice Hall 1995, chapter 2.

use model_export::link::fault::AdaptationCondition;

use crate::adaptation::AdaptationConfig;
use crate::control::PidConfig;

/// Window that the certificate is computed for, ms; arming is refused with a model of another period.
pub const WINDOW_MS: u16 = 20;
/// The same in s.
const WINDOW_S: f32 = 0.02;
/// Largest incremental gain from correction to estimate beside an inverse of the physics: what `catheter tune` keeps its margins for.
pub const STEEPEST: f32 = 1.15;
/// Farthest that limits may let the adapted estimate be from the raw one within the span, spans.
pub const FARTHEST_SHARE: f32 = 0.3;
/// Largest `q` of the theorem: at most five times the signals without adaptation.
pub const LARGEST_GAIN: f32 = 0.8;
/// Time constant of adaptation over the settling time of the loop, at least.
pub const SLOWER: f32 = 10.0;

/// Corrections that are on their way: the longest delay of the setting in windows, and two for the fraction.
const MAX_PAST: usize = 32;
/// Windows that the loop is run for at first, and at most.
const WINDOWS: [u16; 5] = [512, 1024, 2048, 4096, 8192];
/// Small enough a remainder to stop there.
const SMALL: f32 = 0.1;
/// Share of the impulse response's magnitudes after which the loop has settled.
const SETTLED: f32 = 0.95;

/// Feedback that listens to the estimate.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ClosedLoop {
    /// The feedback.
    pub pid: PidConfig,
    /// Delay from correction to estimate, ms, at least a window and at most 600.
    pub delay_ms: u16,
    /// Laser and estimate blended instead of the estimate alone.
    pub blends: bool,
    /// The feed-forward is the inverse of the physics.
    pub lags_inverted: bool,
}

/// What is certified.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Certificate {
    /// Farthest that the adapted estimate can be from the raw one within the span, spans.
    pub farthest_share: f32,
    /// Sum of the magnitudes of the complementary sensitivity's impulse response, from above; zero without feedback on the estimate.
    pub peak: f32,
    /// `q` of the theorem.
    pub gain: f32,
    /// What the loop takes to settle, s.
    pub settling_s: f32,
}

/// Examines settings; `closed` is absent when no feedback listens to the estimate.
///
/// # Errors
/// The first condition that fails.
///
/// # Deadline
/// Not for the tick: some million operations.
pub fn certify(config: &AdaptationConfig, closed: Option<&ClosedLoop>) -> Result<Certificate, AdaptationCondition> {
    let require = |holds: bool, condition| if holds { Ok(()) } else { Err(condition) };
    let half_mm = 0.5 * config.span_mm;
    let [low_mm, high_mm] = config.laser_mm;
    let inside = config.pivot_mm - half_mm >= low_mm && config.pivot_mm + half_mm <= high_mm;
    require(inside, AdaptationCondition::SpanWithinLaser)?;
    let delta = config.farthest_gain();
    let farthest_share = config.zero_limit + 0.5 * delta;
    require(farthest_share <= FARTHEST_SHARE, AdaptationCondition::NearTheRaw)?;
    let Some(closed) = closed else { return Ok(Certificate { farthest_share, peak: 0.0, gain: 0.0, settling_s: 0.0 }) };
    require(closed.lags_inverted, AdaptationCondition::LagsInverted)?;
    let (mut peak, mut settling_s) = (0.0f32, 0.0f32);
    for kappa in [STEEPEST, 1.0 / STEEPEST] {
        let response = Linear::new(closed, kappa).response().ok_or(AdaptationCondition::LoopContracts)?;
        peak = peak.max(response.peak);
        settling_s = settling_s.max(response.settling_s);
    }
    let gain = if closed.blends { 2.0 } else { 1.0 } * delta * peak;
    require(gain <= LARGEST_GAIN, AdaptationCondition::LoopMargin)?;
    require(config.time_constant_s >= SLOWER * settling_s, AdaptationCondition::SlowerThanLoop)?;
    Ok(Certificate { farthest_share, peak, gain, settling_s })
}

/// The loop without adaptation, linear.
struct Linear {
    pid: PidConfig,
    kappa: f32,
    /// Whole windows of the delay, and the rest.
    delay: usize,
    fraction: f32,
}

/// Its state: corrections on their way, the newest first, the integral, and the filter of the derivative.
#[derive(Clone)]
struct State {
    past: [f32; MAX_PAST],
    integral: f32,
    filtered: f32,
}

/// What is known of `T`.
struct Response {
    peak: f32,
    settling_s: f32,
}

impl State {
    const ZERO: Self = Self { past: [0.0; MAX_PAST], integral: 0.0, filtered: 0.0 };
}

impl Linear {
    fn new(closed: &ClosedLoop, kappa: f32) -> Self {
        let delay = usize::from(closed.delay_ms / WINDOW_MS).clamp(1, MAX_PAST - 2);
        Self { pid: closed.pid, kappa, delay, fraction: f32::from(closed.delay_ms % WINDOW_MS) / f32::from(WINDOW_MS) }
    }

    /// One window: the estimate for the reference.
    fn step(&self, state: &mut State, reference: f32) -> f32 {
        // The correction of `delay` windows ago stands at `delay - 1`: this window's is not there yet.
        let ago = |windows: usize| state.past.get(windows.wrapping_sub(1)).copied().unwrap_or(0.0);
        let estimate = self.kappa * ((1.0 - self.fraction) * ago(self.delay) + self.fraction * ago(self.delay + 1));
        let error = reference - estimate;
        state.integral += self.pid.integral_per_s * WINDOW_S * error;
        let share = WINDOW_S / (WINDOW_S + self.pid.derivative_filter_s);
        let change = share * (error - state.filtered);
        state.filtered += change;
        let correction = self.pid.proportional * error + state.integral + self.pid.derivative_s / WINDOW_S * change;
        state.past.rotate_right(1);
        if let Some(newest) = state.past.first_mut() {
            *newest = correction;
        }
        estimate
    }

    /// Bounds `T`; `None` when the loop is not proven stable.
    fn response(&self) -> Option<Response> {
        WINDOWS.iter().find_map(|windows| self.response_within(*windows))
    }

    fn response_within(&self, windows: u16) -> Option<Response> {
        // From each unit vector: rows of magnitudes after all windows, and all outputs on the way.
        let mut rows = State::ZERO;
        let mut outputs = 0.0f32;
        let mut run = |mut state: State| {
            for _ in 0..windows {
                outputs += self.step(&mut state, 0.0).abs();
            }
            rows.past.iter_mut().zip(&state.past).for_each(|(row, entry)| *row += entry.abs());
            rows.integral += state.integral.abs();
            rows.filtered += state.filtered.abs();
        };
        for place in 0..self.delay + 1 {
            let mut state = State::ZERO;
            if let Some(entry) = state.past.get_mut(place) {
                *entry = 1.0;
                run(state);
            }
        }
        // What nothing feeds stays as it is for ever, and is zero.
        if self.pid.integral_per_s != 0.0 {
            run(State { integral: 1.0, ..State::ZERO });
        }
        if self.pid.derivative_s != 0.0 {
            run(State { filtered: 1.0, ..State::ZERO });
        }
        let rho = self.largest(&rows);
        // What is no number is infinite here, hence not small.
        if rho >= SMALL {
            return None;
        }
        let mut state = State::ZERO;
        let sum = |state: &mut State, until: f32| {
            let (mut sum, mut passed) = (0.0f32, 0u16);
            while passed < windows && sum < until {
                sum += self.step(state, if passed == 0 { 1.0 } else { 0.0 }).abs();
                passed += 1;
            }
            (sum, passed)
        };
        let (so_far, _) = sum(&mut state, f32::INFINITY);
        let peak = so_far + self.largest(&state) * outputs / (1.0 - rho);
        let mut again = State::ZERO;
        let (_, settled) = sum(&mut again, SETTLED * peak);
        Some(Response { peak, settling_s: f32::from(settled) * WINDOW_S })
    }

    /// Largest magnitude of a state that the loop can reach.
    fn largest(&self, state: &State) -> f32 {
        let integral = if self.pid.integral_per_s == 0.0 { 0.0 } else { state.integral };
        let filtered = if self.pid.derivative_s == 0.0 { 0.0 } else { state.filtered };
        let entries = state.past.iter().take(self.delay + 1).copied().chain([integral, filtered]);
        // Not `max`, in which a number that is none gets lost.
        entries.fold(0.0, |largest, entry| {
            if entry.abs() <= largest {
                largest
            } else if entry.is_nan() {
                f32::INFINITY
            } else {
                entry.abs()
            }
        })
    }
}

#[cfg(test)]
mod tests {
    extern crate std;
    use std::vec::Vec;

    use proptest::prelude::*;

    use super::*;

    const CONFIG: AdaptationConfig = crate::adaptation::TEST_CONFIG;

    fn closed(proportional: f32, integral_per_s: f32, delay_ms: u16) -> ClosedLoop {
        let pid = PidConfig { proportional, integral_per_s, derivative_filter_s: 0.04, limit_mm: 5.0, ..PidConfig::default() };
        ClosedLoop { pid, delay_ms, blends: false, lags_inverted: true }
    }

    #[test]
    fn a_slow_integral_never_overshoots_so_its_peak_is_one_and_a_fast_one_is_refused() {
        // Without overshoot the impulse response has one sign and adds up to one: up to 1 / e = 0.37 of gain times delay.
        let response = Linear::new(&closed(0.0, 2.0, 100), 1.0).response().unwrap();
        assert!((response.peak - 1.0).abs() < 2e-3, "{}", response.peak);
        // e^(-2 t) has settled to 5 % after 1.5 s, and the delay speeds the end up.
        assert!((0.8..1.8).contains(&response.settling_s), "{}", response.settling_s);
        let lively = Linear::new(&closed(0.0, 8.0, 100), 1.0).response().unwrap();
        assert!(lively.peak > 1.5 && lively.peak.is_finite(), "{}", lively.peak);
        // x_k = x_(k-1) - a x_(k-5) is stable up to a = 2 cos(4 pi / 9) = 0.347, which is 17.4 in 20 ms.
        assert!(Linear::new(&closed(0.0, 18.0, 100), 1.0).response().is_none());
        assert!(Linear::new(&closed(0.0, f32::NAN, 100), 1.0).response().is_none());
    }

    #[test]
    fn each_condition_is_named_when_it_is_the_first_that_fails() {
        let good = closed(0.0, 3.0, 100);
        let certificate = certify(&CONFIG, Some(&good)).unwrap();
        assert!(certificate.peak > 0.9999 && certificate.gain < 0.5 && certificate.settling_s > 0.1, "{certificate:?}");
        assert_eq!(certify(&CONFIG, None).map(|certificate| certificate.gain), Ok(0.0));
        let refused = |config: AdaptationConfig, closed: ClosedLoop| certify(&config, Some(&closed)).unwrap_err();
        use AdaptationCondition::*;
        assert_eq!(refused(AdaptationConfig { pivot_mm: 4.9, ..CONFIG }, good), SpanWithinLaser);
        assert_eq!(refused(AdaptationConfig { zero_limit: 0.25, ..CONFIG }, good), NearTheRaw);
        assert_eq!(refused(CONFIG, ClosedLoop { lags_inverted: false, ..good }), LagsInverted);
        assert_eq!(refused(CONFIG, closed(0.0, 20.0, 100)), LoopContracts);
        assert_eq!(refused(CONFIG, closed(0.0, 12.0, 100)), LoopMargin);
        assert_eq!(refused(AdaptationConfig { time_constant_s: 10.0, ..CONFIG }, closed(0.0, 1.0, 100)), SlowerThanLoop);
        // Blending doubles what adaptation does to the loop.
        let lively = closed(0.0, 11.5, 100);
        let narrow = AdaptationConfig { gain_minimum: 0.9, gain_maximum: 1.1, ..CONFIG };
        assert!(certify(&narrow, Some(&lively)).is_ok());
        assert_eq!(refused(narrow, ClosedLoop { blends: true, ..lively }), LoopMargin);
    }

    /// What the theorem promises, on a loop with gains that an adversary draws.
    fn worst_against_promise(closed: &ClosedLoop, delta: f32, zero: f32, kappa: f32, draws: &[(bool, bool)]) -> (f32, f32) {
        let linear = Linear::new(closed, kappa);
        let peak = linear.response().unwrap().peak;
        let mut state = State::ZERO;
        let (mut quiet, mut largest, mut alone) = (State::ZERO, 0.0f32, 0.0f32);
        let mut feedback = 0.0;
        for (step, (gain_up, zero_up)) in draws.iter().enumerate() {
            let reference = if (step / 60) % 2 == 0 { 1.0 } else { -1.0 };
            alone = alone.max(linear.step(&mut quiet, reference).abs());
            // The estimate of this window is known before the error is made of it.
            let seen = linear.step(&mut state.clone(), reference - feedback);
            feedback = if *gain_up { delta } else { -delta } * seen + if *zero_up { zero } else { -zero };
            largest = largest.max(linear.step(&mut state, reference - feedback).abs());
        }
        (largest, (alone + peak * zero) / (1.0 - delta * peak))
    }

    proptest! {
        #[test]
        fn no_sequence_of_gains_and_zeros_breaks_the_promise(
            integral in 0.5f32..7.0,
            proportional in 0.0f32..0.3,
            delay_ms in 40u16..140,
            draws in prop::collection::vec((any::<bool>(), any::<bool>()), 600),
        ) {
            let closed = closed(proportional, integral, delay_ms);
            let config = AdaptationConfig { time_constant_s: 600.0, ..CONFIG };
            prop_assume!(certify(&config, Some(&closed)).is_ok());
            for kappa in [STEEPEST, 1.0 / STEEPEST] {
                let (largest, promise) = worst_against_promise(&closed, config.farthest_gain(), config.zero_limit, kappa, &draws);
                // Rounding of some hundred f32 operations.
                prop_assert!(largest <= promise * 1.001, "{} above {}", largest, promise);
            }
        }

        #[test]
        fn the_bound_is_not_below_the_impulse_response_of_a_much_longer_run(integral in 0.3f32..8.0, delay_ms in 20u16..200) {
            let linear = Linear::new(&closed(0.1, integral, delay_ms), STEEPEST);
            let Some(response) = linear.response() else { return Ok(()) };
            let mut state = State::ZERO;
            let magnitudes: Vec<f32> = (0..50_000).map(|step| linear.step(&mut state, if step == 0 { 1.0 } else { 0.0 }).abs()).collect();
            let sum: f64 = magnitudes.iter().map(|magnitude| f64::from(*magnitude)).sum();
            prop_assert!(f64::from(response.peak) > sum * 0.9999, "{} below {}", response.peak, sum);
        }
    }
}
