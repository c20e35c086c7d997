//! The sections that reports are made of.

use super::Example;
use super::chart::{Caption, DotRow, HeatMap, Panel, Series, dots, heat, loops, panels};
use super::page::{Cell, Page, Width};
use super::text::{count, number, percent};
use crate::evaluate::FamilyErrors;
use crate::evaluate::ladder::Ladder;
use crate::evaluate::suite::SuiteReport;

/// What the letters of the paper's families stand for.
fn family_name(family: &str) -> String {
    match family {
        "a" => "(a) descending sine".to_owned(),
        "b" => "(b) descending triangle".to_owned(),
        "c" => "(c) ascending sine".to_owned(),
        "d" => "(d) ascending sine, altering frequency".to_owned(),
        other => other.to_owned(),
    }
}

/// A table of errors by family.
pub fn families(page: &mut Page, families: &[FamilyErrors], unit: &str) {
    let row = |family: &FamilyErrors| {
        vec![
            Cell::Text(family_name(&family.family)),
            Cell::Figure(count(family.files)),
            Cell::Figure(count(family.n)),
            Cell::Figure(number(family.rmse, 3)),
            Cell::Figure(percent(family.nrmse)),
            Cell::Figure(number(family.max_abs, 3)),
        ]
    };
    let rows: Vec<Vec<Cell>> = families.iter().map(row).collect();
    let (rmse, largest) = (format!("RMSE / {unit}"), format!("largest error / {unit}"));
    page.table(
        "Free running from the first sample. RMSE is the mean over the family's recordings; \u{201c}of range\u{201d} is RMSE over the range of the recording\u{2019}s output.",
        &["family", "recordings", "samples", &rmse, "of range", &largest],
        &rows,
        None,
    );
}

/// How to read [`examples`].
pub fn examples_help(page: &mut Page) {
    page.how_to_read(
        "One row for each kind of excitation. On the left the measured output (wide grey line) and the predictions (thin lines) over time: where a \
         thin line runs in the middle of the grey one, that model is right. **Below it the error**, prediction less measurement, on a \
         scale of its own: look at its axis first. On the right the same samples as output over input: the hysteresis loop. A model without \
         memory would draw a single curve there. Of each family the recording with the **largest** error is shown.",
    );
}

/// Each example in the layout of the paper's Figs. 2 and 3: output over time with the error below, and the loop at the side.
pub fn examples(page: &mut Page, examples: &[Example]) {
    for example in examples {
        one_example(page, example);
    }
}

/// Line styles of the predictions and their errors, the last of them for the model that the page is about.
const STYLES: [(&str, &str); 3] = [("two", "two"), ("one", "one"), ("model", "error")];

