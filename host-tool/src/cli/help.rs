//! What `--help` teaches below the options: what a command reads and leaves behind, and examples to copy.
//!
//! A test runs every line of these texts that starts with `catheter` through the parser, so no example outlives an option.

/// Below the help of `catheter` itself.
pub const OVERVIEW: &str = "\
From nothing to a verified model, one command after the other:
  catheter simulate rich --out data
  catheter identify --data data/train --out physics.toml
  catheter train --data data/train --out model.safetensors
  catheter export model.safetensors --calibration data/train --out model.blob
  catheter evaluate --model model.blob --data data/test --suite

To the rig and back, on a board, in QEMU or in this process:
  catheter rig --flash rig.flash model upload model.blob --activate
  catheter rig --flash rig.flash record --excitation staircase.toml --out run.csv
  catheter replay run.csv --at 3.25

All of it at once, with a report to look at:
  catheter demo --out demo

Exit codes:
  0  done
  1  the command ran, and a check it makes failed (a limit of `evaluate --suite`, a golden vector, a replay that differs)
  2  usage or input: the message says which file, which line and what to do; nothing was half-written";

/// Below the help of `init`.
pub const INIT: &str = "\
Every command that reads recordings looks for `catheter.toml` here and in the folders above. Options on the command line come first.

Examples:
  catheter init --recordings runs --columns time=t_ms,input=P:kPa,output=laser:mA@4..20=0..50mm
  catheter init --skip-s 2 --maximum-pressure-bar 2.5 --force";

/// Below the help of `convert`.
pub const CONVERT: &str = "\
Times, values and units keep every bit. What is written has our column names where the recording has our quantities: it is read again without
--columns. PlotJuggler and Foxglove open MCAP.

Examples:
  catheter convert run.mat --columns time=t:s,input=P:kPa,output=x:um --out run.csv
  catheter convert run.csv --out run.mcap
  catheter convert runs --to npz --out converted";

/// Below the help of `check`.
pub const CHECK: &str = "\
Nothing is changed and nothing is fitted. Exit code 0 whatever was found, 2 when a file cannot be read.

Roles of --columns: time, input, input2 to input9, output, measured (pressure), temperature, session (time), recording (a new
recording starts where its value changes), group.

Examples:
  catheter check --data runs --html check.html --json check.json
  catheter check --data run.csv --columns time=t_ms,input=valve_V,input2=supply_bar,output=angle_deg
  catheter check --data arm.csv --columns input=p1:bar,output=q1:rad,recording=episode --rate-hz 100";

/// Below the help of `discover`.
pub const DISCOVER: &str = "\
Leaves DIR/model.toml (the model with the effect), DIR/runner_up.toml (with the second best effect instead), DIR/discovery.json,
DIR/report.html and, where the microcontroller knows the effect, DIR/microcontroller.toml for `export`. Exit code 0 whatever the verdict.

Examples:
  catheter discover --data session --holdout other --out result
  catheter discover --model physics.toml --data session --out result --json result.json
  catheter evaluate --model result/model.toml --data other";

/// Below the help of `plan-experiment`.
pub const PLAN_EXPERIMENT: &str = "\
Leaves the excitation as TOML. Play it, add the recording to the session and run `discover` again.

Examples:
  catheter plan-experiment --models result/model.toml result/runner_up.toml --out next.toml
  catheter plan-experiment --models result/model.toml result/runner_up.toml --maximum-slew-bar-per-s 8 --out next.toml
  catheter simulate next.toml --out played";

/// Below the help of `hide`.
pub const HIDE: &str = "\
Leaves DIR/recordings and DIR/holdout, and the truth in DIR/truth.sealed.json: look at that last.

Example:
  catheter hide --effect creep --seed 7 --out case";

/// Below the help of `train`.
pub const TRAIN: &str = "\
Leaves the trained model as safetensors. The same seed and the same number of threads give the same bits.

