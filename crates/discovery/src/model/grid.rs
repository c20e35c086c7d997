//! The thresholds that a model's operators stand on: a coarse grid to search on, a fine one to judge by.
//!
//! A rig has thresholds of its own. What those between two thresholds of a grid leave looks like a small effect and is none: with
//! twenty random thresholds and no noise the coarse grid leaves up to 0.16 % of the span, the fine one less than half of that. Searching
//! on the fine grid would take three times as long, so parameters are searched on the coarse one, and every comparison that decides
//! something is made on the fine one.

/// Thresholds of the coarse grid, normalised: denser near zero, where operators move on every stroke, and even beyond half the span, where
/// they move on the way to a new peak only.
#[must_use]
pub fn coarse() -> Vec<f64> {
    const DENSE: usize = 18;
    const WIDE: usize = 12;
    let dense = (0..DENSE).map(|index| 0.5 * (index as f64 / (DENSE - 1) as f64).powf(1.5));
    let wide = (1..=WIDE).map(|index| 0.5 + 0.04 * index as f64);
    dense.chain(wide).collect()
}

#[cfg(test)]
mod tests {
    use crate::model::structure::Model;

    use crate::data::session::Session;
    use crate::model::initial_state::InitialState;
    use crate::model::structure::Scope;
    use virtual_rig as rig;
    use virtual_rig::{CaseConfig, Generator};

    /// Root mean square that a plain rig without noise leaves of the selecting samples on both grids, relative to the span.
    fn left_over(generator: Generator, seed: u64) -> [f64; 2] {
        let case = rig::hide(&CaseConfig { seed, noise: 0.0, generator, ..CaseConfig::default() }).expect("a case");
        let session = Session::new(&case.recordings, &[]).expect("a session");
        let mut coarse = Model::baseline(InitialState::carrying(case.truth.continuous), false);
        let on_coarse = coarse.fit(&session, Scope::Both).1;
        let mut fine = coarse.refined();
        let on_fine = fine.fit(&session, Scope::Both).1;
        let pruned = fine.pruned();
        assert!(pruned.thresholds.len() < fine.thresholds.len());
        for run in &session.runs {
            for (x, y) in fine.predict(run).iter().zip(pruned.predict(run)) {
                assert!((x - y).abs() < 1e-12, "operators without weight predict something");
            }
        }
        [on_coarse.sqrt(), on_fine.sqrt()]
    }

    #[test]
    fn a_model_that_is_regrown_stands_on_the_fine_grid_and_predicts_the_same() {
        let case = rig::hide(&CaseConfig { seed: 546, ..CaseConfig::default() }).expect("a case");
        let session = Session::new(&case.recordings[..4], &[]).expect("a session");
        let mut fine = Model::baseline(InitialState::SESSION, false).refined();
        fine.fit(&session, Scope::Both);
        let regrown = fine.pruned().regrown();
        assert_eq!(regrown.thresholds, fine.thresholds);
        assert_eq!(regrown.base, fine.base);
        // One that a valve's mean error has moved off the grid keeps its place.
        let mut off = fine.pruned();
        off.thresholds[1] += 1e-3;
        let grown = off.regrown();
        assert_eq!(grown.thresholds.len(), fine.thresholds.len() + 1);
        assert!(grown.thresholds.is_sorted());
        let (of_off, of_grown) = (off.predict(&session.runs[0]), grown.predict(&session.runs[0]));
        assert!(of_off.iter().zip(of_grown).all(|(x, y)| (x - y).abs() < 1e-12));
    }

    #[test]
    fn the_fine_grid_leaves_less_of_a_plain_rig_than_a_decision_turns_on() {
        for generator in [Generator::Physics, Generator::Rival] {
            for seed in 540..546 {
                let [coarse, fine] = left_over(generator, seed);
                println!("{generator:?} {seed}: {coarse:.6} {fine:.6}");
                assert!(fine < coarse && fine < crate::selection::settings::GRID_ERROR, "{generator:?} {seed}: {coarse} {fine}");
            }
        }
    }
}
