//! How much of the residual is noise: from rest, where nothing else can be, or from the residual's fast part.

use std::ops::Range;

use crate::data::fast_noise::fast_noise;
use crate::data::phasors::transform;
use crate::data::session::{Run, Session};
use crate::data::worked::worked_with;

/// Standard deviation of the noise, normalised, from the residuals of all recordings.
///
/// Rest tells it with its colour: each stretch loses its mean, and what that takes away of correlated noise is given back by the
/// correlation of neighbours (an AR(1) law). A stretch far louder than the quiet quarter of them still moves. In a session that never rests,
/// stretches in which the input hardly moves stand in for rest, the quietest first. Without either, or where something moves by itself there,
/// the fast part has to do, which misses coloured noise. A pump too fast to be told by that shows as a line of the spectrum at rest, and lines
/// are no noise. A sensor that reads in steps wider than its noise hides at rest what it adds in motion: a uniform error of the step's width.
#[must_use]
pub fn floor(session: &Session, residual: &[Vec<f64>]) -> f64 {
    let mut straightened: Vec<(f64, Vec<f64>)> = Vec::new();
    let quiet = stretches(session);
    for ((run, residual), quiet) in session.runs.iter().zip(residual).zip(&quiet) {
        for stretch in quiet {
            let values: Vec<f64> = stretch.clone().filter(|&sample| run.keep[sample]).map(|sample| residual[sample]).collect();
            if values.len() < 10 {
                continue;
            }
            // Straight line off: creep and drift move during rest, noise does not.
            let n = values.len() as f64;
            let mean = values.iter().sum::<f64>() / n;
            let centre = 0.5 * (n - 1.0);
            let slope = values.iter().enumerate().map(|(at, value)| (at as f64 - centre) * value).sum::<f64>() / (n * (n * n - 1.0) / 12.0);
            let flat: Vec<f64> = values.iter().enumerate().map(|(at, value)| value - mean - slope * (at as f64 - centre)).collect();
            straightened.push((flat.iter().map(|value| value * value).sum::<f64>() / (n - 2.0), flat));
        }
    }
    straightened.sort_by(|x, y| x.0.total_cmp(&y.0));
    let quietest = straightened.get(straightened.len() / 4).map_or(0.0, |stretch| stretch.0);
    straightened.retain(|stretch| stretch.0 <= STILL_MOVES * quietest);
    let (mut sum, mut neighbours, mut count) = (0.0, 0.0, 0.0);
    let mut slow = SlowMotion::new(session.runs[0].period_s);
    let mut lines = Lines::new();
    for (_, flat) in &straightened {
        sum += flat.iter().map(|value| value * value).sum::<f64>();
        slow.add(flat);
        lines.add(flat);
        neighbours += flat.windows(2).map(|pair| pair[0] * pair[1]).sum::<f64>();
        count += flat.len() as f64;
    }
    let freedom = count - 2.0 * straightened.len() as f64;
    let step = session.output_step;
    let with_step = |square: f64| if step * step > 0.25 * square { square + step * step / 12.0 } else { square };
    let over_fast = (sum / count).sqrt() / fast_part(session, residual).max(1e-30);
    // Noise that merely fades does not go to and fro.
    let [is_there, swings] = [slow.correlations().any(|of| of.abs() > 0.5), slow.correlations().any(|of| of < -0.4)];
    if count < ENOUGH_REST as f64 || (is_there && over_fast > 2.0) || (swings && over_fast > 1.3) {
        return with_step(fast_part(session, residual).powi(2)).sqrt();
    }
    let of_lines = lines.share();
    // A line's correlation is not the noise's.
    let correlation = if of_lines > 0.0 { 0.0 } else { (neighbours / sum.max(1e-30)).clamp(0.0, 0.9) };
    let mean_length = count / straightened.len() as f64;
    let lost = (2.0 * (1.0 + correlation) / (1.0 - correlation) / mean_length).min(0.6);
    let whole = blocks(session, residual, |run, sample| session.runs[run].role[sample].is_worked_with());
    let whole = whole.iter().sum::<f64>() / whole.len().max(1) as f64;
    let most = (MOST_OVER_FAST * fast_part(session, residual)).powi(2);
    // Rest in recordings that the model does not fit may hold more than noise; the noise is never more than the whole residual.
    with_step((sum / freedom * (1.0 - of_lines) * (1.0 - 2.0 / mean_length) / (1.0 - lost)).min(most)).min(whole).sqrt()
}

