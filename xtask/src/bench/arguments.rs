//! What to measure, and how long.

use std::path::PathBuf;

/// Run the headline measurements; hours with the default budgets, so name the ones you want.
#[derive(clap::Args)]
pub struct Arguments {
    /// Which measurements; all of them when none is named.
    pub what: Vec<What>,
    /// Write the results as JSON to this file. With `firmware` or `board-model` alone it holds these figures and nothing else.
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
    /// Seeds per figure. They are 9001, 9002 and so on, used nowhere else in the project.
    #[arg(long, default_value_t = 5, value_name = "N")]
    pub seeds: u64,
    /// Processor seconds each training may use, instead of what the figure is stated for.
    #[arg(long, value_name = "S")]
    pub budget_cpu_s: Option<u64>,
    /// Of `accuracy`, only the data of this name: paper, rich or all-effects.
    #[arg(long, value_name = "NAME")]
    pub only: Option<String>,
    /// Folder with the public measured sets (`piezo-picma` and so on); docs/how-to/import-recordings.md says where to get them.
    #[arg(long, value_name = "FOLDER")]
    pub recordings: Option<PathBuf>,
    /// Of `measured`, only these maps of tests/baselines/maps.toml. Tune on `development`, publish `reporting`.
    #[arg(long, value_name = "WHICH", default_value = "development")]
    pub maps: Maps,
    /// Of `measured`, options of `catheter fit` for a quick look, as in `--fit-options=--no-networks`; published figures go without.
    #[arg(long, value_name = "OPTIONS", default_value = "", hide_default_value = true, allow_hyphen_values = true)]
    pub fit_options: String,
    /// Of `measured`, also whether `fit` can be fooled: copies, other names, other units, outputs that inputs cannot explain. Needs
    /// --maps development or all.
    #[arg(long)]
    pub checks: bool,
    /// Of `measured`, the Python (3.11 or newer, with numpy, scipy and scikit-learn) that fits the baselines; of `time-to-error`, the one with
    /// torch and numpy.
    #[arg(long, value_name = "PROGRAM", default_value = "python3")]
    pub python: String,
    /// Of `time-to-error`, the error on the test recordings, free running, in mm.
    #[arg(long, default_value_t = 0.003, value_name = "MM")]
    pub target_mm: f64,
    /// Record the firmware's instruction counts as those that the tests compare with.
    #[arg(long)]
    pub bless: bool,
}

#[derive(Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum What {
    /// RMSE on the simulated sets, per test family, over several seeds, in f32 and fixed point.
    Accuracy,
    /// RMSE on the measured recordings; needs --recordings.
    Measured,
    /// What the jumps of the all-effects plant allow an estimator.
    Jumps,
    /// Tracking of the controllers on the realistic rig, side by side.
    Control,
    /// How fast a CSV of five million rows is read, beside the bare records of the csv crate.
    Reading,
    /// Training throughput, beside PyTorch where python3 has it.
    Training,
    /// Time of training to an error, beside PyTorch where --python has it.
    TimeToError,
    /// Instructions per step and tick counted in the emulator, flash, RAM and stack; error of the quantised networks.
    Firmware,
    /// The flashable image on the model of its chip: closed loop for ten virtual minutes, registers, faults.
    BoardModel,
    /// Hidden effects of two virtual rigs: which are named right, false alarms, unknown ones, gap closed, time.
    Discover,
}

/// Which of the maps in `tests/baselines/maps.toml`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Maps {
    /// Those that may be looked at while `fit` is developed.
    Development,
    /// Those that published figures come from. Whoever tunes by them makes them worthless.
    Reporting,
    /// Both, and the figures of `identify` and `train`.
    All,
}

impl Maps {
    /// As the role stands in the index, or on the command line of the Python script.
    pub fn name(self) -> &'static str {
        match self {
            Self::Development => "development",
            Self::Reporting => "reporting",
            Self::All => "all",
        }
    }
}

/// First of the seeds that figures are reported with.
pub const FIRST_REPORTING_SEED: u64 = 9001;
