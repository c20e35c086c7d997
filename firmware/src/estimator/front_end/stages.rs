//! The further stages of a front end, by the equations of [`model_export::schema::Stages`].

use model_export::schema::{Curve, Filter, FrontEnd, Growth, MAX_PLAY, Stages};

use crate::estimator::curve::{MAX_NORMALISED, bent};

/// The memory of the stages.
#[derive(Clone, Debug, PartialEq)]
pub struct StagesState {
    flowed: f32,
    line: FilterState,
    /// Size of the path's steps, as far as it is remembered.
    step_size: f32,
    tip: FilterState,
}

/// The last two outputs and inputs of a filter, newest first.
#[derive(Clone, Copy, Debug, PartialEq)]
struct FilterState {
    outputs: [f32; 2],
    inputs: [f32; 2],
}

/// Farthest readout that the tip follows, in the unit of the operators' sum.
pub const MAX_READOUT: f32 = 1.0e6;

impl FilterState {
    const NEW: Self = Self { outputs: [0.0; 2], inputs: [0.0; 2] };
}

impl StagesState {
    /// Before the first sample, which sets what is not set here.
    pub const NEW: Self = Self { flowed: 0.0, line: FilterState::NEW, step_size: 0.0, tip: FilterState::NEW };

    /// The path that the operators follow, for an input behind the dead time.
    #[inline(never)]
    pub fn lead(&mut self, stages: &Stages, delayed: f32, first: bool) -> f32 {
        let supplied = along(stages.supply.as_ref(), delayed);
        self.flowed = match &stages.flow {
            Some(flow) if !first => {
                let missing = supplied - self.flowed;
                if missing > 0.0 { self.flowed + towards(&flow.fill, missing) } else { self.flowed - towards(&flow.vent, -missing) }
            }
            _ => supplied,
        };
        let swung = stages.line.as_ref().map_or(self.flowed, |filter| self.line.step(filter, self.flowed, first));
        // What no measurement may be, no path is either: everything behind it stays finite.
        between(along(stages.muscle.as_ref(), swung), -MAX_NORMALISED, MAX_NORMALISED)
    }

    /// The weighted sum of play operators whose thresholds change; `last` is the path of the sample before.
    #[inline(never)]
    pub fn growing_plays(
        &mut self,
        growth: &Growth,
        config: &FrontEnd,
        plays: &mut [f32; MAX_PLAY],
        (path, last): (f32, f32),
        first: bool,
    ) -> f32 {
        let step = if path < last { last - path } else { path - last };
        self.step_size = if first { 0.0 } else { self.step_size + growth.fading * (step - self.step_size) };
        let law = bent(&growth.law, self.step_size);
        let [linear, square, cube] = growth.apart;
        let extra = growth.extra * law + path * (linear + path * (square + path * cube));
        let [rising, falling] = growth.per_path.map(|per_path| not_negative(1.0 + per_path * path) + growth.share * law);
        let operators = config.play_thresholds.iter().zip(&config.play_weights);
        let mut sum = 0.0;
        for ((threshold, weight), memory) in operators.zip(plays) {
            let low = path - not_negative(rising * threshold + extra);
            let high = path + not_negative(falling * threshold + extra);
            let bound = between(*memory, low, high);
            *memory = match &growth.follow {
                Some(follow) if !first => {
                    let missing = bound - *memory;
                    if missing > 0.0 { *memory + towards(follow, missing) } else { *memory - towards(follow, -missing) }
                }
                _ => bound,
            };
            sum += weight * *memory;
        }
        sum
    }

    /// The readout behind the tip.
    #[inline(never)]
    pub fn swing(&mut self, tip: &Filter, readout: f32, first: bool) -> f32 {
        self.tip.step(tip, between(readout, -MAX_READOUT, MAX_READOUT), first)
    }
}

impl FilterState {
    fn step(&mut self, filter: &Filter, input: f32, first: bool) -> f32 {
        if first {
            *self = Self { outputs: [input; 2], inputs: [input; 2] };
        }
        let ([last, before], [input_last, input_before]) = (self.outputs, self.inputs);
        let [now, at_last, at_before] = filter.gains;
        let moved =
            filter.momentum * (last - before) + now * (input - last) + at_last * (input_last - last) + at_before * (input_before - last);
        let output = last + moved;
        *self = Self { outputs: [output, last], inputs: [input, input_last] };
        output
    }
}

fn along(curve: Option<&Curve>, value: f32) -> f32 {
    curve.map_or(value, |curve| bent(curve, value))
}

/// How far something goes over a distance, and no farther.
fn towards(curve: &Curve, distance: f32) -> f32 {
    between(bent(curve, distance), 0.0, distance)
}

/// Not `f32::clamp`: comparisons in this order, and the same answer on every target.
fn between(value: f32, low: f32, high: f32) -> f32 {
    if value < low {
        low
    } else if value > high {
        high
    } else {
        value
    }
}

fn not_negative(value: f32) -> f32 {
    if value > 0.0 { value } else { 0.0 }
}
