//! The control laws against a simulated actuator: what a user may require of them.

extern crate std;

use core::num::NonZeroU16;
use std::vec::Vec;

use hysteresis::PrandtlIshlinskii;
use model_export::compensation::Compensation;
use model_export::link::fault::{Notice, NoticeSet};
use model_export::link::message::{PlaybackChunk, Quantity, Refusal};

use super::*;

/// A muscle with 4 mm/bar, a quarter of it hysteretic, behind 20 ms of dead time and two lags.
fn parameters() -> Compensation {
    let (thresholds_bar, weights) = ([0.0, 0.1, 0.2, 0.4], [2.5, 0.5, 0.5, 0.5]);
    let inverse = PrandtlIshlinskii::<f32, 4>::new(&thresholds_bar, &weights).unwrap().inverse().unwrap();
    let pairs =
        |thresholds: &[f32], weights: &[f32]| thresholds.iter().zip(weights).map(|(threshold, weight)| [*threshold, *weight]).collect();
    Compensation {
        plain_constant_mm: 2.0,
        constant_mm: 2.0,
        plain_inverse: pairs(inverse.thresholds(), inverse.weights()),
        plays: pairs(&thresholds_bar, &weights),
        friction_per_bar: 0.1,
        creep: [[5.0, 0.03]].into_iter().collect(),
        square_per_mm: -0.004,
        cube_per_mm2: 0.0,
        touch_bar: 0.2,
        touch_width_bar: 0.02,
        dead_time_s: 0.02,
        fill_time_constant_s: 0.06,
        vent_time_constant_s: 0.09,
        second_time_constant_s: 0.02,
        highest_bar: 3.0,
        error_mm: 0.05,
    }
}

fn config(feed_forward: FeedForward, sensor: FeedbackSensor) -> TrackingConfig {
    TrackingConfig {
        period_ms: NonZeroU16::new(20).unwrap(),
        feed_forward,
        sensor,
        linear_mm_per_bar: 3.6,
        linear_offset_mm: 1.6,
        learned_look_ahead_ms: 0,
        pid: PidConfig { proportional: 0.1, integral_per_s: 3.0, derivative_s: 0.0, derivative_filter_s: 0.05, limit_mm: 3.0 },
        observer: ObserverConfig { time_constant_s: 0.3, estimate_bound_mm: 0.5, widening_mm_per_s: 0.1 },
        transfer_s: 0.2,
        outside_domain: OutsideDomain::FallBack,
        estimate_by_physics: false,
    }
}

/// A law, the actuator it drives, a limiter, a laser and a model that can each be taken away.
struct Bench {
    law: Tracking,
    state: TrackingState,
    compensator: Option<Compensator>,
    plant: Actuator,
    plant_state: ActuatorState,
    line: [f32; 21],
    tick: u32,
    window_sum_mm: f32,
    inputs: ControlInputs<'static>,
    load_mm: f32,
    tip_mm: f32,
    laser: bool,
    /// Error of the model's estimate, mm; without a number there is no model.
    model_error_mm: Option<f32>,
    output_bar: f32,
    notices: NoticeSet,
    set_point_mm: f32,
    slew_bar: f32,
    /// The tip so far, and how many ticks ago the window of the estimate ended.
    past_mm: Vec<f32>,
    late_ticks: usize,
}

impl Bench {
    fn new(config: TrackingConfig) -> Self {
        let law = config.build();
        let mut state = TrackingState::default();
        let inputs = ControlInputs { window_s: 0.02, ..ControlInputs::default() };
        law.start(&mut state, &inputs);
        Self {
            law,
            state,
            compensator: Some(Compensator::new(parameters()).unwrap()),
            plant: Actuator::new(parameters()).unwrap(),
            plant_state: ActuatorState::default(),
            line: [0.0; 21],
            tick: 0,
            window_sum_mm: 0.0,
            inputs,
            load_mm: 0.0,
            tip_mm: 2.0,
            laser: true,
            model_error_mm: None,
            output_bar: 0.0,
            notices: NoticeSet::EMPTY,
            set_point_mm: 0.0,
            slew_bar: 0.04,
            past_mm: Vec::new(),
            late_ticks: 0,
        }
    }

