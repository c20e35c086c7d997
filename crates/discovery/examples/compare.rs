//! The criterion beside the verdict, on cases of a virtual rig.
use clap::ValueEnum;
use discovery::{DiscoverConfig, discover};
use std::time::Instant;
use virtual_rig::{self as rig, CaseConfig, Excitation, Generator};

fn main() {
    let arguments: Vec<String> = std::env::args().collect();
    let generator = Generator::from_str(&arguments[1], true).expect("a rig");
    let excitation = Excitation::from_str(&arguments[2], true).expect("an excitation");
    let seeds: Vec<u64> = arguments[3].split(',').map(|seed| seed.parse().expect("a seed")).collect();
    let coloured_noise = arguments[4] == "coloured";
    for seed in seeds {
        for name in &arguments[5..] {
            let effects: Vec<String> = if name == "none" { Vec::new() } else { name.split('+').map(str::to_owned).collect() };
            let config = CaseConfig { effects, seed, generator, excitation, coloured_noise, ..CaseConfig::default() };
            let case = rig::hide(&config).expect("a case");
            let begin = Instant::now();
            let finding = discover(&case.recordings, &case.kept_out, &DiscoverConfig { threads: 1, ..DiscoverConfig::default() });
            let discovery = finding.expect("a finding").discovery;
            let found: Vec<&str> = discovery.effects.iter().map(|effect| effect.name.as_str()).collect();
            let set: Vec<String> = discovery
                .confidence_set
                .iter()
                .map(|member| format!("{}:{:.4}({:.2})", member.effects.join("+"), member.criterion, member.p_value))
                .collect();
            println!(
                "{name:<28}{seed:>6} {:<10}{:<44} unexpl {:.3} crit {:.4} set [{}] {:.1} s",
                format!("{:?}", discovery.verdict),
                found.join("+"),
                discovery.unexplained,
                discovery.criterion.unwrap_or(0.0),
                set.join(", "),
                begin.elapsed().as_secs_f64()
            );
        }
    }
}
