//! `catheter tune`.

use std::cell::Cell;
use std::collections::BTreeMap;
use std::path::PathBuf;

use anyhow::{Context, Result};
use model_export::link::settings::{SettingValue, by_number};
use serde::Serialize;

use super::{Common, Data, Outcome};
use crate::recording::Recording;
use crate::track::{CONTROLLERS, SettingValues, controller};
use crate::tune::{self, Gains, Progress, TuneError, Tuned, simulate::Limits};
use crate::{output, report, say, setting_words};

/// Propose controllers from recordings; sends nothing.
///
/// Identifies the actuator (dead time, lags, threshold, hysteresis, creep, curve) with 95 % intervals, finds gains that keep gain, phase and
/// delay margins for every actuator within the intervals, and writes the settings and a model for the device to a folder.
#[derive(clap::Args)]
#[command(after_long_help = "\
Record steps, sines and random levels over the pressures that will be used; two minutes suffice.

Examples:
  catheter tune --data recordings --out tuned
  catheter tune --data recordings --out tuned --controller pid --json tuned.json")]
pub struct Arguments {
    #[command(flatten)]
    data: Data,
    /// Folder for `settings.toml` and `control.blob`; where it holds something already, a number is added to its name.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// The controller that the settings choose.
    #[arg(long, default_value = "physics-inverse+pid", value_name = "NAME", value_parser = controller_names())]
    controller: String,
    /// Pressure ceiling of the device, bar.
    #[arg(long, default_value_t = 3.0, value_name = "BAR")]
    ceiling_bar: f32,
    /// Slew limit of the device, bar/s.
    #[arg(long, default_value_t = 20.0, value_name = "BAR/S")]
    slew_bar_per_s: f32,
    #[command(flatten)]
    common: Common,
}

/// The names that a controller may have.
pub(super) fn controller_names() -> clap::builder::PossibleValuesParser {
    CONTROLLERS.iter().map(|controller| controller.name).collect::<Vec<_>>().into()
}

#[derive(Serialize)]
struct Parameter {
    value: f64,
    half_width_95: f64,
}

#[derive(Serialize)]
struct Summary {
    controller: String,
    rmse_mm: f64,
    error_95_mm: f64,
    samples: usize,
    parameters: BTreeMap<&'static str, Parameter>,
    reach_mm: [f64; 2],
    feedback_alone: Gains,
    feedback_beside_feed_forward: Gains,
    settings: BTreeMap<&'static str, serde_json::Value>,
    warnings: Vec<String>,
}

/// Settings by name, as people and files write them.
fn named(settings: &SettingValues) -> BTreeMap<&'static str, serde_json::Value> {
    let value = |value: &SettingValue| match value {
        // Through text, so that 0.1 stays 0.1.
        SettingValue::Float(number) => number.to_string().parse::<f64>().map_or(serde_json::Value::Null, serde_json::Value::from),
        SettingValue::Integer(number) => (*number).into(),
        SettingValue::Flag(flag) => (*flag).into(),
    };
    settings.iter().filter_map(|(number, setting)| Some((by_number(*number)?.name, value(setting)))).collect()
}

/// Runs the command.
///
/// # Errors
/// On bad input.
pub fn run(arguments: &Arguments) -> Result<Outcome> {
    let recordings = arguments.data.load()?;
    let out = output::free_folder(&arguments.out);
    output::check_folder(&out).map_err(|problem| anyhow::anyhow!("--out {}: {problem}", out.display()))?;
    let (settings_path, blob_path) = (out.join("settings.toml"), out.join("control.blob"));
    let inputs: Vec<PathBuf> = recordings.iter().map(Recording::file).collect();
    let mut outputs = vec![settings_path.as_path(), blob_path.as_path()];
    outputs.extend(arguments.common.results.files());
    output::refuse_overwriting(&inputs, &outputs)?;
    let limits = Limits { ceiling_bar: arguments.ceiling_bar, slew_bar_per_s: arguments.slew_bar_per_s };
    let tuned = tune_and_tell(&recordings, limits, arguments.common.seed)?;
    let chosen = controller(&arguments.controller).context("no such controller")?;
    let settings = named(&tuned.settings(chosen));
    let values: BTreeMap<u16, SettingValue> = tuned.settings(chosen).into_iter().collect();
    let made = output::provenance::line();
    let heading = format!("Settings of the controller {}, tuned from {} recordings; {made}", chosen.name, recordings.len());
    output::write_atomic(&settings_path, setting_words::file(&heading, &values).as_bytes())?;
    output::write_atomic(&blob_path, &tuned.blob)?;
    print(&tuned);
    say!("settings for {} -> {}, model -> {}", chosen.name, settings_path.display(), blob_path.display());
    let lead = format!(
        "The controller {}: the actuator explains the recordings to {:.4} mm, 95 % of its errors are below {:.4} mm.",
        chosen.name, tuned.fitted.rmse_mm, tuned.fitted.error_mm
    );
    arguments.common.results.write("A controller from recordings", &lead, &summary(&tuned, chosen.name, settings), |page| {
        unknown(&tuned).iter().for_each(|warning| page.paragraph(&format!("**Warning:** {warning}")));
        recordings.iter().take(4).for_each(|recording| report::check::picture(page, recording));
    })?;
    Ok(Outcome::Success)
}

