//! The corpus of hidden cases: runs discovery on the virtual rig and counts what it got right.

use std::collections::BTreeMap;
use std::time::Instant;

use serde::Serialize;

use super::{DiscoverConfig, Verdict, discover};
use crate::rig::{self, ALIENS, CaseConfig, EFFECTS, Excitation, RigError};

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
    /// Threads inside a case.
    pub threads: usize,
}

/// One case, told and found.
#[derive(Clone, Debug, Serialize)]
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
    /// Time, s.
    pub seconds: f64,
}

/// Runs the corpus; `each` sees every result as it comes.
///
/// # Errors
/// When a name is unknown.
pub fn run(config: &CorpusConfig, mut each: impl FnMut(&CaseResult)) -> Result<Vec<CaseResult>, RigError> {
    let mut all = Vec::new();
    let mut names: Vec<Vec<String>> = Vec::new();
    for name in &config.names {
        match name.as_str() {
            "none" => names.push(Vec::new()),
            "effects" => names.extend(EFFECTS.iter().map(|name| vec![(*name).to_owned()])),
            "aliens" => names.extend(ALIENS.iter().map(|name| vec![(*name).to_owned()])),
            "pairs" => names.push(vec!["pairs".to_owned()]),
            other => names.push(other.split('+').map(str::to_owned).collect()),
        }
    }
    for seed in config.seeds.clone() {
        for hidden in &names {
            let hidden = if hidden.first().is_some_and(|name| name == "pairs") { pair(seed) } else { hidden.clone() };
            let case = rig::hide(&CaseConfig {
                effects: hidden.clone(),
                seed,
                noise: config.noise,
                coloured_noise: config.coloured_noise,
                excitation: config.excitation,
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
                seconds: begin.elapsed().as_secs_f64(),
            };
            each(&result);
            all.push(result);
        }
    }
    Ok(all)
}

/// Two different effects, drawn by a hash of the seed.
fn pair(seed: u64) -> Vec<String> {
    let count = EFFECTS.len() as u64;
    let mixed = seed.wrapping_mul(0x9E37_79B9_7F4A_7C15).rotate_left(29);
    let first = mixed % count;
    let second = (first + 1 + (mixed / count) % (count - 1)) % count;
    [first, second].iter().map(|&index| EFFECTS[usize::try_from(index).unwrap_or(0)].to_owned()).collect()
}

/// Whether a case was answered as it should be.
#[must_use]
pub fn right(result: &CaseResult) -> bool {
    let alien = result.hidden.iter().any(|name| ALIENS.contains(&name.as_str()));
    match result.hidden.len() {
        0 => result.verdict == Verdict::None,
        _ if alien => matches!(result.verdict, Verdict::Unknown | Verdict::Ambiguous),
        1 => result.found.first() == result.hidden.first() && result.verdict != Verdict::Unknown && result.found.len() == 1,
        _ => result.hidden.iter().all(|name| result.found.contains(name)) && result.verdict != Verdict::Unknown,
    }
}

/// The confusion matrix in words: for every hidden effect how many were right, the median gap closed and what was said instead.
#[must_use]
pub fn summary(results: &[CaseResult]) -> String {
    let mut by_name: BTreeMap<String, Vec<&CaseResult>> = BTreeMap::new();
    for result in results {
        let name = match result.hidden.len() {
            0 => "(none)".to_owned(),
            1 => result.hidden[0].clone(),
            _ => "(two effects)".to_owned(),
        };
        by_name.entry(name).or_default().push(result);
    }
    let mut text = format!("{:<28}{:>9}{:>8}{:>8}  instead\n", "hidden", "right", "gap", "s");
    for (name, cases) in &by_name {
        let good = cases.iter().filter(|case| right(case)).count();
        let middle = |mut values: Vec<f64>| {
            values.sort_by(f64::total_cmp);
            values[values.len() / 2]
        };
        let gap = middle(cases.iter().map(|case| case.gap_closed).collect());
        let seconds = middle(cases.iter().map(|case| case.seconds).collect());
        let mut instead: BTreeMap<String, usize> = BTreeMap::new();
        for case in cases.iter().filter(|case| !right(case)) {
            let verdict = format!("{:?}", case.verdict).to_lowercase();
            *instead.entry(format!("{verdict} {}", case.found.join("+"))).or_default() += 1;
        }
        let instead: Vec<String> = instead.iter().map(|(what, count)| format!("{count} x {what}")).collect();
        text += &format!("{name:<28}{:>9}{gap:>8.3}{seconds:>8.2}  {}\n", format!("{good}/{}", cases.len()), instead.join(", "));
    }
    let single: Vec<&CaseResult> =
        results.iter().filter(|case| case.hidden.len() == 1 && !ALIENS.contains(&case.hidden[0].as_str())).collect();
    if !single.is_empty() {
        let top = single.iter().filter(|case| case.found.first() == case.hidden.first()).count();
        let good = single.iter().filter(|case| right(case)).count();
        text += &format!("single effects: {good}/{} right, {top} of them at least first\n", single.len());
    }
    text
}