    fn set(&mut self, value_mm: f32) {
        self.law.accept(&mut self.state, &SetPoint::Value(Quantity::Displacement, value_mm)).unwrap();
    }

    fn step(&mut self) {
        self.line.rotate_right(1);
        self.line[0] = self.output_bar;
        let model_mm = self.plant.step(&mut self.plant_state, self.line[20]);
        self.tip_mm = model_mm + self.load_mm;
        let compensator = self.compensator.take();
        let window_begins = self.tick.is_multiple_of(20);
        if window_begins {
            let mean_mm = if self.tick == 0 { self.tip_mm } else { self.window_sum_mm / 20.0 };
            self.inputs.window_displacement_mm = self.laser.then_some(mean_mm);
            let end = self.past_mm.len().saturating_sub(self.late_ticks);
            let window = &self.past_mm[end.saturating_sub(20)..end];
            let modelled_mm = if window.is_empty() { self.tip_mm } else { window.iter().sum::<f32>() / window.len() as f32 };
            self.inputs.estimate_mm = self.model_error_mm.map(|error_mm| modelled_mm - self.load_mm + error_mm);
            self.window_sum_mm = 0.0;
        }
        self.window_sum_mm += self.tip_mm;
        self.past_mm.push(self.tip_mm);
        let inputs = ControlInputs { output_bar: self.output_bar, window_begins, compensator: compensator.as_ref(), ..self.inputs };
        self.law.follow(&mut self.state, &inputs);
        let control = self.law.step(&mut self.state, &inputs);
        let Demand::Pressure(demand_bar) = control.demand else { panic!("a tracking law always demands") };
        assert!(demand_bar.is_finite());
        let allowed_bar = demand_bar.clamp(0.0, 3.0).clamp(self.output_bar - self.slew_bar, self.output_bar + self.slew_bar);
        self.inputs.limited = allowed_bar != demand_bar;
        self.output_bar = allowed_bar;
        self.notices = control.notices;
        self.set_point_mm = control.set_point;
        self.compensator = compensator;
        self.tick += 1;
    }

    fn run(&mut self, ticks: u32) {
        (0..ticks).for_each(|_| self.step());
    }

    /// Root mean square error over a path of points 20 ms apart, mm, the first second left out.
    fn follow(&mut self, points_mm: &[f32]) -> f32 {
        let mut sent = 0;
        let (mut squares, mut count) = (0.0, 0.0);
        for tick in 0..points_mm.len() * 20 {
            while sent < points_mm.len() && self.state.reference().points().free() >= 32 {
                let end = (sent + 32).min(points_mm.len());
                let values_bar = heapless::Vec::from_slice(&points_mm[sent..end]).unwrap();
                let chunk = PlaybackChunk { first_index: u32::try_from(sent).unwrap(), last: end == points_mm.len(), values_bar };
                self.law.accept(&mut self.state, &SetPoint::Chunk(chunk)).unwrap();
                sent = end;
            }
            self.step();
            if tick > 1000 {
                squares += (self.tip_mm - self.set_point_mm).powi(2);
                count += 1.0;
            }
        }
        (squares / count as f32).sqrt()
    }
}

/// A sine of 0.5 Hz between 3.5 and 8.5 mm that begins at rest.
fn sine() -> Vec<f32> {
    (0..500u16).map(|point| 6.0 - 2.5 * (f32::from(point) * 0.02 * core::f32::consts::PI).cos()).collect()
}

#[test]
fn the_inverse_of_the_physics_follows_far_closer_than_the_linear_map() {
    let error = |feed_forward| Bench::new(config(feed_forward, FeedbackSensor::None)).follow(&sine());
    let (linear, physics) = (error(FeedForward::Linear), error(FeedForward::Physics));
    // On an actuator that is exactly the model only the smoothing of the derivatives remains: a hundredth of the 5 mm.
    assert!(physics < 0.05, "{physics} mm");
    assert!(physics < 0.1 * linear, "linear {linear}, physics {physics} mm");
}

