//! One round of the search: every form on top of what is there, the best few polished, and the test whether the best one pays.

use std::sync::atomic::{AtomicUsize, Ordering};

use crate::chain::form::Form;
use crate::data::noise;
use crate::data::session::{Role, Run, Session};
use crate::model::structure::{Model, Order, Scope};
use crate::search::forms;
use crate::search::forms::Started;
use crate::search::parallel::{Progress, Watch, in_parallel_by, labour, labour_of_all};
use crate::search::simplex::{Fitted, PENALTY, penalised};
use crate::selection::settings::{BREADTH, GRID_ERROR, LIKELY};

/// Evaluations for each parameter when candidates are polished.
pub const POLISH: usize = 20;

/// The best few of a round: two forms of an effect at most, five models at most.
pub fn leaders(tried: &[Tried]) -> Vec<Model> {
    let mut names: Vec<&str> = Vec::new();
    let mut best = Vec::new();
    for one in tried {
        if names.iter().filter(|name| **name == one.form.name()).count() < 2 && best.len() < BREADTH {
            names.push(one.form.name());
            best.push(one.fitted.model.clone());
        }
    }
    best
}

/// Share of the least gain that a form's grid must show before its parameters are searched.
const HOPELESS: f64 = 0.25;

/// Share of the best form's gain that a form's grid must show before its parameters are searched: a grid point takes away at least that
/// of what its valley does.
pub const FAR_BEHIND: f64 = 0.15;

/// How many deviations the mean over blocks of `before - after` lies above zero.
pub fn deviations(before: &[f64], after: &[f64]) -> f64 {
    let differences: Vec<f64> = before.iter().zip(after).map(|(x, y)| x - y).collect();
    let n = differences.len() as f64;
    let mean = differences.iter().sum::<f64>() / n;
    // Neighbouring blocks share their errors: the variance of the mean takes lags up to three blocks (Newey and West 1987).
    let mut variance = differences.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / n;
    for lag in 1..=3_usize {
        let covariance: f64 = differences.windows(lag + 1).map(|pair| (pair[0] - mean) * (pair[lag] - mean)).sum::<f64>() / n;
        variance += 2.0 * (1.0 - lag as f64 / 4.0) * covariance;
    }
    mean / (variance.max(1e-30) / n).sqrt()
}

/// A candidate with its test.
#[derive(Clone)]
pub struct Tried {
    /// The model with it.
    pub fitted: Fitted,
    /// Its form.
    pub form: &'static dyn Form,
    /// How many deviations its gain on the selecting blocks lies above zero.
    pub deviations: f64,
}

/// Everything the selection works with.
pub struct Bench<'a> {
    /// The recordings.
    pub session: &'a Session,
    /// Forms that take part.
    pub forms: Vec<&'static dyn Form>,
    /// Worker threads.
    pub threads: usize,
    /// Hears how far the search is.
    pub watch: Watch<'a>,
}