fn one_example(page: &mut Page, example: &Example) {
    let (input, output) = (&example.input_signal, &example.output_signal);
    let unit = &output.unit;
    let name = family_name(&example.family);
    let file = example.path.file_name().map_or_else(String::new, |name| name.to_string_lossy().into_owned());
    page.heading(&name);
    let errors = |predicted: &[f64]| -> Vec<f64> {
        let each = predicted.iter().zip(&example.measured).map(|(predicted, measured)| predicted - measured);
        each.enumerate().map(|(index, error)| if index < example.first { f64::NAN } else { error }).collect()
    };
    let styles = &STYLES[STYLES.len().saturating_sub(example.predictions.len())..];
    let lines = |x: &[f64]| {
        let mut series = vec![Series::new("measured", "measured", x, &example.measured)];
        let predictions = example.predictions.iter().zip(styles);
        series.extend(predictions.map(|(prediction, style)| Series::new(&prediction.model, style.0, x, &prediction.predicted)));
        series
    };
    let predictions = example.predictions.iter().zip(styles);
    let error_lines: Vec<Series> = predictions
        .map(|(prediction, style)| {
            let name = if example.predictions.len() > 1 { format!("error of {}", prediction.model) } else { "error".to_owned() };
            Series::new(&name, style.1, &example.time_s, &errors(&prediction.predicted))
        })
        .collect();
    let figures: Vec<String> = example
        .predictions
        .iter()
        .rev()
        .map(|prediction| {
            let (errors, model) = (&prediction.errors, &prediction.model);
            let (rmse, share, largest) = (number(errors.rmse, 3), percent(errors.nrmse), number(errors.max_abs, 3));
            format!("**{model}** RMSE {rmse} {unit} ({share} of the output range), largest {largest} {unit}")
        })
        .collect();
    let figures = figures.join("; ");
    let described = figures.replace("**", "");
    let time = panels(
        Caption {
            title: &format!("{name}: output over time and error"),
            description: &format!("Measured output and predictions over time. {described}."),
        },
        "time / s",
        760.0,
        &[
            Panel { label: format!("{} / {unit}", output.quantity), series: lines(&example.time_s), height: 206.0, zero: false },
            Panel { label: format!("error / {unit}"), series: error_lines, height: 92.0, zero: true },
            Panel {
                label: format!("{} / {}", input.quantity, input.unit),
                series: vec![Series::new("", "input", &example.time_s, &example.input)],
                height: 64.0,
                zero: false,
            },
        ],
    );
    let loop_plot = loops(
        Caption {
            title: &format!("{name}: hysteresis loop"),
            description: &format!("Output over input, measured and predicted. {described}."),
        },
        &format!("{} / {}", input.quantity, input.unit),
        &format!("{} / {unit}", output.quantity),
        (372.0, 470.0),
        &lines(&example.input),
    );
    page.begin_row();
    page.figure(time, Width::TwoThirds, &format!("{figures}. Recording {file}."));
    page.figure(loop_plot, Width::Third, "The same samples as output over input.");
    page.end_row();
}

/// How to read a ladder.
pub fn ladder_help(page: &mut Page, ladder: &Ladder) {
    page.how_to_read(&format!(
        "Models from the simplest down to the most capable, all judged on the same recordings that none of them was fitted to. The scale \
         is **logarithmic**: each step to the left is a tenfold smaller error. Bars end at the mean RMSE, the letters at that of each family. \
         The highlighted row is the simplest model that suffices: {}. Anything below it costs more and gains nothing.",
        ladder.rule
    ));
}

/// One ladder as a plot and a table.
pub fn ladder(page: &mut Page, ladder: &Ladder, unit: &str, on: &str) {
    let chosen = |name: &str| ladder.simplest_sufficient.as_deref() == Some(name);
    let row = |rung: &crate::evaluate::ladder::Rung| DotRow {
        name: rung.name.clone(),
        note: format!("{} numbers, {} MAC a step", count(rung.parameters), count(rung.macs_per_step)),
        value: rung.mean_rmse,
        dots: rung
            .families
            .iter()
            .filter(|family| family.family.chars().count() == 1)
            .map(|family| (family.family.clone(), family.rmse))
            .collect(),
        marked: chosen(&rung.name),
    };
    let rows: Vec<DotRow> = ladder.rungs.iter().map(row).collect();
    let least = rows.iter().map(|row| row.value).filter(|value| *value > 0.0).fold(f64::INFINITY, f64::min);
    // Five decades are plenty: what is smaller is rounding. A little room to the left of the least, so that it has a bar.
    let most = rows.iter().map(|row| row.value).fold(0.0, f64::max);
    let floor = (0.4 * least).max(1e-5 * most);
    let best = ladder.simplest_sufficient.as_deref().unwrap_or("none");
    let plot = dots(
        Caption {
            title: &format!("Ladder of models {on}"),
            description: &format!("Mean RMSE of each model on a logarithmic scale. The simplest that suffices is: {best}."),
        },
        &format!("RMSE / {unit}, logarithmic"),
        1120.0,
        floor,
        &rows,
    );
    page.figure(plot, Width::Full, "");
    let table: Vec<Vec<Cell>> = ladder
        .rungs
        .iter()
        .map(|rung| {
            vec![
                Cell::Text(rung.name.clone()),
                Cell::Text(rung.kind.clone()),
                Cell::Figure(count(rung.parameters)),
                Cell::Figure(number(rung.mean_rmse, 3)),
                Cell::Figure(percent(rung.mean_nrmse)),
                Cell::Figure(number(rung.max_abs, 3)),
                Cell::Text(
                    if chosen(&rung.name) {
                        "simplest that suffices"
                    } else if rung.sufficient {
                        "suffices"
                    } else {
                        ""
                    }
                    .to_owned(),
                ),
            ]
        })
        .collect();
    let (rmse, largest) = (format!("RMSE / {unit}"), format!("largest / {unit}"));
    let header = ["model", "what it is", "fitted numbers", &rmse, "of range", &largest, ""];
    page.table(&format!("The ladder {on}."), &header, &table, ladder.rungs.iter().position(|rung| chosen(&rung.name)));
}