/// Whether what counts as noise may hold a rhythm: it is louder than its fast part, as coloured noise is and as a slow rhythm makes it.
#[must_use]
pub fn may_hold_a_rhythm(session: &Session, residual: &[Vec<f64>]) -> bool {
    floor(session, residual).powi(2) > LOUDER_THAN_FAST * fast_part(session, residual).powi(2)
}

/// Mean square of what counts as noise over that of its fast part from which on a rhythm is looked for: one of 0.45 times the noise.
const LOUDER_THAN_FAST: f64 = 1.2;

/// Standard deviation of the fast part, the median over all recordings. The noise is in the output as it is in the residual, and what is
/// faster in one of them is none.
fn fast_part(session: &Session, residual: &[Vec<f64>]) -> f64 {
    let of = |run: &Run| {
        let [residual, output] = [&residual[run.index], &run.output].map(|values| fast_noise(&worked_with(run, values)));
        residual.min(output)
    };
    let mut floors: Vec<f64> = session.worked().map(of).collect();
    floors.sort_by(f64::total_cmp);
    floors[floors.len() / 2]
}

/// Mean square over the lower quartile of all stretches from which on something still moves in one: a step that comes late ends in the rest behind it.
const STILL_MOVES: f64 = 4.0;

/// Fewest samples of rest that tell the noise.
const ENOUGH_REST: usize = 100;

/// Length of the stretches that stand in for rest, s.
const QUIET_S: f64 = 2.0;

/// Most that the input moves in them, of its span: what a model misses of so small a motion is little beside the noise.
const HARDLY_MOVES: f64 = 0.06;

/// Samples of them that are looked at, those first in which the input moves least.
const ENOUGH_QUIET: usize = 2000;

/// Most noise over its fast part. A model that lacks something large misses small motions and what still moves at rest, too, and that would
/// pass for noise; a sensor's noise that is half correlated over a tenth of a second has 1.4 times its fast part, one that is so altogether
/// 2.8 times.
const MOST_OVER_FAST: f64 = 3.0;

/// Where every recording shows its noise: at rest; in a session that never rests, where the input hardly moves.
fn stretches(session: &Session) -> Vec<Vec<Range<usize>>> {
    let of = |run: &Run| if run.is_worked_with() { run.rest.clone() } else { Vec::new() };
    let at_rest: Vec<Vec<Range<usize>>> = session.runs.iter().map(of).collect();
    if at_rest.iter().flatten().map(Range::len).sum::<usize>() >= ENOUGH_REST {
        return at_rest;
    }
    let mut quiet: Vec<(f64, usize, Range<usize>)> = Vec::new();
    for run in session.worked() {
        let length = (QUIET_S / run.period_s).round().max(10.0) as usize;
        for range in (0..run.input.len() / length).map(|at| at * length..(at + 1) * length) {
            let (low, high) =
                run.input[range.clone()].iter().fold((f64::MAX, f64::MIN), |(low, high), &value| (low.min(value), high.max(value)));
            quiet.push((high - low, run.index, range));
        }
    }
    quiet.retain(|(moves, ..)| *moves <= HARDLY_MOVES);
    quiet.sort_by(|x, y| x.0.total_cmp(&y.0));
    let mut of_runs = vec![Vec::new(); session.runs.len()];
    let mut samples = 0;
    for (_, run, range) in quiet {
        if samples >= ENOUGH_QUIET {
            break;
        }
        samples += range.len();
        of_runs[run].push(range);
    }
    of_runs
}

