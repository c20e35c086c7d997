//! Tracking: a displacement goes in, the tip follows.
//!
//! ```text
//! reference ─► + ─► feed-forward (linear, PI inverse, physics inverse, learned inverse) ─► + ─► demand
//!              ▲ correction, mm                                                            ▲ transfer, bar
//!   error ─► PID (one step a window)                                     what makes a change of law no jump
//!     ▲
//! reference of the last window less laser, estimate, or observer, each the mean over the same window
//! ```
//!
//! Terms. The **feed-forward** turns a wanted displacement into a pressure; which one is a setting, and one that cannot work at the moment
//! hands over to the next simpler one. The **sensor** of the feedback is a setting too; without its signal the correction stays as it
//! is. The **transfer** is the difference between the last demand and the first one after any change, and fades away.

use core::num::NonZeroU16;

use model_export::link::fault::{Notice, NoticeSet};
use model_export::link::message::{ControlReport, Refusal};

use super::compensator::CompensatorState;
use super::law::{Accepted, ControlInputs, ControlLaw, ControlOutput, Demand, SetPoint};
use super::observer::{Blend, ObserverConfig, ObserverState};
use super::pid::{Pid, PidConfig, PidState};
use super::reference::{Reference, ReferenceState};

/// What turns a wanted displacement into a pressure.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FeedForward {
    /// Nothing: the correction alone, through the linear map.
    None,
    /// The linear map: open loop.
    Linear,
    /// The closed-form inverse of the Prandtl-Ishlinskii model.
    PrandtlIshlinskii,
    /// The inverse of the whole physics model.
    Physics,
    /// A network trained with input and output exchanged.
    Learned,
}

impl FeedForward {
    /// The feed-forward with this number in the settings.
    pub fn from_number(number: u32) -> Option<Self> {
        [Self::None, Self::Linear, Self::PrandtlIshlinskii, Self::Physics, Self::Learned].get(usize::try_from(number).ok()?).copied()
    }
}

/// What the feedback listens to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FeedbackSensor {
    /// Nothing: no feedback.
    None,
    /// The laser.
    Laser,
    /// The model's estimate.
    Estimate,
    /// Both, blended.
    Observer,
}

impl FeedbackSensor {
    /// The sensor with this number in the settings.
    pub fn from_number(number: u32) -> Option<Self> {
        [Self::None, Self::Laser, Self::Estimate, Self::Observer].get(usize::try_from(number).ok()?).copied()
    }
}

/// What to do outside of what the model was trained on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum OutsideDomain {
    /// Only say so.
    Tell,
    /// A learned feed-forward hands over to the physics, and the estimate is not listened to.
    FallBack,
    /// The demand stays as it is.
    Hold,
}

impl OutsideDomain {
    /// The action with this number in the settings.
    pub fn from_number(number: u32) -> Option<Self> {
        [Self::Tell, Self::FallBack, Self::Hold].get(usize::try_from(number).ok()?).copied()
    }
}

/// How to track.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TrackingConfig {
    /// Ticks of 1 ms from one point of the reference to the next.
    pub period_ms: NonZeroU16,
    /// The feed-forward.
    pub feed_forward: FeedForward,
    /// What the feedback listens to.
    pub sensor: FeedbackSensor,
    /// Slope of the linear map, mm/bar.
    pub linear_mm_per_bar: f32,
    /// Displacement of the linear map at zero pressure, mm.
    pub linear_offset_mm: f32,
    /// How far a learned inverse looks ahead, ms.
    pub learned_look_ahead_ms: u16,
    /// The feedback.
    pub pid: PidConfig,
    /// The observer.
    pub observer: ObserverConfig,
    /// Time constant with which a transfer fades, s.
    pub transfer_s: f32,
    /// What to do outside of what the model was trained on.
    pub outside_domain: OutsideDomain,
    /// Whether the estimate is the compensator's modelled actuator instead of the model's.
    pub estimate_by_physics: bool,
}

