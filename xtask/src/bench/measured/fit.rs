//! `catheter fit` with its default options on every map, judged on the map's test recordings by `catheter evaluate`.
//!
//! The recordings are prepared, and the baselines fitted, by `tests/baselines/measured.py`; both programs read the same prepared files.

use std::path::Path;
use std::time::Instant;

use anyhow::{Context, Result, bail};
use serde_json::{Map, Value, json};

use super::checks;
use super::compare::{self, Judged};
use super::distort::{FITTED, PREPARED, SCRIPT};
use crate::bench::arguments::Arguments;
use crate::bench::arguments::Maps;
use crate::bench::files::{catheter_json, fresh_folder, read_json};
use crate::bench::table::markdown;
use crate::process::{answer, command, root, run, target_folder};

const PACKAGES: &str = "numpy, scipy, sklearn";

/// Fits and judges every map, prints the tables and gives the figures.
pub fn measure(recordings: &Path, arguments: &Arguments) -> Result<Value> {
    let bench = target_folder().join("bench");
    let (index_value, baselines) = prepare(recordings, &bench, arguments)?;
    let index = index_value.as_object().context("index.json holds no object")?;
    let mut judged = Vec::new();
    for (name, map) in index {
        if arguments.maps != Maps::All && map["role"] != arguments.maps.name() {
            continue;
        }
        eprintln!("{name}");
        let baseline = &baselines[name];
        // One map that fails must not cost the figures of the others, and must be seen among them.
        judged.push(match one_map(&bench, name, map, baseline, &arguments.fit_options) {
            Ok(judged) => judged,
            Err(error) => {
                eprintln!("  failed: {error:#}");
                Judged::failed(name, map, &format!("{error:#}"))
            }
        });
    }
    let summary = compare::summary(&judged);
    print(&judged, &summary, arguments.maps);
    let checks = if arguments.checks { Some(checks::measure(&bench, &index_value, arguments)?) } else { None };
    let maps: Map<String, Value> = judged.into_iter().map(|judged| (judged.name.clone(), judged.json())).collect();
    Ok(json!({ "role": arguments.maps.name(), "fit_options": arguments.fit_options, "summary": summary, "maps": maps, "checks": checks }))
}

/// Prepares the recordings and fits the baselines; gives the index of the ones and the figures of the others. What an earlier run left of these and is still true is kept.
fn prepare(recordings: &Path, bench: &Path, arguments: &Arguments) -> Result<(Value, Value)> {
    let python = &arguments.python;
    if answer(command(python).args(["-c", &format!("import tomllib, {PACKAGES}")])).is_none() {
        bail!(
            "`{python}` is no Python 3.11 or newer with numpy, scipy and scikit-learn. Type\n  \
             python3 -m venv ENV && ENV/bin/pip install numpy scipy scikit-learn\n\
             outside the checkout and name it with `--python ENV/bin/python`"
        );
    }
    std::fs::create_dir_all(bench).with_context(|| format!("cannot create {}", bench.display()))?;
    let (prepared, results) = (bench.join(PREPARED), bench.join("measured-baselines.json"));
    let script = root().join(SCRIPT);
    run("prepare", command(python).arg(&script).arg("prepare").arg("--data").arg(recordings).arg("--out").arg(&prepared))?;
    let mut baselines = command(python);
    baselines.arg(&script).arg("baselines").arg("--prepared").arg(&prepared).arg("--json").arg(&results);
    run("baselines", baselines.args(["--role", arguments.maps.name()]))?;
    Ok((read_json(&prepared.join("index.json"))?, read_json(&results)?))
}

/// Fits and judges one map. All paths are below the folder `bench`, where the commands run.
fn one_map(bench: &Path, name: &str, map: &Value, baseline: &Value, options: &str) -> Result<Judged> {
    let columns = map["columns"].as_str().context("index.json names no columns")?;
    let (own, prepared) = (format!("{FITTED}/{name}"), format!("{PREPARED}/{name}"));
    fresh_folder(&own)?;
    let start = Instant::now();
    let line = format!("fit --data {prepared}/train --columns {columns} --out {own}/fitted {options}");
    let fitted = catheter_json(bench, &format!("{own}/fit"), &line)?;
    let fit_s = start.elapsed().as_secs_f64();
    let line = format!("evaluate --model {own}/fitted/model --data {prepared}/test --columns {columns}");
    let evaluated = catheter_json(bench, &format!("{own}/evaluation"), &line)?;
    Judged::new(name, map, baseline, &fitted, &evaluated, fit_s)
}

fn print(judged: &[Judged], summary: &Value, maps: Maps) {
    println!("`catheter fit` on the {} maps: RMSE in % of the output range of the test recordings, free running\n", maps.name());
    let header = ["map", "chosen", "fit", "best baseline", "ratio", "ratio to the baseline that training picks", "promised", "kept", "s"];
    println!("{}", markdown(&header, &judged.iter().map(Judged::row).collect::<Vec<_>>()));
    println!("{}", compare::summary_text(summary));
}
