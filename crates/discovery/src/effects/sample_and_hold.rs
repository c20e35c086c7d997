//! `sample-and-hold`: the command is looked at once in a period and held until the next look, `v(t) = u(t_k)` with `t_k = (k + a) P <= t`,
//! and followed at once or like a volume behind a restriction; or so is the output, by a camera.

use std::ops::Range;

use crate::chain::columns::{Columns, Filter};
use crate::chain::filters::{best_starts, shift};
use crate::chain::form::{Form, Parameter, Place, Quantity, Spec, Told};
use crate::chain::steps::{Steps, agreement, best_of, best_place, over};
use crate::data::phasors::{spacing_hz, spacing_over_hz};
use crate::data::session::{Run, Session};

/// All forms.
pub const FORMS: &[&dyn Form] = &[&OF_EACH_RECORDING, &RUNNING_ON, &UNTIED, &OUTPUT_OF_EACH_RECORDING, &OUTPUT_RUNNING_ON, &OUTPUT_UNTIED];

struct Held {
    form: Told,
    place: Place,
    parameters: &'static [Parameter],
    clock: Clock,
}

/// Where the looks of a recording are.
#[derive(Clone, Copy, PartialEq)]
enum Clock {
    /// At the same places in each.
    Starts,
    /// It runs on from recording to recording.
    RunsOn,
    /// It runs on, and nothing tells how long: the recording itself shows where they are.
    Untied,
}

const fn command(form: Told, parameters: &'static [Parameter], clock: Clock) -> Held {
    Held { form, place: Place::Supply, parameters, clock }
}

const fn output(form: Told, parameters: &'static [Parameter], clock: Clock) -> Held {
    Held { form, place: Place::Sensor, parameters, clock }
}

static OF_EACH_RECORDING: Held =
    command(("of-each-recording", "held for a period, counted from the start of each recording"), TIED, Clock::Starts);

static RUNNING_ON: Held = command(("of-the-session", "held for a period of a clock that runs on through the session"), TIED, Clock::RunsOn);

static UNTIED: Held =
    command(("own-phase", "held for a period, at a phase of its own in each recording"), &[PERIOD, FOLLOWS, AGE], Clock::Untied);

static OUTPUT_OF_EACH_RECORDING: Held =
    output(("output-of-each-recording", "output held for a period, counted from the start of each recording"), SEEN, Clock::Starts);

static OUTPUT_RUNNING_ON: Held =
    output(("output-of-the-session", "output held for a period of a clock that runs on through the session"), SEEN, Clock::RunsOn);

static OUTPUT_UNTIED: Held =
    output(("output-own-phase", "output held for a period, at a phase of its own in each recording"), &[PERIOD], Clock::Untied);

/// Of what holds the command, where the clock shows where it looks.
const TIED: &[Parameter] = &[PERIOD, FIRST_LOOK, FOLLOWS, AGE];

/// Of what holds the output, there.
const SEEN: &[Parameter] = &[PERIOD, FIRST_LOOK];

const PERIOD: Parameter = Parameter { name: "period", quantity: Quantity::Time, low: 1e-3, high: LONGEST_S, logarithmic: true };

/// It goes round: neither end is one.
const FIRST_LOOK: Parameter = Parameter { name: "first_look", quantity: Quantity::Ratio, low: -0.5, high: 1.5, logarithmic: false };

/// Time constant of what follows the held command; as short as can be it follows at once.
const FOLLOWS: Parameter = Parameter { name: "follow_time_constant", quantity: Quantity::Time, low: 1e-3, high: 0.3, logarithmic: true };

/// How old what is held is already: a converter that averages holds the middle of what it has seen. As short as can be it is fresh.
const AGE: Parameter = Parameter { name: "age", ..FOLLOWS };

/// The oldest that it can be, in periods: the middle of a whole one. What comes later than that is late for another reason.
const OLDEST: f64 = 0.5;

/// Longest period that is looked for, s.
const LONGEST_S: f64 = 0.6;

/// Fewest samples in a period that is looked for: with fewer, a dead time of half of it does as well.
const FEWEST_SAMPLES: f64 = 3.0;

