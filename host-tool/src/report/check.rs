//! The report of `catheter check`: each recording as a picture, with what was found beside it.

use super::chart::{Caption, Panel, Series, loops, panels};
use super::page::{Cell, Page, Width};
use super::text::number;
use crate::recording::Recording;
use crate::recording::check::{Check, Checked, check};

/// Recordings that are drawn; the rest stands in the JSON result.
const MOST_DRAWN: usize = 12;

/// The whole document.
#[must_use]
pub fn page(checked: &Check, recordings: &[Recording]) -> String {
    let unit = recordings.first().map_or("", |recording| recording.output_signal.unit.as_str());
    let lead = format!("{} recording(s) as they are, before anything is fitted to them.", recordings.len());
    let mut page = Page::new("What the recordings show", &lead);
    page.section("All recordings");
    let found = &checked.repeatability;
    let known = |value: Option<f64>| value.map_or_else(|| "not known".to_owned(), |value| format!("{} {unit}", number(value, 3)));
    page.tiles(&[
        (known(Some(found.noise)), "sensor **noise**, from sample to sample".to_owned(), None),
        (known(found.repeatability), "what the rig **repeats**: no model gets below it".to_owned(), None),
        (format!("{} s", number(checked.common_period_s, 3)), "the **period** of a fit".to_owned(), None),
    ]);
    table(&mut page, "All recordings together.", &checked.lines(unit));
    for (checked, recording) in checked.recordings.iter().zip(recordings).take(MOST_DRAWN) {
        let name = recording.path.file_name().map_or_else(|| "recording".to_owned(), |name| name.to_string_lossy().into_owned());
        page.section(&name);
        table(&mut page, "What was found.", &checked.lines());
        draw(&mut page, &name, checked, recording);
    }
    let left_out = recordings.len().saturating_sub(MOST_DRAWN);
    if left_out > 0 {
        page.paragraph(&format!("{left_out} more recording(s) are in the JSON result (--json) only."));
    }
    page.finish(&format!("Made by catheter {}. All figures are in the JSON result (--json).", env!("CARGO_PKG_VERSION")))
}

fn table(page: &mut Page, caption: &str, lines: &[(&'static str, String)]) {
    let rows: Vec<Vec<Cell>> = lines.iter().map(|(name, value)| vec![Cell::Text((*name).to_owned()), Cell::Text(value.clone())]).collect();
    page.table(caption, &["what", "value"], &rows, None);
}

/// A recording as a picture, in a section of its own.
pub fn picture(page: &mut Page, recording: &Recording) {
    let name = recording.path.file_name().map_or_else(|| "recording".to_owned(), |name| name.to_string_lossy().into_owned());
    page.section(&name);
    draw(page, &name, &check(std::slice::from_ref(recording)).recordings[0], recording);
}

/// Inputs and output over time, and the loop of the first input.
fn draw(page: &mut Page, name: &str, checked: &Checked, recording: &Recording) {
    // A line for each stretch: nothing is drawn across a gap.
    let series = |label: &str, class: &'static str, x: &[f64], y: &[f64]| -> Vec<Series> {
        let parts = recording.segments().into_iter().enumerate();
        parts.map(|(part, segment)| Series::new(if part == 0 { label } else { "" }, class, &x[segment.clone()], &y[segment])).collect()
    };
    let label = |quantity: &str, unit: &str| format!("{quantity} / {unit}");
    let (input, output) = (&recording.input_signal, &recording.output_signal);
    let time_s: Vec<f64> = recording.time_s.iter().map(|time_s| time_s - recording.time_s[0]).collect();
    let mut plots = vec![Panel {
        label: label(&output.quantity, &output.unit),
        series: series("output", "model", &time_s, &recording.output),
        height: 170.0,
        zero: false,
    }];
    let classes = ["one", "two", "three"];
    for (index, (channel, values)) in checked.channels.iter().zip(recording.inputs()).enumerate() {
        let series = series(&channel.role, classes[index % classes.len()], &time_s, values);
        plots.push(Panel { label: label(&channel.quantity, &channel.unit), series, height: 90.0, zero: false });
    }
    let described = format!("{} samples, {} gap(s).", checked.samples, checked.clock.gaps);
    let over_time = Caption { title: &format!("{name} over time"), description: &format!("Output and inputs over time. {described}") };
    let over_input = Caption { title: &format!("{name}: loop"), description: &format!("Output over the first input. {described}") };
    let loop_plot = loops(
        over_input,
        &label(&input.quantity, &input.unit),
        &label(&output.quantity, &output.unit),
        (372.0, 388.0),
        &series("", "model", &recording.input, &recording.output),
    );
    page.begin_row();
    page.figure(panels(over_time, "time / s", 760.0, &plots), Width::TwoThirds, &described);
    page.figure(loop_plot, Width::Third, "The same samples as output over input.");
    page.end_row();
}