#[test]
fn an_estimate_that_comes_a_tick_late_costs_little_and_one_a_window_late_costs_more() {
    for (feed_forward, gain) in [(FeedForward::Linear, 1.0), (FeedForward::Linear, 3.0), (FeedForward::PrandtlIshlinskii, 3.0)] {
        let error = |late_ticks| {
            let mut configuration = config(feed_forward, FeedbackSensor::Estimate);
            configuration.pid = PidConfig { proportional: 0.1 * gain, integral_per_s: 3.0 * gain, limit_mm: 12.0, ..configuration.pid };
            let mut bench = Bench::new(configuration);
            (bench.laser, bench.model_error_mm, bench.late_ticks) = (false, Some(0.0), late_ticks);
            bench.follow(&sine())
        };
        let [at_once, tick, window] = [0, 1, 20].map(error);
        std::println!("{feed_forward:?}, gains times {gain}: {at_once:.4} mm, a tick late {tick:.4}, a window late {window:.4}");
        assert!(tick < 1.005 * at_once, "{feed_forward:?}: {at_once} and {tick} mm");
        assert!(window > 1.03 * at_once, "{feed_forward:?}: {at_once} and {window} mm");
    }
}

#[test]
fn feedback_settles_on_a_step_and_rejects_a_load() {
    for feed_forward in [FeedForward::None, FeedForward::Linear, FeedForward::PrandtlIshlinskii, FeedForward::Physics] {
        let mut configuration = config(feed_forward, FeedbackSensor::Laser);
        configuration.pid.limit_mm = 12.0;
        configuration.pid.integral_per_s = 2.5;
        let mut bench = Bench::new(configuration);
        bench.set(6.0);
        bench.run(5000);
        assert!((bench.tip_mm - 6.0).abs() < 0.02, "{feed_forward:?}: {} mm", bench.tip_mm);
        let before_bar = bench.output_bar;
        bench.load_mm = -0.5;
        bench.run(5000);
        assert!((bench.tip_mm - 6.0).abs() < 0.02, "{feed_forward:?} under a load: {} mm", bench.tip_mm);
        assert!(bench.output_bar - before_bar > 0.05, "{feed_forward:?} did nothing against the load");
    }
}

#[test]
fn without_feedback_a_load_stays() {
    let mut bench = Bench::new(config(FeedForward::Physics, FeedbackSensor::None));
    bench.set(6.0);
    bench.run(3000);
    bench.load_mm = -0.5;
    bench.run(3000);
    assert!((bench.tip_mm - 5.5).abs() < 0.05, "{} mm", bench.tip_mm);
}

#[test]
fn an_unreachable_set_point_does_not_wind_the_integral_up() {
    let mut configuration = config(FeedForward::Linear, FeedbackSensor::Laser);
    configuration.pid.limit_mm = 100.0;
    let mut bench = Bench::new(configuration);
    bench.set(30.0);
    bench.run(20_000);
    assert!((bench.output_bar - 3.0).abs() < 1e-3, "{} bar", bench.output_bar);
    bench.set(6.0);
    bench.run(1500);
    // Twenty seconds of an error of 18 mm would have wound the integral up to 1000 mm.
    assert!((bench.tip_mm - 6.0).abs() < 0.5, "{} mm a second and a half after the set-point came back", bench.tip_mm);
}

#[test]
fn the_start_and_every_change_of_law_is_no_jump() {
    let mut bench = Bench::new(config(FeedForward::Physics, FeedbackSensor::None));
    bench.set(6.0);
    bench.run(3000);
    let settled_bar = bench.output_bar;
    // The compensator goes away and comes back, as with a model that is exchanged.
    let compensator = bench.compensator.take();
    let mut largest_bar = 0.0_f32;
    for _ in 0..500 {
        let before_bar = bench.output_bar;
        bench.step();
        largest_bar = largest_bar.max((bench.output_bar - before_bar).abs());
    }
    assert!(bench.notices.contains(Notice::FeedForwardFallback));
    assert!(largest_bar < 0.01, "{largest_bar} bar in a tick");
    assert!((bench.output_bar - settled_bar).abs() > 0.02, "the linear map should ask for another pressure in the end");
    bench.compensator = compensator;
    for _ in 0..500 {
        let before_bar = bench.output_bar;
        bench.step();
        largest_bar = largest_bar.max((bench.output_bar - before_bar).abs());
    }
    assert!(!bench.notices.contains(Notice::FeedForwardFallback));
    assert!(largest_bar < 0.01, "{largest_bar} bar in a tick");
}

