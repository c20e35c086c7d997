//! The report of a discovery: the verdict, where the disagreement lies, every effect that was tried, and the gap before and after.

use super::chart::{Caption, DotRow, HeatMap, Panel, Series, bars_from, dots, heat, loops, panels};
use super::page::{Cell, Page, Width};
use super::text::{count, number, percent};
use crate::discover::{Correlation, Discovery, Effect, Finding, HALF, Member, Residual, Role, Run, Share, Verdict, residual_map};
use crate::recording::Signal;

/// Most recordings drawn.
const MOST_RECORDINGS: usize = 3;

/// The verdict in a few words.
#[must_use]
pub fn headline(discovery: &Discovery) -> String {
    let names: Vec<&str> = discovery.effects.iter().map(|effect| effect.name.as_str()).collect();
    match discovery.verdict {
        Verdict::None if discovery.errs_kept_out_only => {
            "Nothing is missing in the recordings that were worked with, but the model does not follow those that were kept out.".to_owned()
        }
        Verdict::None if discovery.stands_out() => {
            "Nothing is missing: what the model leaves above the noise is no more than its grid of play operators may leave.".to_owned()
        }
        Verdict::None => "Nothing is missing: the model leaves no more than the noise.".to_owned(),
        Verdict::Unknown if names.is_empty() => "Something is missing, and it is none of the effects in the catalogue.".to_owned(),
        Verdict::Unknown => {
            let explain = if names.len() == 1 { "explains" } else { "explain" };
            format!("Something is missing that the catalogue does not explain; {} {explain} a part of it.", names.join(" and "))
        }
        Verdict::Ambiguous if discovery.effects.iter().all(|effect| effect.confidence == 0.0) => {
            format!("What is missing looks like {}, but recordings that it has not seen speak against it.", names.join(" and "))
        }
        Verdict::Ambiguous if discovery.confidence_set.len() > 1 => {
            let sets: Vec<String> = discovery.confidence_set.iter().map(|member| member.effects.join(" and ")).collect();
            format!("What is missing is one of these, which the recordings cannot tell apart: {}.", sets.join("; "))
        }
        Verdict::Ambiguous if discovery.leaves_much() => format!(
            "What is missing looks like {}, by another law than the catalogue's or with something else: {} of it stays unexplained.",
            names.join(" and "),
            percent(Some(discovery.unexplained))
        ),
        Verdict::Ambiguous if discovery.few_strokes => {
            let kinds = if discovery.unlike_strokes == 1 { "one stroke does" } else { "so few different strokes do" };
            let (all, unlike) = (discovery.strokes, discovery.unlike_strokes);
            format!(
                "What is missing looks like {}, but {kinds} not confirm it ({all} in all, {unlike} different): record others.",
                names.join(" and ")
            )
        }
        Verdict::Ambiguous if discovery.runner_up.as_ref().is_none_or(|second| second.separable) => {
            format!("What is missing looks like {}, but recordings that it has not seen do not confirm it.", names.join(" and "))
        }
        Verdict::Ambiguous => {
            let second = discovery.runner_up.as_ref().map_or("another effect", |second| second.name.as_str());
            format!("Missing is {} or {second}: these recordings cannot tell them apart.", names.join(" and "))
        }
        Verdict::Named => {
            let (sure, unsure): (Vec<&Effect>, Vec<&Effect>) = discovery.effects.iter().partition(|effect| effect.confidence > HALF);
            let names = |of: &[&Effect]| of.iter().map(|effect| effect.name.as_str()).collect::<Vec<_>>().join(" and ");
            match (&sure[..], &unsure[..]) {
                (sure, []) => format!("Missing is {}.", names(sure)),
                ([], unsure) => format!("What is missing looks like {}, but that is not sure.", names(unsure)),
                (sure, unsure) => format!("Missing is {}; {} beside it is not sure.", names(sure), names(unsure)),
            }
        }
    }
}

