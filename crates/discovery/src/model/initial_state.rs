//! What the play operators know when a recording begins: nothing, the session's earlier recordings, or also what came before these.
//!
//! A play operator keeps what the peaks of its input left. Where the muscle was pressed before the first recording, its wide operators
//! already stand where that left them, and the first strokes move them late: that looks like a threshold, a softening or a changed set-up
//! in the first recordings and is none of them. One peak from before the session tells nearly all of it.

/// What the operators know when a recording begins.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum InitialState {
    /// Nothing: they begin anew in every recording.
    Fresh,
    /// The earlier recordings of the session, and what came before these.
    Carried {
        /// Highest input before the session, normalised; zero when it has never been pressed.
        peak: f64,
    },
}

impl InitialState {
    /// Operators that remember the session and nothing before it.
    pub const SESSION: Self = Self::Carried { peak: 0.0 };
    /// Operators that were moved as far as they go before the session.
    pub const PRESSED: Self = Self::Carried { peak: 2.0 };
    /// Highest inputs before the session that are tried. Twice the span moves every operator as far as it goes.
    pub const PEAKS: [f64; 9] = [0.2, 0.35, 0.5, 0.65, 0.8, 1.0, 1.2, 1.5, 2.0];

    /// Whether operators remember earlier recordings.
    #[must_use]
    pub fn is_carried(self) -> bool {
        self != Self::Fresh
    }

    /// Operators that remember the session, or none.
    #[cfg(test)]
    pub fn carrying(carries: bool) -> Self {
        if carries { Self::SESSION } else { Self::Fresh }
    }

    /// Turning points before the session, the first where no operator had moved yet.
    pub(crate) fn before_the_session(self) -> Vec<f64> {
        match self {
            Self::Carried { peak } if peak > 0.0 => vec![0.0, peak],
            _ => Vec::new(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::data::session::Session;
    use crate::discover;
    use crate::model::structure::{Model, Scope};
    use crate::result::{DiscoverConfig, Discovery, Verdict};
    use crate::tests::deviates;
    use recording::{Recording, Signal};
    use std::path::Path;

    /// Operators of the closed-form muscle: threshold and weight.
    const OPERATORS: [(f64, f64); 8] =
        [(0.0, 0.5), (0.07, 0.2), (0.15, 0.18), (0.24, 0.15), (0.31, 0.2), (0.38, 0.12), (0.43, 0.15), (0.47, 0.1)];

    /// Twelve decaying sines of a muscle that remembers, pressed to `peak` before the first of them. Its gain is less by `missing` where it has
    /// not been stretched since the recording began.
    fn session(peak: f64, missing: f64) -> Vec<Recording> {
        let mut noise = deviates(0x9E37_79B9_7F4A_7C15);
        let mut plays = OPERATORS.map(|(threshold, _)| (peak - threshold).max(0.0).min(threshold));
        let mut record = |index: usize| {
            let (frequency_hz, decay_per_s) = ([0.15, 0.3, 0.5, 0.7][index % 4], [0.02, 0.06, 0.12][index / 4]);
            let top = [0.6, 0.8, 1.0, 0.9][index % 4];
            let (mut times, mut inputs, mut outputs) = (Vec::new(), Vec::new(), Vec::new());
            let mut highest: f64 = 0.0;
            for sample in 0..1100_u32 {
                let time_s = f64::from(sample) * 0.02;
                let stroke_s = (time_s - 2.0).max(0.0);
                let input = 0.5 * top * (-decay_per_s * stroke_s).exp() * (1.0 - (std::f64::consts::TAU * frequency_hz * stroke_s).cos());
                highest = highest.max(input);
                let mut place = 0.0;
                for (state, (threshold, weight)) in plays.iter_mut().zip(OPERATORS) {
                    *state = state.max(input - threshold).min(input + threshold);
                    place += weight * *state;
                }
                times.push(time_s);
                inputs.push(input);
                outputs.push(10.0 * place * (1.0 - missing * (1.0 - highest)) + 0.05 * noise());
            }
            // It is let off before the next one.
            for (state, (threshold, _)) in plays.iter_mut().zip(OPERATORS) {
                *state = state.min(threshold);
            }
            let path = format!("run{index:02}.csv");
            Recording::new(Path::new(&path), Signal::pressure_bar(), Signal::displacement_mm(), times, inputs, outputs)
                .expect("a recording")
        };
        (0..12).map(&mut record).collect()
    }

    fn found(recordings: &[Recording]) -> Discovery {
        discover(recordings, &[], &DiscoverConfig { most_effects: 1, ..DiscoverConfig::default() }).expect("a finding").discovery
    }

    #[test]
    fn a_muscle_that_was_pressed_before_the_session_lacks_nothing() {
        for peak in [0.0, 0.6, 2.0] {
            let recordings = session(peak, 0.0);
            let discovery = found(&recordings);
            assert_eq!(discovery.verdict, Verdict::None, "pressed to {peak}: {discovery:?}");
        }
        // With operators that begin at rest these recordings would be no test.
        let pressed = Session::new(&session(2.0, 0.0), &[]).expect("a session");
        let left = |initial_state: InitialState| Model::baseline(initial_state, false).refined().fit(&pressed, Scope::Both).1;
        let (at_rest, before) = (left(InitialState::SESSION), left(InitialState::Carried { peak: 2.0 }));
        assert!(at_rest > 1.3 * before, "{at_rest} and {before}");
    }

    #[test]
    fn softening_by_the_largest_load_is_named_with_its_size() {
        let discovery = found(&session(0.0, 0.25));
        let named: Vec<&str> = discovery.effects.iter().map(|effect| effect.name.as_str()).collect();
        assert_eq!((discovery.verdict, named), (Verdict::Named, vec!["first-cycle-softening"]), "{:?}", discovery.effects);
        let missing = discovery.effects[0].parameters["missing_gain"];
        assert!((missing / 0.25 - 1.0).abs() < 0.05, "{missing}");
        assert!(discovery.gap_closed > 0.97, "{}", discovery.gap_closed);
    }
}
