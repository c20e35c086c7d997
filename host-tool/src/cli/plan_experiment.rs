//! `catheter plan-experiment`.

use std::path::PathBuf;

use anyhow::{Result, bail};

use super::{Common, Outcome};
use crate::discover::file::DiscoveredModel;
use crate::discover::plan;
use crate::excitation::{self, Limits};
use crate::{output, say};

/// Find the excitation, within the rig's limits, that best tells two explanations apart.
///
/// The explanations are two models that `catheter discover` wrote: `model.toml` and `runner_up.toml` of its folder. For each excitation of
/// a library one model plays the rig and the other is fitted to it; what remains is what the experiment can see.
#[derive(clap::Args)]
pub struct Arguments {
    /// The two models.
    #[arg(long, num_args = 2, required = true, value_names = ["FIRST", "SECOND"])]
    models: Vec<PathBuf>,
    /// Standard deviation of the noise, output units; 0.5 % of the model's output span when absent.
    #[arg(long, value_name = "VALUE")]
    noise: Option<f64>,
    /// The rig's highest pressure; of other inputs, the largest value.
    #[arg(long, default_value_t = Limits::default().maximum_bar, value_name = "BAR")]
    maximum_pressure_bar: f64,
    /// The rig's fastest change of pressure.
    #[arg(long, default_value_t = Limits::default().maximum_slew_bar_per_s, value_name = "BAR/S")]
    maximum_slew_bar_per_s: f64,
    /// File for the best excitation; `catheter simulate FILE` and the rig play it.
    #[arg(long, value_name = "FILE", value_parser = output::file_argument(".toml"))]
    out: PathBuf,
    #[command(flatten)]
    common: Common,
}

/// Runs the command.
///
/// # Errors
/// On models that do not belong together, or limits that nothing fits.
pub fn run(arguments: &Arguments) -> Result<Outcome> {
    let outputs = std::iter::once(arguments.out.as_path()).chain(arguments.common.results.files()).collect::<Vec<_>>();
    output::refuse_overwriting(&arguments.models, &outputs)?;
    for (name, value) in
        [("--maximum-pressure-bar", arguments.maximum_pressure_bar), ("--maximum-slew-bar-per-s", arguments.maximum_slew_bar_per_s)]
    {
        if !(value.is_finite() && value > 0.0) {
            bail!("{name} is a positive number, not {value}");
        }
    }
    let (first, second) = (DiscoveredModel::read(&arguments.models[0])?, DiscoveredModel::read(&arguments.models[1])?);
    let noise = arguments.noise.unwrap_or(0.005 * first.output_scale.abs());
    if !(noise.is_finite() && noise > 0.0) {
        bail!("--noise is a positive number, not {noise}");
    }
    let limits = Limits {
        maximum_bar: arguments.maximum_pressure_bar,
        maximum_slew_bar_per_s: arguments.maximum_slew_bar_per_s,
        ..Limits::default()
    };
    let bar = output::progress(0, "plan");
    bar.set_message("both models on every excitation");
    let watch = |judged: usize, of: usize| {
        bar.set_length(of as u64);
        bar.set_position(judged as u64);
    };
    let plans = plan::rank(&first, &second, noise, &limits, arguments.common.seed, &watch)?;
    bar.finish_and_clear();
    let best = &plans[0];
    output::write_atomic(
        &arguments.out,
        format!("# {}\n{}", output::provenance::line(), excitation::to_toml(&best.excitation)).as_bytes(),
    )?;
    let result = serde_json::json!({ "best": best.name, "noise": noise, "plans": plans });
    arguments.common.results.write("Which experiment tells two models apart?", &format!("The best is {}.", best.name), &result, |_| {})?;
    let unit = &first.output.unit;
    let width = plans.iter().map(|plan| plan.name.len()).max().unwrap_or(0);
    say!("{:width$}  {:>14}  {:>22}", "excitation", format!("differ by/{unit}"), "ln(likelihood ratio)");
    for plan in &plans {
        say!("{:width$}  {:>14.5}  {:>22.1}", plan.name, plan.difference, plan.log_likelihood_ratio);
    }
    // A likelihood ratio of e^5, 150 to 1, settles it.
    if best.log_likelihood_ratio < 5.0 {
        say!("None of these would settle it: the two models say nearly the same within the rig's limits.");
    }
    say!("{} -> {}", best.name, arguments.out.display());
    Ok(Outcome::Success)
}