/// What to say of recordings that were kept out: where they speak against what was found, and where a model extrapolates.
#[must_use]
pub fn warning(discovery: &Discovery) -> Option<String> {
    let worse = discovery.is_worse() && !discovery.errs_kept_out_only;
    let worse = worse.then(|| "There the model with what was found is worse than the one without: do not simulate with it.".to_owned());
    let elsewhere = discovery.errs_kept_out_only.then(|| {
        format!(
            "There it errs by {} times the noise, and no choice may look at them: give such recordings to the search as well.",
            number(discovery.rmse_after / discovery.noise_floor, 2)
        )
    });
    let beyond = (!discovery.beyond_range.is_empty()).then(|| {
        let goes = if discovery.beyond_range.len() == 1 { "goes" } else { "go" };
        format!("{} {goes} beyond the input of all others: there a model extrapolates.", discovery.beyond_range.join(", "))
    });
    let said: Vec<String> = [worse, elsewhere, beyond].into_iter().flatten().collect();
    (!said.is_empty()).then(|| said.join(" "))
}

/// The page.
#[must_use]
pub fn page(finding: &Finding, input: &Signal, output: &Signal) -> String {
    let discovery = &finding.discovery;
    let unit = &output.unit;
    let mut page = Page::new("Which effect does the simulation lack?", &headline(discovery));
    page.section("Where simulation and measurement disagree");
    page.paragraph(&discovery.summary);
    disagreements(&mut page, finding, input, output);
    memory(&mut page, discovery, unit);
    page.section("The verdict");
    let gap = percent(Some(discovery.gap_closed));
    page.tiles(&[
        (format!("{} {unit}", number(discovery.rmse_before, 3)), "RMSE of the simulation as it was".into(), None),
        (format!("{} {unit}", number(discovery.rmse_after, 3)), "RMSE with what was found".into(), None),
        (format!("{} {unit}", number(discovery.noise_floor, 3)), "noise".into(), None),
        (gap, "of the gap closed".into(), None),
    ]);
    let kept = if discovery.kept_out.is_empty() { "all recordings".to_owned() } else { discovery.kept_out.join(", ") };
    let warning = warning(discovery).map_or(String::new(), |warning| format!(" **{warning}**"));
    page.paragraph(&format!("The figures are those of recordings that took no part in any choice: {kept}.{warning}"));
    if finding.session.runs.iter().any(|run| run.is_worked_with() && run.role.contains(&Role::Test)) {
        page.paragraph(
            "The recordings are too few to leave whole ones out: blocks of them were left out instead, and their neighbours were not.",
        );
    }
    page.paragraph(&match discovery.calibrate_s {
        Some(seconds) => format!(
            "Both models ran freely behind a start-up of {seconds:.2} s, over which the zero was set and which does not count: \
             `catheter evaluate --calibrate-s {seconds}` gives the same."
        ),
        None => "Both models ran freely, from the input alone: `catheter evaluate` gives the same.".to_owned(),
    });
    if let Some([before, after, closed]) = discovery.one_step() {
        page.paragraph(&format!(
            "One step ahead, from the samples before, an observer that knows no jumps is off by {} {unit} and one that knows them by \
             {} {unit}: {} of the gap closed.",
            number(before, 3),
            number(after, 3),
            percent(Some(closed))
        ));
    }
    if !discovery.side_unknown.is_empty() {
        let names = discovery.side_unknown.join(", ");
        page.paragraph(&format!(
            "They leave out {names}: made about when the set-up changed, and the other recordings do not tell on which side."
        ));
    }
    if let Some(second) = &discovery.runner_up {
        let words = if second.separable { "these recordings tell them apart" } else { "these recordings do **not** tell them apart" };
        page.paragraph(&format!("The second best explanation is **{}**; {words}.", second.name));
    }
    effects(&mut page, discovery);
    // Beside a given model that leaves no more than the noise nothing is.
    if !discovery.candidates.is_empty() {
        page.section("What was tried");
        candidates(&mut page, discovery);
        confidence_set(&mut page, discovery);
    }
    page.section("Before and after");
    before_and_after(&mut page, finding, input, output);
    page.section("What is left");
    residuals(&mut page, discovery);
    page.finish(&format!("Made by catheter {}. All figures are in the JSON result (--json).", env!("CARGO_PKG_VERSION")))
}

