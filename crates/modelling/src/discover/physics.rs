//! The form of a discovered model that the microcontroller runs: a [`PhysicsModel`] with its further [`Stages`].
//!
//! Every effect has one stage of the blob's front end (see `model_export::schema`), and its parameters go there as they are; what is a
//! curve is asked for its values, what is a linear filter for the answer to an impulse. What drifts with the session's time (drift of zero and gain,
//! a change of set-up) goes into constant and weights as it was when the session ended: that is the rig as it is now. A skew of the clocks
//! belongs to the recordings, not to the rig, and is left out.
//!
//! A model that has any other effect, two for one stage, or effects in another order than the stages stays on the desktop;
//! [`physics_model`] then says which effect it is. So does one whose form departs from it by more than it errs itself and than a share of the
//! output's range.

use discovery::effects::creep::TIMES_S;
use discovery::file::DiscoveredModel;
use discovery::{OperatorLaw, Slot};
use recording::{Recording, Signal};

use crate::physics::{
    ChannelRange, CreepFilters, Curve, FORMAT_VERSION, Filter, Flow, InputPath, Kind, PhysicsModel, Points, Provenance, Source, Stages,
    ThresholdGrowth,
};

/// Where in the blob's front end an effect acts, in the order of the signal.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Stage {
    /// The supply's curve.
    Supply,
    /// What is missing drives a flow.
    Flow,
    /// A filter of the second order.
    Line,
    /// The muscle's curve.
    Muscle,
    /// How thresholds change.
    Operators,
    /// Creep of the operators' sum.
    Creep,
    /// The readout's curve.
    Readout,
    /// A filter of the second order behind it.
    Tip,
    /// Zero and gain.
    Sensor,
}

/// How much farther than the recordings go a curve is followed bend by bend, in spans.
const MARGIN: f64 = 0.2;

/// Sizes of steps that a flow is tried with, the largest of them in spans, and samples of a ramp.
const PROBES: usize = 200;
const MOST_MISSING: f64 = 1.5;
const RAMP: usize = 1000;

/// Share of the output's range by which the form may depart from the model in any case.
const ALIKE: f64 = 0.01;

/// Growth in proportion to a rate of so many spans per s is in proportion at any rate.
const FASTER_THAN_ANY: f64 = 100.0;

/// The stage of an effect.
fn stage(effect: &Slot) -> Option<Stage> {
    if effect.form.definition().is_some() {
        return None;
    }
    Some(match (effect.form.name(), effect.form.key()) {
        ("supply-saturation", "rounded" | "drooping") => Stage::Supply,
        ("slew-limit", _)
        | ("pneumatic-lag", "before" | "before-held" | "orifice")
        | ("fill-vent-asymmetry", "by-error" | "by-error-held" | "orifices") => Stage::Flow,
        ("pneumatic-lag", "two-before") | ("resonance", "pressure") => Stage::Line,
        ("activation-threshold", "rounded" | "opens" | "two-sided") | ("static-nonlinearity", "input-cubic" | "input-rational") => {
            Stage::Muscle
        }
        ("asymmetric-hysteresis", "bouc-wen" | "bouc-wen-going-on" | "dahl" | "dahl-going-on") => return None,
        ("asymmetric-hysteresis", _) => Stage::Operators,
        ("rate-dependent-hysteresis", "overstress-asinh" | "overstress-fading" | "share-asinh" | "viscous" | "viscous-stiffening") => {
            Stage::Operators
        }
        ("creep", "of-the-displacement" | "of-the-displacement-going-on" | "of-the-displacement-held") => Stage::Creep,
        ("activation-threshold", "of-the-displacement") => Stage::Readout,
        ("static-nonlinearity", form) if form.starts_with("output-") => Stage::Readout,
        ("pneumatic-lag", "behind" | "two-behind") | ("resonance", "tip" | "shaken-tip" | "part-of-tip") => Stage::Tip,
        ("offset-drift" | "gain-drift" | "setup-change", _) => Stage::Sensor,
        _ => return None,
    })
}

