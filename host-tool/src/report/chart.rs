//! The kinds of plots: lines over a common axis, loops, dots on a logarithmic scale, bars and heat maps.

use super::axis::Axis;
use super::data::Plot;
use super::decimate::decimate;
pub use super::series::Series;
use super::svg::{Anchor, Svg};
use super::text::{number, superscript};

/// Most points of a line: more than the pixels it crosses, so nothing visible is lost.
const MOST_POINTS: usize = 1600;
/// Room for tick labels and the label of the vertical axis.
const LEFT: f64 = 66.0;
/// From the vertical axis to the baseline of its label: six digits have room between them.
const LABEL: f64 = 53.0;
const RIGHT: f64 = 14.0;
/// Room for tick labels and the label of the horizontal axis.
const BOTTOM: f64 = 44.0;
/// Room for the legend.
const TOP: f64 = 26.0;
/// Between panels one above the other.
const BETWEEN: f64 = 18.0;

/// One of several plots one above the other.
#[derive(Clone, Debug)]
pub struct Panel {
    /// Quantity and unit.
    pub label: String,
    /// The lines, the first at the back.
    pub series: Vec<Series>,
    /// Height in pixels without axis labels.
    pub height: f64,
    /// Whether zero is shown and marked, as for errors.
    pub zero: bool,
}

/// What a plot is called, and what it tells to who cannot see it.
#[derive(Clone, Copy, Debug)]
pub struct Caption<'a> {
    /// A few words.
    pub title: &'a str,
    /// A sentence or two.
    pub description: &'a str,
}

struct Frame {
    left: f64,
    right: f64,
    top: f64,
    bottom: f64,
    x: Axis,
    y: Axis,
}

impl Frame {
    fn new(left: f64, right: f64, top: f64, bottom: f64, series: &[Series], x_margin: f64, zero: bool) -> Self {
        let points = || series.iter().flat_map(|series| series.points.iter());
        let x = Axis::over(points().map(|point| point.0), x_margin, left, right);
        let mut values: Vec<f64> = points().map(|point| point.1).collect();
        if zero {
            values.push(0.0);
        }
        Self { left, right, top, bottom, x, y: Axis::over(values, 0.06, bottom, top) }
    }

    /// What the page's script needs of it.
    fn plot(&self, labels: [&str; 2], series: &[Series]) -> Plot {
        Plot {
            frame: [self.left, self.right, self.top, self.bottom],
            x: self.x.ends(),
            y: self.y.ends(),
            logarithmic: self.y.is_logarithmic(),
            labels: labels.map(str::to_owned),
            series: series.to_vec(),
        }
    }

    fn grid(&self, svg: &mut Svg, x_label: Option<&str>, y_label: &str, ticks: (usize, usize)) {
        svg.begin_group(if x_label.is_some() { "ticks below" } else { "ticks" }, "");
        for value in self.y.between_decades() {
            svg.line("grid minor", (self.left, self.y.at(value)), (self.right, self.y.at(value)));
        }
        for tick in self.y.ticks(ticks.1) {
            let at = self.y.at(tick.value);
            svg.line("grid", (self.left, at), (self.right, at));
            svg.text("tick", (self.left - 8.0, at + 4.0), Anchor::End, &tick.label);
        }
        for tick in self.x.ticks(ticks.0) {
            let at = self.x.at(tick.value);
            svg.line("grid", (at, self.top), (at, self.bottom));
            if x_label.is_some() {
                svg.text("tick", (at, self.bottom + 17.0), Anchor::Middle, &tick.label);
            }
        }
        svg.end_group();
        svg.line("axis", (self.left, self.bottom), (self.right, self.bottom));
        svg.line("axis", (self.left, self.top), (self.left, self.bottom));
        if let Some(label) = x_label {
            let label = with_power(label, self.x.power());
            svg.text("label", (0.5 * (self.left + self.right), self.bottom + 37.0), Anchor::Middle, &label);
        }
        svg.upward_text("label", (self.left - LABEL, 0.5 * (self.top + self.bottom)), &with_power(y_label, self.y.power()));
    }

