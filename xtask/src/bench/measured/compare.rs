//! What `fit` reached on a map beside the baselines, and whether the next recordings kept what it promised.
//!
//! Terms. The *error* of a map is the RMSE in per cent of the output range, pooled over the test recordings of a group (the episodes of
//! a session; elsewhere one recording) and averaged over the groups. The *best* baseline is the one with the least error on the test
//! recordings, known only afterwards; the *picked* one has the least cross-validated error, which is known before. A promise is *kept*
//! by a test recording whose RMSE lies in the `cv_interval` of the chosen rung.

use anyhow::{Context, Result, ensure};
use serde_json::{Map, Value, json};

use crate::bench::files::number;

/// Least share of a test recording's samples that must have been scored: one that is scored in part is another recording.
const LEAST_SCORED: f64 = 0.98;

/// One map's figures; `outcome` holds what went wrong instead, where something did.
pub struct Judged {
    pub name: String,
    role: Value,
    shift: Value,
    outcome: Result<Figures, String>,
}

struct Figures {
    chosen: String,
    fit_s: f64,
    /// Per cent of the output range: ours, the best baseline's, the picked one's.
    percent: f64,
    best: (String, f64),
    picked: (String, f64),
    cv_rmse: f64,
    cv_interval: Option<[f64; 2]>,
    /// RMSE of each test recording, by file name.
    rmse: Vec<(String, f64)>,
    /// Per cent of the range in one unit of the output.
    percent_per_unit: f64,
    /// What else `fit` says of the recordings.
    repeatability: Value,
    noise: Value,
    parameters: Value,
    step_instructions: Value,
}

impl Judged {
    /// Puts the answers of `fit` and `evaluate` beside the results of the baselines; `map` is the map's entry in the index.
    pub fn new(name: &str, map: &Value, baseline: &Value, fitted: &Value, evaluated: &Value, fit_s: f64) -> Result<Self> {
        let chosen = fitted["chosen"].as_str().context("fit names no `chosen` rung")?;
        let rungs = fitted["ladder"].as_array().context("fit gives no `ladder`")?;
        let rung =
            rungs.iter().find(|rung| rung["name"] == chosen).with_context(|| format!("the chosen rung `{chosen}` is not in the ladder"))?;
        let groups = map["groups"].as_object().context("the index names no groups")?;
        let (mut percents, mut ranges, mut rmse) = (Vec::new(), Vec::new(), Vec::new());
        for group in groups.values() {
            let (mut squares, mut samples) = (0.0, 0.0);
            for path in group["recordings"].as_array().context("a group names no recordings")? {
                let path = path.as_str().context("a recording's path is no text")?;
                let scored = score_of(evaluated, path)?;
                let (error, count) = (number(scored, "rmse")?, number(scored, "n")?);
                if let Some(wanted) = samples_of(baseline, path) {
                    ensure!(count >= LEAST_SCORED * wanted, "{path}: only {count} of {wanted} samples were scored");
                }
                squares += error * error * count;
                samples += count;
                rmse.push((file_name(path).to_owned(), error));
            }
            let range = number(group, "range")?;
            percents.push(100.0 * (squares / samples).sqrt() / range);
            ranges.push(range);
        }
        let figures = Figures {
            chosen: chosen.to_owned(),
            fit_s,
            percent: mean(&percents),
            best: baseline_of(baseline, "best")?,
            picked: baseline_of(baseline, "picked")?,
            cv_rmse: number(rung, "cv_rmse")?,
            cv_interval: rung["cv_interval"][0].as_f64().zip(rung["cv_interval"][1].as_f64()).map(|(low, high)| [low, high]),
            rmse,
            percent_per_unit: 100.0 / mean(&ranges),
            repeatability: fitted["repeatability"].clone(),
            noise: fitted["noise"].clone(),
            parameters: rung["parameters"].clone(),
            step_instructions: rung["step_instructions"].clone(),
        };
        Ok(Self { name: name.to_owned(), role: map["role"].clone(), shift: map["shift"].clone(), outcome: Ok(figures) })
    }

    /// A map on which a command failed.
    pub fn failed(name: &str, map: &Value, problem: &str) -> Self {
        Self { name: name.to_owned(), role: map["role"].clone(), shift: map["shift"].clone(), outcome: Err(problem.to_owned()) }
    }

