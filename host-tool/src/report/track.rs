//! The report of tracked references: every controller on the same reference, side by side.

use super::chart::{Caption, Panel, Series, panels};
use super::page::{Cell, Page, Width};
use super::text::{number, percent};
use crate::track::compare::Run;

/// Styles of the lines, in the order of the controllers.
const CLASSES: [&str; 4] = ["model", "one", "two", "three"];

/// The whole document; `warnings` stand above the figures.
#[must_use]
pub fn page(reference: &str, rig: &str, runs: &[Run], warnings: &[String]) -> String {
    let lead = format!(
        "The reference {reference} on {rig}, with one controller after the other. Errors are those of the tip itself, in mm; the first second is not counted."
    );
    let mut page = Page::new("Tracking a displacement", &lead);
    page.section("Side by side");
    warnings.iter().for_each(|warning| page.paragraph(warning));
    let rows: Vec<Vec<Cell>> = runs
        .iter()
        .map(|run| {
            let figures = &run.figures;
            vec![
                Cell::Text(figures.name.clone()),
                Cell::Figure(number(figures.rmse_mm, 3)),
                Cell::Figure(number(figures.max_mm, 3)),
                Cell::Figure(figures.settling_s.map_or_else(|| "-".to_owned(), |settling| number(settling, 3))),
                Cell::Figure(number(figures.overshoot_mm, 3)),
                Cell::Figure(number(figures.effort_bar_per_s, 3)),
                Cell::Figure(percent(Some(figures.limited_share))),
            ]
        })
        .collect();
    let best = (0..runs.len()).min_by(|a, b| runs[*a].figures.rmse_mm.total_cmp(&runs[*b].figures.rmse_mm));
    page.table(
        "Settling: mean time from the beginning of a level until the tip stays within 3 % of the range around it. Effort: mean speed of the output. Limited: share of \
         the time in which the limiter held the output back.",
        &["controller", "RMSE / mm", "largest / mm", "settling / s", "overshoot / mm", "effort / bar/s", "limited"],
        &rows,
        best,
    );
    for (index, run) in runs.iter().enumerate() {
        let time: Vec<f64> = run.samples.iter().map(|sample| sample.time_s).collect();
        let line = |name: &str, class, value: &dyn Fn(usize) -> f64| {
            Series::new(name, class, &time, &(0..time.len()).map(value).collect::<Vec<f64>>())
        };
        let samples = &run.samples;
        let class = CLASSES[index % CLASSES.len()];
        let plots = [
            Panel {
                label: "displacement / mm".to_owned(),
                series: vec![line("reference", "measured", &|at| samples[at].reference_mm), line("tip", class, &|at| samples[at].tip_mm)],
                height: 150.0,
                zero: false,
            },
            Panel {
                label: "error / mm".to_owned(),
                series: vec![line("", "error", &|at| samples[at].tip_mm - samples[at].reference_mm)],
                height: 80.0,
                zero: true,
            },
            Panel {
                label: "output / bar".to_owned(),
                series: vec![line("", "input", &|at| samples[at].output_bar)],
                height: 80.0,
                zero: true,
            },
        ];
        let name = &run.figures.name;
        page.section(name);
        let description = format!("Reference and tip over time with {name}, the error below, and the pressure put out.");
        page.figure(
            panels(Caption { title: name, description: &description }, "time / s", 900.0, &plots),
            Width::Full,
            &format!("**{name}:** RMSE {} mm.", number(run.figures.rmse_mm, 3)),
        );
    }
    page.finish(&format!("Made by catheter {}. All figures are in the JSON result (--json).", env!("CARGO_PKG_VERSION")))
}