fn effects(page: &mut Page, discovery: &Discovery) {
    if discovery.effects.is_empty() {
        return;
    }
    let mut rows = Vec::new();
    for effect in &discovery.effects {
        for (name, value) in &effect.parameters {
            let interval = effect.intervals.get(name);
            let interval = interval.map_or_else(String::new, |[low, high]| format!("{} to {}", number(*low, 3), number(*high, 3)));
            rows.push(vec![
                Cell::Text(format!("{} ({})", effect.name, effect.form)),
                Cell::Text(name.clone()),
                Cell::Figure(number(*value, 4)),
                Cell::Figure(interval),
                Cell::Figure(number(effect.confidence, 2)),
            ]);
        }
    }
    page.table(
        "What was found. The unit ends the parameter\u{2019}s name; the interval holds the value with 95 % confidence, if the form is right.",
        &["effect", "parameter", "value", "interval", "confidence"],
        &rows,
        None,
    );
}

fn confidence_set(page: &mut Page, discovery: &Discovery) {
    let of = |member: &Member| {
        let effects = if member.effects.is_empty() { "none".to_owned() } else { member.effects.join(" and ") };
        vec![Cell::Text(effects), Cell::Figure(number(member.criterion, 3)), Cell::Figure(number(member.p_value, 2))]
    };
    let rows: Vec<Vec<Cell>> = discovery.confidence_set.iter().map(of).collect();
    if !rows.is_empty() {
        page.table(
            "Explanations that no other predicts left-out recordings significantly better than: the log predictive density over that of the \
             model without effects, and the probability of a distance like its own, were all as good.",
            &["effects", "nats per sample", "p"],
            &rows,
            None,
        );
    }
}

fn disagreements(page: &mut Page, finding: &Finding, input: &Signal, output: &Signal) {
    let discovery = &finding.discovery;
    let rows: Vec<Vec<Cell>> = discovery
        .disagreements
        .iter()
        .take(14)
        .map(|one| {
            vec![
                Cell::Text(one.axis.clone()),
                Cell::Text(one.region.clone()),
                Cell::Figure(percent(Some(one.share))),
                Cell::Figure(percent(Some(one.even_share))),
                Cell::Figure(number(one.p_value, 2)),
            ]
        })
        .collect();
    if !rows.is_empty() {
        page.table(
            "Regions that hold more of the disagreement than their share of the samples, at a false discovery rate of 5 %.",
            &["along", "region", "of the disagreement", "of the samples", "p"],
            &rows,
            None,
        );
    }
    let session = &finding.session;
    let unit = &output.unit;
    let (levels, before) = residual_map::map(session, &residual(finding, &finding.simulated));
    let after_prediction: Vec<Vec<f64>> = finding.after.outputs(session, |_| true);
    let (_, after) = residual_map::map(session, &residual(finding, &after_prediction));
    let columns: Vec<String> = levels.iter().map(|level| number(*level, 2)).collect();
    let highest = before.iter().flat_map(|row| &row.1).copied().filter(|value| value.is_finite()).fold(0.0, f64::max);
    let low = (0.5 * discovery.noise_floor).max(1e-3 * highest).max(1e-12);
    page.figure(
        heat(
            Caption {
                title: "Disagreement by level and rate of the input",
                description: "Root mean square of the residual for levels of the input and for falling and rising input, before and after.",
            },
            (&format!("{} / {}", input.quantity, input.unit), "direction", unit),
            1120.0,
            (low, highest.max(4.0 * low)),
            &[
                HeatMap { heading: "as it was".into(), columns: columns.clone(), rows: before },
                HeatMap { heading: "with what was found".into(), columns, rows: after },
            ],
        ),
        Width::Full,
        "Root mean square of the disagreement by level of the input (across) and its direction and rate (up: falling fast at the bottom, rising \
         fast at the top). Grey: hardly any samples.",
    );
    if let Some(area) = &discovery.loop_area {
        let row = |name: &str, share: &Share, time_s: Option<f64>| {
            vec![
                Cell::Text(name.to_owned()),
                Cell::Figure(percent(Some(share.value))),
                Cell::Figure(format!("{} to {}", percent(Some(share.low)), percent(Some(share.high)))),
                Cell::Figure(time_s.map_or_else(String::new, |time_s| number(time_s, 3))),
            ]
        };
        page.table(
            "What opens the loops: their area split into transport delay, lag and what remains at any speed.",
            &["part", "of the area", "95 % interval", "time / s"],
            &[
                row("transport delay", &area.dead_time, Some(area.dead_time_s)),
                row("lag", &area.lag, Some(area.lag_s)),
                row("true hysteresis", &area.hysteresis, None),
            ],
            None,
        );
    }
}