/// The physics model for `catheter export`; `recordings` are like those that it will meet.
///
/// # Errors
/// With the name and the form of the first effect that the microcontroller does not know, or what else keeps the model off it.
pub fn physics_model(model: &DiscoveredModel, recordings: &[Recording]) -> Result<PhysicsModel, String> {
    let mut forming = Forming::new(model, recordings)?;
    let mut reached = Stage::Supply;
    for (at, effect) in model.slots()?.iter().enumerate() {
        let refused = |why: &str| format!("{} ({}){why}", effect.form.name(), effect.form.key());
        match effect.form.name() {
            "dead-time" => forming.delay_samples += effect.parameters[0] / model.sample_period_s,
            "clock-skew" => {}
            _ => {
                let stage = stage(effect).ok_or_else(|| refused(""))?;
                if stage < reached {
                    return Err(refused(": it acts in another order there"));
                }
                reached = stage;
                forming.add(stage, at, effect).map_err(|why| refused(&why))?;
            }
        }
    }
    forming.finish()
}

/// A physics model in the making. Its values are normalised as the discovered model's are, and count from the rest input.
struct Forming<'a> {
    model: &'a DiscoveredModel,
    recordings: &'a [Recording],
    delay_samples: f64,
    /// Lowest and highest value of the path so far, normalised, with a margin.
    reach: [f64; 2],
    /// Effects of the readout, by their numbers.
    bends: Vec<usize>,
    creep: CreepFilters,
    stages: Stages,
    /// Whether the flow is one lag for both directions, with this time constant.
    lag_s: Option<f64>,
    gain: f64,
    zero: f64,
}

impl<'a> Forming<'a> {
    fn new(model: &'a DiscoveredModel, recordings: &'a [Recording]) -> Result<Self, String> {
        let (low, high) = extent(recordings.iter().flat_map(|recording| &recording.input));
        if !(low.is_finite() && high.is_finite()) {
            return Err("recordings without samples".to_owned());
        }
        let [low, high] = [low, high].map(|value| (value - model.input_offset) / model.input_scale);
        let margin = MARGIN * (high - low).max(1.0);
        Ok(Self {
            model,
            recordings,
            delay_samples: 0.0,
            reach: [low.min(0.0) - margin, high.max(0.0) + margin],
            bends: Vec::new(),
            creep: CreepFilters::default(),
            stages: Stages::default(),
            lag_s: None,
            gain: 1.0,
            zero: 0.0,
        })
    }

    /// Gives an effect its stage.
    fn add(&mut self, stage: Stage, at: usize, effect: &Slot) -> Result<(), String> {
        let taken = || Err(": its stage is taken by another effect".to_owned());
        match stage {
            Stage::Supply | Stage::Muscle => {
                let place = if stage == Stage::Supply { &self.stages.supply } else { &self.stages.muscle };
                if place.is_some() {
                    return taken();
                }
                let curve = Some(self.curve_of_input(at)?);
                if stage == Stage::Supply { self.stages.supply = curve } else { self.stages.muscle = curve }
            }
            Stage::Flow if self.stages.flow.is_none() => {
                self.lag_s = (effect.form.name() == "pneumatic-lag" && effect.parameters.len() == 1).then(|| effect.parameters[0]);
                self.flow(at)?;
            }
            // A lag behind another flow is a filter.
            Stage::Flow if effect.form.name() == "pneumatic-lag" && self.stages.line.is_none() => self.stages.line = Some(self.filter(at)?),
            Stage::Line if self.stages.line.is_none() => self.stages.line = Some(self.filter(at)?),
            Stage::Tip if self.stages.tip.is_none() => self.stages.tip = Some(self.filter(at)?),
            // Laws add up, and so do the curves of the path that belong to them.
            Stage::Operators if self.model.stops => return Err(" of stop operators".to_owned()),
            Stage::Operators => {
                let bends = self.model.respond(at, &[0.25, 0.5]).map_err(of_file)?;
                if bends != [0.25, 0.5] {
                    if self.stages.muscle.is_some() {
                        return taken();
                    }
                    self.stages.muscle = Some(self.curve_of_input(at)?);
                }
                self.stages.growth = Some(self.growth()?);
            }
            Stage::Creep if self.creep.gains.is_empty() => {
                let active = TIMES_S.iter().zip(&effect.weights).filter(|(_, weight)| **weight > 0.0);
                (self.creep.time_constants_s, self.creep.gains) = active.map(|(time_s, weight)| (*time_s, *weight)).unzip();
            }
            Stage::Readout => self.bends.push(at),
            Stage::Sensor => {
                let of = |sum: f64| Ok::<f64, String>(self.model.respond(at, &[sum]).map_err(of_file)?[0]);
                let zero = of(0.0)?;
                let gain = of(1.0)? - zero;
                (self.gain, self.zero) = (self.gain * gain, self.zero * gain + zero);
            }
            Stage::Flow | Stage::Line | Stage::Tip | Stage::Creep => return taken(),
        }
        Ok(())
    }