/// Tracking, ready to run.
#[derive(Clone, Debug, PartialEq)]
pub struct Tracking {
    reference: Reference,
    feed_forward: FeedForward,
    sensor: FeedbackSensor,
    bar_per_mm: f32,
    linear_offset_mm: f32,
    learned_look_ahead_ms: u16,
    pid: Pid,
    observer: ObserverConfig,
    transfer_keep: f32,
    outside_domain: OutsideDomain,
    estimate_by_physics: bool,
}

/// The memory of [`Tracking`].
#[derive(Clone, Debug, Default)]
pub struct TrackingState {
    reference: ReferenceState,
    compensator: CompensatorState,
    pid: PidState,
    observer: ObserverState,
    blend: Option<Blend>,
    /// What stands in for the laser: the mean over the window that ended last.
    estimate_mm: Option<f32>,
    /// The same before adaptation.
    raw_estimate_mm: Option<f32>,
    /// Sum of the reference over the ticks of the window so far.
    window_sum_mm: f32,
    window_ticks: u16,
    learned_wanted_mm: f32,
    in_use: Option<FeedForward>,
    demand_bar: f32,
    transfer_bar: f32,
    report: ControlReport,
}

impl TrackingConfig {
    /// Builds the law.
    pub fn build(&self) -> Tracking {
        Tracking {
            reference: Reference::new(self.period_ms),
            feed_forward: self.feed_forward,
            sensor: self.sensor,
            bar_per_mm: 1.0 / self.linear_mm_per_bar,
            linear_offset_mm: self.linear_offset_mm,
            learned_look_ahead_ms: self.learned_look_ahead_ms,
            pid: self.pid,
            observer: self.observer,
            transfer_keep: 1.0 - 0.001 / (0.001 + self.transfer_s),
            outside_domain: self.outside_domain,
            estimate_by_physics: self.estimate_by_physics,
        }
    }
}

impl TrackingState {
    /// The points that were sent ahead.
    pub fn reference(&self) -> &ReferenceState {
        &self.reference
    }

    /// Forgets everything, in place.
    pub fn clear(&mut self) {
        self.reference.clear();
        self.compensator.clear();
        (self.pid, self.observer) = (PidState::default(), ObserverState::default());
        (self.blend, self.estimate_mm, self.raw_estimate_mm, self.in_use) = (None, None, None, None);
        (self.window_sum_mm, self.window_ticks, self.learned_wanted_mm) = (0.0, 0, 0.0);
        (self.demand_bar, self.transfer_bar) = (0.0, 0.0);
        self.report = ControlReport::default();
    }

    /// Forgets the points.
    pub fn clear_reference(&mut self) {
        self.reference.clear();
    }

    /// The displacement a learned inverse shall bring about, mm, corrected.
    pub fn learned_wanted_mm(&self) -> f32 {
        self.learned_wanted_mm
    }

    /// What stands in for the laser, mm.
    pub fn estimate_mm(&self) -> Option<f32> {
        self.estimate_mm
    }

    /// The same before adaptation, mm.
    pub fn raw_estimate_mm(&self) -> Option<f32> {
        self.raw_estimate_mm
    }

    /// What the controllers did since the start.
    pub fn report(&self) -> &ControlReport {
        &self.report
    }
}

impl Tracking {
    /// Whether the estimate is that of the compensation's physics.
    pub fn estimates_by_physics(&self) -> bool {
        self.estimate_by_physics
    }

    /// Whether the model in use is asked for pressures.
    pub fn uses_learned_inverse(&self) -> bool {
        self.feed_forward == FeedForward::Learned
    }

    /// Whether the law needs the parameters of the actuator.
    pub fn needs_compensator(&self) -> bool {
        let listens = matches!(self.sensor, FeedbackSensor::Estimate | FeedbackSensor::Observer);
        (self.estimate_by_physics && listens) || matches!(self.feed_forward, FeedForward::PrandtlIshlinskii | FeedForward::Physics)
    }

