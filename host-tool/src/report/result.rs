//! A result of any command as a page: what the JSON result holds, in tables.

use serde_json::Value;

use super::page::{Cell, Page};
use super::text::number;

/// Rows of a table that are shown; the rest stands in the JSON result.
const MOST_ROWS: usize = 60;

/// A page with what `draw` puts there, and the figures below.
#[must_use]
pub fn page(title: &str, lead: &str, figures: &Value, draw: impl FnOnce(&mut Page)) -> String {
    let mut page = Page::new(title, lead);
    draw(&mut page);
    page.section("Figures");
    if let Value::Object(fields) = figures {
        let single: Vec<(&String, &Value)> = fields.iter().filter(|(_, value)| is_single(value)).collect();
        let rows: Vec<Vec<Cell>> = single.iter().map(|(name, value)| vec![Cell::Text((*name).clone()), Cell::Text(shown(value))]).collect();
        if !rows.is_empty() {
            page.table("The result, by the names of its fields.", &["field", "value"], &rows, None);
        }
        for (name, value) in fields.iter().filter(|(_, value)| !is_single(value)) {
            table(&mut page, name, value);
        }
    }
    page.finish(&format!("Made by catheter {}. All figures are in the JSON result (--json).", env!("CARGO_PKG_VERSION")))
}

/// Whether a value fits a cell: anything but a list of objects, an object with objects in it, or a long list.
fn is_single(value: &Value) -> bool {
    match value {
        Value::Array(values) => values.len() <= 4 && values.iter().all(|value| !value.is_object() && !value.is_array()),
        Value::Object(_) => false,
        _ => true,
    }
}

fn shown(value: &Value) -> String {
    match value {
        Value::Null => "-".to_owned(),
        Value::String(text) => text.clone(),
        Value::Number(figure) if figure.is_f64() => number(figure.as_f64().unwrap_or(f64::NAN), 5),
        Value::Array(values) if values.is_empty() => "none".to_owned(),
        Value::Array(values) if is_single(value) => values.iter().map(shown).collect::<Vec<_>>().join(", "),
        Value::Array(values) => format!("{} values", values.len()),
        Value::Object(fields) => {
            let part = |(name, value): (&String, &Value)| format!("{name} {}", shown(value));
            fields.iter().take(6).map(part).collect::<Vec<_>>().join("; ")
        }
        other => other.to_string(),
    }
}

/// A field with more than a cell in it.
fn table(page: &mut Page, name: &str, value: &Value) {
    match value {
        Value::Array(values) if values.iter().all(Value::is_object) => {
            let Some(names) = values.first().and_then(Value::as_object).map(|first| first.keys().cloned().collect::<Vec<_>>()) else {
                return;
            };
            let header: Vec<&str> = names.iter().map(String::as_str).collect();
            let row = |value: &Value| names.iter().map(|name| Cell::Text(shown(&value[name]))).collect();
            let rows: Vec<Vec<Cell>> = values.iter().take(MOST_ROWS).map(row).collect();
            page.table(&of(name, values.len()), &header, &rows, None);
        }
        Value::Array(values) => {
            let row = |(index, value): (usize, &Value)| vec![Cell::Text((index + 1).to_string()), Cell::Text(shown(value))];
            let rows: Vec<Vec<Cell>> = values.iter().enumerate().take(MOST_ROWS).map(row).collect();
            page.table(&of(name, values.len()), &["number", "value"], &rows, None);
        }
        Value::Object(fields) => {
            let rows: Vec<Vec<Cell>> =
                fields.iter().take(MOST_ROWS).map(|(name, value)| vec![Cell::Text(name.clone()), Cell::Text(shown(value))]).collect();
            page.table(&of(name, fields.len()), &["field", "value"], &rows, None);
        }
        _ => {}
    }
}

fn of(name: &str, rows: usize) -> String {
    if rows > MOST_ROWS { format!("**{name}**, the first {MOST_ROWS} of {rows}.") } else { format!("**{name}**") }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_figure_of_a_result_stands_on_its_page() {
        let result = serde_json::json!({
            "rmse": 0.0123, "name": "<b>", "none": null, "interval": [1.5, 2.5], "empty": [],
            "files": [{ "path": "a.csv", "rmse": 0.5 }, { "path": "b.csv", "rmse": 0.25 }],
            "many": (0..100).collect::<Vec<_>>(), "margins": { "gain": 2.0 },
        });
        let page = page("A result", "It says", &result, |page| page.paragraph("drawn"));
        for wanted in ["drawn", "0.0123", "&lt;b&gt;", "1.5000, 2.5000", "a.csv", "0.25000", "<td>none</td>", "the first 60 of 100", "gain"]
        {
            assert!(page.contains(wanted), "{wanted}");
        }
        assert!(!page.contains("<b>&lt;"), "names are text");
    }
}