/// Motion during rest that is too slow for a sensor's noise: a rhythm, a hand, a valve that hunts. It must not pass for noise, or the
/// very effect that is sought would raise the floor above itself.
struct SlowMotion {
    lags: Vec<usize>,
    products: Vec<f64>,
    energy: f64,
}

impl SlowMotion {
    /// Looks at delays of 0.15 to 0.5 s; a sensor's filter is faster.
    fn new(period_s: f64) -> Self {
        let lags: Vec<usize> = (0..8).map(|step| ((0.15 + 0.05 * f64::from(step)) / period_s).round().max(1.0) as usize).collect();
        Self { products: vec![0.0; lags.len()], lags, energy: 1e-30 }
    }

    fn add(&mut self, flat: &[f64]) {
        self.energy += flat.iter().map(|value| value * value).sum::<f64>();
        for (product, &lag) in self.products.iter_mut().zip(&self.lags) {
            *product += flat.iter().zip(flat.iter().skip(lag)).map(|(x, y)| x * y).sum::<f64>();
        }
    }

    /// Its correlations, lag by lag.
    fn correlations(&self) -> impl Iterator<Item = f64> {
        self.products.iter().map(|product| product / self.energy)
    }
}

/// The spectrum at rest, averaged over windows: noise of any colour is smooth, a pump is a line.
struct Lines {
    powers: [f64; WINDOW / 2],
    windows: f64,
}

/// Samples of a window; windows overlap by half.
const WINDOW: usize = 64;

/// Fewest windows whose average tells a line: it scatters by 0.3 of itself then.
const FEWEST_WINDOWS: f64 = 12.0;

/// Power of a line over its surroundings (the geometric mean of the medians on both sides), seven such scatters above one.
const LINE: f64 = 3.0;

/// Lowest bin that may be a line: below there is nothing to compare it with.
const LOWEST_LINE: usize = 4;

impl Lines {
    fn new() -> Self {
        Self { powers: [0.0; WINDOW / 2], windows: 0.0 }
    }

    fn add(&mut self, flat: &[f64]) {
        let turn = 2.0 * std::f64::consts::PI / WINDOW as f64;
        let bins: Vec<f64> = (0..WINDOW / 2).map(|bin| bin as f64 / WINDOW as f64).collect();
        for start in (0..(flat.len() + 1).saturating_sub(WINDOW)).step_by(WINDOW / 2) {
            // Hann's window keeps a line within two bins of its own.
            let faded: Vec<f64> = (0..WINDOW).map(|at| flat[start + at] * 0.5 * (1.0 - (turn * (at as f64 + 0.5)).cos())).collect();
            let [re, im] = transform(&faded, 0.0, 1.0, &bins);
            self.powers.iter_mut().zip(re.iter().zip(im)).for_each(|(power, (re, im))| *power += re * re + im * im);
            self.windows += 1.0;
        }
    }

    /// Share of the energy that is in lines.
    fn share(&self) -> f64 {
        if self.windows < FEWEST_WINDOWS {
            return 0.0;
        }
        let last = self.powers.len();
        let middle = |bins: std::ops::Range<usize>| {
            let mut near: Vec<f64> = bins.map(|bin| self.powers[bin]).collect();
            near.sort_by(f64::total_cmp);
            near.get(near.len() / 2).copied()
        };
        // Between both sides: the spectrum of correlated noise falls so steeply that its lower end stands far out of what follows.
        let around =
            |bin: usize| match (middle(bin.saturating_sub(6).max(1)..bin.saturating_sub(2).max(1)), middle(bin + 3..(bin + 7).min(last))) {
                (Some(below), Some(above)) => (below * above).sqrt(),
                (below, above) => below.or(above).unwrap_or(f64::MAX),
            };
        let is_line = |bin: usize| self.powers[bin] > LINE * around(bin);
        let lines: Vec<usize> = (LOWEST_LINE..last).filter(|&bin| is_line(bin)).collect();
        let belongs = |bin: &usize| lines.iter().any(|line| line.abs_diff(*bin) <= 2);
        let excess: f64 = (1..last).filter(belongs).map(|bin| (self.powers[bin] - around(bin)).max(0.0)).sum();
        excess / self.powers[1..].iter().sum::<f64>().max(1e-30)
    }
}