    /// Keeps the modelled actuator where the real one is; every tick, running or not, before [`ControlLaw::step`].
    ///
    /// # Deadline
    /// Two loops over the play operators.
    pub fn follow(&self, state: &mut TrackingState, inputs: &ControlInputs<'_>) {
        if let Some(compensator) = inputs.compensator {
            compensator.follow(&mut state.compensator, inputs.output_bar, inputs.window_begins);
        }
        if inputs.window_begins {
            state.raw_estimate_mm = self.estimate_mm(state, inputs);
            state.estimate_mm = match inputs.correction {
                Some(correction) => state.raw_estimate_mm.map(|raw_mm| correction.apply(raw_mm)),
                None => state.raw_estimate_mm,
            };
        }
    }

    /// The estimate that stands in for the laser, mm: the mean over the last window.
    fn estimate_mm(&self, state: &TrackingState, inputs: &ControlInputs<'_>) -> Option<f32> {
        if self.estimate_by_physics {
            return inputs.compensator.and_then(|compensator| compensator.modelled_mm(&state.compensator, inputs.window_s));
        }
        inputs.estimate_mm.filter(|_| !inputs.outside_domain || self.outside_domain == OutsideDomain::Tell)
    }

    /// The observer and the feedback, once a window.
    fn feed_back(&self, state: &mut TrackingState, inputs: &ControlInputs<'_>) -> NoticeSet {
        let mut notices = NoticeSet::EMPTY;
        let ticks = f32::from(state.window_ticks.max(1));
        let reference_mm = state.window_sum_mm / ticks;
        (state.window_sum_mm, state.window_ticks) = (0.0, 0);
        let estimate_mm = state.estimate_mm;
        // Without the laser means without it: what is blended then is the estimate alone.
        let laser_mm = inputs.window_displacement_mm.filter(|_| self.sensor != FeedbackSensor::Estimate);
        state.blend = self.observer.step(&mut state.observer, laser_mm, estimate_mm, inputs.window_s);
        let measured_mm = match self.sensor {
            FeedbackSensor::None => return notices,
            FeedbackSensor::Laser => laser_mm,
            FeedbackSensor::Estimate => estimate_mm,
            FeedbackSensor::Observer => state.blend.map(|blend| blend.displacement_mm),
        };
        match measured_mm {
            Some(measured_mm) => {
                let error_mm = reference_mm - measured_mm;
                self.pid.step(&mut state.pid, error_mm, inputs.window_s, inputs.limited);
            }
            None => {
                state.pid.hold();
                notices.insert(Notice::FeedbackMissing);
            }
        }
        notices
    }

    /// The feed-forward that can work now.
    fn usable(&self, inputs: &ControlInputs<'_>) -> FeedForward {
        let outside = inputs.outside_domain && self.outside_domain != OutsideDomain::Tell;
        let learned = self.feed_forward != FeedForward::Learned || (inputs.inverse_bar.is_some() && !outside);
        let wanted = if learned { self.feed_forward } else { FeedForward::Physics };
        let physics = matches!(wanted, FeedForward::PrandtlIshlinskii | FeedForward::Physics);
        if physics && inputs.compensator.is_none() { FeedForward::Linear } else { wanted }
    }

    /// The demand of a feed-forward for the reference with the correction on it, bar.
    fn pressure(&self, state: &mut TrackingState, feed_forward: FeedForward, inputs: &ControlInputs<'_>, here_mm: f32) -> f32 {
        let correction_mm = state.pid.correction_mm();
        let linear_bar = |wanted_mm: f32| (wanted_mm - self.linear_offset_mm) * self.bar_per_mm;
        match (feed_forward, inputs.compensator) {
            (FeedForward::None, _) => correction_mm * self.bar_per_mm,
            (FeedForward::PrandtlIshlinskii, Some(compensator)) => {
                compensator.plain_pressure(&mut state.compensator, here_mm + correction_mm)
            }
            (FeedForward::Physics, Some(compensator)) => {
                let ahead_mm = self.reference.ahead(&state.reference, compensator.look_ahead_ticks()).unwrap_or(here_mm);
                compensator.demand(&mut state.compensator, ahead_mm + correction_mm)
            }
            (FeedForward::Learned, _) => inputs.inverse_bar.unwrap_or(state.demand_bar),
            _ => linear_bar(here_mm + correction_mm),
        }
    }
}

