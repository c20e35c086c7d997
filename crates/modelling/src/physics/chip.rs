//! What of the ladder the microcontroller can hold: sums of play operators, or a curve, behind dead time and lag.

use identification::{Basis, LinearModel, OutputPath};

use super::fitted::FittedModel;
use super::model::{ChannelRange, CreepFilters, Curve, FORMAT_VERSION, InputPath, Kind, PhysicsModel, Provenance, Source};

/// A model file in the form that has a front end on the chip; `None` for a mean of several, and where there is none.
#[must_use]
pub fn of_file(file: &FittedModel) -> Option<PhysicsModel> {
    match &file.members[..] {
        [only] => {
            let physics = of_sum(&only.model, &file.inputs, &file.output, &file.data)?;
            Some(PhysicsModel { expected: Some(file.expected.clone()), ..physics })
        }
        _ => None,
    }
}

/// The same of a sum of columns, in the units of the data.
///
/// The two agree to rounding wherever the sum's limits do not act: those lie a tenth of the range beyond the data, and the chip's own
/// limiter does not rest on them.
#[must_use]
pub fn of_sum(model: &LinearModel, inputs: &[ChannelRange], output: &ChannelRange, sources: &[Source]) -> Option<PhysicsModel> {
    let structure = &model.structure;
    let [scaling] = structure.scalings[..] else { return None };
    if structure.output_path != OutputPath::Direct || structure.widening.is_some() {
        return None;
    }
    let plain = structure.columns.iter().all(|column| column.lag.is_none());
    let plays = structure.columns.iter().any(|column| matches!(column.basis, Basis::Play { .. }));
    let ramps = structure.columns.iter().any(|column| matches!(column.basis, Basis::Ramp { .. }));
    if !plain || (plays && ramps) || (plays && structure.rest.is_none()) {
        return None;
    }
    // Where operators rest; a curve has no memory and may count from anywhere.
    let rest = structure.rest.as_ref().and_then(|rest| rest.first()).copied().unwrap_or(-1.0);
    let rest_input = scaling.centre + scaling.half * rest;
    let (mut constant, mut input_gain) = (model.constant, 0.0);
    let mut operators: Vec<(f64, f64)> = Vec::new();
    let mut steps: Vec<(f64, f64, f64)> = Vec::new();
    for (column, &weight) in structure.columns.iter().zip(&model.weights) {
        match column.basis {
            Basis::Polynomial { degree: 1, .. } => {
                input_gain += weight / scaling.half;
                constant += weight * rest;
            }
            // A play operator moves along with what it starts from: H(x) = H(v - rest) / half + rest.
            Basis::Play { threshold, .. } => {
                operators.push((threshold * scaling.half, weight / scaling.half));
                constant += weight * rest;
            }
            Basis::Ramp { from, to, .. } => steps.push((from, to, weight)),
            _ => return None,
        }
    }
    operators.sort_by(|a, b| a.0.total_cmp(&b.0));
    let curve = if steps.is_empty() { None } else { Some(curve(&steps, scaling.half, rest, input_gain)?) };
    if curve.is_some() {
        input_gain = 1.0;
    }
    let physics = PhysicsModel {
        format_version: FORMAT_VERSION,
        kind: if curve.is_some() { Kind::ModifiedPrandtlIshlinskii } else { Kind::PrandtlIshlinskii },
        sample_period_s: structure.sample_period_s,
        rest_input,
        thresholds: operators.iter().map(|one| one.0).collect(),
        weights_95: Vec::new(),
        weights: operators.iter().map(|one| one.1).collect(),
        input_gain,
        constant,
        thresholds_95: Vec::new(),
        constant_95: None,
        input: inputs.first()?.clone(),
        output: output.clone(),
        input_path: InputPath { dead_time_s: structure.dead_time_s, lag_time_constant_s: structure.lag_s },
        curve,
        creep: CreepFilters::default(),
        stages: crate::physics::Stages::default(),
        provenance: Provenance {
            program: format!("catheter {}", env!("CARGO_PKG_VERSION")),
            method: "catheter fit".to_owned(),
            rmse: 0.0,
            nrmse: 0.0,
            samples: sources.iter().map(|source| source.samples).sum(),
            data: sources.to_vec(),
        },
        expected: None,
        nuisances: Vec::new(),
    };
    // More operators or bends than fit?
    physics.front_end().is_ok().then_some(physics)
}

/// Ramps that follow each other from -1 to 1, as a curve of the input less its rest; none when they leave holes.
fn curve(steps: &[(f64, f64, f64)], half: f64, rest: f64, input_gain: f64) -> Option<Curve> {
    let mut steps = steps.to_vec();
    steps.sort_by(|a, b| a.0.total_cmp(&b.0));
    // Segments whose weight is zero were left out of the sum: they are flat.
    let mut edges = vec![-1.0];
    let mut slopes = Vec::new();
    let flat = input_gain;
    for &(from, to, weight) in &steps {
        let last = *edges.last()?;
        if from > last + 1e-9 {
            slopes.push(flat);
            edges.push(from);
        }
        slopes.push(flat + weight / ((to - from) * half));
        edges.push(to);
    }
    if *edges.last()? < 1.0 - 1e-9 {
        slopes.push(flat);
        edges.push(1.0);
    }
    // The constant belongs to the first breakpoint; a straight part counts from the rest.
    (input_gain == 0.0).then(|| Curve { breakpoints: edges.iter().map(|edge| (edge - rest) * half).collect(), slopes })
}