/// Mean squares of blocks of about one second, over the samples for which `wanted` holds.
#[must_use]
pub fn blocks(session: &Session, residual: &[Vec<f64>], wanted: impl Fn(usize, usize) -> bool) -> Vec<f64> {
    let mut all = Vec::new();
    for (index, (run, residual)) in session.runs.iter().zip(residual).enumerate() {
        let length = (1.0 / run.period_s).round().max(4.0) as usize;
        for start in (0..residual.len()).step_by(length) {
            let samples: Vec<usize> =
                (start..(start + length).min(residual.len())).filter(|&sample| run.keep[sample] && wanted(index, sample)).collect();
            if samples.len() * 2 >= length {
                all.push(samples.iter().map(|&sample| residual[sample].powi(2)).sum::<f64>() / samples.len() as f64);
            }
        }
    }
    all
}

#[cfg(test)]
mod tests {
    use crate::data::noise::{Lines, floor, may_hold_a_rhythm};
    use crate::data::session::Session;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;
    use recording::{Recording, Signal};
    use std::f64::consts::PI;
    use std::path::Path;

    /// Noise of unit variance whose neighbours correlate by `correlation`.
    fn noise(rng: &mut ChaCha8Rng, correlation: f64, samples: usize) -> Vec<f64> {
        let mut deviate = || (0..12).map(|_| rng.random_range(-0.5..0.5)).sum::<f64>();
        let mut state = deviate();
        (0..samples)
            .map(|_| {
                state = correlation * state + (1.0 - correlation * correlation).sqrt() * deviate();
                state
            })
            .collect()
    }

    #[test]
    fn a_pump_is_a_line_and_the_steep_end_of_correlated_noise_is_none() {
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        for correlation in [0.0, 0.6, 0.8, 0.88] {
            let (mut plain, mut with_pump) = (Lines::new(), Lines::new());
            for _ in 0..24 {
                let values = noise(&mut rng, correlation, 100);
                plain.add(&values);
                let pumped: Vec<f64> =
                    (0..100).zip(&values).map(|(at, value)| value + (2.0 * PI * 8.0 * f64::from(at) / 50.0).sin()).collect();
                with_pump.add(&pumped);
            }
            assert!(plain.share() == 0.0, "{correlation}: {} of the noise passes for lines", plain.share());
            // The pump has a third of the whole.
            assert!((with_pump.share() - 1.0 / 3.0).abs() < 0.1, "{correlation}: {} instead of a third", with_pump.share());
        }
    }

    #[test]
    fn correlated_noise_is_measured_where_a_session_without_rest_is_quiet() {
        let mut rng = ChaCha8Rng::seed_from_u64(6);
        let mut of_noise = Vec::new();
        let recordings: Vec<Recording> = (0..8)
            .map(|run| {
                let time_s: Vec<f64> = (0..1000).map(|sample| f64::from(sample) * 0.02).collect();
                let decay = 0.05 * f64::from(run);
                let input: Vec<f64> = time_s.iter().map(|time| (-decay * time).exp() * (1.0 - (2.0 * PI * 0.5 * time).cos())).collect();
                let noise = noise(&mut rng, 0.8, 1000);
                let output = input.iter().zip(&noise).map(|(input, noise)| input + noise).collect();
                of_noise.push(noise);
                Recording::new(Path::new("run.csv"), Signal::pressure_bar(), Signal::displacement_mm(), time_s, input, output)
                    .expect("a recording")
            })
            .collect();
        let session = Session::new(&recordings, &[]).expect("a session");
        assert!(session.runs.iter().all(|run| run.rest.is_empty()));
        let residual: Vec<Vec<f64>> =
            of_noise.iter().map(|noise| noise.iter().map(|value| value / session.output_scale.abs()).collect()).collect();
        let found = floor(&session, &residual) * session.output_scale.abs();
        assert!((found - 1.0).abs() < 0.12, "{found} instead of 1");
    }

