//! From recordings to a session: common scales, stretches between gaps, rest, roles.

use std::sync::Arc;

use recording::{Recording, Signal};

use crate::data::late_steps;
use crate::data::session::{MOST_OTHERS, OtherInput, Role, Run, Session, SessionError};
use crate::data::test_view::TestView;
use crate::data::turning::remember;
use crate::data::worked::worked_with;

fn span(values: impl Iterator<Item = f64>) -> (f64, f64) {
    values.fold((f64::MAX, f64::MIN), |(low, high), value| (low.min(value), high.max(value)))
}

impl Session {
    /// Makes recordings ready. `kept` take no part in any choice; when there are none, some of `recordings` are set apart. The session has no
    /// outputs of theirs.
    ///
    /// # Errors
    /// When there is too little or nothing moving.
    pub fn new(recordings: &[Recording], kept: &[Recording]) -> Result<Self, SessionError> {
        Self::split(recordings, kept).map(|(session, _)| session)
    }

    /// As [`Self::new`], with the outputs that are kept out apart.
    ///
    /// # Errors
    /// As [`Self::new`].
    pub fn split(recordings: &[Recording], kept: &[Recording]) -> Result<(Self, TestView), SessionError> {
        let first = recordings.first().ok_or(SessionError::Empty)?;
        let samples: usize = recordings.iter().map(Recording::len).sum();
        if samples < 400 {
            return Err(SessionError::TooShort { samples });
        }
        for recording in recordings.iter().chain(kept) {
            if (recording.sample_period_s / first.sample_period_s - 1.0).abs() > 0.05 {
                return Err(SessionError::Period {
                    path: recording.path.display().to_string(),
                    found_s: recording.sample_period_s,
                    expected_s: first.sample_period_s,
                });
            }
        }
        let (lowest, highest) = span(recordings.iter().flat_map(|recording| recording.input.iter().copied()));
        if highest - lowest <= 1e-12 * highest.abs().max(1e-12) {
            return Err(SessionError::StillInput { value: lowest });
        }
        let others = others(recordings, kept)?;
        // Zero stays zero unless the input never comes near it.
        let input_offset = if lowest > 0.1 * highest { lowest } else { 0.0 };
        let input_scale = (highest - input_offset).abs().max((lowest - input_offset).abs());
        let session_column = |recording: &Recording| {
            recording.extra.iter().find(|column| column.name == "session_time_s").map(|column| column.values.clone())
        };
        let has_session_time = recordings.iter().all(|recording| session_column(recording).is_some());
        let mut clock_s = 0.0;
        let mut runs = Vec::new();
        for (position, recording) in recordings.iter().chain(kept).enumerate() {
            let origin = recording.time_s[0];
            let time_s: Vec<f64> = recording.time_s.iter().map(|time| time - origin).collect();
            let session_s = match session_column(recording) {
                Some(column) if has_session_time => column,
                _ => time_s.iter().map(|time| time + clock_s).collect(),
            };
            clock_s += time_s[time_s.len() - 1] + recording.sample_period_s;
            let role = if position < recordings.len() { Role::Fit } else { Role::Test };
            let name =
                recording.path.file_name().map_or_else(|| recording.path.display().to_string(), |name| name.to_string_lossy().into_owned());
            let segments = recording.segments();
            for (part, segment) in segments.iter().enumerate() {
                // Nobody knows what the input did in a gap: what follows is a run of its own.
                if segment.len() < 50 {
                    continue;
                }
                let input: Vec<f64> = recording.input[segment.clone()].iter().map(|value| (value - input_offset) / input_scale).collect();
                let output = recording.output[segment.clone()].to_vec();
                let channels = others.iter().zip(&recording.more_inputs);
                let others = channels.map(|(other, channel)| other.normalised(&channel.values[segment.clone()])).collect();
                let rest = rest_of(&input, recording.sample_period_s);
                runs.push(Run {
                    name: if segments.len() > 1 { format!("{name} from sample {}", segment.start) } else { name.clone() },
                    file: name.clone(),
                    index: 0,
                    source: (position, segment.start),
                    sha256: recording.sha256.clone(),
                    part,
                    period_s: recording.sample_period_s,
                    keep: vec![true; input.len()],
                    screens: true,
                    role: vec![role; input.len()],
                    input,
                    others,
                    output,
                    session_s: session_s[segment.clone()].to_vec(),
                    time_s: time_s[segment.clone()].iter().map(|time| time - time_s[segment.start]).collect(),
                    rest,
                    history: Vec::new(),
                    beginning: None,
                    earlier: None,
                    session: Arc::default(),
                });
            }
        }
        if !runs.iter().any(|run| run.role[0] == Role::Fit) {
            return Err(SessionError::TooShort { samples: 0 });
        }
        runs.sort_by(|x, y| x.session_s[0].total_cmp(&y.session_s[0]));
        let origin = runs[0].session_s[0];
        let mut history: Vec<f64> = Vec::new();
        let mut steps = Vec::new();
        for (index, run) in runs.iter_mut().enumerate() {
            run.index = index;
            for value in &mut run.session_s {
                *value -= origin;
            }
            run.history.clone_from(&history);
            remember(&mut history, &run.input);
            steps.extend(run.input.windows(2).map(|pair| (pair[1] - pair[0]).abs() / run.period_s));
        }
        assign_roles(&mut runs, kept.is_empty());
        // The span of the output is taken between quantiles, or one wild sample would set the scale.
        let mut outputs: Vec<f64> = runs.iter().flat_map(|run| worked_with(run, &run.output)).collect();
        outputs.sort_by(f64::total_cmp);
        let output_scale = outputs[outputs.len() - 1 - outputs.len() / 200] - outputs[outputs.len() / 200];
        if output_scale <= 1e-12 * outputs[0].abs().max(1e-12) {
            return Err(SessionError::StillOutput { value: outputs[0] });
        }
        // A falling characteristic is turned round, so that weights are positive on any rig.
        let output_scale = if correlation(&runs) < 0.0 { -output_scale } else { output_scale };
        runs.iter_mut().flat_map(|run| &mut run.output).for_each(|value| *value /= output_scale);
        let test = TestView::withhold(&mut runs);
        let all = Arc::new(runs.clone());
        runs.iter_mut().for_each(|run| run.session = Arc::clone(&all));
        steps.sort_by(f64::total_cmp);
        let fastest_per_s = steps[steps.len() - 1 - steps.len() / 200].max(1e-9);
        let length_s = runs.iter().filter_map(|run| run.session_s.last().copied()).fold(1.0, f64::max);
        let mut session = Self {
            runs,
            input_offset,
            input_scale,
            others,
            output_scale,
            input_unit: first.input_signal.unit.clone(),
            output_unit: first.output_signal.unit.clone(),
            output_step: usual_step(&outputs) / output_scale.abs(),
            origin_s: origin,
            length_s,
            has_session_time,
            fastest_per_s,
        };
        session.screen_some();
        for (run, sample) in late_steps::on_either_side(&session.runs) {
            session.runs[run].role[sample] = Role::Nothing;
        }
        Ok((session, test))
    }