Examples:
  catheter train --data data/train --out model.safetensors
  catheter train --preset stream-1x32 --data data/train --out small.safetensors --budget-cpu-s 250
  catheter train --preset paper-window --data data/paper/train --out window.safetensors --seed 3 --threads 1";

/// Below the help of `import-network`.
pub const IMPORT_NETWORK: &str = "\
Without an offset or a scale the network takes and gives values in the channels' units. Options go before what the file's metadata say;
the Python helper `save_torch` or `save_keras` writes all of them there. Exit code 1: the check failed, and no model was written.

Examples:
  catheter import-network network.safetensors --check check.csv --out model.safetensors
  catheter import-network network.onnx --input pressure:bar --output displacement:mm --sample-period-s 0.02 --input-min-max 0,3 \
--input-range 0,3 --output-range 0,12 --out model.safetensors
  catheter import-network state.safetensors --input voltage:V --output displacement:um --sample-period-s 0.005 --streaming \
--features input,difference --check check.csv --out model.safetensors
  catheter export model.safetensors --calibration data/train --out model.blob";

/// Below the help of `evaluate`.
pub const EVALUATE: &str = "\
The model runs freely from the first sample: it sees the input and never the measured output. Takes .toml, .safetensors and .blob;
a blob is run by the very code of the microcontroller. With --suite a failed limit ends in exit code 1.

Examples:
  catheter evaluate --model model.blob --data data/test --suite
  catheter evaluate --model physics.toml --data run.csv --json errors.json
  catheter evaluate --model model.blob --data data/test --suite --reference model.safetensors
  catheter evaluate --model model.safetensors --data data/test --ladder --ladder-train data/train --compare physics.toml
  catheter evaluate --model piezo.toml --data piezo_test.csv --tare --columns time=t_s,input=voltage_V,output=displacement_um";

/// Below the help of `demo`.
pub const DEMO: &str = "\
Simulates, identifies, trains, quantises, verifies and evaluates with a small budget; about a minute on two cores.

Examples:
  catheter demo
  catheter demo --out demo --seed 7
  catheter demo --quick --out look";

/// Below the help of `rig`.
pub const RIG: &str = "\
The rig is a board on a serial port, the firmware as ARM code in QEMU, or the firmware in this process; every command works on all three.

Examples:
  catheter rig hello
  catheter rig --backend serial:/dev/ttyUSB0 status
  catheter rig --backend serial:COM3 explain
  catheter rig --backend serial hold --arm --pressure-bar 0.5
  catheter rig monitor --rate-hz 100 --csv watched.csv
  catheter rig calibrate --save --html calibration.html
  catheter rig settings get limits.ceiling_bar
  catheter rig --flash rig.flash settings set limits.ceiling_bar=2.5 laser.required=false --save
  catheter rig --flash rig.flash settings diff --defaults
  catheter rig --flash rig.flash model upload model.blob --activate
  catheter rig --flash rig.flash --plant all-effects record --excitation staircase.toml --out run.csv
  catheter rig --backend qemu record --excitation staircase.toml --out run.csv --json run.json
  catheter rig --backend serial:/dev/ttyUSB0 vent

Exit code 1: `vent` saw no low pressure; `arm`, `hold`, `move`, `jog`, `start` or `record` ended with a fault.
On a simulated rig each command begins with the power off; on a board states stay. A running rig vents when its command ends.";

/// Below the help of `dashboard`.
pub const DASHBOARD: &str = "\
The first line on standard output is `listening on ADDRESS`; the address carries a token, which is the key to the rig. Pages and scripts that
operate must give a sign of life some times a second: when they do not, the device vents by itself.

Examples:
  catheter dashboard
  catheter dashboard --backend serial:/dev/ttyUSB0
  catheter dashboard --plant all-effects --port 0 --no-open
  catheter dashboard --backend serial:/dev/ttyUSB0 --listen 0.0.0.0 --name rig.lab --role observe";

