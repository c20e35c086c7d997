//! The log-likelihood for a law of jumps, and the best law: what the observers of [`super::jumps`] make of all recordings.

use crate::chain::form::Drive;
use crate::data::session::{Role, Run, Session};
use crate::model::paths::Paths;
use crate::model::structure::Model;
use crate::observers::jumps;
use crate::observers::jumps::Tip;
use crate::observers::law::{
    LEAST_FLOW, MOST_KINETIC_FRICTION, MOST_PRESLIDING, MOST_RATE_WEAKENING, MOST_SLIP_PER_SPEED_S, MOST_SLIP_S, NEVER, Seen, SlipLaw,
};
use crate::search::parallel;

/// Largest model error of the quasi-static response, in break-away distances: with more, holding says nothing.
const MOST_MODEL_ERROR: f64 = 0.4;

/// Least break-away distance, in deviations of the noise: shorter ones cannot be seen.
const LEAST_BREAK_AWAY: f64 = 2.0;

/// Lowest speed of the drive, per s, from which it slides: below, holding and sliding could not be told apart.
const SLOWEST: f64 = 0.1;

/// Steps of the search for a law, as shares of its parameters, one round each.
const STEPS: [f64; 4] = [0.15, 0.07, 0.035, 0.015];

/// A step of one parameter of a law.
type Move = fn(SlipLaw, f64) -> SlipLaw;

/// Log-likelihood on the selecting samples: the logarithm of the likelihood per sample.
pub struct LogLikelihood {
    /// Mean of every second.
    pub blocks: Vec<f64>,
}

impl LogLikelihood {
    /// Mean of all.
    pub fn mean(&self) -> f64 {
        self.blocks.iter().sum::<f64>() / self.blocks.len().max(1) as f64
    }
}

/// A fitted model's quasi-static response and the noise, for the observers.
pub struct QuasiStatic<'a> {
    session: &'a Session,
    tips: Vec<Tip>,
    noise: f64,
    /// Root mean square of what the quasi-static response misses beyond the noise.
    excess: f64,
    /// Worker threads; results do not hang on them.
    threads: usize,
}

impl<'a> QuasiStatic<'a> {
    /// The quasi-static response by a model with its weights fitted.
    ///
    /// A stick position does not feel what the model's sensor adds, unless `feels`.
    pub fn new(session: &'a Session, model: &Model, noise: f64, feels: bool) -> Self {
        let (mut sum, mut count) = (0.0, 1.0);
        let follows_s = crate::model::structure::follows_s(model);
        let mut tips = Vec::new();
        model.walk(
            session,
            &mut Paths::default(),
            |_| true,
            |run, columns, values| {
                for sample in (0..values.len()).filter(|&sample| run.keep[sample] && run.role[sample] == Role::Fit) {
                    sum += (run.output[sample] - values[sample]).powi(2);
                    count += 1.0;
                }
                tips.push(Tip::new(run, columns, &values, feels, follows_s));
            },
        );
        let excess = (sum / count - noise * noise).max(0.04 * noise * noise).sqrt();
        Self { session, tips, noise, excess, threads: 1 }
    }

    /// The same, whose recordings are observed by so many threads.
    pub fn by(self, threads: usize) -> Self {
        Self { threads, ..self }
    }

    fn seen<'b>(&'b self, run: &'b Run) -> Seen<'b> {
        self.tips[run.index].seen(run, self.noise)
    }