    fn lines(&self, svg: &mut Svg, series: &[Series]) {
        for (number, line) in series.iter().enumerate() {
            let points: Vec<(f64, f64)> =
                decimate(&line.points, MOST_POINTS).into_iter().map(|(x, y)| (self.x.at(x), self.y.at(y))).collect();
            svg.begin_group("series", &number.to_string());
            svg.polyline(line.class, &points);
            svg.end_group();
        }
        if series.iter().all(|line| line.points.is_empty()) {
            let middle = (0.5 * (self.left + self.right), 0.5 * (self.top + self.bottom));
            svg.text("label", middle, Anchor::Middle, "no data");
        }
    }
}

/// `error / mm` becomes `error / 10⁻⁷ mm` when the ticks are given in that power of ten.
fn with_power(label: &str, power: Option<i32>) -> String {
    let Some(power) = power else { return label.to_owned() };
    let power = format!("10{}", superscript(power));
    match label.rsplit_once(" / ") {
        Some((quantity, unit)) => format!("{quantity} / {power} {unit}"),
        None => format!("{label} / {power}"),
    }
}

/// Names the lines from the edge of the frame on, further left where they need the room.
fn legend<'a>(svg: &mut Svg, series: impl Iterator<Item = &'a Series>, width: f64, baseline: f64) {
    // Seven pixels a letter at twelve pixels high, on average, and a gap.
    let extent = |line: &Series| 28.0 + 6.7 * line.name.chars().count() as f64 + 20.0;
    let named: Vec<&Series> = series.filter(|line| !line.name.is_empty()).collect();
    let total: f64 = named.iter().map(|line| extent(line)).sum();
    let mut x = LEFT.min(width - total).max(4.0);
    for line in named {
        svg.begin_group("entry", &line.name);
        svg.line(line.class, (x, baseline - 4.0), (x + 22.0, baseline - 4.0));
        svg.text("legend", (x + 28.0, baseline), Anchor::Start, &line.name);
        svg.end_group();
        x += extent(line);
    }
}

/// Panels one above the other over one horizontal axis.
#[must_use]
pub fn panels(caption: Caption<'_>, x_label: &str, width: f64, panels: &[Panel]) -> Svg {
    let heights: f64 = panels.iter().map(|panel| panel.height).sum();
    let gaps = BETWEEN * panels.len().saturating_sub(1) as f64;
    let mut svg = Svg::new(width, TOP + heights + gaps + BOTTOM, caption.title, caption.description);
    // One horizontal axis for all, also where a panel's own data end earlier.
    let all: Vec<Series> = panels.iter().flat_map(|panel| panel.series.iter().cloned()).collect();
    let common = Frame::new(LEFT, width - RIGHT, 0.0, 0.0, &all, 0.0, false).x;
    let mut top = TOP;
    for (index, panel) in panels.iter().enumerate() {
        let mut frame = Frame::new(LEFT, width - RIGHT, top, top + panel.height, &panel.series, 0.0, panel.zero);
        frame.x = common;
        let last = index + 1 == panels.len();
        let lines = if panel.height < 110.0 { 3 } else { 5 };
        svg.begin_plot(frame.plot([x_label, &panel.label], &panel.series));
        frame.grid(&mut svg, last.then_some(x_label), &panel.label, (8, lines));
        if panel.zero {
            svg.begin_group("zeros", "");
            svg.line("zero", (frame.left, frame.y.at(0.0)), (frame.right, frame.y.at(0.0)));
            svg.end_group();
        }
        frame.lines(&mut svg, &panel.series);
        svg.end_group();
        top += panel.height + BETWEEN;
    }
    legend(&mut svg, all.iter(), width, 14.0);
    svg
}