/// Below the help of `replay`.
pub const REPLAY: &str = "\
Runs every tick of the recording again and compares it; exit code 1 if any output differs.

Examples:
  catheter replay run.journal
  catheter replay run.csv --at 3.25
  catheter replay run.journal --at 3.25 --json why.json";

/// Below the help of `pil`.
pub const PIL: &str = "\
Needs QEMU (`cargo xtask setup`) and the image: cargo build --release --target thumbv7em-none-eabihf -p firmware --bin pil
Exit code 1 if the two logs differ, or the experiment ended early with a fault.

Examples:
  catheter pil --blob model.blob
  catheter pil --blob model.blob --plant all-effects --seconds 60 --json pil.json
  catheter pil --blob model.blob --excitation staircase.toml --out run.csv";

/// Below the help of `explain`.
pub const EXPLAIN: &str = "\
Examples:
  catheter explain E017
  catheter explain b3
  catheter explain";

/// Below the help of `completions`.
pub const COMPLETIONS: &str = "\
Put the script where your shell looks for it.

Examples:
  catheter completions bash > ~/.local/share/bash-completion/completions/catheter
  catheter completions fish > ~/.config/fish/completions/catheter.fish
  catheter completions zsh > ~/.zfunc/_catheter";

/// Below the help of `man`.
pub const MAN: &str = "\
Examples:
  catheter man ~/.local/share/man/man1
  catheter man manual";

#[cfg(test)]
mod tests {
    use clap::CommandFactory;

    use crate::cli::Cli;

    /// The lines of `text` that call the command, split into words, redirections and remarks (after three spaces) left out.
    fn examples(text: &str) -> impl Iterator<Item = Vec<&str>> {
        text.lines()
            .map(str::trim)
            .filter(|line| line.starts_with("catheter "))
            .map(|line| line.split("   ").next().unwrap_or(line))
            .map(|line| line.split_whitespace().take_while(|word| *word != ">").collect())
    }

    /// The README and the book; `$ catheter` there is a command to type.
    fn book() -> Vec<String> {
        let root = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
        let (mut pages, mut folders) = (vec![root.join("README.md")], vec![root.join("docs")]);
        while let Some(folder) = folders.pop() {
            for entry in std::fs::read_dir(folder).expect("a folder of the book") {
                let path = entry.expect("an entry of a folder").path();
                if path.is_dir() {
                    folders.push(path);
                } else if path.extension().is_some_and(|ending| ending == "md") {
                    pages.push(path);
                }
            }
        }
        let texts = pages.iter().map(|page| std::fs::read_to_string(page).expect("a page of the book"));
        // What a program wrote is no example.
        texts.filter(|text| !text.contains("<!-- generated")).map(|text| joined(&text).replace("$ catheter ", "catheter ")).collect()
    }

    /// Lines that a backslash at their end joins to the next, as one.
    fn joined(text: &str) -> String {
        text.split("\\\n").map(str::trim_start).collect::<Vec<_>>().join("")
    }

    #[test]
    fn every_example_in_the_help_and_the_book_is_understood_by_the_parser() {
        // Not wrapped: an example is one line, however narrow the terminal.
        let mut command = Cli::command().term_width(0);
        command.build();
        let mut texts = vec![command.render_long_help().to_string()];
        for subcommand in command.get_subcommands_mut().filter(|subcommand| subcommand.get_name() != "help" && !subcommand.is_hide_set()) {
            let help = subcommand.clone().term_width(0).render_long_help().to_string();
            assert!(examples(&help).next().is_some(), "no example in the help of {}", subcommand.get_name());
            texts.push(help);
        }
        texts.extend(book());
        for words in texts.iter().flat_map(|text| examples(text)) {
            if let Err(error) = Cli::command().try_get_matches_from(&words) {
                panic!("`{}`: {error}", words.join(" "));
            }
        }
    }

    #[test]
    fn the_command_line_is_consistent() {
        Cli::command().debug_assert();
    }
}