    /// A third of the fitted recordings takes the first, coarse look: every third by how fast their input is, the fastest first, so that
    /// slow and fast motion are both among them.
    pub fn screen_some(&mut self) {
        let mut fitted: Vec<(f64, usize)> = Vec::new();
        if self.runs.iter().any(|run| run.role.contains(&Role::Fit) && run.role.contains(&Role::Select)) {
            return;
        }
        for (index, run) in self.runs.iter_mut().enumerate() {
            run.screens = false;
            if run.role[0] == Role::Fit {
                let travel: f64 = run.input.windows(2).map(|pair| (pair[1] - pair[0]).powi(2)).sum();
                fitted.push((travel / run.input.len() as f64, index));
            }
        }
        fitted.sort_by(|x, y| y.0.total_cmp(&x.0));
        for &(_, index) in fitted.iter().step_by(3) {
            self.runs[index].screens = true;
        }
    }
}

/// The further inputs, which all recordings must have.
fn others(recordings: &[Recording], kept: &[Recording]) -> Result<Vec<OtherInput>, SessionError> {
    let signals = |recording: &Recording| -> Vec<String> {
        let further = recording.more_inputs.iter().map(|channel| &channel.signal);
        std::iter::once(&recording.input_signal).chain(further).map(Signal::column).collect()
    };
    let expected = signals(&recordings[0]);
    let differs = |recording: &&Recording| signals(recording) != expected || expected.len() > MOST_OTHERS + 1;
    if let Some(other) = recordings.iter().chain(kept).find(differs) {
        let [found, expected] = [signals(other), expected].map(|signals| signals.join(", "));
        return Err(SessionError::OtherInputs { path: other.path.display().to_string(), found, expected });
    }
    let of = |at: usize| {
        let (lowest, highest) = span(recordings.iter().flat_map(|recording| recording.more_inputs[at].values.iter().copied()));
        // One that rests has no span.
        let scale = if highest > lowest { highest - lowest } else { 1.0 };
        OtherInput { signal: recordings[0].more_inputs[at].signal.clone(), offset: lowest, scale }
    };
    Ok((0..recordings[0].more_inputs.len()).map(of).collect())
}

