//! `periodic-disturbance`: heart or pump, at a rhythm of its own, running on between recordings; at the sensor, or in the pressure.

use std::collections::BTreeMap;
use std::f64::consts::PI;

use crate::chain::columns::Columns;
use crate::chain::filters::grid;
use crate::chain::form::{Form, Parameter, Place, Quantity, Spec, Told};
use crate::data::phasors;
use crate::data::session::{Run, Session};

/// All forms.
pub const FORMS: &[&dyn Form] = &[&RUNNING_ON, &TRIGGERED, &LOOSE, &LOOSE_BEAT, &Pump];

/// Harmonics that must not go with the input for a rhythm to be from outside: the higher ones are small on either side.
const STRONG_HARMONICS: usize = 3;

/// Harmonics of the rhythm: a heart's pulse is a tenth of its period long.
const HARMONICS: usize = 6;

/// A rhythm of one phase in all recordings.
struct Beat {
    form: Told,
    /// Whether it begins with each recording, instead of running on through the session.
    triggered: bool,
}

static RUNNING_ON: Beat = Beat { form: ("of-the-session", "running on through the session"), triggered: false };

static TRIGGERED: Beat = Beat { form: ("triggered", "beginning with each recording"), triggered: true };

const NAME: &str = "periodic-disturbance";

struct Pump;

/// A rhythm whose phase is read from each recording.
struct Loose {
    form: Told,
    harmonics: usize,
    cost: usize,
}

static LOOSE: Loose = Loose { form: ("own-phase", "with a phase of its own in each recording"), harmonics: 1, cost: 6 };

static LOOSE_BEAT: Loose =
    Loose { form: ("beat-own-phase", "a beat with a phase of its own in each recording"), harmonics: HARMONICS, cost: 14 };

/// Periods of a rhythm from which its phase is read.
const PERIODS_OF_START_UP: f64 = 3.0;

const FREQUENCY: &[Parameter] = &[Parameter { name: "frequency", quantity: Quantity::Frequency, low: 0.05, high: 25.0, logarithmic: true }];

/// The residual of one recording, ready to be searched for lines.
struct Line<'a> {
    run: &'a Run,
    /// Kept-out samples are zero: they have no say.
    residual: Vec<f64>,
    /// Frequency at which the input goes to and fro.
    own_hz: f64,
}

impl<'a> Line<'a> {
    fn new(run: &'a Run, residual: &'a [f64]) -> Self {
        let mean = run.input.iter().sum::<f64>() / run.input.len() as f64;
        let crossings = run.input.windows(2).filter(|pair| (pair[0] > mean) != (pair[1] > mean)).count();
        let residual = residual.iter().zip(&run.role).map(|(value, role)| if role.is_worked_with() { *value } else { 0.0 }).collect();
        Self { run, residual, own_hz: crossings as f64 / 2.0 / (run.input.len() as f64 * run.period_s) }
    }

    fn all(session: &'a Session, residual: &'a [Vec<f64>]) -> Vec<Self> {
        let worked = Run::is_worked_with;
        session.runs.iter().zip(residual).filter(|(run, _)| worked(run)).map(|(run, residual)| Self::new(run, residual)).collect()
    }

    /// Whether a frequency is a multiple of the input's own: what goes with the input is no rhythm from outside.
    fn belongs_to_input(&self, frequency_hz: f64) -> bool {
        let multiple = (frequency_hz / self.own_hz).round();
        let resolved_hz = 0.6 / (self.run.input.len() as f64 * self.run.period_s);
        (1.0..=12.0).contains(&multiple) && (frequency_hz - multiple * self.own_hz).abs() < resolved_hz.max(0.04 * self.own_hz)
    }

    /// Real and imaginary part of the residual's sums at these frequencies; the phase is that of the session.
    fn transform(&self, frequencies_hz: &[f64]) -> [Vec<f64>; 2] {
        phasors::transform(&self.residual, self.run.session_s[0], self.run.period_s, frequencies_hz)
    }
}

