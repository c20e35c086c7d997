//! What the jumps of the `all-effects` plant allow an estimator: how far the truth without jumps is from the truth, and how far from it
//! one gets that knows the stick band exactly and the motion under it almost.
//!
//! The tip rests until the motion under it is a band away, then jumps there. Whoever ignores that is off by up to the band; whoever
//! follows it jumps at another sample as soon as the motion is known only to a fraction of a micrometre, and is off by up to the band
//! until both jump together. So the second is also what any two computations of one model differ by, f32 and fixed point among them.

use std::path::Path;

use anyhow::{Context, Result};
use serde_json::{Value, json};

use super::arguments::{Arguments, FIRST_REPORTING_SEED};
use super::files::{catheter_json, fresh_folder};
use super::table::{Spread, markdown};

/// Errors of the motion under the band, root mean square in mm.
const MOTION_ERRORS_MM: [f64; 6] = [0.00002, 0.0001, 0.0002, 0.0005, 0.001, 0.002];
/// Half-width of the band in the `all-effects` plant.
const BAND_MM: f64 = 0.02;
const STICK_TABLE: &str = "[stick_slip]";

/// Measures both and prints one table.
pub fn measure(arguments: &Arguments) -> Result<Value> {
    let mut ignoring = Spread::default();
    let mut following = vec![Spread::default(); MOTION_ERRORS_MM.len()];
    for seed in (0..arguments.seeds).map(|index| FIRST_REPORTING_SEED + index) {
        let folder = fresh_folder(&format!("jumps-{seed}"))?;
        catheter_json(&folder, "simulate", &format!("simulate rich --plant all-effects --out jumping --seed {seed}"))?;
        let plant = std::fs::read_to_string(folder.join("jumping/plant.toml"))?;
        let (before, after) = plant.split_once(STICK_TABLE).context("the plant has no stick-slip")?;
        let rest = after.find("\n[").map_or("", |next| &after[next..]);
        std::fs::write(folder.join("smooth.toml"), format!("{before}{rest}"))?;
        catheter_json(&folder, "simulate-smooth", &format!("simulate rich --plant smooth.toml --out smooth --seed {seed}"))?;
        let mut files: Vec<_> =
            std::fs::read_dir(folder.join("jumping/test"))?.map(|entry| Ok(entry?.file_name())).collect::<Result<_>>()?;
        files.sort();
        for file in files {
            let jumping = outputs(&folder.join("jumping/test").join(&file))?;
            let smooth = outputs(&folder.join("smooth/test").join(&file))?;
            ignoring.push(root_mean_square(jumping.iter().zip(&smooth)));
            for (&error, spread) in MOTION_ERRORS_MM.iter().zip(&mut following) {
                let followed = follow(&smooth, error);
                spread.push(root_mean_square(jumping.iter().zip(&followed)));
            }
        }
    }
    let mut rows = vec![vec!["ignored".to_owned(), "none".to_owned(), ignoring.cell()]];
    for (error, spread) in MOTION_ERRORS_MM.iter().zip(&following) {
        rows.push(vec!["followed".to_owned(), format!("{error}"), spread.cell()]);
    }
    println!(
        "Jumps of the all-effects plant: RMSE in mm on the test recordings of {} seeds, mean (least to most) of the recordings\n",
        arguments.seeds
    );
    println!("{}", markdown(&["jumps", "error of the motion under the band, RMS in mm", "error of the output"], &rows));
    let followed: Vec<Value> =
        MOTION_ERRORS_MM.iter().zip(&following).map(|(error, spread)| json!({ "motion_error_mm": error, "rmse": spread.json() })).collect();
    Ok(json!({ "ignored": ignoring.json(), "followed": followed }))
}

/// The motion with an error of this root mean square, behind the plant's own band. Two sines without a common period are error enough,
/// and repeat.
fn follow(smooth: &[f64], error_mm: f64) -> Vec<f64> {
    let mut held = None;
    let disturbed = smooth.iter().enumerate().map(|(sample, motion)| {
        let phase = sample as f64;
        motion + error_mm * ((0.731 * phase + 1.0).sin() + (0.117 * phase).sin())
    });
    disturbed
        .map(|motion| {
            let output = held.filter(|held: &f64| (motion - held).abs() <= BAND_MM).unwrap_or(motion);
            held = Some(output);
            output
        })
        .collect()
}

fn root_mean_square<'a>(pairs: impl ExactSizeIterator<Item = (&'a f64, &'a f64)>) -> f64 {
    let count = pairs.len() as f64;
    (pairs.map(|(one, other)| (one - other).powi(2)).sum::<f64>() / count).sqrt()
}

/// The last column of a recording: the displacement.
fn outputs(path: &Path) -> Result<Vec<f64>> {
    let text = std::fs::read_to_string(path).with_context(|| format!("{}: cannot be read", path.display()))?;
    let last = |line: &str| -> Result<f64> { Ok(line.rsplit(',').next().unwrap_or(line).trim().parse()?) };
    let rows = text.lines().filter(|line| !line.starts_with('#')).skip(1);
    rows.map(last).collect::<Result<_>>().with_context(|| format!("{}: no number in the last column", path.display()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_exact_motion_jumps_exactly_and_a_disturbed_one_does_not() {
        let motion: Vec<f64> = (0..500).map(|sample| (f64::from(sample) * 0.05).sin()).collect();
        let exact = follow(&motion, 0.0);
        assert!(exact.iter().zip(&motion).all(|(held, motion)| (held - motion).abs() <= BAND_MM));
        assert!(exact.windows(2).any(|pair| pair[0] == pair[1]), "it rests where the motion turns");
        let disturbed = root_mean_square(exact.iter().zip(&follow(&motion, 0.001)));
        assert!(disturbed > 0.001, "an error of 0.001 mm has grown, not shrunk: {disturbed}");
    }
}
