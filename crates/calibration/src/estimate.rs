//! A value with its interval.

/// A value with its 95 % interval.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct Estimate {
    /// The value.
    pub value: f64,
    /// Half the width of its 95 % interval; `None` where there are no more measurements than unknowns.
    pub half_width: Option<f64>,
}

impl Estimate {
    /// The value times a factor.
    #[must_use]
    pub fn scaled(self, factor: f64) -> Self {
        Self { value: self.value * factor, half_width: self.half_width.map(|half| half * factor.abs()) }
    }
}