    /// The curve that an effect makes of the path, in input units from the rest input; the path is what it makes of it from then on.
    fn curve_of_input(&mut self, at: usize) -> Result<Points, String> {
        let model = self.model;
        model.respond(at, &[0.0]).map_err(of_file)?;
        let [low, high] = self.reach;
        let mut curve = Points::near(|values| model.respond(at, values).unwrap_or_default(), low, high);
        let (low, high) = extent(&curve.to);
        self.reach = [low, high];
        curve.from.iter_mut().chain(&mut curve.to).for_each(|value| *value *= model.input_scale);
        Ok(curve)
    }

    /// The filter that an effect is.
    fn filter(&self, at: usize) -> Result<Filter, String> {
        self.model.respond(at, &[0.0]).map_err(of_file)?;
        Filter::of(|signal| self.model.respond(at, signal).unwrap_or_default())
            .ok_or_else(|| ": it is no filter of the second order that settles".to_owned())
    }

    /// The growth of thresholds by all laws together.
    fn growth(&self) -> Result<ThresholdGrowth, String> {
        let (model, scale) = (self.model, self.model.input_scale);
        let law = model.operator_law().map_err(of_file)?;
        if law.law.is_some() {
            return Err(": its law is not known there".to_owned());
        }
        if law.viscous_power != 0.0 {
            return Err(": its operators have one time constant there".to_owned());
        }
        let [slope, bend, cubic] = law.envelopes;
        let [linear, square, cube] = [slope + bend + cubic, -bend - 3.0 * cubic, 2.0 * cubic];
        let has_rate = law.growth_per_rate != 0.0 || law.extra_per_rate != 0.0;
        Ok(ThresholdGrowth {
            per_input: [law.growth_per_input, law.growth_per_input + law.growth_unloading].map(|growth| growth / scale),
            apart: [linear, square / scale, cube / (scale * scale)],
            law: has_rate.then(|| self.law_of_steps(&law)),
            share: law.growth_per_rate,
            extra: law.extra_per_rate * scale,
            fading_time_s: law.rate_memory_s,
            follow: (law.viscous_s > 0.0).then(|| self.follow(&law)),
        })
    }

    /// How far operators go towards bounds that stand still, in a sample: for a distance `x` at the speed `x / T (1 + (x / E)^2)`.
    fn follow(&self, law: &OperatorLaw) -> Points {
        let ratio = self.model.sample_period_s / law.viscous_s;
        let left = |distance: f64| match law.stiffening > 0.0 && distance > 0.0 {
            false => distance * (-ratio).exp(),
            true => {
                let (near, far) = (distance.powi(-2), law.stiffening.powi(-2));
                ((near + far) * (2.0 * ratio).min(700.0).exp() - far).powf(-0.5)
            }
        };
        let mut curve = Points::near(|distances| distances.iter().map(|distance| distance - left(*distance)).collect(), 0.0, 1.0);
        curve.from.iter_mut().chain(&mut curve.to).for_each(|value| *value *= self.model.input_scale);
        curve
    }

    /// The flow that an effect is: how far it goes in a sample is seen from steps of every size, and how late it is from a ramp.
    fn flow(&mut self, at: usize) -> Result<(), String> {
        let model = self.model;
        model.respond(at, &[0.0]).map_err(of_file)?;
        let respond = |signal: &[f64]| model.respond(at, signal).unwrap_or_default();
        let curve = |sign: f64| {
            // What is missing after the sample of a step, and how much of it is there a sample later.
            let probe = |step: usize| {
                let step = MOST_MISSING * (step as f64 / PROBES as f64).powi(2);
                let answer = respond(&[0.0, sign * step, sign * step, sign * step]);
                (step - sign * answer[2], sign * (answer[3] - answer[2]))
            };
            let probes: Vec<(f64, f64)> = (0..=PROBES).map(probe).collect();
            let most = probes[PROBES].0;
            Points::near(|sizes| sizes.iter().map(|size| interpolated(&probes, *size)).collect(), 0.0, most)
        };
        let mut flow = Flow { fill: curve(1.0), vent: curve(-1.0) };
        let late = |sign: f64| -> f64 {
            let step = sign * self.typical_step();
            let ramp: Vec<f64> = (0..RAMP).map(|sample| sample as f64 * step).collect();
            (flow.run(&ramp)[RAMP - 1] - respond(&ramp)[RAMP - 1]) / step
        };
        self.delay_samples += f64::max(0.5 * (late(1.0) + late(-1.0)), 0.0);
        for curve in [&mut flow.fill, &mut flow.vent] {
            curve.from.iter_mut().chain(&mut curve.to).for_each(|value| *value *= model.input_scale);
        }
        self.stages.flow = Some(flow);
        Ok(())
    }