    /// The map's row in the printed table.
    pub fn row(&self) -> Vec<String> {
        let figures = match &self.outcome {
            Ok(figures) => figures,
            Err(_) => return [self.name.as_str(), "failed", "-", "-", "-", "-", "-", "-", "-"].map(str::to_owned).to_vec(),
        };
        let percent = |value: f64| format!("{:.2}", value * figures.percent_per_unit);
        let interval = figures.cv_interval.map_or("no interval".to_owned(), |[low, high]| format!("{} to {}", percent(low), percent(high)));
        vec![
            self.name.clone(),
            figures.chosen.clone(),
            format!("{:.2}", figures.percent),
            format!("{:.2} {}", figures.best.1, figures.best.0),
            format!("{:.2}", figures.percent / figures.best.1),
            format!("{:.2} {}", figures.percent / figures.picked.1, figures.picked.0),
            format!("{} ({interval})", percent(figures.cv_rmse)),
            format!("{} of {}", figures.kept(), figures.rmse.len()),
            format!("{:.1}", figures.fit_s),
        ]
    }

    /// The map's entry in the results.
    pub fn json(self) -> Value {
        match self.outcome {
            Err(problem) => json!({ "role": self.role, "shift": self.shift, "failed": problem }),
            Ok(figures) => json!({
                "role": self.role, "shift": self.shift, "chosen": figures.chosen, "fit_s": figures.fit_s, "percent": figures.percent,
                "best_baseline": figures.best.0, "best_baseline_percent": figures.best.1, "ratio": figures.percent / figures.best.1,
                "picked_baseline": figures.picked.0, "picked_baseline_percent": figures.picked.1,
                "ratio_to_picked": figures.percent / figures.picked.1,
                "cv_rmse": figures.cv_rmse, "cv_interval": figures.cv_interval, "recordings": figures.rmse.len(), "kept": figures.kept(),
                "test_rmse": figures.rmse.iter().map(|(name, rmse)| (name.clone(), json!(rmse))).collect::<Map<String, Value>>(),
                "repeatability": figures.repeatability, "noise": figures.noise, "parameters": figures.parameters,
                "step_instructions": figures.step_instructions,
            }),
        }
    }
}

impl Figures {
    /// Test recordings whose error lies within the promised interval. Without an interval nothing was promised and nothing is kept.
    fn kept(&self) -> usize {
        let within = |rmse: f64| self.cv_interval.is_some_and(|[low, high]| (low..=high).contains(&rmse));
        self.rmse.iter().filter(|(_, rmse)| within(*rmse)).count()
    }

    /// Test recordings whose error is above what was promised: the side that hurts.
    fn above(&self) -> usize {
        self.rmse.iter().filter(|(_, rmse)| self.cv_interval.is_none_or(|[_, high]| *rmse > high)).count()
    }
}

/// Figures over all maps: ratios, coverage (also for each kind of shift between training and test side), times.
pub fn summary(judged: &[Judged]) -> Value {
    let figures: Vec<&Figures> = judged.iter().filter_map(|judged| judged.outcome.as_ref().ok()).collect();
    // A map that failed counts as the worst that can be; so do errors that are no number.
    let ratios = |of: fn(&Figures) -> f64| {
        let mut ratios: Vec<f64> =
            figures.iter().map(|figures| of(figures)).map(|ratio| if ratio.is_nan() { f64::INFINITY } else { ratio }).collect();
        ratios.resize(judged.len(), f64::INFINITY);
        ratios.sort_by(f64::total_cmp);
        let below = ratios.iter().filter(|ratio| **ratio < 1.0).count();
        // JSON has no infinity: a null median or worst stands for a failure.
        json!({ "median": median(&ratios), "worst": ratios.last(), "share_below_1": below as f64 / ratios.len() as f64 })
    };
    let mut shifts: Vec<&str> = judged.iter().filter_map(|judged| judged.shift.as_str()).collect();
    shifts.sort_unstable();
    shifts.dedup();
    let by_shift = shifts.into_iter().map(|shift| {
        let those = judged.iter().filter(|judged| judged.shift == shift).filter_map(|judged| judged.outcome.as_ref().ok());
        (shift.to_owned(), coverage(&those.collect::<Vec<_>>()))
    });
    let mut times: Vec<f64> = figures.iter().map(|figures| figures.fit_s).collect();
    times.sort_by(f64::total_cmp);
    json!({
        "maps": judged.len(), "failed": judged.len() - figures.len(),
        "ratio_to_best": ratios(|figures| figures.percent / figures.best.1),
        "ratio_to_picked": ratios(|figures| figures.percent / figures.picked.1),
        "coverage": coverage(&figures), "coverage_by_shift": by_shift.collect::<Map<String, Value>>(),
        "fit_s": { "median": median(&times), "worst": times.last() },
    })
}