impl Bench<'_> {
    /// As [`in_parallel_by`]; whoever watches hears which share of the `length` is done.
    pub fn in_parallel<T: Send, I: Sync>(&self, items: &[I], length: impl Fn(&I) -> usize + Sync, work: impl Fn(&I) -> T + Sync) -> Vec<T> {
        let all = items.iter().map(&length).sum();
        let done = AtomicUsize::new(0);
        in_parallel_by(items, self.threads, &length, |item| {
            let result = work(item);
            let now = length(item);
            (self.watch)(Progress::Part { done: done.fetch_add(now, Ordering::Relaxed) + now, all });
            result
        })
    }

    /// Logarithms of the mean squares of the selecting blocks: what is missed may differ by orders of magnitude between them, and few would outweigh
    /// all others.
    pub fn selecting_blocks(&self, model: &Model) -> Vec<f64> {
        let selects = |run: &Run| run.role.contains(&Role::Select);
        let outputs = model.outputs(self.session, selects);
        let of = |(run, output): (&Run, Vec<f64>)| output.into_iter().zip(&run.output).map(|(p, y)| y - p).collect();
        let residual: Vec<Vec<f64>> = self.session.runs.iter().zip(outputs).map(of).collect();
        let selects = |run: usize, sample: usize| self.session.runs[run].role[sample] == Role::Select;
        let squares = noise::blocks(self.session, &residual, selects);
        squares.into_iter().map(|square| (square + GRID_ERROR * GRID_ERROR).ln()).collect()
    }

    /// Every form on top of `base` but those in narrow valleys, best first. Forms whose grid shows nowhere near the gain `least` are not searched further.
    pub fn round(&self, base: &Model, least: f64) -> Vec<Tried> {
        let residual = base.residuals(self.session);
        let before = self.selecting_blocks(base);
        let is_new = |form: &&'static dyn Form| !form.spec().is_narrow && !base.slots.iter().any(|slot| slot.form.name() == form.name());
        let forms: Vec<&'static dyn Form> = self.forms.iter().copied().filter(is_new).collect();
        let with_sensitivities = forms::with_sensitivities(base, self.session);
        let started = self.in_parallel(
            &forms,
            |form| labour(*form),
            |form| forms::start_form(&with_sensitivities, *form, Order::Usual, self.session, &residual),
        );
        let started: Vec<Started> = started.into_iter().flatten().collect();
        let broad = |started: &&Started| !started.form.spec().discrete;
        let most = started.iter().filter(broad).map(|started| started.gain).fold(0.0, f64::max);
        let worth = (HOPELESS * least).max(FAR_BEHIND * most);
        let mut tried = self.in_parallel(
            &started,
            |started| labour(started.form),
            |started| {
                let Started { model, form, gain, .. } = started;
                let settle = |mut model: Model| Fitted { select: model.fit(self.session, Scope::Both).1, model };
                let fitted = if *gain > worth { forms::refine_form(model, *form, self.session) } else { settle(model.clone()) };
                let deviations = deviations(&before, &self.selecting_blocks(&fitted.model));
                Tried { fitted, form: *form, deviations }
            },
        );
        tried.sort_by(|x, y| x.fitted.penalised().total_cmp(&y.fitted.penalised()));
        tried
    }

    /// Polishes every model's parameters together and judges what comes of it; best first.
    pub fn polished(&self, models: &[Model], evaluations: usize) -> Vec<Judged> {
        let polish = |model: &Model| self.judge(&forms::polish(model, self.session, Scope::Fit, evaluations).model);
        let mut polished = self.in_parallel(models, labour_of_all, polish);
        polished.sort_by(|x, y| x.penalised().total_cmp(&y.penalised()));
        // What the muscle remembers of earlier recordings shows only when nothing large is missing any more: the best is asked, and where it
        // remembers otherwise than it was fitted, all are.
        let remembering = |judged: &Judged| {
            let other = judged.model.with_best_initial_state(self.session);
            let is_other = other.model.initial_state != judged.model.initial_state;
            let pays = is_other && (other.select / judged.model.clone().fit(self.session, Scope::Both).1).ln() < -PENALTY;
            pays.then(|| polish(&other.model)).filter(|other| other.select < judged.select)
        };
        if let Some(best) = polished.first().and_then(remembering) {
            let of = |judged: &Judged| remembering(judged).unwrap_or_else(|| judged.clone());
            polished = [vec![best], self.in_parallel(&polished[1..], |judged| labour_of_all(&judged.model), of)].concat();
            polished.sort_by(|x, y| x.penalised().total_cmp(&y.penalised()));
        }
        polished
    }

    /// Weighs a model on the fine grid.
    pub fn judge(&self, model: &Model) -> Judged {
        let mut fine = model.refined();
        let (_, select) = fine.fit(self.session, Scope::Both);
        let blocks = self.selecting_blocks(&fine);
        Judged { model: model.clone(), fine, select, blocks }
    }
}

/// A model as it is judged: on the fine grid, by the selecting samples.
#[derive(Clone)]
pub struct Judged {
    /// The model on the coarse grid, to search on.
    pub model: Model,
    /// The same on the fine grid, its weights fitted.
    pub fine: Model,
    /// Mean square of the selecting samples on the fine grid.
    pub select: f64,
    /// Logarithms of the mean squares of the selecting blocks on the fine grid.
    pub blocks: Vec<f64>,
}