    /// The recordings.
    pub fn session(&self) -> &'a Session {
        self.session
    }

    /// Whether operators alone make it.
    pub fn is_of_a_bank(&self) -> bool {
        self.tips.iter().all(|tip| tip.bank.is_some())
    }

    /// Sum of the log-likelihood on the fitted samples, of the screening recordings only unless `all`.
    fn fitted(&self, all: bool, log_likelihood: impl Fn(&Seen<'_>) -> Vec<f64> + Sync) -> f64 {
        let runs: Vec<&Run> = self.session.runs.iter().filter(|run| (all || run.screens) && run.role.contains(&Role::Fit)).collect();
        let of_run = |run: &&Run| {
            let of = log_likelihood(&self.seen(run));
            of.iter().zip(&run.role).filter(|(_, role)| **role == Role::Fit).map(|(value, _)| value).sum::<f64>()
        };
        if self.threads > 1 { parallel::in_parallel(&runs, self.threads, of_run).iter().sum() } else { runs.iter().map(of_run).sum() }
    }

    /// Log-likelihood on the selecting samples.
    fn selecting(&self, log_likelihood: impl Fn(&Seen<'_>) -> Vec<f64>) -> LogLikelihood {
        let mut blocks = Vec::new();
        for run in self.session.runs.iter().filter(|run| run.role.contains(&Role::Select)) {
            let of = log_likelihood(&self.seen(run));
            let length = (1.0 / run.period_s).round().max(4.0) as usize;
            for (block, roles) in of.chunks(length).zip(run.role.chunks(length)) {
                if roles.iter().all(|role| *role == Role::Select) {
                    blocks.push(block.iter().sum::<f64>() / block.len() as f64);
                }
            }
        }
        LogLikelihood { blocks }
    }

    /// Log-likelihood on every sample of every recording.
    pub fn of_every_recording(&self, log_likelihood: impl Fn(&Seen<'_>) -> Vec<f64>) -> Vec<Vec<f64>> {
        self.session.runs.iter().map(|run| log_likelihood(&self.seen(run))).collect()
    }

    /// Log-likelihood of the best smooth observer of this quasi-static response.
    pub fn smooth(&self) -> LogLikelihood {
        let (_, model_error, time_s) = self.smoothest();
        self.selecting(|seen| jumps::smooth(seen, model_error, time_s))
    }

    /// What the best smooth observer is off by, sample by sample, one step ahead.
    pub fn missed_smoothly(&self) -> Vec<Vec<f64>> {
        let (_, model_error, time_s) = self.smoothest();
        let of = |run: &Run| {
            let expected = jumps::expect_smoothly(&self.seen(run), model_error, time_s);
            run.output.iter().zip(expected).map(|(output, expected)| output - expected).collect()
        };
        self.session.runs.iter().map(of).collect()
    }

    /// The best smooth observer on the screening samples: the log-likelihood for it, its model error and the time constant of that, s.
    pub fn smoothest(&self) -> (f64, f64, f64) {
        let model_errors = [0.4, 0.7, 1.0, 1.4].map(|share| share * self.excess);
        let grid = model_errors.into_iter().flat_map(|model_error| [0.04, 0.1, 0.25, 0.6, 2.0].map(|time_s| (model_error, time_s)));
        let judged =
            grid.map(|(model_error, time_s)| (self.fitted(false, |seen| jumps::smooth(seen, model_error, time_s)), model_error, time_s));
        judged.max_by(|x, y| x.0.total_cmp(&y.0)).unwrap_or((0.0, self.excess, 0.25))
    }

    /// Log-likelihood per screening sample, at first sight: of the best smooth observer, and of the best of a ladder of laws that break away by
    /// `drive`, as far as they can be seen.
    pub fn at_first_sight(&self, drive: Drive) -> (f64, f64) {
        let of = |run: &Run| (0..run.keep.len()).filter(|&at| run.keep[at] && run.role[at] == Role::Fit).count();
        let count = self.session.runs.iter().filter(|run| run.screens).map(of).sum::<usize>().max(1) as f64;
        let jumping = self.judged(self.ladder(drive, 0.0).into_iter(), false).into_iter().map(|judged| judged.0);
        (self.smoothest().0 / count, jumping.fold(f64::MIN, f64::max) / count)
    }

    /// The law of a tip that begins where those of the fitted recordings do in the mean: it is seen while the quasi-static response rests at first.
    pub fn with_own_begin(&self, law: SlipLaw) -> SlipLaw {
        let (mut sum, mut count) = (0.0, 1e-30);
        for run in self.session.runs.iter().filter(|run| run.role.first() == Some(&Role::Fit)) {
            let seen = self.seen(run);
            let rest = seen.quasi_static.iter().take_while(|quasi_static| **quasi_static == seen.quasi_static[0]).count();
            for at in (0..rest).filter(|&at| seen.keep[at]) {
                sum += seen.measured[at] - seen.quasi_static[at];
                count += 1.0;
            }
        }
        SlipLaw { begins: sum / count, ..law }
    }

    /// Log-likelihood of jumps by `law` on the fitted samples.
    pub fn fitting(&self, law: &SlipLaw) -> f64 {
        self.fitted(true, |seen| jumps::observe(seen, law).log_likelihood)
    }

    /// Log-likelihood of jumps by `law`.
    pub fn jumping(&self, law: &SlipLaw) -> LogLikelihood {
        self.selecting(|seen| jumps::observe(seen, law).log_likelihood)
    }

    /// A law from which others differ.
    fn still(&self, drive: Drive, lag_s: f64) -> SlipLaw {
        let (scatter, model_error) = (0.25, 0.5 * self.excess);
        SlipLaw { break_away: 0.16, overshoot: 0.5, scatter, model_error, lag_s, ..SlipLaw::plain(drive) }
    }

    /// Laws of jumps that break away by `drive`.
    fn ladder(&self, drive: Drive, lag_s: f64) -> Vec<SlipLaw> {
        // Slip overshoot beyond the drive and never sliding, or slip overshoot near it and sliding with it.
        const OF_A_TIP: [(f64, f64); 8] =
            [(1.0, NEVER), (0.7, NEVER), (0.4, NEVER), (0.0, NEVER), (0.5, 0.8), (0.5, 0.4), (0.1, 0.4), (0.1, 0.2)];
        // Error at which it closes, time constant of its flow, s, and limit of that, spans per s.
        const OF_A_VALVE: [(f64, f64, f64); 8] = [
            (0.02, 0.0002, NEVER),
            (0.1, 0.01, NEVER),
            (0.1, 0.025, NEVER),
            (0.2, 0.025, NEVER),
            (0.3, 0.025, NEVER),
            (0.1, 0.06, NEVER),
            (0.3, 0.06, NEVER),
            (0.2, 0.002, 5.0),
        ];
        let still = self.still(drive, lag_s);
        let at_once = OF_A_TIP.map(|(overshoot, sliding_speed)| SlipLaw { overshoot, sliding_speed, ..still });
        // A mass takes its time.
        let slow = [1, 2, 6].map(|kind: usize| SlipLaw { slip_s: 0.5 * MOST_SLIP_S, ..at_once[kind] });
        let kinds: Vec<SlipLaw> = match drive {
            Drive::QuasiStatic => [&at_once[..], &slow].concat(),
            Drive::Command => OF_A_VALVE.map(|(closing, flow_s, most_flow)| SlipLaw { closing, flow_s, most_flow, ..still }).into(),
        };
        let of = |break_away: f64| kinds.iter().map(move |kind| SlipLaw { break_away, ..*kind });
        crate::chain::filters::ladder(0.01, 0.16, 10).into_iter().flat_map(of).collect()
    }

    /// The best law of jumps that break away by `drive`, of a ladder of laws.
    pub fn law(&self, drive: Drive, lag_s: f64) -> SlipLaw {
        self.best(self.ladder(drive, lag_s), false).map_or_else(|| self.still(drive, lag_s), |best| self.tuned(best.1, &STEPS, false))
    }

    /// The best of a few laws, and its log-likelihood on the fitted samples; of none when none can be seen.
    pub fn best(&self, laws: Vec<SlipLaw>, all: bool) -> Option<(f64, SlipLaw)> {
        // The first of equals, whatever comes later.
        self.judged(laws.into_iter(), all).into_iter().reduce(|best, other| if other.0 > best.0 { other } else { best })
    }

    /// The laws that can be seen, and their log-likelihood on the fitted samples.
    fn judged(&self, laws: impl Iterator<Item = SlipLaw>, all: bool) -> Vec<(f64, SlipLaw)> {
        let seen = laws.filter_map(|law| self.believed(law));
        seen.map(|law| (self.fitted(all, |seen| jumps::observe(seen, &law).log_likelihood), law)).collect()
    }

    /// The laws with the model error that this quasi-static response may have, for one that was found on another.
    pub fn with_own_model_error(&self, laws: &[SlipLaw]) -> Vec<SlipLaw> {
        let of = |law: &SlipLaw| [law.model_error, 0.5 * self.excess, 0.2 * self.excess].map(|model_error| SlipLaw { model_error, ..*law });
        laws.iter().flat_map(of).collect()
    }

    /// The law with no more model error than is believed, unless its jumps are shorter than can be seen.
    fn believed(&self, law: SlipLaw) -> Option<SlipLaw> {
        let seen = law.break_away >= LEAST_BREAK_AWAY * self.noise;
        seen.then(|| SlipLaw { model_error: law.model_error.min(MOST_MODEL_ERROR * law.break_away), ..law })
    }

    /// The best law about this one, its parameters moved one after the other by each of `steps`; what a tip does besides holding and leaping
    /// only when its law is to be `whole`.
    pub fn tuned(&self, law: SlipLaw, steps: &[f64], whole: bool) -> SlipLaw {
        self.tuned_by(law, steps, whole, |law| self.fitting(law))
    }

    /// As [`Self::tuned`], by how little the observer misses instead of how likely that is.
    pub fn tuned_to_miss_least(&self, law: SlipLaw, steps: &[f64], whole: bool) -> SlipLaw {
        let squares = |seen: &Seen<'_>, law: &SlipLaw| -> Vec<f64> {
            let mean = jumps::observe(seen, law).mean;
            let of = |((measured, mean), keep): ((&f64, f64), &bool)| if *keep { -(measured - mean).powi(2) } else { 0.0 };
            seen.measured.iter().zip(mean).zip(seen.keep).map(of).collect()
        };
        self.tuned_by(law, steps, whole, |law| self.fitted(true, |seen| squares(seen, law)))
    }

    fn tuned_by(&self, law: SlipLaw, steps: &[f64], whole: bool, worth: impl Fn(&SlipLaw) -> f64) -> SlipLaw {
        let Some(law) = self.believed(law) else { return law };
        let mut best = (worth(&law), law);
        for &size in steps {
            for sign in [-size, size] {
                for moved in moves_of(&best.1, whole) {
                    let Some(other) = self.believed(moved(best.1, sign)) else { continue };
                    let worth = worth(&other);
                    if worth > best.0 {
                        best = (worth, other);
                    }
                }
            }
        }
        best.1
    }

    /// Mean square by which the observer of `law` expects to miss, without the noise, on all that is not kept out.
    pub fn scatter(&self, law: &SlipLaw) -> f64 {
        let (mut sum, mut count) = (0.0, 1e-30);
        for run in self.session.runs.iter().filter(|run| !run.role.contains(&Role::Test)) {
            let variance = jumps::observe(&self.seen(run), law).variance;
            sum += variance.iter().sum::<f64>();
            count += variance.len() as f64;
        }
        sum / count
    }
}

/// The steps of the parameters that this law has.
fn moves_of(law: &SlipLaw, whole: bool) -> Vec<Move> {
    const OF_BOTH: [Move; 4] = [
        |law, by| law.with_break_away(law.break_away * (1.0 + by)),
        |law, by| law.with_overshoot(by),
        |law, by| SlipLaw { scatter: law.scatter * (1.0 + 4.0 * by), ..law },
        |law, by| SlipLaw { model_error: law.model_error * (1.0 + 4.0 * by), ..law },
    ];
    const OF_A_VALVE: [Move; 3] = [
        |law, by| SlipLaw { closing: (law.closing + by).clamp(0.0, 1.0), ..law },
        |law, by| SlipLaw { flow_s: law.flow_s * (1.0 + 3.0 * by), ..law },
        |law, by| SlipLaw { most_flow: (law.most_flow * (1.0 + 3.0 * by)).clamp(LEAST_FLOW, NEVER), ..law },
    ];
    const OF_A_SLIDER: [Move; 1] = [|law, by| SlipLaw { sliding_speed: (law.sliding_speed * (1.0 + 3.0 * by)).max(SLOWEST), ..law }];
    const OF_A_WHOLE_TIP: [Move; 5] = [
        |law, by| SlipLaw { slip_s: (law.slip_s + 0.1 * by).clamp(0.0, MOST_SLIP_S), ..law },
        |law, by| SlipLaw { rate_weakening: (law.rate_weakening + 2.0 * by).clamp(0.0, MOST_RATE_WEAKENING), ..law },
        |law, by| SlipLaw { kinetic_friction: (law.kinetic_friction + by).clamp(-MOST_KINETIC_FRICTION, MOST_KINETIC_FRICTION), ..law },
        |law, by| SlipLaw { presliding: (law.presliding + 0.3 * by).clamp(0.0, MOST_PRESLIDING), ..law },
        |law, by| SlipLaw {
            slip_per_speed_s: (law.slip_per_speed_s + 0.04 * by).clamp(-MOST_SLIP_PER_SPEED_S, MOST_SLIP_PER_SPEED_S),
            ..law
        },
    ];
    let is_tip = law.drive == Drive::QuasiStatic;
    // Where nothing limits the flow, no step of it makes a difference.
    let of_a_valve = if law.most_flow < NEVER { &OF_A_VALVE[..] } else { &OF_A_VALVE[..2] };
    let of_kind: &[Move] = if is_tip { &[] } else { of_a_valve };
    let of_a_slider: &[Move] = if is_tip && law.sliding_speed < NEVER { &OF_A_SLIDER } else { &[] };
    // Of what a tip does besides, the first is how long a slip takes.
    let moves = if whole { OF_A_WHOLE_TIP.len() } else { usize::from(law.slip_s > 0.0) };
    let of_the_rest: &[Move] = if is_tip { &OF_A_WHOLE_TIP[..moves] } else { &[] };
    [&OF_BOTH, of_kind, of_a_slider, of_the_rest].concat()
}

/// Lags that are tried for what moves, s: a light tip on its spring follows within milliseconds; through a valve that is open the pressure
/// follows within some hundredths of a second.
pub fn lags(drive: Drive) -> &'static [f64] {
    match drive {
        Drive::QuasiStatic => &[0.0, 0.004, 0.008],
        Drive::Command => &[0.0, 0.01, 0.02, 0.03],
    }
}