/// Shares of test recordings within and above their intervals, and the width of these: an interval that reaches everywhere promises
/// nothing. Every map counts the same in `maps_mean`, whatever the number of its recordings.
fn coverage(figures: &[&Figures]) -> Value {
    let recordings: usize = figures.iter().map(|figures| figures.rmse.len()).sum();
    let share = |count: fn(&Figures) -> usize| figures.iter().map(|figures| count(figures)).sum::<usize>() as f64 / recordings as f64;
    let means: Vec<f64> = figures.iter().map(|figures| figures.kept() as f64 / figures.rmse.len() as f64).collect();
    let mut widths: Vec<f64> = figures.iter().filter_map(|figures| figures.cv_interval).map(|[low, high]| high / low).collect();
    widths.sort_by(f64::total_cmp);
    let mut met: Vec<f64> = figures.iter().map(|figures| root_mean_square(&figures.rmse) / figures.cv_rmse).collect();
    met.sort_by(f64::total_cmp);
    json!({
        "recordings": recordings, "within": share(Figures::kept), "above": share(Figures::above), "maps_mean": mean(&means),
        "median_high_over_low": median(&widths), "median_met_over_promised": median(&met),
    })
}

/// The summary for a person.
pub fn summary_text(summary: &Value) -> String {
    let shown = |value: &Value| value.as_f64().map_or("-".to_owned(), |value| format!("{value:.2}"));
    let percent = |value: &Value| value.as_f64().map_or("-".to_owned(), |value| format!("{:.0} %", 100.0 * value));
    let ratio = |name: &str| {
        let ratio = &summary[name];
        format!("median {}, worst {}, below 1 on {}", shown(&ratio["median"]), shown(&ratio["worst"]), percent(&ratio["share_below_1"]))
    };
    let covered = |of: &Value| {
        format!(
            "{} of {} recordings within, {} above; {} as the mean of the maps; high / low {}, error met / promised {}",
            percent(&of["within"]),
            of["recordings"],
            percent(&of["above"]),
            percent(&of["maps_mean"]),
            shown(&of["median_high_over_low"]),
            shown(&of["median_met_over_promised"]),
        )
    };
    let mut lines = vec![
        format!("Maps: {}, failed: {}", summary["maps"], summary["failed"]),
        format!("Ratio to the best baseline, known afterwards: {}", ratio("ratio_to_best")),
        format!("Ratio to the baseline that training picks: {}", ratio("ratio_to_picked")),
        format!("Promises: {}", covered(&summary["coverage"])),
    ];
    if let Some(shifts) = summary["coverage_by_shift"].as_object() {
        lines.extend(shifts.iter().map(|(shift, of)| format!("  shift {shift}: {}", covered(of))));
    }
    lines.push(format!("Time of fit: median {} s, worst {} s", shown(&summary["fit_s"]["median"]), shown(&summary["fit_s"]["worst"])));
    lines.join("\n") + "\n"
}

/// The entry of `evaluate` for a recording, by its file name: folders may be written in another way.
fn score_of<'a>(evaluated: &'a Value, path: &str) -> Result<&'a Value> {
    let files = evaluated["files"].as_array().context("evaluate names no files")?;
    let same = |file: &&Value| file["path"].as_str().is_some_and(|other| file_name(other) == file_name(path));
    files.iter().find(same).with_context(|| format!("evaluate says nothing about {path}"))
}

/// Samples of a test recording as the baselines counted them.
fn samples_of(baseline: &Value, path: &str) -> Option<f64> {
    baseline["baselines"].as_object()?.values().next()?["recordings"][path]["n"].as_f64()
}

/// Name and error in per cent of the baseline that `role` (best, picked) points to.
fn baseline_of(baseline: &Value, role: &str) -> Result<(String, f64)> {
    let name = baseline[role].as_str().with_context(|| format!("the baselines name no `{role}`"))?;
    Ok((name.to_owned(), number(&baseline["baselines"][name], "percent")?))
}