/// How much of the initial state the output needs.
fn memory(page: &mut Page, discovery: &Discovery, unit: &str) {
    if discovery.memory_horizon.is_empty() {
        return;
    }
    page.section("How much of the past the output needs");
    page.how_to_read(
        "Each bar is the error of a predictor that sees the input of the last so many seconds **and nothing before**, on recordings it was not \
         fitted to. Where the bars stop falling ends the memory of the plant. A network with a window sees one of these lengths; play operators and \
         recurrent networks see everything.",
    );
    let row = |name: String, note: String, value: f64, marked: bool| DotRow { name, note, value, dots: Vec::new(), marked };
    let mut rows: Vec<DotRow> = discovery
        .memory_horizon
        .iter()
        .map(|window| {
            let [low, high] = window.interval.map(|value| number(value, 3));
            row(format!("last {} s", number(window.window_s, 2)), format!("95 %: {low} to {high}"), window.rmse, false)
        })
        .collect();
    rows.push(row("simulation as it was".into(), "sees everything".into(), discovery.rmse_before, false));
    rows.push(row("with what was found".into(), "sees everything".into(), discovery.rmse_after, true));
    let floor = 0.5 * discovery.noise_floor.max(1e-3 * discovery.rmse_before).max(1e-12);
    let caption = Caption {
        title: "Error against the length of the window",
        description: "Root mean square error of the best predictor that sees a window of the input, for windows of growing length, beside both models.",
    };
    page.figure(
        dots(caption, &format!("RMSE / {unit}"), 1120.0, floor, &rows),
        Width::Full,
        &format!(
            "The noise is {} {unit}. The models are judged on the kept-out recordings, the windows on those that selected.",
            number(discovery.noise_floor, 3)
        ),
    );
}

/// Bars are drawn down to here, per cent; the figure beside a longer one is its true value.
const LOWEST_BAR: f64 = -20.0;

fn candidates(page: &mut Page, discovery: &Discovery) {
    page.how_to_read(
        "Every effect of the catalogue was added to the simulation alone and fitted to one half of the recordings. A bar says how much of \
         the mean square it takes away **on the other half**; noise takes nothing away, and a bar may be negative. Effects that act alike have \
         bars of like length: the search then prefers the one with fewer parameters. Bars are drawn down to -20 %; the figure beside is the true one.",
    );
    let mut shown: Vec<(String, f64)> =
        discovery.candidates.iter().map(|candidate| (candidate.name.clone(), 100.0 * candidate.score)).collect();
    shown.sort_by(|x, y| y.1.total_cmp(&x.1));
    page.figure(
        bars_from(
            Caption {
                title: "Effects tried alone",
                description: "Share of the mean square that each effect takes away on recordings it was not fitted to.",
            },
            "share of the mean square taken away / %",
            1120.0,
            LOWEST_BAR,
            &shown,
        ),
        Width::Full,
        "",
    );
}

/// Measured less predicted.
fn residual(finding: &Finding, prediction: &[Vec<f64>]) -> Vec<Vec<f64>> {
    finding.session.runs.iter().zip(prediction).map(|(run, p)| run.output.iter().zip(p).map(|(y, p)| y - p).collect()).collect()
}

