//! A line of a plot.

/// One line of a plot.
#[derive(Clone, Debug)]
pub struct Series {
    /// Name in the legend; a line without a name is not in it.
    pub name: String,
    /// Class of the style sheet: `measured`, `model`, `error`, `one`, `two`, `three`, `input`.
    pub class: &'static str,
    /// The points, in order.
    pub points: Vec<(f64, f64)>,
}

impl Series {
    /// A line through values at times.
    #[must_use]
    pub fn new(name: &str, class: &'static str, x: &[f64], y: &[f64]) -> Self {
        Self { name: name.to_owned(), class, points: x.iter().copied().zip(y.iter().copied()).collect() }
    }
}