fn file_name(path: &str) -> &str {
    path.rsplit(['/', '\\']).next().unwrap_or(path)
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

/// Of sorted values; nothing for none.
fn median(values: &[f64]) -> Option<f64> {
    let upper = *values.get(values.len() / 2)?;
    Some(if values.len() % 2 == 1 { upper } else { f64::midpoint(values[values.len() / 2 - 1], upper) })
}

fn root_mean_square(rmse: &[(String, f64)]) -> f64 {
    (rmse.iter().map(|(_, rmse)| rmse * rmse).sum::<f64>() / rmse.len() as f64).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn map() -> Value {
        json!({ "role": "development", "shift": "none", "groups": {
            "day": { "recordings": ["m/test/a.csv", "m/test/b.csv"], "range": 10.0 },
            "night": { "recordings": ["m/test/c.csv"], "range": 5.0 },
        }})
    }

    fn baseline() -> Value {
        let counts = json!({ "m/test/a.csv": { "n": 30 }, "m/test/b.csv": { "n": 10 }, "m/test/c.csv": { "n": 100 } });
        json!({ "best": "arx", "picked": "forest", "baselines": {
            "arx": { "percent": 2.0, "recordings": counts }, "forest": { "percent": 8.0, "recordings": counts } } })
    }

    fn fitted(interval: &Value) -> Value {
        json!({ "chosen": "pi", "ladder": [{ "name": "static", "cv_rmse": 9.0 }, { "name": "pi", "cv_rmse": 0.2, "cv_interval": interval }] })
    }

    fn evaluated() -> Value {
        json!({ "files": [
            { "path": "elsewhere/m/test/a.csv", "rmse": 0.1, "n": 30 },
            { "path": "elsewhere/m/test/b.csv", "rmse": 0.3, "n": 10 },
            { "path": "elsewhere/m/test/c.csv", "rmse": 0.5, "n": 100 },
        ]})
    }

    #[test]
    fn errors_are_pooled_within_a_group_and_averaged_over_groups() {
        let judged = Judged::new("m", &map(), &baseline(), &fitted(&json!([0.1, 0.4])), &evaluated(), 1.0).unwrap();
        let value = judged.json();
        let day = 100.0 * (0.1_f64.powi(2) * 30.0 + 0.3_f64.powi(2) * 10.0).sqrt() / 40.0_f64.sqrt() / 10.0;
        let percent = f64::midpoint(day, 10.0);
        // Same sums in another order.
        assert!((value["percent"].as_f64().unwrap() - percent).abs() < 1e-12, "{value}");
        assert!((value["ratio"].as_f64().unwrap() - percent / 2.0).abs() < 1e-12);
        assert!((value["ratio_to_picked"].as_f64().unwrap() - percent / 8.0).abs() < 1e-12);
        assert_eq!((&value["kept"], &value["recordings"]), (&json!(2), &json!(3)));
    }

    #[test]
    fn a_missing_interval_promises_nothing_that_could_be_kept() {
        let judged = Judged::new("m", &map(), &baseline(), &fitted(&Value::Null), &evaluated(), 1.0).unwrap();
        let summary = summary(&[judged]);
        assert_eq!((summary["coverage"]["within"].as_f64(), summary["coverage"]["above"].as_f64()), (Some(0.0), Some(1.0)));
    }

    #[test]
    fn a_recording_scored_in_part_is_refused() {
        let mut evaluated = evaluated();
        evaluated["files"][2]["n"] = json!(50);
        let error = Judged::new("m", &map(), &baseline(), &fitted(&json!([0.1, 0.4])), &evaluated, 1.0).err().unwrap();
        assert!(error.to_string().contains("only 50 of 100 samples"), "{error}");
    }

    #[test]
    fn a_failed_map_is_the_worst_one() {
        let good = Judged::new("m", &map(), &baseline(), &fitted(&json!([0.1, 0.4])), &evaluated(), 1.0).unwrap();
        let summary = summary(&[good, Judged::failed("n", &map(), "no model")]);
        assert_eq!((&summary["failed"], &summary["ratio_to_best"]["worst"]), (&json!(1), &Value::Null));
        assert_eq!(summary["coverage_by_shift"]["none"]["recordings"], 3);
        assert!(summary_text(&summary).contains("failed: 1"));
    }
}
