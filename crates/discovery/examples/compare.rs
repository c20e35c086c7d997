//! The criterion beside the verdict, for whoever works on either: on cases of a virtual rig, or on recordings.
//!
//! ```text
//! compare composed-tuning paper 3300,3301 white none creep pneumatic-lag+creep
//! compare files time=t_s,input=position_mm,output=force_N a.csv b.csv
//! ```

use std::path::PathBuf;
use std::time::Instant;

use clap::ValueEnum;
use discovery::{DiscoverConfig, discover};
use recording::{ReadOptions, Recording};
use virtual_rig::{self as rig, CaseConfig, Excitation, Generator};

fn main() {
    let arguments: Vec<String> = std::env::args().collect();
    if arguments[1] == "files" {
        let paths: Vec<PathBuf> = arguments[3..].iter().map(PathBuf::from).collect();
        let recordings = recording::load_with(&paths, &ReadOptions::columns(Some(&arguments[2]))).expect("recordings");
        return show("files", &recordings, &[]);
    }
    let generator = Generator::from_str(&arguments[1], true).expect("a rig");
    let excitation = Excitation::from_str(&arguments[2], true).expect("an excitation");
    let coloured_noise = arguments[4] == "coloured";
    for seed in arguments[3].split(',').map(|seed| seed.parse().expect("a seed")) {
        for name in &arguments[5..] {
            let effects: Vec<String> = if name == "none" { Vec::new() } else { name.split('+').map(str::to_owned).collect() };
            let config = CaseConfig { effects, seed, generator, excitation, coloured_noise, ..CaseConfig::default() };
            let case = rig::hide(&config).expect("a case");
            show(&format!("{name} {seed}"), &case.recordings, &case.kept_out);
        }
    }
}

/// One line of what was found and of the confidence set.
fn show(name: &str, recordings: &[Recording], kept: &[Recording]) {
    let begin = Instant::now();
    let config = DiscoverConfig { threads: 1, ..DiscoverConfig::default() };
    let discovery = discover(recordings, kept, &config).expect("a finding").discovery;
    let found: Vec<String> = discovery.effects.iter().map(|effect| format!("{}({:.2})", effect.name, effect.confidence)).collect();
    let set: Vec<String> = discovery
        .confidence_set
        .iter()
        .map(|member| format!("{}:{:.4}({:.2})", member.effects.join("+"), member.criterion, member.p_value))
        .collect();
    println!(
        "{name:<34} {:<10}{:<50} left {:.3} gap {:.3} criterion {:.4} set [{}] {:.1} s",
        format!("{:?}", discovery.verdict),
        found.join("+"),
        discovery.unexplained,
        discovery.gap_closed,
        discovery.criterion.unwrap_or(0.0),
        set.join(", "),
        begin.elapsed().as_secs_f64()
    );
}