/// Periods from which the phase of a clock that nothing ties to the recording is read when a model is judged or simulated.
const PERIODS_OF_START_UP: f64 = 10.0;

/// Fewest places of the first look that are looked at; in a long period they are two samples apart.
const FEWEST_LOOKS: f64 = 4.0;

/// A recording is looked at in stretches of at least so many samples and so many of the longest period: what one recording resolves is as fine as
/// it is long, and to look for all of that at once takes the square of its length.
const LEAST_SAMPLES: usize = 2000;
const LEAST_PERIODS: f64 = 20.0;

/// Starts that are made finer.
const BEST: usize = 8;

/// Share of a grid that is looked at in all recordings: what goes best with every other one.
const SIEVED: usize = 8;

/// The best of a grid, by a score of every so many recordings.
fn sieved(grid: Vec<Vec<f64>>, score: impl Fn(usize, &Vec<f64>) -> f64) -> Vec<Vec<f64>> {
    let count = (grid.len() / SIEVED).max(BEST);
    let few = best_starts(grid.into_iter(), |start| score(2, start), count);
    best_starts(few.into_iter(), |start| score(1, start), BEST)
}

impl Form for Held {
    fn spec(&self) -> Spec {
        let untied = self.clock == Clock::Untied;
        Spec {
            parameters: self.parameters,
            steps: if untied { &[2e-4, 0.3, 0.3] } else { &[2e-4, 0.05, 0.3, 0.3] },
            simpler_at: match (self.holds_output(), untied) {
                (true, _) => &[],
                (false, true) => &[(1, FOLLOWS.low), (2, AGE.low)],
                (false, false) => &[(2, FOLLOWS.low), (3, AGE.low)],
            },
            reads_output: untied,
            needs_sum: untied && self.holds_output(),
            ..Spec::new("sample-and-hold", self.form, self.place)
        }
    }
    fn start_up_s(&self, parameters: &[f64]) -> f64 {
        if self.clock == Clock::Untied { PERIODS_OF_START_UP * parameters[0] } else { 0.0 }
    }
    /// Periods and first looks of which what holding does to the steps of what is held goes best with what the model misses of those of the output.
    fn starts(&self, session: &Session, residual: &[Vec<f64>]) -> Vec<Vec<f64>> {
        // Where the recordings tell their places in the session, a clock that runs on is tied to them; where they do not, it is not.
        if self.clock == if session.has_session_time { Clock::Untied } else { Clock::RunsOn } {
            return Vec::new();
        }
        // What is held: the command, or the output as the model has it.
        let modelled = |run: &Run| run.output.iter().zip(&residual[run.index]).map(|(output, missed)| output - missed).collect();
        let held = |run: &Run| if self.holds_output() { modelled(run) } else { run.input.clone() };
        let sample_s = session.runs[0].period_s;
        let stretch = LEAST_SAMPLES.max((LEAST_PERIODS * LONGEST_S / sample_s) as usize);
        let steps = Steps::in_stretches(session, residual, held, stretch);
        let is_cut = steps.runs().any(|(.., begun_s)| begun_s > 0.0);
        let staircase = |look_s: f64, first: f64| {
            move |run: &Run, signal: &[f64], jump: &mut dyn FnMut(usize, f64)| {
                held_values(signal, look_s / run.period_s, first, |held, value| jump(held.start, value));
            }
        };
        let of = |(at, run, begun_s): (usize, &Run, f64), start: &[f64]| {
            let first = (self.first_look(start, run, &[]) - begun_s / start[0]).rem_euclid(1.0);
            steps.matched_jumps(at, staircase(start[0], first))
        };
        let score = |every: usize, start: &Vec<f64>| over(steps.runs().step_by(every).map(|one| of(one, start)));
        let first_looks = |period_s: f64| first_looks(period_s / sample_s);
        // Over several recordings or stretches of a clock that runs on, a period that is nearly right has the looks of each elsewhere.
        let best_looks = |every: usize, start: &Vec<f64>| {
            let best = |at: usize| best_of(first_looks(start[0]).map(|first| steps.matched_jumps(at, staircase(start[0], first))));
            over(steps.runs().step_by(every).map(|(at, ..)| best(at)))
        };
        let of_recordings = spacing_hz(session);
        let coarse_hz = if is_cut { spacing_over_hz(steps.longest_s()) } else { of_recordings };
        let with = |frequency_hz: f64, first: f64| vec![1.0 / frequency_hz, first.rem_euclid(1.0), FOLLOWS.low, AGE.low];
        let (slowest_hz, fastest_hz) = (1.0 / LONGEST_S, 1.0 / (FEWEST_SAMPLES * sample_s));
        let count = ((fastest_hz - slowest_hz) / coarse_hz).max(0.0) as usize;
        let frequencies = (0..count).map(|step| slowest_hz + step as f64 * coarse_hz);
        let untied = self.clock == Clock::Untied;
        let (spacing_hz, begun) = if self.clock != Clock::Starts || is_cut {
            let best = sieved(frequencies.map(|hz| with(hz, 0.0)).collect(), best_looks);
            let of_session = of_recordings * session.runs[0].input.len() as f64 * sample_s / session.length_s;
            let fine_hz = if self.clock == Clock::RunsOn { of_session } else { of_recordings };
            let steps = (coarse_hz / fine_hz).ceil() as i32;
            let near = |start: Vec<f64>| {
                let near = (-2 * steps..=2 * steps).map(|step| 1.0 / start[0] + 0.5 * f64::from(step) * fine_hz);
                let all = near.flat_map(|hz| first_looks(1.0 / hz).map(move |first| with(hz, first)));
                best_starts(all, |start| score(1, start), 1)
            };
            // What nothing ties is found by the best looks of each recording, and those tell no more.
            if untied { (coarse_hz, best) } else { (fine_hz, best.into_iter().flat_map(near).collect::<Vec<_>>()) }
        } else {
            let all = frequencies.flat_map(|hz| first_looks(1.0 / hz).map(move |first| with(hz, first)));
            (of_recordings, sieved(all.collect(), score))
        };
        // Finer steps about each, until a period is as near as the recordings resolve.
        let finer = |start: Vec<f64>| {
            let lates = if untied { 0..=0 } else { -2..=2 };
            let places = (-5..=5).flat_map(|step| lates.clone().map(move |late| (0.1 * f64::from(step), 0.06 * f64::from(late))));
            let score = |start: &Vec<f64>| if untied { best_looks(1, start) } else { score(1, start) };
            best_starts(places.map(|(step, late)| with(1.0 / start[0] + step * spacing_hz, start[1] + late)), score, 1)
        };
        begun
            .into_iter()
            .flat_map(finer)
            .flat_map(|start| {
                let with = |follows_s: f64, age_s: f64| vec![start[0], start[1], follows_s, age_s];
                let all = [start.clone(), with(0.02, AGE.low), with(FOLLOWS.low, 0.25 * start[0])];
                all.into_iter().take(if self.holds_output() { 1 } else { 3 })
            })
            .map(|mut start| {
                if self.clock == Clock::Untied {
                    start.remove(1);
                }
                start.truncate(self.parameters.len());
                start
            })
            .collect()
    }
    fn input(&self, parameters: &[f64], run: &Run, path: &mut [f64]) {
        let (&[look_s, _, follows_s, age_s] | &[look_s, follows_s, age_s]) = parameters else { return };
        if age_s > AGE.low {
            let fresh = path.to_vec();
            shift(path, &fresh, |_| age_s.min(OLDEST * look_s) / run.period_s);
        }
        hold(path, look_s, self.first_look(parameters, run, path), follows_s, run.period_s);
    }
    fn output(&self, parameters: &[f64], run: &Run, sum: &[f64], columns: &mut Columns) {
        if self.holds_output() {
            columns.filter(&Looks { samples: parameters[0] / run.period_s, first: self.first_look(parameters, run, sum) });
        }
    }
}