    #[test]
    fn rest_into_which_a_step_comes_late_tells_no_noise() {
        let mut rng = ChaCha8Rng::seed_from_u64(8);
        let time_s: Vec<f64> = (0..1200).map(|sample| f64::from(sample) * 0.02).collect();
        // A staircase; two of three of its steps come 0.4 s late, and the model knows nothing of that.
        let input: Vec<f64> = time_s.iter().map(|time| (time / 2.0).floor() % 2.0).collect();
        let mut of_noise = Vec::new();
        let recordings: Vec<Recording> = (0..8)
            .map(|_| {
                let noise: Vec<f64> = noise(&mut rng, 0.0, 1200).iter().map(|value| 0.01 * value).collect();
                let output: Vec<f64> =
                    (0..1200).map(|at| noise[at] + input[if (at / 100) % 3 == 0 { at } else { at.saturating_sub(20) }]).collect();
                of_noise.push(output.iter().zip(&input).map(|(output, input)| output - input).collect::<Vec<f64>>());
                let recording = Recording::new(
                    Path::new("run.csv"),
                    Signal::pressure_bar(),
                    Signal::displacement_mm(),
                    time_s.clone(),
                    input.clone(),
                    output,
                );
                recording.expect("a recording")
            })
            .collect();
        let session = Session::new(&recordings, &[]).expect("a session");
        let residual: Vec<Vec<f64>> =
            of_noise.iter().map(|values| values.iter().map(|value| value / session.output_scale.abs()).collect()).collect();
        let found = floor(&session, &residual) * session.output_scale.abs();
        assert!((found / 0.01 - 1.0).abs() < 0.1, "{found} instead of 0.01");
    }

    #[test]
    fn a_slow_rhythm_at_rest_is_suspected_and_white_noise_is_not() {
        let mut rng = ChaCha8Rng::seed_from_u64(7);
        let time_s: Vec<f64> = (0..1000).map(|sample| f64::from(sample) * 0.02).collect();
        // Two seconds of rest in each recording.
        let input: Vec<f64> = time_s.iter().map(|time| 1.0 - (PI * (time - 2.0_f64).max(0.0)).cos()).collect();
        let recording = |_| {
            Recording::new(
                Path::new("run.csv"),
                Signal::pressure_bar(),
                Signal::displacement_mm(),
                time_s.clone(),
                input.clone(),
                input.clone(),
            )
            .expect("a recording")
        };
        let mut session = Session::new(&(0..8).map(recording).collect::<Vec<_>>(), &[]).expect("a session");
        let white: Vec<Vec<f64>> = (0..8).map(|_| noise(&mut rng, 0.0, 1000)).collect();
        // The noise is in the output, too.
        for (run, noise) in session.runs.iter_mut().zip(&white) {
            run.output.clone_from(noise);
        }
        // 0.9 Hz, as much energy as the noise: less than two periods in a stretch of rest, and the floor counts it as noise.
        let beat = |(run, values): (usize, &Vec<f64>)| -> Vec<f64> {
            let at = |time: &f64| 1.4 * (2.0 * PI * 0.9 * (time + 24.7 * run as f64)).sin();
            values.iter().zip(&time_s).map(|(value, time)| value + at(time)).collect()
        };
        let with_rhythm: Vec<Vec<f64>> = white.iter().enumerate().map(beat).collect();
        assert!(!may_hold_a_rhythm(&session, &white), "white noise passes for a rhythm");
        assert!(may_hold_a_rhythm(&session, &with_rhythm), "a floor of {} holds the rhythm", floor(&session, &with_rhythm));
    }
}