impl ControlLaw for Tracking {
    type State = TrackingState;

    fn start(&self, state: &mut TrackingState, inputs: &ControlInputs<'_>) {
        state.reference.start();
        state.pid = PidState::default();
        state.in_use = None;
        state.demand_bar = inputs.output_bar;
        state.transfer_bar = 0.0;
        (state.window_sum_mm, state.window_ticks) = (0.0, 0);
        state.report = ControlReport::default();
        state.compensator.start(false);
    }

    fn accept(&self, state: &mut TrackingState, set_point: &SetPoint) -> Result<Accepted, Refusal> {
        self.reference.accept(&mut state.reference, set_point)
    }

    fn needs_model(&self) -> bool {
        let listens = matches!(self.sensor, FeedbackSensor::Estimate | FeedbackSensor::Observer);
        listens || self.needs_compensator() || self.uses_learned_inverse()
    }

    fn is_ready(&self, _state: &TrackingState) -> bool {
        // A live set-point comes after the start; until something comes the output stays.
        true
    }

    fn step(&self, state: &mut TrackingState, inputs: &ControlInputs<'_>) -> ControlOutput {
        let mut notices = NoticeSet::EMPTY;
        let progress = self.reference.step(&mut state.reference, inputs.window_begins);
        let Some(here_mm) = self.reference.ahead(&state.reference, 0) else {
            // Nothing to follow yet.
            let demand = Demand::Pressure(state.demand_bar);
            return ControlOutput { demand, set_point: 0.0, finished: progress.finished, notices };
        };
        notices.insert_if(progress.starved, Notice::PlaybackStarved);
        if inputs.window_begins && state.window_ticks > 0 {
            notices = notices.union(self.feed_back(state, inputs));
        }
        state.window_sum_mm += here_mm;
        state.window_ticks = state.window_ticks.saturating_add(1);
        let learned_mm = self.reference.ahead(&state.reference, self.learned_look_ahead_ms).unwrap_or(here_mm);
        state.learned_wanted_mm = learned_mm + state.pid.correction_mm();

        let feed_forward = self.usable(inputs);
        notices.insert_if(feed_forward != self.feed_forward, Notice::FeedForwardFallback);
        notices.insert_if(inputs.outside_domain, Notice::OutsideDomain);
        let changed = state.in_use != Some(feed_forward);
        if changed {
            state.compensator.start(state.report.ticks > 0);
        }
        let law_bar = self.pressure(state, feed_forward, inputs, here_mm);
        if changed {
            state.transfer_bar = state.demand_bar - law_bar;
            state.in_use = Some(feed_forward);
        }
        state.transfer_bar *= self.transfer_keep;
        let hold = inputs.outside_domain && self.outside_domain == OutsideDomain::Hold;
        let demand_bar = law_bar + state.transfer_bar;
        if hold {
            // What the law wants when it may go on is another demand: no jump then either.
            state.in_use = None;
        } else if demand_bar.is_finite() {
            state.demand_bar = demand_bar;
        }
        self.account(state, inputs, notices);
        ControlOutput { demand: Demand::Pressure(state.demand_bar), set_point: here_mm, finished: progress.finished, notices }
    }
}

impl Tracking {
    /// Keeps the counts for the host.
    fn account(&self, state: &mut TrackingState, inputs: &ControlInputs<'_>, notices: NoticeSet) {
        let report = &mut state.report;
        report.ticks = report.ticks.saturating_add(1);
        let count = |counter: &mut u32, happened: bool| *counter = counter.saturating_add(u32::from(happened));
        count(&mut report.limited_ticks, inputs.limited);
        count(&mut report.outside_domain_ticks, inputs.outside_domain);
        count(&mut report.fallback_ticks, notices.contains(Notice::FeedForwardFallback));
        report.correction_mm = state.pid.correction_mm();
        (report.blend_mm, report.bound_mm) = match state.blend {
            Some(blend) => (blend.displacement_mm, blend.bound_mm),
            None => (f32::NAN, f32::NAN),
        };
    }
}