impl Held {
    fn holds_output(&self) -> bool {
        self.place > Place::Operators
    }

    /// The first look of a recording behind its start, over the period, at what is held.
    fn first_look(&self, parameters: &[f64], run: &Run, held: &[f64]) -> f64 {
        let first = match self.clock {
            Clock::Starts => parameters[1],
            Clock::RunsOn => parameters[1] - run.session_s[0] / parameters[0],
            Clock::Untied => shown_look(held, parameters[0], run),
        };
        first.rem_euclid(1.0)
    }
}

/// Places of the first look, over the period, that are looked at where a period takes so many samples.
fn first_looks(samples: f64) -> impl Iterator<Item = f64> {
    let count = (samples / 2.0).max(FEWEST_LOOKS).ceil();
    (0..count as usize).map(move |place| place as f64 / count)
}

/// The first look, over the period, after which a few operators of what is held leave least of the measured output. Where there is no measured output
/// (a simulation) it is the first sample.
fn shown_look(held: &[f64], look_s: f64, run: &Run) -> f64 {
    if run.output.iter().all(|value| *value == 0.0) {
        return 0.0;
    }
    let mut path = held.to_vec();
    let agreement = |first: f64| {
        path.copy_from_slice(held);
        hold(&mut path, look_s, first.rem_euclid(1.0), FOLLOWS.low, run.period_s);
        agreement(&path, run)
    };
    let samples = look_s / run.period_s;
    best_place(first_looks(samples), 1.0 / first_looks(samples).count() as f64, REFINEMENTS, agreement)
}