#[test]
fn no_feed_forward_takes_over_from_another_with_a_jump() {
    use FeedForward as F;
    let mut moved = 0;
    // Those that hand over to each other; a PID alone does to none.
    let all = [F::Linear, F::PrandtlIshlinskii, F::Physics, F::Learned];
    for before in all {
        for after in all {
            let mut bench = Bench::new(config(before, FeedbackSensor::None));
            bench.inputs.inverse_bar = Some(1.4);
            bench.set(6.0);
            bench.run(3000);
            let (before_bar, mut largest_bar) = (bench.output_bar, 0.0_f32);
            bench.law = config(after, FeedbackSensor::None).build();
            for _ in 0..1000 {
                let last_bar = bench.output_bar;
                bench.step();
                largest_bar = largest_bar.max((bench.output_bar - last_bar).abs());
            }
            // What lies between two laws fades with 0.2 s, 0.005 of it in a tick, and the inverse of the lags asks for some of it at once. A
            // law that takes over as fast as it can moves at the slew limit of 0.04 bar.
            assert!(largest_bar < 0.016, "{before:?} to {after:?}: {largest_bar} bar in a tick");
            moved += usize::from((bench.output_bar - before_bar).abs() > 0.02);
        }
    }
    assert!(moved >= 8, "only {moved} changes lead to another pressure");
}

#[test]
fn losing_the_laser_in_mid_motion_moves_the_tip_by_less_than_a_hundredth_of_the_stroke() {
    let path = |loses: bool| {
        let mut bench = Bench::new(config(FeedForward::Physics, FeedbackSensor::Observer));
        bench.model_error_mm = Some(0.3);
        bench.load_mm = -0.2;
        bench.set(5.0);
        bench.run(2000);
        bench.set(7.0);
        bench.run(100);
        bench.laser = !loses;
        let tips: Vec<f32> = (0..400)
            .map(|_| {
                bench.step();
                bench.tip_mm
            })
            .collect();
        (tips, *bench.state.report())
    };
    let ((with, before), (without, after)) = (path(false), path(true));
    let jump_mm = with.iter().zip(&without).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
    assert!(jump_mm < 0.1, "{jump_mm} mm");
    assert!(after.bound_mm > before.bound_mm, "the bound widens: {} and {} mm", before.bound_mm, after.bound_mm);
}

#[test]
fn the_bound_widens_up_to_that_of_the_estimate_and_no_further() {
    let mut bench = Bench::new(config(FeedForward::Physics, FeedbackSensor::Observer));
    bench.model_error_mm = Some(0.0);
    bench.set(5.0);
    bench.run(2000);
    bench.laser = false;
    let mut last_mm = 0.0;
    for _ in 0..20 {
        bench.run(500);
        let bound_mm = bench.state.report().bound_mm;
        assert!(bound_mm >= last_mm && bound_mm <= 0.5);
        last_mm = bound_mm;
    }
    assert_eq!(last_mm, 0.5);
}

#[test]
fn a_laser_alone_that_is_lost_freezes_the_correction_and_says_so() {
    let mut bench = Bench::new(config(FeedForward::Physics, FeedbackSensor::Laser));
    bench.load_mm = -0.3;
    bench.set(6.0);
    bench.run(4000);
    let correction_mm = bench.state.report().correction_mm;
    bench.laser = false;
    bench.run(3001);
    assert_eq!(bench.state.report().correction_mm, correction_mm);
    assert!((bench.tip_mm - 6.0).abs() < 0.1, "{} mm", bench.tip_mm);
    bench.run(19);
    assert!((0..20).any(|_| {
        bench.step();
        bench.notices.contains(Notice::FeedbackMissing)
    }));
}

