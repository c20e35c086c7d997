//! The report of `catheter fit`: the ladder, what was left out, and the chosen model on recordings that it took no part in.

use super::page::{Cell, Page};
use super::text::{count, number};
use super::{primer, sections};
use crate::fit::Outcome;
use crate::fit::folder::left_out;
use modelling::physics::Calibrated;

/// The page.
#[must_use]
pub fn page(fitted: &Outcome) -> String {
    let examples = super::examples("left out", &fitted.prepared.recordings, &left_out(fitted));
    let output = &fitted.prepared.output;
    let (unit, range) = (&output.unit, output.maximum - output.minimum);
    let chosen = &fitted.ladder[fitted.chosen];
    let [low, high] = chosen.cv_interval;
    let lead = format!(
        "{}: {}. On the next recording expect an error of {} {unit}, between {} and {} {unit} with 95 % probability.",
        chosen.name,
        chosen.what,
        number(chosen.cv_rmse, 3),
        number(low, 2),
        number(high, 2)
    );
    let mut page = Page::new("Which model to use", &lead);
    let repeats = fitted.repeatability.repeatability;
    page.tiles(&[
        (format!("{} {unit}", number(chosen.cv_rmse, 3)), "error on recordings left out".to_owned(), None),
        (format!("{} %", number(100.0 * chosen.cv_rmse / range, 2)), "of the output\u{2019}s range".to_owned(), None),
        (
            repeats.map_or("not known".to_owned(), |value| format!("{} {unit}", number(value, 2))),
            "what the rig itself repeats".to_owned(),
            None,
        ),
        (format!("{} {unit}", number(fitted.repeatability.noise, 2)), "noise of the sensor".to_owned(), None),
    ]);
    page.section("The ladder");
    page.how_to_read(
        "Each row is a kind of model, the simplest on top. The error is that of predictions, free running, of recordings that took **no part** in \
         fitting or choosing that model. The marked row is the simplest whose error is as small as the smallest, within what can be told \
         apart. The interval is what to expect on **one more recording** of this rig.",
    );
    ladder(&mut page, fitted, unit, range);
    page.paragraph(&format!("Left out at a time: {}. {}.", fitted.splits.what, capitalised(&fitted.repeatability.method)));
    for note in &fitted.notes {
        page.paragraph(&format!("{}.", capitalised(note)));
    }
    nuisances(&mut page, fitted, unit);
    page.section("On recordings that took no part");
    sections::examples_help(&mut page);
    sections::examples(&mut page, &examples);
    primer::add(&mut page);
    page.finish(&format!("Made by catheter {}. All figures are in the JSON result (--json).", env!("CARGO_PKG_VERSION")))
}

/// What moved recordings and is no part of the model.
fn nuisances(page: &mut Page, fitted: &Outcome, unit: &str) {
    let calibrate_s = number(fitted.calibrate_s, 2);
    page.paragraph(&format!("Calibrated: with the zero set over the first {calibrate_s} s of each recording, which do not count there."));
    let named = &fitted.ladder[fitted.chosen].nuisances;
    if named.is_empty() {
        return;
    }
    page.section("Nuisances");
    page.how_to_read(
        "What the data show to move the output of a whole recording, or of its rest, and what is **no part of the model**. Rungs are compared \
         with it taken off. The errors above are with it.",
    );
    let row = |kind: String| {
        move |value: &modelling::physics::nuisance::Value| {
            let at = value.at.map_or("\u{2013}".to_owned(), |at| number(at, 3));
            vec![Cell::Text(kind.clone()), Cell::Text(value.recording.clone()), Cell::Figure(number(value.value, 3)), Cell::Figure(at)]
        }
    };
    let rows: Vec<Vec<Cell>> = named.iter().flat_map(|one| one.values.iter().map(row(one.kind.to_string()))).collect();
    let above = format!("above the model / {unit}");
    page.table(
        "At: time of a step in s; session time or temperature of the recording.",
        &["nuisance", "recording", &above, "at"],
        &rows,
        None,
    );
}

/// The errors of every rung, and below them what each is and costs: one table would be wider than the page.
fn ladder(page: &mut Page, fitted: &Outcome, unit: &str, range: f64) {
    let errors = |rung: &crate::fit::LadderRung| {
        let [low, high] = rung.cv_interval;
        let calibrated = |text: fn(&Calibrated) -> String| rung.calibrated.as_ref().map_or("\u{2013}".to_owned(), text);
        vec![
            Cell::Text(rung.name.clone()),
            Cell::Figure(number(rung.cv_rmse, 3)),
            Cell::Figure(format!("{} %", number(100.0 * rung.cv_rmse / range, 2))),
            Cell::Figure(format!("{} to {}", number(low, 2), number(high, 2))),
            Cell::Figure(calibrated(|one| number(one.rmse, 3))),
            Cell::Figure(calibrated(|one| format!("{} to {}", number(one.interval[0], 2), number(one.interval[1], 2)))),
        ]
    };
    let rows: Vec<Vec<Cell>> = fitted.ladder.iter().map(errors).collect();
    let (error, next, calibrated) = (format!("error / {unit}"), format!("next recording / {unit}"), format!("calibrated / {unit}"));
    let header = ["rung", &error, "of range", &next, &calibrated, &next];
    page.table("Errors are means over what was left out.", &header, &rows, Some(fitted.chosen));
    let costs = |rung: &crate::fit::LadderRung| {
        let what = if rung.eligible { rung.what.clone() } else { format!("{} (these data cannot judge it)", rung.what) };
        vec![
            Cell::Text(rung.name.clone()),
            Cell::Text(what),
            Cell::Figure(count(rung.parameters)),
            Cell::Figure(count(rung.step_instructions)),
            Cell::Text(if rung.on_chip { "yes" } else { "no" }.to_owned()),
            Cell::Figure(number(rung.seconds, 2)),
        ]
    };
    let rows: Vec<Vec<Cell>> = fitted.ladder.iter().map(costs).collect();
    page.table(
        "Instructions are those of one step on a Cortex-M4F, about.",
        &["rung", "what it is", "numbers", "instructions", "on the chip", "time / s"],
        &rows,
        Some(fitted.chosen),
    );
}

fn capitalised(text: &str) -> String {
    let mut characters = text.chars();
    characters.next().map_or(String::new(), |first| first.to_uppercase().chain(characters).collect())
}