    /// Root mean square of the input's steps from sample to sample, normalised.
    fn typical_step(&self) -> f64 {
        let steps = || self.recordings.iter().flat_map(|recording| recording.input.windows(2).map(|pair| pair[1] - pair[0]));
        let squares: f64 = steps().map(|step| step * step).sum();
        ((squares / steps().count().max(1) as f64).sqrt() / self.model.input_scale).max(1e-6)
    }

    /// What growth goes with at a size of the path's step, in input units a sample.
    fn law_of_steps(&self, law: &OperatorLaw) -> Points {
        let (period_s, scale) = (self.model.sample_period_s, self.model.input_scale);
        let rate = |step: f64| step / (scale * period_s);
        if law.rate_scale_per_s == 0.0 || law.rate_scale_per_s > FASTER_THAN_ANY {
            let one = scale * period_s;
            return Points { from: vec![0.0, one], to: vec![0.0, law.saturated(1.0)] };
        }
        let steps = self.recordings.iter().flat_map(|recording| recording.input.windows(2).map(|pair| (pair[1] - pair[0]).abs()));
        let most = (1.0 + MARGIN) * steps.fold(0.0, f64::max);
        Points::near(|steps| steps.iter().map(|step| law.saturated(rate(*step))).collect(), 0.0, most.max(1e-6 * scale))
    }

    fn finish(mut self) -> Result<PhysicsModel, String> {
        let model = self.model;
        let mut input_path = InputPath { dead_time_s: self.delay_samples * model.sample_period_s, lag_time_constant_s: 0.0 };
        // What is a lag and nothing else runs on firmware that knows no stages.
        let only_lag = Stages { flow: self.stages.flow.clone(), ..Stages::default() } == self.stages;
        if let Some(lag_s) = self.lag_s.filter(|_| only_lag) {
            (input_path.lag_time_constant_s, self.stages.flow) = (lag_s, None);
        }
        let gain = model.output_scale / model.input_scale;
        let active = || model.thresholds.iter().zip(&model.weights).filter(|(_, weight)| **weight != 0.0);
        let thresholds: Vec<f64> = active().map(|(threshold, _)| threshold * model.input_scale).collect();
        // A stop is what a play lacks to the input.
        let sign = if model.stops { -1.0 } else { 1.0 };
        let mut weights: Vec<f64> = active().map(|(_, weight)| sign * weight * gain).collect();
        let mut input_gain = 0.0;
        if model.stops {
            // The first operator is the input itself, the others are the input less their plays.
            input_gain = gain * model.weights.iter().sum::<f64>();
            for (weight, threshold) in weights.iter_mut().zip(&thresholds) {
                if *threshold == 0.0 {
                    *weight = 0.0;
                }
            }
        }
        let range = |signal: &Signal, (minimum, maximum): (f64, f64)| ChannelRange {
            quantity: signal.quantity.clone(),
            unit: signal.unit.clone(),
            minimum,
            maximum,
        };
        let source = |recording: &Recording| Source {
            file: recording.path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default(),
            sha256: recording.sha256.clone(),
            samples: recording.len(),
        };
        let mut physics = PhysicsModel {
            format_version: FORMAT_VERSION,
            kind: Kind::PrandtlIshlinskii,
            sample_period_s: model.sample_period_s,
            rest_input: model.input_offset,
            thresholds,
            weights,
            input_gain,
            constant: model.constant * model.output_scale,
            thresholds_95: Vec::new(),
            weights_95: Vec::new(),
            constant_95: None,
            input: range(&model.input, extent(self.recordings.iter().flat_map(|recording| &recording.input))),
            output: range(&model.output, extent(self.recordings.iter().flat_map(|recording| &recording.output))),
            input_path,
            curve: None,
            creep: self.creep.clone(),
            stages: self.stages.clone(),
            provenance: Provenance {
                program: model.origin.program.clone(),
                method: "catheter discover".to_owned(),
                rmse: 0.0,
                nrmse: 0.0,
                samples: self.recordings.iter().map(Recording::len).sum(),
                data: self.recordings.iter().map(source).collect(),
            },
            expected: None,
            nuisances: Vec::new(),
        };
        self.bend(&mut physics)?;
        self.scale_and_zero(&mut physics);
        self.check(physics)
    }