impl Judged {
    /// What competing models are ordered by: the logarithm of the mean square that remains and the price of the parameters.
    pub fn penalised(&self) -> f64 {
        penalised(&self.model, self.select)
    }

    /// Whether this takes away the share `least` of `before`'s mean square, more than a grid of thresholds may leave, and probably
    /// not by chance: what comes in by chance leaves again when explanations are compared.
    pub fn pays(&self, before: &Self, least: f64) -> bool {
        let gain = 1.0 - self.select / before.select;
        let beyond_grid = before.select - self.select > GRID_ERROR * GRID_ERROR;
        let reads = |judged: &Self| judged.model.slots.iter().filter(|slot| slot.form.spec().reads_output).count();
        let worth_its_penalty = reads(self) <= reads(before) || self.penalised() < before.penalised();
        worth_its_penalty && gain >= least && beyond_grid && deviations(&before.blocks, &self.blocks) >= LIKELY
    }
}

#[cfg(test)]
mod tests {
    use virtual_rig::{self as rig, CaseConfig};

    use crate::data::session::Session;
    use crate::effects::{offset_drift, periodic_disturbance};
    use crate::model::initial_state::InitialState;
    use crate::model::structure::{Model, Scope};
    use crate::selection::rounds::{Bench, Judged, deviations};
    use crate::selection::settings::LIKELY;

    #[test]
    fn a_form_that_reads_its_values_from_every_recording_must_bring_its_price() {
        let base = Model::baseline(InitialState::Fresh, false);
        let judged =
            |model: &Model, square: f64| Judged { model: model.clone(), fine: model.clone(), select: square, blocks: vec![square; 200] };
        let (loose, drift) = (periodic_disturbance::FORMS[2], offset_drift::FORMS[0]);
        assert!(loose.spec().reads_output && !drift.spec().reads_output);
        let pays = |form, square| judged(&base.with(form, vec![1.0]), square).pays(&judged(&base, 1.0), 0.024);
        // Coloured noise gives way to a loose rhythm by a twentieth.
        assert!(pays(drift, 0.95) && !pays(loose, 0.95) && pays(loose, 0.9));
    }

    #[test]
    fn what_is_better_everywhere_is_no_chance_where_a_few_blocks_miss_most() {
        let missed = |share: f64| (0..200).map(|block| share * if block % 40 == 7 { 1.0 } else { 1e-4 }).collect::<Vec<f64>>();
        let logarithms = |squares: Vec<f64>| squares.into_iter().map(f64::ln).collect::<Vec<f64>>();
        let scattered = |squares: Vec<f64>| -> Vec<f64> {
            squares.into_iter().enumerate().map(|(block, square)| square * (1.0 + 0.2 * (block as f64 * 2.4).sin())).collect()
        };
        let (before, after) = (scattered(missed(1.0)), missed(0.7));
        assert!(deviations(&logarithms(before.clone()), &logarithms(after.clone())) > 2.0 * LIKELY);
        // Differences of the squares themselves are those of five blocks.
        assert!(deviations(&before, &after) < 1.5 * LIKELY);
    }

    #[test]
    fn blocks_are_the_logarithms_of_what_is_missed_in_them() {
        let case = rig::hide(&CaseConfig { seed: 575, ..CaseConfig::default() }).expect("a case");
        let session = Session::new(&case.recordings[..12], &[]).expect("a session");
        let bench = Bench { session: &session, forms: Vec::new(), threads: 1, watch: &|_| {} };
        let mut model = Model::baseline(InitialState::carrying(case.truth.continuous), false);
        let (_, select) = model.fit(&session, Scope::Both);
        let blocks = bench.selecting_blocks(&model);
        let mean = blocks.iter().map(|block| block.exp()).sum::<f64>() / blocks.len() as f64;
        // Blocks have a length, and short ends of recordings do not count.
        assert!(blocks.len() > 20 && (mean / select - 1.0).abs() < 0.1, "{mean} in {} blocks, and {select} in all", blocks.len());
    }
}
