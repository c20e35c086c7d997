//! The verdict and the figures that go with it.

use std::collections::BTreeMap;

use crate::chain::form::{Drive, Parameter, Place};
use crate::data::noise;
use crate::data::session::{Role, Run, Session};
use crate::data::strokes;
use crate::effects::catalogue;
use crate::explanation::intervals;
use crate::model::changes::in_a_gap;
use crate::model::structure::{Model, Slot};
use crate::result::{Discovery, Effect, RunnerUp, Verdict};
use crate::selection::criterion::sources;
use crate::selection::decision::Decision;
use crate::selection::found::Found;
use crate::selection::leaves::{Left, gains, one_step_ahead, rmse, worked};
use crate::selection::settings::{FEWEST_FOR_HALVES, GRID_ERROR, HALF, MATERIAL_SHARE, STANDS_OUT, UNEXPLAINED};

/// Whether an effect that differs between recordings has about as many values as there are recordings: one step for each file is no drift, but a zero
/// of its own in each.
fn is_confounded(session: &Session, slot: &Slot) -> bool {
    slot.form.spec().is_between_recordings && sources(session).len() < FEWEST_FOR_HALVES
}

/// Share of a parameter's range next to a limit that counts as the limit.
const AT_A_LIMIT: f64 = 1e-3;

/// How far an effect can be believed by what is known of its parameters: 1 when all are known exactly, and no more than [`HALF`] when
/// one could lie anywhere in its range; between these by the share of the variance of the one known least that is left. One at a limit of the search
/// could lie anywhere beyond; where the law is a simpler one, none is missed.
fn determined(slot: &Slot, half_widths: &[f64]) -> f64 {
    if slot.form.spec().discrete {
        return 1.0;
    }
    let of = |((at, parameter), (&value, &half)): ((usize, &Parameter), (&f64, &f64))| {
        let share = parameter.share(value);
        if slot.form.does_without(at, [value - half, value + half]) {
            0.0
        } else if share.min(1.0 - share) < AT_A_LIMIT {
            1.0
        } else {
            parameter.share(value + half) - parameter.share(value - half)
        }
    };
    let widest = slot.form.parameters().iter().enumerate().zip(slot.parameters.iter().zip(half_widths)).map(of).fold(0.0, f64::max);
    1.0 - (1.0 - HALF) * widest * widest
}

/// Share of the mean square above the noise that a model closes on test recordings, 0 to 1; nothing where there was no gap.
fn closed(before: f64, after: f64, floor: f64) -> Option<f64> {
    let excess = |rmse: f64| (rmse * rmse - floor * floor).max(0.0);
    (before > STANDS_OUT * floor).then(|| if after > STANDS_OUT * floor { 1.0 - excess(after) / excess(before) } else { 1.0 })
}

/// Share of the gap closed, 0 to 1.
fn gap_closed(before: f64, after: f64, floor: f64) -> f64 {
    let gap = before - floor;
    if gap > 0.0 { ((before - after) / gap).clamp(0.0, 1.0) } else { 0.0 }
}

impl Discovery {
    /// Whether the simulation without the effects errs by more than the noise on test samples.
    #[must_use]
    pub fn stands_out(&self) -> bool {
        self.rmse_before > STANDS_OUT * self.noise_floor
    }

    /// Whether the model with what was found errs by more than the one without, and by more than the noise where nothing was found.
    #[must_use]
    pub fn is_worse(&self) -> bool {
        self.rmse_after > self.rmse_before && (!self.effects.is_empty() || self.rmse_after > STANDS_OUT * self.noise_floor)
    }

    /// Whether more stays unexplained than beside an effect by the catalogue's law.
    #[must_use]
    pub fn leaves_much(&self) -> bool {
        self.unexplained > UNEXPLAINED[0]
    }
}

/// What jumps, and what the model errs by without it on test recordings, in simulation and one step ahead.
pub struct Jumping {
    /// Its effect.
    pub name: &'static str,
    /// What it breaks away by.
    pub drive: Drive,
    /// RMSE of the simulation of the smooth model.
    pub smooth: f64,
    /// RMSE of the smooth observer, and of the one that knows the jumps.
    pub one_step: [f64; 2],
    /// What the one that knows the jumps gains in the log predictive density, nats per sample: where they were found, and on test recordings.
    pub gains: [f64; 2],
    /// Another effect that jumps and gains nearly as much where they were found: by another law of its own it may be the cause.
    pub rival: Option<&'static str>,
}