/// Lines of positive values over a common axis, on a logarithmic scale; what is not positive lies at its lower end.
#[must_use]
pub fn decades(caption: Caption<'_>, x_label: &str, y_label: &str, size: (f64, f64), series: &[Series]) -> Svg {
    let mut svg = Svg::new(size.0, size.1, caption.title, caption.description);
    let mut frame = Frame::new(LEFT, size.0 - RIGHT, TOP, size.1 - BOTTOM, series, 0.0, false);
    let positive = series.iter().flat_map(|line| line.points.iter().map(|point| point.1)).filter(|y| y.is_finite() && *y > 0.0);
    let (low, high) = positive.fold((f64::INFINITY, 0.0_f64), |(low, high), value| (low.min(value), high.max(value)));
    frame.y = Axis::decades(low, high, frame.bottom, frame.top);
    svg.begin_plot(frame.plot([x_label, y_label], series));
    frame.grid(&mut svg, Some(x_label), y_label, (8, 6));
    frame.lines(&mut svg, series);
    svg.end_group();
    legend(&mut svg, series.iter(), size.0, 14.0);
    svg
}

/// Output over input: hysteresis loops.
#[must_use]
pub fn loops(caption: Caption<'_>, x_label: &str, y_label: &str, size: (f64, f64), series: &[Series]) -> Svg {
    let mut svg = Svg::new(size.0, size.1, caption.title, caption.description);
    let frame = Frame::new(LEFT, size.0 - RIGHT, TOP, size.1 - BOTTOM, series, 0.04, false);
    svg.begin_plot(frame.plot([x_label, y_label], series));
    frame.grid(&mut svg, Some(x_label), y_label, (5, 6));
    frame.lines(&mut svg, series);
    svg.end_group();
    legend(&mut svg, series.iter(), size.0, 14.0);
    svg
}

/// One row of a dot plot.
#[derive(Clone, Debug)]
pub struct DotRow {
    /// Name.
    pub name: String,
    /// Small print below the name.
    pub note: String,
    /// The value that decides; drawn as a bar from the left.
    pub value: f64,
    /// Single values with their letters.
    pub dots: Vec<(String, f64)>,
    /// Whether the row is marked as the one to look at.
    pub marked: bool,
}

/// Rows of errors on a logarithmic axis: a bar to the mean, a letter for each family. A row below `floor` is only said to be so.
#[must_use]
pub fn dots(caption: Caption<'_>, x_label: &str, width: f64, floor: f64, rows: &[DotRow]) -> Svg {
    const ROW: f64 = 46.0;
    const NAMES: f64 = 232.0;
    const FIGURES: f64 = 84.0;
    let bottom = 12.0 + ROW * rows.len() as f64;
    let mut svg = Svg::new(width, bottom + BOTTOM, caption.title, caption.description);
    let high = rows.iter().flat_map(|row| row.dots.iter().map(|dot| dot.1).chain([row.value])).filter(|value| value.is_finite());
    let axis = Axis::decades(floor, high.fold(10.0 * floor, f64::max), NAMES, width - FIGURES);
    for value in axis.between_decades() {
        svg.line("grid minor", (axis.at(value), 8.0), (axis.at(value), bottom));
    }
    for tick in axis.ticks(8) {
        svg.line("grid", (axis.at(tick.value), 8.0), (axis.at(tick.value), bottom));
        svg.text("tick", (axis.at(tick.value), bottom + 17.0), Anchor::Middle, &tick.label);
    }
    svg.line("axis", (NAMES, bottom), (width - FIGURES, bottom));
    svg.text("label", (0.5 * (NAMES + width - FIGURES), bottom + 37.0), Anchor::Middle, x_label);
    for (index, row) in rows.iter().enumerate() {
        let middle = 12.0 + ROW * (index as f64 + 0.5);
        if row.marked {
            svg.rectangle("band", (0.0, middle - 0.5 * ROW + 2.0), (width, ROW - 4.0), None, "");
        }
        svg.text("name", (0.0 + 10.0, middle - 2.0), Anchor::Start, &row.name);
        svg.text("note", (0.0 + 10.0, middle + 13.0), Anchor::Start, &row.note);
        if row.value < floor {
            svg.text("note", (NAMES + 8.0, middle + 4.0), Anchor::Start, "\u{25c2} below the scale: exact up to rounding");
            svg.text("figure", (width - 6.0, middle + 4.0), Anchor::End, &number(row.value, 3));
            continue;
        }
        let end = axis.clamped(row.value);
        let tip = format!("{}: mean {}", row.name, number(row.value, 3));
        svg.rectangle(if row.marked { "bar chosen" } else { "bar" }, (NAMES, middle - 7.0), (end - NAMES, 14.0), None, &tip);
        // Letters that would lie on each other move apart, up and down in turn.
        for (number_of_dot, (letter, value)) in row.dots.iter().enumerate() {
            let at = (axis.clamped(*value), middle + if number_of_dot.is_multiple_of(2) { -7.5 } else { 7.5 });
            svg.disc("dot", at, 7.0, &format!("{}, family {letter}: {}", row.name, number(*value, 3)));
            svg.text("letter", (at.0, at.1 + 3.6), Anchor::Middle, letter);
        }
        svg.text("figure", (width - 6.0, middle + 4.0), Anchor::End, &number(row.value, 3));
    }
    svg
}