/// Every other recording selects; without recordings of their own, one in six is kept out. Few recordings are cut into blocks.
fn assign_roles(runs: &mut [Run], keep_some: bool) {
    let own: Vec<usize> = (0..runs.len()).filter(|&run| runs[run].role[0] == Role::Fit).collect();
    if own.len() >= 6 {
        for (position, &run) in own.iter().enumerate() {
            // Neighbours take turns, and turn about every eight so that no operator law of the session's order falls on one role only.
            let role = if keep_some && position % 6 == 4 {
                Role::Test
            } else if (position + position / 8) % 2 == 0 {
                Role::Fit
            } else {
                Role::Select
            };
            runs[run].role.fill(role);
        }
        return;
    }
    for &run in &own {
        let run = &mut runs[run];
        let blocks = 12;
        let length = run.input.len().div_ceil(blocks);
        for (sample, role) in run.role.iter_mut().enumerate() {
            let block = sample / length;
            *role = if keep_some && block % 6 == 5 {
                Role::Test
            } else if block % 2 == 0 {
                Role::Fit
            } else {
                Role::Select
            };
        }
    }
}

/// Median distance between neighbouring values that differ, of values in order: the step of whatever rounded them.
fn usual_step(ordered: &[f64]) -> f64 {
    let mut steps: Vec<f64> = ordered.windows(2).map(|pair| pair[1] - pair[0]).filter(|step| *step > 0.0).collect();
    steps.sort_by(f64::total_cmp);
    steps.get(steps.len() / 2).copied().unwrap_or(0.0)
}

/// Correlation of input and output over all that is worked with.
fn correlation(runs: &[Run]) -> f64 {
    let pairs = || runs.iter().flat_map(|run| worked_with(run, &run.input).into_iter().zip(worked_with(run, &run.output)));
    let count = pairs().count() as f64;
    let (x, y) = pairs().fold((0.0, 0.0), |(x, y), (input, output)| (x + input / count, y + output / count));
    pairs().map(|(input, output)| (input - x) * (output - y)).sum()
}

/// Stretches in which the input does not move, without their first 0.1 s.
fn rest_of(input: &[f64], period_s: f64) -> Vec<std::ops::Range<usize>> {
    let mut found = Vec::new();
    let mut start = 0;
    for index in 1..=input.len() {
        if index == input.len() || (input[index] - input[start]).abs() > 1e-4 {
            let skip = if start == 0 { 0 } else { (0.1 / period_s).ceil() as usize };
            if (index - start) as f64 * period_s >= 0.6 && index > start + skip + 8 {
                found.push(start + skip..index);
            }
            start = index;
        }
    }
    found
}
