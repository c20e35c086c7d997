//! What plots show, as numbers beside the drawing: what the page's script zooms into, and what it downloads as CSV. Without the script the
//! drawing is all there is, and enough.

use serde_json::{Value, json};

use super::series::Series;

/// Most rows of a table: twenty times the pixels of a plot, for what is zoomed into.
const MOST_ROWS: usize = 4000;

/// A frame and the lines in it.
pub struct Plot {
    /// Left, right, top and bottom in the drawing.
    pub frame: [f64; 4],
    /// Values at left and right.
    pub x: [f64; 2],
    /// Values at bottom and top; of a logarithmic axis their powers of ten.
    pub y: [f64; 2],
    /// Whether the vertical axis is logarithmic.
    pub logarithmic: bool,
    /// Names of the axes.
    pub labels: [String; 2],
    /// The lines, in the order of the drawing.
    pub series: Vec<Series>,
}

/// Lines of one length: their samples belong together.
#[derive(Default)]
struct Table {
    rows: usize,
    columns: Vec<Vec<f64>>,
}

impl Table {
    /// The number of a column, which is added if no other is equal to the bit.
    fn column(&mut self, values: Vec<f64>) -> usize {
        let equal = |one: &Vec<f64>| one.iter().zip(&values).all(|(one, other)| one.to_bits() == other.to_bits());
        if let Some(known) = self.columns.iter().position(equal) {
            return known;
        }
        self.columns.push(values);
        self.columns.len() - 1
    }

    /// The rows that are kept: within equal stretches the smallest and the largest of every column, and the ends.
    fn kept(&self) -> Vec<usize> {
        let stretches = MOST_ROWS / (2 * self.columns.len().max(1)).max(1);
        if self.rows <= MOST_ROWS || stretches == 0 {
            return (0..self.rows).collect();
        }
        let stretch = self.rows.div_ceil(stretches);
        let mut kept = vec![0, self.rows - 1];
        for begin in (0..self.rows).step_by(stretch) {
            let part = begin..(begin + stretch).min(self.rows);
            for column in &self.columns {
                let by = |one: &usize, other: &usize| column[*one].total_cmp(&column[*other]);
                kept.extend(part.clone().min_by(by));
                kept.extend(part.clone().max_by(by));
            }
        }
        kept.sort_unstable();
        kept.dedup();
        kept
    }
}

/// The figures of a group, whose plots belong together, as the text of a JSON object; nothing where no figure has a plot.
pub fn group(figures: &[(String, Vec<Plot>)]) -> Option<String> {
    let mut tables: Vec<Table> = Vec::new();
    let mut described: Vec<Value> = Vec::new();
    for (id, plots) in figures.iter().filter(|(_, plots)| !plots.is_empty()) {
        let mut drawn: Vec<Value> = Vec::new();
        for plot in plots {
            let lines: Vec<Value> = plot.series.iter().map(|series| line(&mut tables, series)).collect();
            let [x_label, y_label] = &plot.labels;
            drawn.push(
                json!({ "frame": plot.frame, "x": plot.x, "y": plot.y, "log": plot.logarithmic, "xl": x_label, "yl": y_label, "s": lines }),
            );
        }
        described.push(json!({ "id": id, "plots": drawn }));
    }
    if described.is_empty() {
        return None;
    }
    let tables: Vec<Value> = tables.iter().map(values).collect();
    // Nothing of it may end the element that it stands in.
    Some(json!({ "figures": described, "tables": tables }).to_string().replace('<', "\\u003c"))
}

fn line(tables: &mut Vec<Table>, series: &Series) -> Value {
    let rows = series.points.len();
    let number = tables.iter().position(|table| table.rows == rows).unwrap_or_else(|| {
        tables.push(Table { rows, columns: Vec::new() });
        tables.len() - 1
    });
    let (x, y) = series.points.iter().copied().unzip();
    let (x, y) = (tables[number].column(x), tables[number].column(y));
    json!({ "n": series.name, "c": series.class, "t": number, "x": x, "y": y })
}

/// The columns with seven digits; what is not finite is null.
fn values(table: &Table) -> Value {
    let kept = table.kept();
    #[expect(clippy::cast_possible_truncation, reason = "seven digits are more than a screen shows")]
    let short = |&row: &usize, column: &Vec<f64>| {
        let value = column[row] as f32;
        // Through text: the shortest digits that are this number.
        value.is_finite().then(|| value.to_string().parse::<f64>().ok()).flatten()
    };
    Value::from(
        table
            .columns
            .iter()
            .map(|column| kept.iter().map(|row| short(row, column)).collect::<Vec<_>>())
            .map(Value::from)
            .collect::<Vec<_>>(),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_share_what_they_share_and_no_peak_is_lost() {
        let time: Vec<f64> = (0..100_000).map(f64::from).collect();
        let mut output = vec![1.0; time.len()];
        output[54_321] = 9.0;
        output[7] = f64::NAN;
        let input: Vec<f64> = time.iter().map(|time| (0.01 * time).sin()).collect();
        let plot = |series: Vec<Series>| Plot {
            frame: [0.0, 1.0, 0.0, 1.0],
            x: [0.0, 1.0],
            y: [0.0, 1.0],
            logarithmic: false,
            labels: ["x".into(), "</script>".into()],
            series,
        };
        let over_time = plot(vec![Series::new("measured", "measured", &time, &output)]);
        let over_input = plot(vec![Series::new("measured", "measured", &input, &output)]);
        let text = group(&[("f1".into(), vec![over_time]), ("f2".into(), vec![over_input])]).expect("plots");
        assert!(!text.contains('<'), "nothing ends the element");
        let group: Value = serde_json::from_str(&text).expect("JSON");
        let columns = group["tables"][0].as_array().expect("columns");
        assert_eq!(columns.len(), 3, "time, output, input");
        let [of_time, of_loop] = [0, 1].map(|figure| &group["figures"][figure]["plots"][0]["s"][0]);
        assert_eq!(of_time["y"], of_loop["y"]);
        let rows = columns[0].as_array().expect("rows");
        assert!(rows.len() <= MOST_ROWS + 2, "{}", rows.len());
        let peak = rows.iter().position(|row| *row == json!(54_321.0)).expect("the peak's row");
        assert_eq!(columns[1][peak], json!(9.0));
        assert!(columns.iter().all(|column| column.as_array().is_some_and(|column| column.len() == rows.len())));
        assert_eq!(super::group(&[("f1".into(), Vec::new())]), None);
    }
}