/// Power of the residual at every frequency: recordings added without regard to phase, or with it.
fn powers(lines: &[Line<'_>], frequencies_hz: &[f64], coherent: bool) -> Vec<f64> {
    let mut total = vec![0.0; frequencies_hz.len()];
    let mut sums = [total.clone(), total.clone()];
    for line in lines {
        let [re, im] = line.transform(frequencies_hz);
        for (at, &frequency_hz) in frequencies_hz.iter().enumerate() {
            if !line.belongs_to_input(frequency_hz) {
                total[at] += re[at] * re[at] + im[at] * im[at];
                sums[0][at] += re[at];
                sums[1][at] += im[at];
            }
        }
    }
    if coherent { sums[0].iter().zip(&sums[1]).map(|(re, im)| re.powi(2) + im.powi(2)).collect() } else { total }
}

/// The residual's power over that of its surroundings, at frequencies at equal distances: the residual of a poor model is all low frequencies.
struct Spectrum {
    lowest_hz: f64,
    spacing_hz: f64,
    over: Vec<f64>,
}

impl Spectrum {
    fn new(session: &Session, residual: &[Vec<f64>]) -> Self {
        let spacing_hz = phasors::spacing_hz(session);
        let lowest_hz = LOWEST_HZ.max(5.0 * spacing_hz);
        let count = ((0.45 / session.runs[0].period_s - lowest_hz) / spacing_hz).max(0.0) as usize;
        let frequencies: Vec<f64> = (0..count).map(|step| lowest_hz + step as f64 * spacing_hz).collect();
        let powers = powers(&Line::all(session, residual), &frequencies, false);
        let over = (0..count)
            .map(|index| {
                let mut around: Vec<f64> = powers[index.saturating_sub(30)..(index + 31).min(count)].to_vec();
                around.sort_by(f64::total_cmp);
                powers[index] / around[around.len() / 2].max(1e-30)
            })
            .collect();
        Self { lowest_hz, spacing_hz, over }
    }

    /// Frequencies with most power, Hz, at most three.
    fn peaks(&self) -> Vec<f64> {
        let mut peaks: Vec<(f64, f64)> = self.over.iter().zip(0..).map(|(&over, step)| (over, self.at(step))).collect();
        peaks.sort_by(|x, y| y.0.total_cmp(&x.0));
        peaks.into_iter().take(3).filter(|entry| entry.0 > 1.5).map(|entry| entry.1).collect()
    }

    /// Power over its surroundings at one of the spectrum's frequencies.
    fn over_at(&self, frequency_hz: f64) -> f64 {
        self.over.get(((frequency_hz - self.lowest_hz) / self.spacing_hz).round() as usize).copied().unwrap_or(0.0)
    }

    fn at(&self, step: u32) -> f64 {
        self.lowest_hz + f64::from(step) * self.spacing_hz
    }

    /// How much speaks for a rhythm at this frequency, known to half a step at its harmonic `exact`: the lines among its harmonics.
    fn log_likelihood(&self, frequency_hz: f64, exact: usize) -> f64 {
        let line = |harmonic: usize| {
            let place = (harmonic as f64 * frequency_hz - self.lowest_hz) / self.spacing_hz;
            let width = 0.5 + 0.5 * harmonic as f64 / exact as f64;
            let (low, high) = ((place - width).ceil().max(0.0) as usize, (place + width).floor().max(0.0) as usize);
            let most = self.over.get(low..(high + 1).min(self.over.len())).unwrap_or(&[]).iter().copied().fold(0.0, f64::max);
            (most / LINE).max(1.0).ln()
        };
        (1..=HARMONICS).map(line).sum()
    }

    /// Of which harmonic of a rhythm the peak is the line: the first unless a slower rhythm has lines that speak for it.
    fn harmonic_of(&self, peak_hz: f64) -> usize {
        let mut best = (1, self.log_likelihood(peak_hz, 1));
        for harmonic in 2..=3 {
            let base_hz = peak_hz / harmonic as f64;
            let log_likelihood = self.log_likelihood(base_hz, harmonic);
            if base_hz >= self.lowest_hz && log_likelihood > 1.1 * best.1 {
                best = (harmonic, log_likelihood);
            }
        }
        best.0
    }

    /// Base frequencies of the rhythms with most power, Hz.
    fn bases(&self) -> Vec<f64> {
        self.peaks().into_iter().map(|peak| peak / self.harmonic_of(peak) as f64).collect()
    }
}

/// Slowest rhythm that is looked for, Hz: nine breaths a minute, three of which are in a recording of 20 s.
const LOWEST_HZ: f64 = 0.15;

/// Power over its surroundings from which on a frequency counts as a line: noise reaches it at one frequency in a hundred.
const LINE: f64 = 6.0;

/// Takes out the starts of which some harmonic goes with the input in every recording: no recording can tell such a rhythm from what the
/// input itself causes.
fn apart_from_input(session: &Session, residual: &[Vec<f64>], mut starts: Vec<Vec<f64>>, harmonics: usize) -> Vec<Vec<f64>> {
    let lines = Line::all(session, residual);
    let goes_with_it = |frequency_hz: f64| lines.iter().all(|line| line.belongs_to_input(frequency_hz));
    starts.retain(|start| (1..=harmonics).all(|harmonic| !goes_with_it(harmonic as f64 * start[0])));
    starts
}

/// Sizes of the harmonics from their sines and cosines.
fn tell_harmonics(weights: &[f64], session: &Session) -> BTreeMap<String, f64> {
    let unit = &session.output_unit;
    (0..weights.len() / 2)
        .map(|harmonic| {
            let name = if harmonic == 0 { format!("amplitude_{unit}") } else { format!("amplitude_of_harmonic_{}_{unit}", harmonic + 1) };
            (name, weights[2 * harmonic].hypot(weights[2 * harmonic + 1]) * session.output_scale.abs())
        })
        .collect()
}

impl Form for Beat {
    fn spec(&self) -> Spec {
        Spec {
            parameters: FREQUENCY,
            weights: 2 * HARMONICS,
            cost: Some(3),
            // The comb is a fifth of what the session resolves.
            steps: if self.triggered { &[0.002] } else { &[1e-4] },
            ..Spec::new(NAME, self.form, Place::Sensor)
        }
    }
    fn starts(&self, session: &Session, residual: &[Vec<f64>]) -> Vec<Vec<f64>> {
        let spectrum = Spectrum::new(session, residual);
        let lines = Line::all(session, residual);
        let of = |peak: f64| tuned(session, &lines, &spectrum, peak).map(|found| found / spectrum.harmonic_of(peak) as f64);
        let found: Vec<f64> = if self.triggered { spectrum.bases() } else { spectrum.peaks().into_iter().filter_map(of).collect() };
        apart_from_input(session, residual, grid(&[&found]), STRONG_HARMONICS)
    }
    fn output(&self, parameters: &[f64], run: &Run, _: &[f64], columns: &mut Columns) {
        push_harmonics(parameters[0], if self.triggered { &run.time_s } else { &run.session_s }, columns);
    }
    fn tell(&self, _: &[f64], weights: &[f64], session: &Session) -> BTreeMap<String, f64> {
        tell_harmonics(weights, session)
    }
}

/// The peak's frequency where its phase runs on through the session: a comb of narrow lines lies under each peak.
fn tuned(session: &Session, lines: &[Line<'_>], spectrum: &Spectrum, peak_hz: f64) -> Option<f64> {
    let fine = 0.2 / session.length_s;
    let steps = (1.2 * spectrum.spacing_hz / fine).ceil() as i64;
    let comb: Vec<f64> = (-steps..=steps).map(|step| peak_hz + step as f64 * fine).collect();
    powers(lines, &comb, true).into_iter().zip(comb).max_by(|x, y| x.0.total_cmp(&y.0)).map(|found| found.1)
}

/// A sine in the pressure: the hysteresis swallows it at every reversal, so that at the sensor it comes and goes with the strokes.
impl Form for Pump {
    fn spec(&self) -> Spec {
        Spec {
            parameters: WAVE,
            steps: &[1e-4, 0.03, 0.03],
            ..Spec::new(NAME, ("of-the-pressure", "of the pressure, running on through the session"), Place::Tube)
        }
    }
    fn starts(&self, session: &Session, residual: &[Vec<f64>]) -> Vec<Vec<f64>> {
        let spectrum = Spectrum::new(session, residual);
        let lines = Line::all(session, residual);
        let samples: f64 = lines.iter().map(|line| line.residual.len() as f64).sum();
        let mut starts = Vec::new();
        for peak in spectrum.peaks().into_iter().filter(|&peak| spectrum.over_at(peak) > LINE) {
            let Some(found) = tuned(session, &lines, &spectrum, peak) else { continue };
            let (mut sine, mut cosine) = (0.0, 0.0);
            for line in &lines {
                let [re, im] = line.transform(&[found]);
                cosine += 2.0 * re[0] / samples;
                sine += 2.0 * im[0] / samples;
            }
            // What arrives at the sensor is what came in, or about half of it.
            starts.extend([1.0, 1.8].map(|more| vec![found, more * sine, more * cosine]));
        }
        apart_from_input(session, residual, starts, 1)
    }
    fn input(&self, parameters: &[f64], run: &Run, path: &mut [f64]) {
        let omega = 2.0 * PI * parameters[0];
        for (value, time_s) in path.iter_mut().zip(&run.session_s) {
            let (im, re) = (omega * time_s).sin_cos();
            *value += parameters[1] * im + parameters[2] * re;
        }
    }
    fn tell(&self, parameters: &[f64], _: &[f64], session: &Session) -> BTreeMap<String, f64> {
        BTreeMap::from([(format!("amplitude_{}", session.input_unit), parameters[1].hypot(parameters[2]) * session.input_scale)])
    }
}

const SINE: Parameter = Parameter { name: "sine", quantity: Quantity::Ratio, low: -0.2, high: 0.2, logarithmic: false };

const WAVE: &[Parameter] = &[FREQUENCY[0], SINE, Parameter { name: "cosine", ..SINE }];

/// A sine and a cosine of each harmonic, at times in s.
fn push_harmonics(frequency_hz: f64, time_s: &[f64], columns: &mut Columns) {
    for harmonic in 1..=HARMONICS {
        let omega = 2.0 * PI * frequency_hz * harmonic as f64;
        let angles: Vec<(f64, f64)> = time_s.iter().map(|time_s| (omega * time_s).sin_cos()).collect();
        columns.push(true, |sample| angles[sample].0);
        columns.push(true, |sample| angles[sample].1);
    }
}

impl Form for Loose {
    fn spec(&self) -> Spec {
        Spec {
            parameters: FREQUENCY,
            weights: 1,
            cost: Some(self.cost),
            steps: &[0.002],
            reads_output: true,
            needs_sum: true,
            ..Spec::new(NAME, self.form, Place::Sensor)
        }
    }
    fn start_up_s(&self, parameters: &[f64]) -> f64 {
        PERIODS_OF_START_UP / parameters[0]
    }
    fn starts(&self, session: &Session, residual: &[Vec<f64>]) -> Vec<Vec<f64>> {
        let spectrum = Spectrum::new(session, residual);
        let found = if self.harmonics > 1 { spectrum.bases() } else { spectrum.peaks() };
        apart_from_input(session, residual, grid(&[&found]), self.harmonics.min(STRONG_HARMONICS))
    }
    fn output(&self, parameters: &[f64], run: &Run, sum: &[f64], columns: &mut Columns) {
        // Nothing but the recording itself knows the phase: it is read from what the model leaves of the measured output. Where there is
        // no measured output (a simulation) there is no rhythm either.
        let mut rhythm = vec![0.0; run.output.len()];
        if run.output.iter().any(|value| *value != 0.0) {
            let kept = || run.output.iter().zip(sum).zip(&run.keep).filter(|(_, keep)| **keep);
            let count = kept().count().max(1) as f64;
            let mean = kept().map(|((output, sum), _)| output - sum).sum::<f64>() / count;
            for harmonic in 1..=self.harmonics {
                let omega = 2.0 * PI * parameters[0] * harmonic as f64;
                let angles: Vec<(f64, f64)> = run.time_s.iter().map(|time_s| (omega * time_s).sin_cos()).collect();
                let (mut sine, mut cosine) = (0.0, 0.0);
                for (sample, (output, sum)) in run.output.iter().zip(sum).enumerate() {
                    let (im, re) = angles[sample];
                    let left = if run.keep[sample] { output - sum - mean } else { 0.0 };
                    sine += 2.0 * left * im / count;
                    cosine += 2.0 * left * re / count;
                }
                for (value, (im, re)) in rhythm.iter_mut().zip(angles) {
                    *value += sine * im + cosine * re;
                }
            }
        }
        columns.push(false, |sample| rhythm[sample]);
    }
    fn tell(&self, _: &[f64], weights: &[f64], _: &Session) -> BTreeMap<String, f64> {
        BTreeMap::from([("share_of_the_line".to_owned(), weights[0])])
    }
}

#[cfg(test)]
mod tests;