/// Bars from zero, one below the other, with their values.
#[must_use]
pub fn bars(caption: Caption<'_>, x_label: &str, width: f64, rows: &[(String, f64)]) -> Svg {
    bars_from(caption, x_label, width, f64::NEG_INFINITY, rows)
}

/// As [`bars`], but none is drawn further down than to `floor`, so that one does not dwarf the others. The value beside it is the true one.
#[must_use]
pub fn bars_from(caption: Caption<'_>, x_label: &str, width: f64, floor: f64, rows: &[(String, f64)]) -> Svg {
    const ROW: f64 = 26.0;
    // Nine pixels a letter of a bold name in a wide font.
    let names = 14.0 + rows.iter().map(|row| 9.0 * row.0.chars().count() as f64).fold(150.0, f64::max);
    let bottom = 8.0 + ROW * rows.len() as f64;
    let mut svg = Svg::new(width, bottom + BOTTOM, caption.title, caption.description);
    let axis = Axis::over(rows.iter().map(|row| row.1.max(floor)).chain([0.0]), 0.0, names, width - 60.0);
    for tick in axis.ticks(6) {
        svg.line("grid", (axis.at(tick.value), 4.0), (axis.at(tick.value), bottom));
        svg.text("tick", (axis.at(tick.value), bottom + 17.0), Anchor::Middle, &tick.label);
    }
    svg.line("axis", (axis.at(0.0), 4.0), (axis.at(0.0), bottom));
    svg.text("label", (0.5 * (names + width - 60.0), bottom + 37.0), Anchor::Middle, x_label);
    for (index, (name, value)) in rows.iter().enumerate() {
        let top = 8.0 + ROW * index as f64;
        svg.text("name", (names - 10.0, top + 14.0), Anchor::End, name);
        let (from, to) = (axis.at(0.0), axis.at(if value.is_finite() { value.max(floor) } else { 0.0 }));
        svg.rectangle("bar", (from.min(to), top + 2.0), ((to - from).abs(), ROW - 8.0), None, &format!("{name}: {}", number(*value, 3)));
        svg.text("figure", (from.max(to) + 6.0, top + 14.0), Anchor::Start, &number(*value, 3));
    }
    svg
}

/// A table of magnitudes as colours.
#[derive(Clone, Debug)]
pub struct HeatMap {
    /// Above the map.
    pub heading: String,
    /// Names of the columns.
    pub columns: Vec<String>,
    /// Name and values of each row, the first at the bottom.
    pub rows: Vec<(String, Vec<f64>)>,
}