    /// The readout's curve: what all its effects make of the sum, where recordings take that.
    fn bend(&self, physics: &mut PhysicsModel) -> Result<(), String> {
        if self.bends.is_empty() {
            return Ok(());
        }
        let scale = self.model.output_scale;
        let sums = self.recordings.iter().flat_map(|recording| physics.sums(&recording.input));
        let (low, high) = extent(sums.map(|sum| sum / scale).collect::<Vec<_>>().iter());
        let margin = MARGIN * (high - low).max(1.0);
        let bent = |values: &[f64]| self.bends.iter().try_fold(values.to_vec(), |values, &at| self.model.respond(at, &values));
        bent(&[0.0]).map_err(of_file)?;
        let mut curve = Points::near(|values| bent(values).unwrap_or_default(), low - margin, high + margin);
        curve.from.iter_mut().chain(&mut curve.to).for_each(|value| *value *= scale);
        if scale < 0.0 {
            curve.from.reverse();
            curve.to.reverse();
        }
        physics.kind = Kind::ModifiedPrandtlIshlinskii;
        physics.constant += self.gain * curve.to[0];
        physics.curve = Some(Curve { slopes: curve.slopes(), breakpoints: curve.from });
        Ok(())
    }

    /// Gain and zero of the sensor as the session left them.
    fn scale_and_zero(&self, physics: &mut PhysicsModel) {
        let weights: Vec<&mut f64> = match &mut physics.curve {
            Some(curve) => curve.slopes.iter_mut().collect(),
            None => physics.weights.iter_mut().chain([&mut physics.input_gain]).collect(),
        };
        weights.into_iter().for_each(|weight| *weight *= self.gain);
        // The gain is one of the displacement without the constant.
        physics.constant += self.zero * self.model.output_scale;
    }

    /// The model with its own error, if it is the discovered one still.
    fn check(&self, mut physics: PhysicsModel) -> Result<PhysicsModel, String> {
        // The microcontroller knows nothing of what the session's recordings left: its error shows that, and it is no matter of the form.
        let model = DiscoveredModel { memory: Vec::new(), ..self.model.clone() };
        let (mut apart, mut wrong, mut samples) = (0.0, 0.0, 0.0_f64);
        for recording in self.recordings {
            let bounds = [&[0], &recording.gaps[..], &[recording.len()]].concat();
            for bound in bounds.windows(2) {
                let (input, output) = (&recording.input[bound[0]..bound[1]], &recording.output[bound[0]..bound[1]]);
                let found = physics.simulate(input);
                let wanted = model.simulate(input).map_err(of_file)?;
                apart += found.iter().zip(&wanted).map(|(found, wanted)| (found - wanted).powi(2)).sum::<f64>();
                wrong += found.iter().zip(output).map(|(found, output)| (found - output).powi(2)).sum::<f64>();
                samples += input.len() as f64;
            }
        }
        let [apart, wrong] = [apart, wrong].map(|sum| (sum / samples.max(1.0)).sqrt());
        let range = physics.output.maximum - physics.output.minimum;
        if apart.is_nan() || apart > model.origin.rmse.max(ALIKE * range) {
            return Err(format!(
                "its effects in the form they would have there: that departs from the model by {apart:.3} {}, which errs by {:.3} itself",
                model.output.unit, model.origin.rmse
            ));
        }
        physics.front_end().map_err(|error| error.to_string())?;
        physics.provenance.rmse = wrong;
        physics.provenance.nrmse = wrong / range;
        Ok(physics)
    }
}

/// A value between those of points that ascend.
fn interpolated(points: &[(f64, f64)], at: f64) -> f64 {
    let above = points.partition_point(|point| point.0 < at).clamp(1, points.len() - 1);
    let ((low, from), (high, to)) = (points[above - 1], points[above]);
    if high > low { from + (to - from) * (at - low) / (high - low) } else { to }
}

/// Smallest and largest value.
fn extent<'a>(values: impl IntoIterator<Item = &'a f64>) -> (f64, f64) {
    values.into_iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), &value| (low.min(value), high.max(value)))
}

/// What is wrong with the file itself.
fn of_file(problem: String) -> String {
    format!(": {problem}")
}

#[cfg(test)]
mod tests;