/// Tunes, and shows how far it is. The parts say nothing of each other's time, so each has a time left of its own.
fn tune_and_tell(recordings: &[Recording], limits: Limits, seed: u64) -> Result<Tuned, TuneError> {
    let bar = output::progress(0, "tune");
    let shown = Cell::new(None);
    let tuned = tune::tune(recordings, limits, seed, &|progress| {
        let (message, done, of) = match progress {
            Progress::Actuator { done, most } => ("part 1 of 4: the actuator (ends early as a rule)", done, most),
            Progress::Gains { beside: false, done, of } => ("part 2 of 4: gains of the feedback alone", done, of),
            Progress::Gains { beside: true, done, of } => ("part 3 of 4: gains beside a feed-forward", done, of),
            Progress::Estimator => ("part 4 of 4: the estimator", 0, 1),
        };
        if shown.replace(Some(message)) != Some(message) {
            bar.reset_elapsed();
            bar.set_message(message);
        }
        bar.set_length(of as u64);
        bar.set_position(done as u64);
    })?;
    bar.finish_and_clear();
    Ok(tuned)
}

fn summary(tuned: &Tuned, controller: &str, settings: BTreeMap<&'static str, serde_json::Value>) -> Summary {
    let fitted = &tuned.fitted;
    Summary {
        controller: controller.to_owned(),
        rmse_mm: fitted.rmse_mm,
        error_95_mm: fitted.error_mm,
        samples: fitted.samples,
        parameters: fitted
            .parameters
            .iter()
            .map(|(name, value, half)| (*name, Parameter { value: *value, half_width_95: *half }))
            .collect(),
        reach_mm: [tuned.reach.low_mm, tuned.reach.high_mm],
        feedback_alone: tuned.alone,
        feedback_beside_feed_forward: tuned.beside,
        settings,
        warnings: unknown(tuned),
    }
}

/// Parameters that the recordings do not tell: their intervals are wider than what they are.
fn unknown(tuned: &Tuned) -> Vec<String> {
    let wide = tuned.fitted.parameters.iter().filter(|(_, value, half)| half.is_nan() || *half > value.abs());
    wide.map(|(name, value, half)| {
        format!(
            "{name} is {value:.4} with an interval of +- {half:.4}: the recordings do not tell it. Record what moves it (steps for times, slow large \
             loops for thresholds, holds for creep), or trust the other figures only."
        )
    })
    .collect()
}

fn print(tuned: &Tuned) {
    let fitted = &tuned.fitted;
    say!("actuator from {} samples: rmse {:.4} mm, 95 % of the errors below {:.4} mm", fitted.samples, fitted.rmse_mm, fitted.error_mm);
    for (name, value, half) in &fitted.parameters {
        say!("  {name:<24} {value:>9.4}  +- {half:.4}");
    }
    unknown(tuned).iter().for_each(|warning| say!("warning: {warning}"));
    for (name, gains) in [("feedback alone", &tuned.alone), ("feedback beside a feed-forward", &tuned.beside)] {
        say!(
            "{name}: proportional {:.3} mm/mm, integral {:.2} /s, derivative {:.3} s",
            gains.proportional,
            gains.integral_per_s,
            gains.derivative_s
        );
        let (best, worst) = (gains.margins, gains.worst_margins);
        say!(
            "  margins: gain {:.1} (at worst {:.1}), phase {:.0} deg ({:.0} deg), delay {:.0} ms ({:.0} ms)",
            best.gain,
            worst.gain,
            best.phase_deg,
            worst.phase_deg,
            1e3 * best.delay_s,
            1e3 * worst.delay_s
        );
    }
}