/// How often the place of the first look is made three times as fine.
const REFINEMENTS: usize = 2;

/// Holds what is looked at once in a period, and follows it with a time constant.
fn hold(path: &mut [f64], look_s: f64, first: f64, follows_s: f64, period_s: f64) {
    let samples = look_s / period_s;
    let before = path.to_vec();
    if follows_s <= FOLLOWS.low {
        held_values(&before, samples, first, |held, value| path[held].fill(value));
        return;
    }
    let place = |sample: usize| last_look(sample as f64, samples, first).clamp(0.0, sample as f64);
    let keep = |samples: f64| (-samples * period_s / follows_s).exp();
    let (mut held, mut state) = (before[0], before[0]);
    for (sample, value) in path.iter_mut().enumerate() {
        let (place, last) = (place(sample), held);
        held = looked_at(&before, sample, place);
        // The last look is some time ago, and until then the one before it counted.
        let since = (sample as f64 - place).min(1.0);
        state = last + (state - last) * keep(1.0 - since);
        state = held + (state - held) * keep(since);
        *value = state;
    }
}

/// What a signal was at a place, in samples, up to now.
fn looked_at(signal: &[f64], now: usize, place: f64) -> f64 {
    let below = place as usize;
    signal[below] + (place - below as f64) * (signal[(below + 1).min(now)] - signal[below])
}

/// Samples for which a value is held, and that value, one look after the other.
fn held_values(signal: &[f64], samples: f64, first: f64, mut holds: impl FnMut(Range<usize>, f64)) {
    let (mut from, mut look) = (0, (1e-9 - first).floor());
    while from < signal.len() {
        let next = |look: f64| (look + 1.0 + first - 1e-9) * samples;
        let until = (next(look).ceil() as usize).clamp(from + 1, signal.len());
        holds(from..until, looked_at(signal, from, ((look + first) * samples).clamp(0.0, from as f64)));
        from = until;
        while next(look) <= from as f64 {
            look += 1.0;
        }
    }
}

/// Holds a column of the output, so many samples a look: what is held, the last value and the number of samples gone.
struct Looks {
    samples: f64,
    first: f64,
}

impl Filter<3> for Looks {
    fn begin(&self, first: f64) -> [f64; 3] {
        [first, first, -1.0]
    }
    #[inline(always)]
    fn step(&self, [held, last, sample]: &mut [f64; 3], value: f64) -> f64 {
        *sample += 1.0;
        let since = *sample - last_look(*sample, self.samples, self.first).max(0.0);
        if since < 1.0 {
            *held = value + since * (*last - value);
        }
        *last = value;
        *held
    }
}

/// When the last look before a sample was, in samples; a look at the moment of a sample counts.
fn last_look(sample: f64, samples: f64, first: f64) -> f64 {
    ((sample / samples - first + 1e-9).floor() + first) * samples
}

#[cfg(test)]
mod tests;
