//! A controller against the identified actuator: the firmware's own law, tick by tick, without the rest of the device.

use firmware::control::{Actuator, ActuatorState, Compensator, ControlInputs, ControlLaw, Demand, SetPoint, Tracking, TrackingState};
use model_export::link::message::PlaybackChunk;

use crate::control::{Figures, PERIOD_S, Sample, figures};

/// Ticks of a window and of a point.
const WINDOW_TICKS: usize = 20;
const _: () = assert!((PERIOD_S * 1000.0) as usize == WINDOW_TICKS);

/// The limits that the output meets.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limits {
    /// Highest output, bar.
    pub ceiling_bar: f32,
    /// Fastest output, bar/s.
    pub slew_bar_per_s: f32,
}

/// How well a law follows a reference on an actuator that is what it was identified as.
#[must_use]
pub fn simulate(law: &Tracking, compensator: &Compensator, plant: &Actuator, limits: Limits, points_mm: &[f64]) -> Figures {
    let mut state = TrackingState::default();
    let mut actuator = ActuatorState::default();
    let dead_ticks = (f64::from(plant.parameters().dead_time_s) * 1000.0).round() as usize;
    let mut line = vec![0.0_f32; dead_ticks + 1];
    let mut inputs = ControlInputs { window_s: PERIOD_S as f32, compensator: Some(compensator), ..ControlInputs::default() };
    law.start(&mut state, &inputs);
    let (mut sent, mut output_bar, mut sum_mm) = (0, 0.0_f32, 0.0_f32);
    let mut samples = Vec::with_capacity(points_mm.len());
    let largest_step_bar = limits.slew_bar_per_s / 1000.0;
    for tick in 0..points_mm.len() * WINDOW_TICKS {
        while sent < points_mm.len() && state.reference().points().free() >= 32 {
            let end = (sent + 32).min(points_mm.len());
            let values_bar = points_mm[sent..end].iter().map(|point| *point as f32).collect();
            let chunk = PlaybackChunk { first_index: sent as u32, last: end == points_mm.len(), values_bar };
            if law.accept(&mut state, &SetPoint::Chunk(chunk)).is_err() {
                break;
            }
            sent = end;
        }
        line.rotate_right(1);
        line[0] = output_bar;
        let tip_mm = plant.step(&mut actuator, line[dead_ticks]);
        inputs.window_begins = tick % WINDOW_TICKS == 0;
        if inputs.window_begins {
            // At the first tick there was no window yet.
            let mean_mm = if tick == 0 { tip_mm } else { sum_mm / WINDOW_TICKS as f32 };
            (inputs.window_displacement_mm, inputs.estimate_mm) = (Some(mean_mm), Some(mean_mm));
            sum_mm = 0.0;
        }
        sum_mm += tip_mm;
        inputs.output_bar = output_bar;
        law.follow(&mut state, &inputs);
        let control = law.step(&mut state, &inputs);
        let wanted_bar = match control.demand {
            Demand::Pressure(bar) => bar,
            Demand::Hold => output_bar,
        };
        let allowed_bar = wanted_bar.clamp(0.0, limits.ceiling_bar).clamp(output_bar - largest_step_bar, output_bar + largest_step_bar);
        inputs.limited = allowed_bar != wanted_bar;
        output_bar = allowed_bar;
        if inputs.window_begins {
            samples.push(Sample {
                time_s: tick as f64 / 1000.0,
                reference_mm: f64::from(control.set_point),
                tip_mm: f64::from(tip_mm),
                output_bar: f64::from(output_bar),
                limited: inputs.limited,
                ..Sample::default()
            });
        }
    }
    figures::of("simulated", &samples)
}
