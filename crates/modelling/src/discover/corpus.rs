//! The corpus of hidden cases: runs discovery on the virtual rig and counts what it got right.

use std::collections::BTreeMap;
use std::time::Instant;

use serde::{Deserialize, Serialize};

use discovery::{DiscoverConfig, Effect, Verdict, discover};
use virtual_rig::{self, CaseConfig, EFFECTS, Excitation, Generator, RigError};

/// What to run.
#[derive(Clone, Debug)]
pub struct CorpusConfig {
    /// Names to hide, one case each and seed; `none` hides nothing, `pairs` two effects drawn by the seed, `aliens` every alien.
    pub names: Vec<String>,
    /// Seeds, first and one past the last.
    pub seeds: std::ops::Range<u64>,
    /// Noise relative to the range.
    pub noise: f64,
    /// Coloured noise.
    pub coloured_noise: bool,
    /// Session.
    pub excitation: Excitation,
    /// The rig.
    pub generator: Generator,
    /// Threads inside a case.
    pub threads: usize,
}

/// One case, told and found.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct CaseResult {
    /// What was hidden.
    pub hidden: Vec<String>,
    /// Seed.
    pub seed: u64,
    /// Verdict.
    pub verdict: Verdict,
    /// Effects named.
    pub found: Vec<String>,
    /// Form of the first.
    pub form: String,
    /// Second best.
    pub runner_up: String,
    /// Share of the gap closed.
    pub gap_closed: f64,
    /// RMSE before, after and the floor, mm.
    pub rmse: [f64; 3],
    /// Share of the mean square above the noise that is left on the samples worked with.
    pub unexplained: f64,
    /// Relative errors of the parameters that the rig and the catalogue both have, `effect.parameter_unit`.
    pub errors: BTreeMap<String, f64>,
    /// Whether the 95 % intervals of those parameters hold the truth.
    pub held: BTreeMap<String, bool>,
    /// Confidence in the first effect.
    pub confidence: f64,
    /// Time, s.
    pub seconds: f64,
}

/// Runs the corpus but for the cases that are `done` already; `each` sees all results whenever one more is there, the new one last.
///
/// # Errors
/// When a name is unknown, or when `each` fails.
pub fn run<E: From<RigError>>(
    config: &CorpusConfig,
    done: Vec<CaseResult>,
    mut each: impl FnMut(&[CaseResult]) -> Result<(), E>,
) -> Result<Vec<CaseResult>, E> {
    let mut all = done;
    let mut names: Vec<Vec<String>> = Vec::new();
    for name in &config.names {
        match name.as_str() {
            "none" => names.push(Vec::new()),
            "effects" => names.extend(EFFECTS.iter().map(|name| vec![(*name).to_owned()])),
            "aliens" => names.extend(config.generator.aliens().iter().map(|name| vec![(*name).to_owned()])),
            "pairs" => names.push(vec!["pairs".to_owned()]),
            other => names.push(other.split('+').map(str::to_owned).collect()),
        }
    }
    for seed in config.seeds.clone() {
        for hidden in &names {
            let hidden = if hidden.first().is_some_and(|name| name == "pairs") { pair(seed) } else { hidden.clone() };
            if all.iter().any(|result| result.seed == seed && result.hidden == hidden) {
                continue;
            }
            let case = virtual_rig::hide(&CaseConfig {
                effects: hidden.clone(),
                seed,
                noise: config.noise,
                coloured_noise: config.coloured_noise,
                excitation: config.excitation,
                generator: config.generator,
                measured_pressure: false,
            })?;
            let begin = Instant::now();
            let settings = DiscoverConfig { threads: config.threads, ..DiscoverConfig::default() };
            let Ok(finding) = discover(&case.recordings, &case.kept_out, &settings) else { continue };
            let result = CaseResult {
                hidden,
                seed,
                verdict: finding.discovery.verdict,
                found: finding.discovery.effects.iter().map(|effect| effect.name.clone()).collect(),
                form: finding.discovery.effects.first().map(|effect| effect.form.clone()).unwrap_or_default(),
                runner_up: finding.discovery.runner_up.as_ref().map(|second| second.name.clone()).unwrap_or_default(),
                gap_closed: finding.discovery.gap_closed,
                rmse: [finding.discovery.rmse_before, finding.discovery.rmse_after, finding.discovery.noise_floor],
                unexplained: finding.discovery.unexplained,
                errors: errors(&case.truth.parameters, &finding.discovery.effects),
                held: held(&case.truth.parameters, &finding.discovery.effects),
                confidence: finding.discovery.effects.first().map_or(0.0, |effect| effect.confidence),
                seconds: begin.elapsed().as_secs_f64(),
            };
            all.push(result);
            each(&all)?;
        }
    }
    Ok(all)
}

