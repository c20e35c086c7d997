//! The memory of earlier recordings that fits best.

use crate::data::session::Session;
use crate::model::initial_state::InitialState;
use crate::model::structure::{Model, Scope};

/// Share of the mean square that a memory of earlier recordings must leave no more of.
const MEMORY_PAYS: f64 = 0.99;

/// The same of a peak before the session.
const PEAK_PAYS: f64 = 0.997;

/// Steps by which the best of the peaks is moved then, as shares of it.
const REFINEMENTS: [f64; 4] = [0.1, 0.05, 0.025, 0.012];

/// A model with a past, its weights fitted.
pub(crate) struct Remembering {
    pub model: Model,
    /// Mean squares of fitted and of selecting samples.
    pub fit: f64,
    pub select: f64,
}

impl Model {
    /// This model with the initial state that both halves of the recordings fit best, its weights fitted; a longer one must pay.
    pub(crate) fn with_best_initial_state(&self, session: &Session) -> Remembering {
        let of = |initial_state: InitialState| {
            let mut model = Self { initial_state, ..self.clone() };
            let (fit, select) = model.fit(session, Scope::Both);
            Remembering { model, fit, select }
        };
        let mut best = of(InitialState::Fresh);
        let is_worse = |other: &Remembering| best.fit < MEMORY_PAYS * other.fit && best.select < MEMORY_PAYS * other.select;
        // A muscle that forgets between recordings does so whether it was pressed before the first or not.
        let session_only = of(InitialState::SESSION);
        if is_worse(&session_only) && is_worse(&of(InitialState::PRESSED)) {
            return best;
        }
        let peaks = InitialState::PEAKS.map(|peak| (InitialState::Carried { peak }, PEAK_PAYS));
        for (initial_state, pays) in [(InitialState::SESSION, MEMORY_PAYS)].into_iter().chain(peaks) {
            let other = of(initial_state);
            let pays = if best.model.initial_state.is_carried() { pays } else { MEMORY_PAYS };
            // Of peaks the best is wanted, whatever lies between it and the last.
            let pays = if best.model.initial_state.before_the_session().is_empty() { pays } else { 1.0 };
            if other.fit < pays * best.fit && other.select < pays * best.select {
                best = other;
            }
        }
        for step in REFINEMENTS {
            let InitialState::Carried { peak } = best.model.initial_state else { break };
            let beside = [peak * (1.0 - step), peak * (1.0 + step)].into_iter().filter(|peak| *peak > 0.0);
            let others =
                beside.map(|peak| of(InitialState::Carried { peak })).filter(|other| other.fit + other.select < best.fit + best.select);
            best = others.min_by(|x, y| (x.fit + x.select).total_cmp(&(y.fit + y.select))).unwrap_or(best);
        }
        best
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::TAU;
    use std::path::Path;

    use super::*;
    use recording::{Recording, Signal};

    /// Strokes over nearly all of the range, of a muscle that was pressed farther before each of them, and creeps anew in each.
    fn strokes(index: u32) -> Recording {
        const CREEP: f64 = 0.16;
        const OPERATORS: [(f64, f64); 6] = [(0.0, 0.5), (0.08, 0.2), (0.17, 0.2), (0.26, 0.2), (0.35, 0.2), (0.45, 0.2)];
        let top = 1.0 - 0.03 * f64::from(index % 4);
        let mut states = OPERATORS.map(|(threshold, _)| threshold);
        let time_s: Vec<f64> = (0..400).map(|sample| 0.02 * f64::from(sample)).collect();
        let input: Vec<f64> = time_s.iter().map(|time_s| 0.5 * top * (1.0 - (TAU * 0.15 * time_s).cos())).collect();
        let mut crept = 0.0;
        let displacement = |input: &f64| {
            let mut elastic = 0.0;
            for (state, (threshold, weight)) in states.iter_mut().zip(OPERATORS) {
                *state = state.max(input - threshold).min(input + threshold);
                elastic += weight * *state;
            }
            crept += 0.02 / 2.0 * (elastic - crept);
            10.0 * (elastic + CREEP * crept)
        };
        let output = input.iter().map(displacement).collect();
        let path = format!("run{index:02}.csv");
        Recording::new(Path::new(&path), Signal::pressure_bar(), Signal::displacement_mm(), time_s, input, output).expect("a recording")
    }

    #[test]
    fn what_was_before_the_session_is_found_where_the_session_alone_is_worse_than_nothing() {
        let session = Session::new(&(0..12).map(strokes).collect::<Vec<_>>(), &[]).expect("a session");
        let baseline = Model::baseline(InitialState::Fresh, false);
        let of = |initial_state| Model { initial_state, ..baseline.clone() }.fit(&session, Scope::Both);
        let [fresh, alone, pressed] = [InitialState::Fresh, InitialState::SESSION, InitialState::PRESSED].map(of);
        // Operators that begin anew look like creep; those that remember the session are wrong in the first recording.
        let is_better = |one: (f64, f64), other: (f64, f64)| one.0 < 0.9 * other.0 && one.1 < 0.9 * other.1;
        assert!(is_better(fresh, alone) && is_better(pressed, fresh), "{fresh:?}, {alone:?} and {pressed:?}");
        let found = baseline.with_best_initial_state(&session);
        assert!(matches!(found.model.initial_state, InitialState::Carried { peak } if peak > 0.0), "{:?}", found.model.initial_state);
        assert!(found.fit + found.select <= pressed.0 + pressed.1, "{} and {pressed:?}", found.fit);
    }
}
