//! Drawing: an SVG that is well-formed and finite whatever it is given, in the page's colours.
//!
//! Colours and line styles are classes; the page's style sheet gives them values for light, dark and paper.

use std::fmt::Write;

use super::data::Plot;
use super::text::escape;

/// A drawing under construction.
pub struct Svg {
    width: f64,
    height: f64,
    title: String,
    description: String,
    body: String,
    plots: Vec<Plot>,
}

/// How text is placed at its point.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Anchor {
    /// It starts there.
    Start,
    /// Its middle is there.
    Middle,
    /// It ends there.
    End,
}

impl Anchor {
    fn name(self) -> &'static str {
        match self {
            Self::Start => "start",
            Self::Middle => "middle",
            Self::End => "end",
        }
    }
}

impl Svg {
    /// An empty drawing of a size in pixels; the page scales it. `title` names it and `description` tells what it shows to who cannot
    /// see it.
    #[must_use]
    pub fn new(width: f64, height: f64, title: &str, description: &str) -> Self {
        Self { width, height, title: title.to_owned(), description: description.to_owned(), body: String::new(), plots: Vec::new() }
    }

    /// Begins the drawing of a plot, whose numbers the page keeps beside it.
    pub fn begin_plot(&mut self, plot: Plot) {
        let _ = write!(self.body, "<g class=\"plot\" data-plot=\"{}\">", self.plots.len());
        self.plots.push(plot);
    }

    /// Begins a group of elements of a class.
    pub fn begin_group(&mut self, class: &str, name: &str) {
        let name = if name.is_empty() { String::new() } else { format!(" data-n=\"{}\"", escape(name)) };
        let _ = write!(self.body, "<g class=\"{}\"{name}>", escape(class));
    }

    /// Ends the newest plot or group.
    pub fn end_group(&mut self) {
        self.body.push_str("</g>");
    }

    /// The plots in the drawing; they are not kept.
    pub fn take_plots(&mut self) -> Vec<Plot> {
        std::mem::take(&mut self.plots)
    }

    /// A straight line.
    pub fn line(&mut self, class: &str, from: (f64, f64), to: (f64, f64)) {
        self.polyline(class, &[from, to]);
    }

    /// A line through points; where a coordinate is not finite it is interrupted.
    pub fn polyline(&mut self, class: &str, points: &[(f64, f64)]) {
        let mut path = String::new();
        let mut pen_down = false;
        for &(x, y) in points {
            let drawable = x.is_finite() && y.is_finite();
            if drawable {
                let _ = write!(path, "{}{} {}", if pen_down { "L" } else { "M" }, coordinate(x), coordinate(y));
            }
            pen_down = drawable;
        }
        if !path.is_empty() {
            let _ = write!(self.body, "<path class=\"{}\" d=\"{path}\"/>", escape(class));
        }
    }

    /// A filled polygon; nothing when a coordinate is not finite.
    pub fn polygon(&mut self, class: &str, points: &[(f64, f64)]) {
        if points.is_empty() || points.iter().any(|(x, y)| !(x.is_finite() && y.is_finite())) {
            return;
        }
        let text: Vec<String> = points.iter().map(|&(x, y)| format!("{},{}", coordinate(x), coordinate(y))).collect();
        let _ = write!(self.body, "<polygon class=\"{}\" points=\"{}\"/>", escape(class), text.join(" "));
    }

    /// A rectangle; `style` may give a colour that is data. `tip` is shown when the pointer rests on it.
    pub fn rectangle(&mut self, class: &str, corner: (f64, f64), size: (f64, f64), fill: Option<&str>, tip: &str) {
        let fill = fill.map_or_else(String::new, |fill| format!(" fill=\"{}\"", escape(fill)));
        let _ = write!(
            self.body,
            "<rect class=\"{}\" x=\"{}\" y=\"{}\" width=\"{}\" height=\"{}\"{fill}>{}</rect>",
            escape(class),
            coordinate(corner.0),
            coordinate(corner.1),
            coordinate(size.0.max(0.0)),
            coordinate(size.1.max(0.0)),
            title(tip)
        );
    }

    /// A disc; nothing when a coordinate is not finite.
    pub fn disc(&mut self, class: &str, centre: (f64, f64), radius: f64, tip: &str) {
        if !(centre.0.is_finite() && centre.1.is_finite()) {
            return;
        }
        let (x, y) = (coordinate(centre.0), coordinate(centre.1));
        let _ = write!(
            self.body,
            "<circle class=\"{}\" cx=\"{x}\" cy=\"{y}\" r=\"{}\">{}</circle>",
            escape(class),
            coordinate(radius),
            title(tip)
        );
    }

    /// A line of text with its baseline at a point.
    pub fn text(&mut self, class: &str, at: (f64, f64), anchor: Anchor, text: &str) {
        let (x, y) = (coordinate(at.0), coordinate(at.1));
        let _ = write!(
            self.body,
            "<text class=\"{}\" x=\"{x}\" y=\"{y}\" text-anchor=\"{}\">{}</text>",
            escape(class),
            anchor.name(),
            escape(text)
        );
    }

    /// Text that reads from bottom to top, its middle at a point.
    pub fn upward_text(&mut self, class: &str, at: (f64, f64), text: &str) {
        let (x, y) = (coordinate(at.0), coordinate(at.1));
        let _ = write!(
            self.body,
            "<text class=\"{}\" transform=\"translate({x} {y}) rotate(-90)\" text-anchor=\"middle\">{}</text>",
            escape(class),
            escape(text)
        );
    }

    /// The drawing as an element of a page; `id` must be unique there.
    #[must_use]
    pub fn finish(self, id: &str) -> String {
        let id = escape(id);
        format!(
            "<svg id=\"{id}\" xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {} {}\" role=\"img\" aria-labelledby=\"{id}-t {id}-d\">\
             <title id=\"{id}-t\">{}</title><desc id=\"{id}-d\">{}</desc>{}</svg>",
            coordinate(self.width),
            coordinate(self.height),
            escape(&self.title),
            escape(&self.description),
            self.body
        )
    }
}

fn title(tip: &str) -> String {
    if tip.is_empty() { String::new() } else { format!("<title>{}</title>", escape(tip)) }
}

/// A coordinate with a tenth of a pixel; what is not finite or far outside any page is brought to its edge.
fn coordinate(value: f64) -> String {
    let value = if value.is_nan() { 0.0 } else { value.clamp(-1e5, 1e5) };
    let text = format!("{value:.1}");
    let short = text.strip_suffix(".0").unwrap_or(&text);
    if short == "-0" { "0".to_owned() } else { short.to_owned() }
}
