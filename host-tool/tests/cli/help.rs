//! Help, version, completions: they teach, and they end as they should.

use crate::support::Bench;

const COMMANDS: [&str; 14] = [
    "simulate",
    "check",
    "tune",
    "track",
    "hide",
    "discover",
    "plan-experiment",
    "identify",
    "train",
    "evaluate",
    "export",
    "inspect",
    "demo",
    "completions",
];

#[test]
fn the_help_of_every_command_shows_examples_and_its_options() {
    let bench = Bench::new();
    for command in COMMANDS {
        let help = bench.works(&format!("{command} --help")).stdout;
        assert!(help.contains(&format!("\n  catheter {command} ")), "no example in the help of {command}:\n{help}");
        let short = bench.works(&format!("{command} -h")).stdout;
        assert!(short.len() < help.len(), "-h of {command} should be the short help");
    }
}

#[test]
fn every_command_that_computes_takes_json_seed_and_threads() {
    let bench = Bench::new();
    for command in COMMANDS.iter().filter(|command| **command != "completions") {
        let help = bench.works(&format!("{command} --help")).stdout;
        for option in ["--json <FILE>", "--seed <N>", "--threads <N>"] {
            assert!(help.contains(option), "{command} lacks {option}");
        }
    }
}

#[test]
fn the_help_states_the_exit_codes() {
    let help = Bench::new().works("--help").stdout;
    assert!(help.contains("Exit codes:"), "{help}");
    for code in ["  0  ", "  1  ", "  2  "] {
        assert!(help.contains(code), "exit code {code} is not explained:\n{help}");
    }
}

#[test]
fn a_command_line_that_makes_no_sense_ends_with_2_and_shows_the_way_to_the_help() {
    let bench = Bench::new();
    for line in ["nonsense", "identify", "identify --no-such-option", "train --seed one", "train --threads 0", "completions tcsh"] {
        bench.refuses(line, &["--help"]);
    }
    let nothing = bench.run("");
    assert_eq!(nothing.code, 2);
    assert!(nothing.stderr.contains("Usage:"), "{}", nothing.stderr);
}

#[test]
fn the_version_is_that_of_the_package() {
    assert_eq!(Bench::new().works("--version").stdout.trim(), format!("catheter {}", env!("CARGO_PKG_VERSION")));
}

#[test]
fn completions_name_every_command_in_every_shell() {
    let bench = Bench::new();
    for shell in ["bash", "elvish", "fish", "powershell", "zsh"] {
        let script = bench.works(&format!("completions {shell}")).stdout;
        for command in COMMANDS {
            assert!(script.contains(command), "{shell} does not complete {command}");
        }
    }
}

#[test]
#[cfg(unix)]
fn bash_accepts_its_completion_script() {
    let bench = Bench::new();
    let script = bench.write("script", bench.works("completions bash").stdout);
    let Ok(status) = std::process::Command::new("bash").arg("-n").arg(script).status() else {
        return; // no bash on this machine, nothing to ask
    };
    assert!(status.success());
}