impl Jumping {
    /// Of a model in which something jumps; `of_each` is what every effect that jumps gains where they were found.
    pub fn of(session: &Session, after: &Model, of_each: &[(&'static str, f64)], threads: usize) -> Option<Self> {
        let slot = after.slots.iter().find(|slot| slot.form.jumps().is_some())?;
        let in_a_gap = in_a_gap(session, after);
        let drive = slot.form.jumps()?;
        let error = |residual: &[Vec<f64>]| rmse(session, residual, Role::Test, &in_a_gap, false) * session.output_scale.abs();
        let (mut smooth, missed) = one_step_ahead(session, after, threads)?;
        let one_step = missed.map(|missed| error(&missed));
        smooth.fit_all(session);
        let name = slot.form.name();
        let own = of_each.iter().find(|(one, _)| *one == name).map_or(f64::MAX, |one| one.1);
        let may_be = |(other, gain): &&(&str, f64)| *other != name && *gain >= (1.0 - UNEXPLAINED[1]) * own;
        let rival = of_each.iter().find(may_be).map(|(other, _)| *other);
        let (smooth, gains) = (error(&smooth.residuals(session)), gains(session, after, &smooth));
        Some(Self { name, drive, smooth, one_step, gains, rival })
    }

    /// Share of what knowing the jumps gains where they were found that it gains on test recordings as well, 0 to 1.
    fn kept(&self) -> f64 {
        let [found, test] = self.gains;
        if found > 0.0 { (test / found).clamp(0.0, 1.0) } else { 0.0 }
    }
}

/// Takes the figures of the simulation, and of the observers where something jumps. What closes less than half of the mean square above the noise on
/// test recordings is not named, and believed by no more than that share; what jumps has to close half of what the model without it leaves, or to gain
/// there half of what it gains where it was found, a valve in simulation. `span` is that of the output.
pub fn confirm(discovery: &mut Discovery, before: f64, after: f64, span: f64, jumping: Option<Jumping>) {
    let floor = discovery.noise_floor;
    (discovery.rmse_before, discovery.rmse_after) = (before, after);
    discovery.gap_closed = gap_closed(before, after, floor);
    let beyond_grid = after * after > floor * floor + (GRID_ERROR * span).powi(2);
    discovery.errs_kept_out_only = discovery.verdict == Verdict::None && after > STANDS_OUT * floor && beyond_grid;
    let observed = jumping.as_ref().map(Jumping::kept);
    if let Some(jumping) = jumping {
        let [smooth, jumps] = jumping.one_step;
        (discovery.rmse_before_one_step, discovery.rmse_after_one_step) = (Some(smooth), Some(jumps));
        discovery.gap_closed_one_step = Some(gap_closed(smooth, jumps, floor));
        let own = closed(jumping.smooth, after, floor);
        // Where the smooth model leaves nothing, jumps are not confirmed.
        let confirmed = own.map_or(HALF, |own| own.max(jumping.kept()));
        // A valve moves by the command alone, and a simulation follows it: what it does not follow may as well be a tip that sticks.
        let sticks = (jumping.drive == Drive::Command).then_some(STICKING);
        let rival = jumping.rival.or(sticks).filter(|_| own.is_none_or(|share| share <= HALF));
        if let Some(rival) = rival {
            discovery.runner_up = Some(RunnerUp { name: rival.to_owned(), separable: false });
        }
        bound(discovery, if rival.is_some() { confirmed.min(HALF) } else { confirmed }, |name| name == jumping.name);
    }
    // What jumps is confirmed by either.
    let Some(share) = closed(before, after, floor).into_iter().chain(observed).reduce(f64::max) else { return };
    bound(discovery, share, |name| name != OUTLIERS);
}

/// Believes the effects of these names by no more than the share of what they are for that they close on test recordings, where it is half or less.
fn bound(discovery: &mut Discovery, share: f64, meant: impl Fn(&str) -> bool) {
    if share > HALF {
        return;
    }
    for effect in discovery.effects.iter_mut().filter(|effect| meant(&effect.name)) {
        effect.confidence = effect.confidence.min(share.max(0.0));
        if discovery.verdict == Verdict::Named {
            discovery.verdict = Verdict::Ambiguous;
        }
    }
}

/// A tip that sticks.
const STICKING: &str = "stick-slip";

/// What the mask names.
const OUTLIERS: &str = "outliers";

/// The verdict and the figures.
pub fn judge(session: &Session, residual_before: &[Vec<f64>], decision: &Decision, found: &Found) -> Discovery {
    let after = &decision.model;
    let residual_after = after.residuals(session);
    let total: usize = session.runs.iter().map(|run| run.role.iter().filter(|role| **role != Role::Test).count()).sum();
    let wrong = |run: &Run| run.keep.iter().zip(&run.role).filter(|(keep, role)| !**keep && **role != Role::Test).count();
    let excluded: usize = session.runs.iter().map(wrong).sum();
    let floor = noise::floor(session, &residual_after);
    let scale = session.output_scale.abs();
    let with_outliers = excluded * 2000 > total;
    let in_a_gap = in_a_gap(session, after);
    let rmse_before = rmse(session, residual_before, Role::Select, &in_a_gap, with_outliers);
    let rmse_after = rmse(session, &residual_after, Role::Select, &in_a_gap, false);
    // Effects are judged by the samples that were worked with: the session has no others.
    let (was, is) = (worked(session, residual_before, with_outliers), worked(session, &residual_after, false));
    // A simulation of what jumps misses the times of the jumps as much as an observer does.
    let jumping = |name: &str| catalogue::forms().iter().any(|form| form.name() == name && form.jumps().is_some());
    let jumps = after.names().any(jumping);
    let [strokes, unlike] = strokes::count(session);
    // A stroke once more confirms what comes with time; of a law it says the same again.
    let asked = |slot: &Slot| if slot.form.spec().place == Place::Sensor { strokes } else { unlike };
    let few_strokes = after.slots.iter().map(asked).min().unwrap_or(unlike) < FEWEST_FOR_HALVES;
    let confounded = few_strokes || after.slots.iter().any(|slot| is_confounded(session, slot));
    let scatter = found.jump_scatter.filter(|_| jumps).unwrap_or(0.0);
    let left = Left::new(was, is - scatter, floor * floor);
    let mut effects: Vec<Effect> = Vec::new();
    let half_widths = intervals::half_widths_over_forms(after, session, (is - scatter - floor * floor).max(0.0));
    for name in &decision.order {
        let before: usize = after.slots.iter().take_while(|slot| slot.form.name() != *name).map(|slot| slot.parameters.len()).sum();
        let Some(slot) = after.slots.iter().find(|slot| slot.form.name() == *name) else { continue };
        let mut parameters: BTreeMap<String, f64> =
            slot.form.parameters().iter().zip(&slot.parameters).map(|(parameter, &value)| parameter.tell(value, session)).collect();
        parameters.extend(slot.form.tell(&slot.parameters, &slot.weights, session));
        let known = slot.form.parameters().iter().zip(&slot.parameters).zip(&half_widths[before..]).filter(|(_, half)| **half > 0.0);
        let interval = |((parameter, &value), half): ((&Parameter, &f64), &f64)| {
            let (name, low) = parameter.tell((value - half).max(parameter.low), session);
            (name, [low, parameter.tell((value + half).min(parameter.high), session).1])
        };
        let intervals = known.map(interval).collect();
        effects.push(Effect {
            name: (*name).to_owned(),
            form: slot.form.form().to_owned(),
            confidence: decision
                .compared
                .probability(name)
                .min(determined(slot, &half_widths[before..before + slot.parameters.len()]))
                // What stands beside such an effect was found with its help.
                .min(if confounded { HALF } else { 1.0 }),
            parameters,
            intervals,
        });
    }
    if with_outliers {
        let share = excluded as f64 / total as f64;
        effects.push(Effect {
            name: OUTLIERS.to_owned(),
            form: "samples that no motion could have caused".to_owned(),
            confidence: 0.99,
            parameters: BTreeMap::from([("share".to_owned(), share)]),
            intervals: BTreeMap::new(),
        });
    }
    if left.is_too_much() {
        // A catalogue that lacks the cause may hold something like it: nothing of what explains a part is believed by more.
        effects.iter_mut().for_each(|effect| effect.confidence = effect.confidence.min(HALF));
    }
    let verdict = if left.is_another_cause() || left.stands_out && effects.is_empty() {
        Verdict::Unknown
    } else if effects.is_empty() {
        Verdict::None
    } else if decision.compared.set.len() > 1 || confounded || left.is_too_much() {
        Verdict::Ambiguous
    } else {
        Verdict::Named
    };
    let kept_out = session.runs.iter().flat_map(kept_out_of).collect();
    let side_unknown = session.runs.iter().zip(&in_a_gap).filter(|(_, in_a_gap)| **in_a_gap).map(|(run, _)| run.name.clone()).collect();
    let noise_floor = floor * scale;
    Discovery {
        verdict,
        effects,
        runner_up: decision.runner_up.clone(),
        rmse_before: rmse_before * scale,
        rmse_after: rmse_after * scale,
        noise_floor,
        gap_closed: gap_closed(rmse_before, rmse_after, floor),
        unexplained: if left.stands_out { left.share } else { 0.0 },
        criterion: Some(decision.compared.gain(decision.compared.best())),
        confidence_set: decision.compared.set.iter().map(|member| decision.compared.member(member)).collect(),
        candidates: found.candidates.clone(),
        strokes,
        unlike_strokes: unlike,
        few_strokes,
        excluded_samples: excluded,
        kept_out,
        side_unknown,
        ..Discovery::default()
    }
}

/// Names of test recordings whose input goes beyond that of all that was worked with by more than anybody cares about.
pub fn beyond_range(session: &Session) -> Vec<String> {
    let reach = |run: &Run, counts: fn(Role) -> bool| {
        let values = run.input.iter().zip(&run.role).filter(|(_, role)| counts(**role)).map(|(value, _)| *value);
        values.fold([f64::MAX, f64::MIN], |[low, high], value| [low.min(value), high.max(value)])
    };
    let worked = session.runs.iter().map(|run| reach(run, Role::is_worked_with));
    let [low, high] = worked.fold([f64::MAX, f64::MIN], |all, run| [all[0].min(run[0]), all[1].max(run[1])]);
    let goes_beyond = |run: &&Run| {
        let [lowest, highest] = reach(run, |role| role == Role::Test);
        lowest < low - MATERIAL_SHARE || highest > high + MATERIAL_SHARE
    };
    session.runs.iter().filter(goes_beyond).map(|run| run.name.clone()).collect()
}

/// What of a recording takes no part in any choice: all of it by its name, or its blocks by their times.
fn kept_out_of(run: &Run) -> Vec<String> {
    if !run.is_worked_with() {
        return run.role.contains(&Role::Test).then(|| run.name.clone()).into_iter().collect();
    }
    let mut first = 0;
    let mut names = Vec::new();
    for block in run.role.chunk_by(|one, other| one == other) {
        let last = first + block.len() - 1;
        if block[0] == Role::Test {
            names.push(format!("{} from {:.2} to {:.2} s", run.name, run.time_s[first], run.time_s[last]));
        }
        first = last + 1;
    }
    names
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use recording::{Recording, Signal};

    use super::*;

    /// A dead time and what jumps, both believed, and noise of 0.1.
    fn named(jumps: &str) -> Discovery {
        let effect = |name: &str| Effect {
            name: name.to_owned(),
            form: String::new(),
            confidence: 0.99,
            parameters: BTreeMap::new(),
            intervals: BTreeMap::new(),
        };
        Discovery {
            verdict: Verdict::Named,
            effects: ["dead-time", jumps].map(effect).to_vec(),
            noise_floor: 0.1,
            strokes: FEWEST_FOR_HALVES,
            ..Discovery::default()
        }
    }

    /// Verdict and confidences after these errors: of the simulation without and with the effects, and of that without the jumps; and these gains of
    /// the observer that knows the jumps.
    fn confirmed(drive: Drive, [before, after, smooth]: [f64; 3], gains: [f64; 2]) -> (Verdict, Vec<f64>) {
        let name = if drive == Drive::Command { "valve-dead-band" } else { "stick-slip" };
        let mut discovery = named(name);
        confirm(&mut discovery, before, after, 1.0, Some(Jumping { name, drive, smooth, one_step: [0.2, 0.2], gains, rival: None }));
        let may_stick = discovery.runner_up.is_some_and(|second| second.name == "stick-slip" && !second.separable);
        assert_eq!(may_stick, drive == Drive::Command && smooth <= after);
        (discovery.verdict, discovery.effects.iter().map(|effect| effect.confidence).collect())
    }

    #[test]
    fn jumps_are_believed_by_what_they_close_beside_everything_else() {
        for drive in [Drive::Command, Drive::QuasiStatic] {
            assert_eq!(confirmed(drive, [1.0, 0.1, 0.5], [0.1, 0.0]), (Verdict::Named, vec![0.99, 0.99]));
            // The dead time closes the gap, and the jumps nothing.
            assert_eq!(confirmed(drive, [1.0, 0.15, 0.15], [0.1, -0.1]), (Verdict::Ambiguous, vec![0.99, 0.0]));
            // Where the smooth model leaves no more than the noise, there is nothing to confirm them by.
            assert_eq!(confirmed(drive, [1.0, 0.1, 0.1], [0.1, 0.1]), (Verdict::Ambiguous, vec![0.99, HALF]));
        }
        // One step ahead where a simulation cannot follow, which of a valve it can.
        assert_eq!(confirmed(Drive::QuasiStatic, [1.0, 0.5, 0.5], [0.1, 0.09]), (Verdict::Named, vec![0.99, 0.99]));
        assert_eq!(confirmed(Drive::QuasiStatic, [1.0, 0.5, 0.5], [0.5, 0.125]), (Verdict::Ambiguous, vec![0.99, 0.25]));
        assert_eq!(confirmed(Drive::Command, [1.0, 0.5, 0.5], [0.1, 0.09]), (Verdict::Ambiguous, vec![0.99, HALF]));
    }

    #[test]
    fn a_tip_that_a_valve_explains_nearly_as_well_is_believed_by_half() {
        let of = |rival, after: f64| {
            let mut discovery = named("stick-slip");
            let jumping =
                Jumping { name: "stick-slip", drive: Drive::QuasiStatic, smooth: 0.5, one_step: [0.2, 0.2], gains: [0.5; 2], rival };
            confirm(&mut discovery, 1.0, after, 1.0, Some(jumping));
            (discovery.effects[1].confidence, discovery.runner_up.map(|second| second.name))
        };
        assert_eq!(of(None, 0.5), (0.99, None));
        assert_eq!(of(Some("valve-dead-band"), 0.5), (HALF, Some("valve-dead-band".to_owned())));
        // What a simulation follows is no other.
        assert_eq!(of(Some("valve-dead-band"), 0.1), (0.99, None));
    }

    #[test]
    fn where_only_what_was_kept_out_errs_it_says_so() {
        // Noise of 0.1 on spans of 1 and 1000: the grid of play operators leaves up to 0.8 of the latter.
        for (verdict, after, span, expected) in [
            (Verdict::None, 0.3, 1.0, true),
            (Verdict::None, 0.3, 1000.0, false),
            (Verdict::None, 0.11, 1.0, false),
            (Verdict::Unknown, 0.3, 1.0, false),
        ] {
            let mut discovery = Discovery { verdict, noise_floor: 0.1, ..Discovery::default() };
            confirm(&mut discovery, after, after, span, None);
            assert_eq!((discovery.errs_kept_out_only, discovery.verdict), (expected, verdict));
        }
    }

    #[test]
    fn kept_out_recordings_that_go_beyond_all_others_are_told() {
        let of = |name: &str, peak: f64| {
            let time_s: Vec<f64> = (0..500).map(|sample| f64::from(sample) * 0.02).collect();
            let input: Vec<f64> = time_s.iter().map(|time| 0.5 * peak * (1.0 - (2.0 * time).cos())).collect();
            let signals = (Signal::pressure_bar(), Signal::displacement_mm());
            Recording::new(Path::new(name), signals.0, signals.1, time_s, input.clone(), input).expect("a recording")
        };
        let worked: Vec<Recording> = (0..8).map(|number| of(&format!("worked_{number}.csv"), 2.0 - 0.1 * f64::from(number))).collect();
        // Two hundredths of the span are what nobody cares about.
        let (mut session, test) = Session::split(&worked, &[of("far.csv", 2.4), of("near.csv", 2.04)]).expect("a session");
        test.reveal(&mut session);
        assert_eq!(beyond_range(&session), ["far.csv"]);
    }

    #[test]
    fn what_closes_less_than_half_of_the_gap_is_believed_by_that_share() {
        let mut discovery = named("valve-dead-band");
        confirm(&mut discovery, 1.0, 0.9, 1.0, None);
        let share = 1.0 - (0.81 - 0.01) / (1.0 - 0.01);
        assert_eq!(discovery.verdict, Verdict::Ambiguous);
        assert!(discovery.effects.iter().all(|effect| (effect.confidence - share).abs() < 1e-12), "{:?}", discovery.effects);
        // Where there was no gap nothing is taken back.
        let mut discovery = named("valve-dead-band");
        confirm(&mut discovery, 0.1, 0.1, 1.0, None);
        assert_eq!(discovery.verdict, Verdict::Named);
    }
}