/// The criteria of the suite.
pub fn suite(page: &mut Page, suite: &SuiteReport) {
    let truth = match &suite.plant {
        Some(plant) => format!("Truth comes from the plant {plant}, which answered new signals that no model was fitted to."),
        None => "There is no plant that could tell the truth for new signals, so the model is held against itself.".to_owned(),
    };
    let rows: Vec<Vec<Cell>> = suite
        .criteria
        .iter()
        .map(|criterion| {
            vec![
                Cell::Text(criterion.name.clone()),
                Cell::Text(criterion.what.clone()),
                Cell::Figure(number(criterion.value, 3)),
                Cell::Figure(format!("\u{2264} {}", number(criterion.limit, 3))),
                Cell::Text(criterion.unit.clone()),
                Cell::Verdict(criterion.passed),
            ]
        })
        .collect();
    page.table(
        &format!("What a model must do beyond a small error on familiar recordings. {truth}"),
        &["criterion", "what was measured", "value", "limit", "unit", "verdict"],
        &rows,
        None,
    );
    for missing in &suite.not_judged {
        page.paragraph(&format!("Not judged: {missing}."));
    }
}

/// Errors during holds as heat maps with one colour scale.
pub fn holds(page: &mut Page, suites: &[(&str, &SuiteReport)], input_unit: &str, unit: &str) {
    let largest = suites.iter().flat_map(|(_, suite)| suite.holds.iter().map(|hold| hold.max_abs)).filter(|value| value.is_finite());
    let high = largest.fold(1e-6, f64::max);
    // Three decades below the worst is as good as nothing.
    let high = 10f64.powf((high.log10() * 2.0).ceil() / 2.0);
    let scale = (1e-3 * high, high);
    let maps: Vec<HeatMap> = suites
        .iter()
        .map(|(name, suite)| HeatMap {
            heading: format!("{name}, worst {}", number(suite.holds.iter().map(|hold| hold.max_abs).fold(0.0, f64::max), 2)),
            columns: suite.hold_times_s.iter().map(|time_s| if *time_s >= 59.0 { "60".to_owned() } else { format!("{time_s}") }).collect(),
            rows: suite.holds.iter().map(|hold| (format!("{:.2}", hold.level), hold.errors.clone())).collect(),
        })
        .collect();
    let plot = heat(
        Caption {
            title: "Errors during holds of a minute",
            description: "Heat maps: level of the hold over time into the hold; bright cells are large errors.",
        },
        ("time into the hold / s", &format!("held at / {input_unit}"), unit),
        1120.0,
        scale,
        &maps,
    );
    page.figure(plot, Width::Full, "");
}

/// How to read the maps of [`holds`].
pub fn holds_help(page: &mut Page, known: bool) {
    let what = if known { "error" } else { "change of the output since 10 s" };
    page.how_to_read(&format!(
        "Each line of a map is one hold: after random moves the input stops at a level of the range and rests for 60 s. Columns are times into the \
         hold, not evenly spaced; the colour is the magnitude of the {what} on a logarithmic scale, the same for all maps of a row. A line that \
         brightens from left to right is a model that **drifts**; a line bright from the start is a model that stopped in the wrong place; a \
         dark map is a model that knows how to wait."
    ));
}