/// Heat maps side by side with one logarithmic colour scale from `low` to `high`.
#[must_use]
pub fn heat(caption: Caption<'_>, labels: (&str, &str, &str), width: f64, scale: (f64, f64), maps: &[HeatMap]) -> Svg {
    const CELL: f64 = 11.0;
    const SCALE: f64 = 66.0;
    let rows = maps.iter().map(|map| map.rows.len()).max().unwrap_or(0);
    let bottom = 30.0 + CELL * rows as f64;
    let mut svg = Svg::new(width, bottom + BOTTOM + 2.0, caption.title, caption.description);
    let count = maps.len().max(1) as f64;
    let gap = 22.0;
    let each = (width - LEFT - SCALE - 24.0 - gap * (count - 1.0)) / count;
    let (x_label, y_label, unit) = labels;
    let share = |value: f64| ((value.max(scale.0) / scale.0).ln() / (scale.1 / scale.0).ln()).clamp(0.0, 1.0);
    for (index, map) in maps.iter().enumerate() {
        let left = LEFT + index as f64 * (each + gap);
        svg.text("name", (left, 18.0), Anchor::Start, &map.heading);
        let cell = each / map.columns.len().max(1) as f64;
        for (row, (name, values)) in map.rows.iter().enumerate() {
            let top = bottom - CELL * (row + 1) as f64;
            for (column, value) in values.iter().enumerate() {
                let tip =
                    format!("{} {name}, {}: {} {unit}", map.heading, map.columns.get(column).map_or("", String::as_str), number(*value, 2));
                let fill = if value.is_finite() { colour(share(value.abs())) } else { "#888888".to_owned() };
                // Half a pixel of overlap: no seams between cells.
                svg.rectangle("cell", (left + cell * column as f64, top), (cell + 0.5, CELL + 0.5), Some(&fill), &tip);
            }
            if index == 0 && row % 5 == 0 {
                svg.text("tick", (left - 8.0, top + 9.0), Anchor::End, name);
            }
        }
        for (column, name) in map.columns.iter().enumerate() {
            if column % 2 == 1 || map.columns.len() < 8 {
                svg.text("tick", (left + cell * (column as f64 + 0.5), bottom + 15.0), Anchor::Middle, name);
            }
        }
        svg.text("label", (left + 0.5 * each, bottom + 37.0), Anchor::Middle, x_label);
    }
    svg.upward_text("label", (LEFT - LABEL, 0.5 * (30.0 + bottom)), y_label);
    let axis = Axis::decades(scale.0, scale.1, bottom, 30.0);
    let (left, steps) = (width - SCALE, 60);
    for step in 0..steps {
        let part = f64::from(step) / f64::from(steps);
        let height = (bottom - 30.0) / f64::from(steps);
        svg.rectangle("cell", (left, bottom - height * f64::from(step + 1)), (12.0, height + 0.5), Some(&colour(part)), "");
    }
    for tick in axis.ticks(5) {
        svg.text("tick", (left + 18.0, axis.at(tick.value) + 4.0), Anchor::Start, &tick.label);
    }
    svg.text("tick", (left - 2.0, 18.0), Anchor::Start, &format!("error/{unit}"));
    svg
}

/// A colour from dark blue (0) over green to yellow (1): even steps of lightness, readable with any colour vision. The nine stops are
/// read off the scale `viridis` (Smith and van der Walt, 2015, CC0).
#[must_use]
pub fn colour(share: f64) -> String {
    const STOPS: [[f64; 3]; 9] = [
        [68.0, 1.0, 84.0],
        [71.0, 44.0, 122.0],
        [59.0, 81.0, 139.0],
        [44.0, 113.0, 142.0],
        [33.0, 144.0, 141.0],
        [39.0, 173.0, 129.0],
        [92.0, 200.0, 99.0],
        [170.0, 220.0, 50.0],
        [253.0, 231.0, 37.0],
    ];
    let position = if share.is_finite() { share.clamp(0.0, 1.0) * 8.0 } else { 0.0 };
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "0 to 7")]
    let below = (position.floor() as usize).min(7);
    let part = position - below as f64;
    let channel = |index: usize| {
        let value = STOPS[below][index] + part * (STOPS[below + 1][index] - STOPS[below][index]);
        format!("{:02x}", value.round().clamp(0.0, 255.0).rem_euclid(256.0) as u8)
    };
    format!("#{}{}{}", channel(0), channel(1), channel(2))
}