fn before_and_after(page: &mut Page, finding: &Finding, input: &Signal, output: &Signal) {
    let session = &finding.session;
    let square = |run: &&Run| -> f64 {
        run.output.iter().zip(&finding.simulated[run.index]).map(|(y, p)| (y - p).powi(2)).sum::<f64>() / run.output.len() as f64
    };
    let mut chosen: Vec<&Run> = session.runs.iter().filter(|run| run.role.contains(&Role::Test)).collect();
    if chosen.is_empty() {
        chosen = session.runs.iter().collect();
    }
    chosen.sort_by(|x, y| square(y).total_cmp(&square(x)));
    chosen.truncate(MOST_RECORDINGS);
    let unit = &output.unit;
    for run in chosen {
        let scale = session.output_scale;
        let scaled = |values: &[f64]| -> Vec<f64> { values.iter().map(|value| value * scale).collect() };
        let inputs: Vec<f64> = run.input.iter().map(|value| value * session.input_scale + session.input_offset).collect();
        let measured = scaled(&run.output);
        let was = scaled(&finding.simulated[run.index]);
        let is = finding.with_effects[run.index].as_ref().map_or_else(|| scaled(&finding.after.predict(run)), |values| scaled(values));
        let error = |predicted: &[f64]| -> Vec<f64> { predicted.iter().zip(&measured).map(|(p, y)| p - y).collect() };
        page.heading(&run.name);
        let description = format!("Measured output, the simulation as it was and with what was found, recording {}.", run.name);
        let lines = |x: &[f64]| {
            vec![
                Series::new("measured", "measured", x, &measured),
                Series::new("as it was", "one", x, &was),
                Series::new("with what was found", "model", x, &is),
            ]
        };
        page.begin_row();
        page.figure(
            panels(
                Caption { title: &format!("{}: output over time and error", run.name), description: &description },
                "time / s",
                760.0,
                &[
                    Panel { label: format!("{} / {unit}", output.quantity), series: lines(&run.time_s), height: 206.0, zero: false },
                    Panel {
                        label: format!("error / {unit}"),
                        series: vec![Series::new("", "one", &run.time_s, &error(&was)), Series::new("", "error", &run.time_s, &error(&is))],
                        height: 110.0,
                        zero: true,
                    },
                    Panel {
                        label: format!("{} / {}", input.quantity, input.unit),
                        series: vec![Series::new("", "input", &run.time_s, &inputs)],
                        height: 64.0,
                        zero: false,
                    },
                ],
            ),
            Width::TwoThirds,
            "",
        );
        page.figure(
            loops(
                Caption { title: &format!("{}: loops", run.name), description: &description },
                &format!("{} / {}", input.quantity, input.unit),
                &format!("{} / {unit}", output.quantity),
                (372.0, 488.0),
                &lines(&inputs),
            ),
            Width::Third,
            "",
        );
        page.end_row();
    }
}

fn residuals(page: &mut Page, discovery: &Discovery) {
    let with = |correlation: &Correlation| {
        Cell::Figure(format!(
            "{} at {} s (p {})",
            number(correlation.value, 2),
            number(correlation.lag_s, 2),
            number(correlation.p_value, 2)
        ))
    };
    let row = |name: &str, residual: &Residual| {
        vec![
            Cell::Text(name.to_owned()),
            Cell::Figure(number(residual.neighbours, 2)),
            with(&residual.with_input),
            with(&residual.with_rate),
            with(&residual.with_model),
        ]
    };
    page.table(
        "A residual that is noise has no memory and goes with nothing. Correlations are the largest over delays of up to a second either way.",
        &["residual", "neighbouring samples", "with the input", "with its rate", "with the model"],
        &[row("as it was", &discovery.residual_before), row("with what was found", &discovery.residual_after)],
        None,
    );
    page.paragraph(&format!(
        "{} of the disagreement above the noise stays unexplained on the recordings that were worked with; {} samples were left out as outliers.",
        percent(Some(discovery.unexplained)),
        count(discovery.excluded_samples)
    ));
}