#[test]
fn outside_of_the_domain_the_demand_holds_or_the_physics_stands_in_and_both_are_counted() {
    let mut configuration = config(FeedForward::Physics, FeedbackSensor::None);
    configuration.outside_domain = OutsideDomain::Hold;
    let mut bench = Bench::new(configuration);
    bench.set(5.0);
    bench.run(2000);
    bench.inputs.outside_domain = true;
    let held_bar = bench.output_bar;
    bench.set(7.0);
    bench.run(500);
    assert_eq!(bench.output_bar, held_bar);
    assert!(bench.notices.contains(Notice::OutsideDomain));
    assert_eq!(bench.state.report().outside_domain_ticks, 500);
    bench.inputs.outside_domain = false;
    bench.run(3000);
    assert!((bench.tip_mm - 7.0).abs() < 0.1, "{} mm", bench.tip_mm);

    let mut bench = Bench::new(config(FeedForward::Learned, FeedbackSensor::None));
    bench.inputs.inverse_bar = Some(1.0);
    bench.set(6.0);
    bench.run(3000);
    assert!((bench.output_bar - 1.0).abs() < 1e-3, "the learned inverse asks for 1 bar");
    bench.inputs.outside_domain = true;
    bench.run(3000);
    assert!((bench.tip_mm - 6.0).abs() < 0.1, "the physics stands in: {} mm", bench.tip_mm);
    assert_eq!(bench.state.report().fallback_ticks, 3000);
}

#[test]
fn the_modelled_actuator_is_a_sensor_in_step_with_the_laser() {
    let mut configuration = config(FeedForward::Physics, FeedbackSensor::Estimate);
    configuration.estimate_by_physics = true;
    let mut bench = Bench::new(configuration);
    bench.set(5.0);
    bench.run(1000);
    bench.set(7.0);
    let mut largest_mm = 0.0_f32;
    for _ in 0..50 {
        bench.run(20);
        // The report is of the window that has ended, like the laser's mean; the laser is a tick of output older than the model.
        let laser_mm = bench.inputs.window_displacement_mm.unwrap();
        largest_mm = largest_mm.max((bench.state.report().blend_mm - laser_mm).abs());
    }
    assert!(largest_mm < 0.05, "{largest_mm} mm");
}

#[test]
fn the_inverse_undoes_the_actuator_from_any_state() {
    let actuator = Actuator::new(parameters()).unwrap();
    let mut state = ActuatorState::default();
    let mut muscle_bar = 0.5_f32;
    for step in 0..4000u16 {
        let phase = f32::from(step) * 0.013;
        muscle_bar += 0.01 * phase.sin() + 0.004 * (2.7 * phase).cos();
        muscle_bar = muscle_bar.clamp(0.3, 2.8);
        let wanted_mm = 2.5 + 6.0 * (0.5 + 0.5 * (1.9 * phase).sin());
        let found_bar = actuator.pressure_for(&state, wanted_mm);
        let mut trial = state.clone();
        let reached_mm = actuator.follow(&mut trial, found_bar);
        // The creep of this one tick is not foreseen: 3 % of the jump in 5 s.
        let inside = found_bar > 0.21 && found_bar < 2.99;
        assert!(!inside || (reached_mm - wanted_mm).abs() < 2e-3, "step {step}: {reached_mm} instead of {wanted_mm} mm");
        actuator.follow(&mut state, muscle_bar);
    }
}

#[test]
fn refuses_pressures_and_what_is_no_number() {
    let law = config(FeedForward::Linear, FeedbackSensor::None).build();
    let mut state = TrackingState::default();
    let mut accept = |set_point| law.accept(&mut state, &set_point);
    assert_eq!(accept(SetPoint::Value(Quantity::Pressure, 1.0)), Err(Refusal::WrongQuantity));
    assert_eq!(accept(SetPoint::Value(Quantity::Displacement, f32::NAN)), Err(Refusal::NotFinite));
    assert_eq!(accept(SetPoint::Value(Quantity::Displacement, 1.0)), Ok(Accepted::InForce));
}
