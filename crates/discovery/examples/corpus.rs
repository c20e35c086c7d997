//! Counts right answers on a virtual rig, one thread, a line for each case with its CPU time:
//!
//! ```text
//! corpus RIG EXCITATION SEEDS white|coloured NOISE NAMES...
//! corpus composed-tuning rich 3000,3001 white 0.005 effects aliens none creep+resonance
//! ```

use std::collections::BTreeMap;

use clap::ValueEnum;
use discovery::{DiscoverConfig, Discovery, Verdict, discover};
use virtual_rig::{self as rig, CaseConfig, EFFECTS, Excitation, Generator};

fn main() {
    let arguments: Vec<String> = std::env::args().collect();
    let generator = Generator::from_str(&arguments[1], true).expect("a rig");
    let excitation = Excitation::from_str(&arguments[2], true).expect("an excitation");
    let noise: f64 = arguments[5].parse().expect("noise over the range");
    let coloured_noise = arguments[4] == "coloured";
    let names: Vec<&str> = arguments[6..]
        .iter()
        .flat_map(|name| match name.as_str() {
            "effects" => EFFECTS.to_vec(),
            "aliens" => generator.aliens().to_vec(),
            other => vec![other],
        })
        .collect();
    for seed in arguments[3].split(',').map(|seed| seed.parse().expect("a seed")) {
        for name in &names {
            let effects: Vec<String> = if *name == "none" { Vec::new() } else { name.split('+').map(str::to_owned).collect() };
            let config = CaseConfig { effects, seed, generator, excitation, noise, coloured_noise, ..CaseConfig::default() };
            let case = rig::hide(&config).expect("a case");
            let begin_s = cpu_s();
            let settings = DiscoverConfig { threads: 1, ..DiscoverConfig::default() };
            let discovery = discover(&case.recordings, &case.kept_out, &settings).expect("a finding").discovery;
            let names: Vec<&str> = discovery.effects.iter().map(|effect| effect.name.as_str()).collect();
            println!(
                "{} {name} {seed} {:?} {} left {:.3} gap {:.3} confidence {:.2} covers {} {:.1} CPU-s",
                if is_right(&config.effects, &names, &discovery) { "RIGHT" } else { "WRONG" },
                discovery.verdict,
                names.join("+"),
                discovery.unexplained,
                discovery.gap_closed,
                discovery.effects.first().map_or(0.0, |effect| effect.confidence),
                covered(&case.truth.parameters, &discovery),
                cpu_s() - begin_s
            );
        }
    }
}

/// How many of the true parameters lie in their intervals, and how many of these there are; those that do not, with the interval.
fn covered(truth: &BTreeMap<String, f64>, discovery: &Discovery) -> String {
    let is_within = |(key, value): (&String, &f64)| {
        let (effect, parameter) = key.split_once('.')?;
        let [low, high] = discovery.effects.iter().find(|one| one.name == effect)?.intervals.get(parameter)?;
        Some((low <= value && value <= high, format!(" {key} {value:.4} outside {low:.4} to {high:.4}")))
    };
    let within: Vec<(bool, String)> = truth.iter().filter_map(is_within).collect();
    let outside: String = within.iter().filter(|(within, _)| !within).map(|(_, which)| which.as_str()).collect();
    format!("{}/{}{outside}", within.iter().filter(|(within, _)| *within).count(), within.len())
}

/// CPU time of this process so far, s, on Linux: a loaded machine does not change it.
fn cpu_s() -> f64 {
    let stat = std::fs::read_to_string("/proc/self/stat").unwrap_or_default();
    // User and system time are fields 14 and 15, in ticks of 10 ms; the name before them is in brackets.
    let fields = stat.rsplit(')').next().unwrap_or_default().split_whitespace();
    fields.skip(11).take(2).filter_map(|ticks| ticks.parse::<f64>().ok()).sum::<f64>() / 100.0
}

/// Whether a case was answered as it should be.
fn is_right(hidden: &[String], names: &[&str], discovery: &Discovery) -> bool {
    match hidden {
        [] => discovery.verdict == Verdict::None,
        [one] if one.starts_with("alien-") => matches!(discovery.verdict, Verdict::Unknown | Verdict::Ambiguous),
        [one] => names == [one.as_str()] && discovery.verdict != Verdict::Unknown,
        all => all.iter().all(|name| names.contains(&name.as_str())) && discovery.verdict != Verdict::Unknown,
    }
}