/// Two different effects, drawn by a hash of the seed.
fn pair(seed: u64) -> Vec<String> {
    let count = EFFECTS.len() as u64;
    // SplitMix64 (Steele, Lea and Flood 2014): neighbouring seeds draw every pair alike.
    let mut mixed = seed.wrapping_add(0x9E37_79B9_7F4A_7C15);
    mixed = (mixed ^ (mixed >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    mixed ^= mixed >> 31;
    let first = mixed % count;
    let second = (first + 1 + (mixed / count) % (count - 1)) % count;
    [first, second].iter().map(|&index| EFFECTS[usize::try_from(index).unwrap_or(0)].to_owned()).collect()
}

/// Whether a case was answered as it should be.
#[must_use]
pub fn right(result: &CaseResult) -> bool {
    let alien = result.hidden.iter().any(|name| name.starts_with("alien-"));
    match result.hidden.len() {
        0 => result.verdict == Verdict::None,
        _ if alien => matches!(result.verdict, Verdict::Unknown | Verdict::Ambiguous),
        1 => result.found.first() == result.hidden.first() && result.verdict != Verdict::Unknown && result.found.len() == 1,
        _ => result.hidden.iter().all(|name| result.found.contains(name)) && result.verdict != Verdict::Unknown,
    }
}

/// Relative errors of the parameters that both sides have.
fn errors(truth: &BTreeMap<String, f64>, found: &[Effect]) -> BTreeMap<String, f64> {
    let mut errors = BTreeMap::new();
    for effect in found {
        for (name, value) in &effect.parameters {
            let key = format!("{}.{name}", effect.name);
            if let Some(truth) = truth.get(&key) {
                errors.insert(key, (value / truth - 1.0).abs());
            }
        }
    }
    errors
}

/// Whether the intervals of the parameters that both sides have hold the truth.
fn held(truth: &BTreeMap<String, f64>, found: &[Effect]) -> BTreeMap<String, bool> {
    let of = |effect: &Effect| {
        let of = |(name, [low, high]): (&String, &[f64; 2])| {
            let key = format!("{}.{name}", effect.name);
            truth.get(&key).map(|truth| (key, (low..=high).contains(&truth)))
        };
        effect.intervals.iter().filter_map(of).collect::<Vec<_>>()
    };
    found.iter().flat_map(of).collect()
}

/// Expected calibration error of the confidence in what was named first, five bins (Naeini et al. 2015): the mean distance of the share that
/// is right from the mean confidence, weighted by cases.
fn calibration_error(results: &[CaseResult]) -> f64 {
    let named: Vec<(f64, bool)> = results
        .iter()
        .filter(|case| !case.found.is_empty())
        .map(|case| (case.confidence, case.found.first().is_some_and(|first| case.hidden.contains(first))))
        .collect();
    let in_bin = |bin: usize| named.iter().filter(move |(confidence, _)| ((5.0 * confidence) as usize).min(4) == bin);
    let error = |bin: usize| {
        let count = in_bin(bin).count() as f64;
        let (confidence, right) =
            in_bin(bin).fold((0.0, 0.0), |sum, (confidence, right)| (sum.0 + confidence, sum.1 + f64::from(u8::from(*right))));
        if count > 0.0 { (confidence - right).abs() } else { 0.0 }
    };
    (0..5).map(error).sum::<f64>() / named.len().max(1) as f64
}

/// What came of all cases with the same thing hidden.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Row {
    /// Cases.
    pub cases: usize,
    /// Of these answered right.
    pub right: usize,
    /// Of these with the hidden effect at least named first.
    pub first: usize,
    /// Median share of the gap closed.
    pub gap_closed: f64,
    /// Median time, s.
    pub seconds: f64,
    /// What was answered, verdict and effects, and how often: a line of the confusion matrix.
    pub answers: BTreeMap<String, usize>,
    /// Median relative error of each parameter.
    pub errors: BTreeMap<String, f64>,
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(f64::NAN)
}

/// One row for everything that was hidden.
#[must_use]
pub fn rows(results: &[CaseResult]) -> BTreeMap<String, Row> {
    let mut by_name: BTreeMap<String, Vec<&CaseResult>> = BTreeMap::new();
    for result in results {
        let name = match result.hidden.len() {
            0 => "(none)".to_owned(),
            1 => result.hidden[0].clone(),
            _ => "(two effects)".to_owned(),
        };
        by_name.entry(name).or_default().push(result);
    }
    by_name
        .into_iter()
        .map(|(name, cases)| {
            let mut row = Row {
                cases: cases.len(),
                right: cases.iter().filter(|case| right(case)).count(),
                first: cases.iter().filter(|case| case.found.first() == case.hidden.first()).count(),
                gap_closed: median(cases.iter().map(|case| case.gap_closed).collect()),
                seconds: median(cases.iter().map(|case| case.seconds).collect()),
                ..Row::default()
            };
            let mut errors: BTreeMap<&String, Vec<f64>> = BTreeMap::new();
            for case in &cases {
                let verdict = format!("{:?}", case.verdict).to_lowercase();
                *row.answers.entry(format!("{verdict} {}", case.found.join("+")).trim_end().to_owned()).or_default() += 1;
                for (key, error) in &case.errors {
                    errors.entry(key).or_default().push(*error);
                }
            }
            row.errors = errors.into_iter().map(|(key, values)| (key.clone(), median(values))).collect();
            (name, row)
        })
        .collect()
}

/// The rows as text: for everything hidden how many were right, the median gap closed, and what was said instead.
#[must_use]
pub fn summary(results: &[CaseResult]) -> String {
    let rows = rows(results);
    let mut text = format!("{:<28}{:>9}{:>8}{:>8}  answers\n", "hidden", "right", "gap", "s");
    for (name, row) in &rows {
        let answers: Vec<String> = row.answers.iter().map(|(what, count)| format!("{count} x {what}")).collect();
        let right = format!("{}/{}", row.right, row.cases);
        text += &format!("{name:<28}{right:>9}{:>8.3}{:>8.2}  {}\n", row.gap_closed, row.seconds, answers.join(", "));
    }
    let single = rows.iter().filter(|(name, _)| !name.starts_with('(') && !name.starts_with("alien-"));
    let (cases, right, first) = single.fold((0, 0, 0), |sum, (_, row)| (sum.0 + row.cases, sum.1 + row.right, sum.2 + row.first));
    if cases > 0 {
        text += &format!("single effects: {right}/{cases} right, {first} of them at least first\n");
    }
    let intervals: Vec<bool> = results.iter().flat_map(|case| case.held.values().copied()).collect();
    if !intervals.is_empty() {
        text += &format!("intervals that hold the truth: {} of {}\n", intervals.iter().filter(|held| **held).count(), intervals.len());
    }
    text += &format!("expected calibration error of the confidence: {:.3}\n", calibration_error(results));
    for (key, error) in rows.values().flat_map(|row| &row.errors) {
        text += &format!("  median error of {key}: {:.1} %\n", 100.0 * error);
    }
    text
}
