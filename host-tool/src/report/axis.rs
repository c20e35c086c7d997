//! Axes: a range that is never empty, ticks at round numbers, labels without superfluous digits.

/// From data to drawing coordinates, linear or logarithmic.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Axis {
    low: f64,
    high: f64,
    start: f64,
    end: f64,
    logarithmic: bool,
}

/// A tick and its label.
#[derive(Clone, Debug, PartialEq)]
pub struct Tick {
    /// Value in the data.
    pub value: f64,
    /// Text.
    pub label: String,
}

impl Axis {
    /// A linear axis over the finite values, widened by `margin` (a share of the range) at both ends, drawn from `start` to `end`.
    /// Without any finite value it spans 0 to 1; a single value gets room around it.
    #[must_use]
    pub fn over(values: impl IntoIterator<Item = f64>, margin: f64, start: f64, end: f64) -> Self {
        let finite = values.into_iter().filter(|value| value.is_finite());
        let (low, high) = finite.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), value| (low.min(value), high.max(value)));
        let (low, high) = if low > high { (0.0, 1.0) } else { (low, high) };
        // Differences below the rounding of the values themselves are no range.
        let span = if high - low > 1e-12 * low.abs().max(high.abs()) { high - low } else { (0.2 * high.abs()).max(1e-9) };
        let middle = 0.5 * (low + high);
        let half = span * (0.5 + margin);
        Self { low: middle - half, high: middle + half, start, end, logarithmic: false }
    }

    /// A logarithmic axis from a power of ten at or below `low` to one at or above `high`, both positive.
    #[must_use]
    pub fn decades(low: f64, high: f64, start: f64, end: f64) -> Self {
        let low = if low.is_finite() && low > 0.0 { low } else { 1e-3 };
        let high = if high.is_finite() && high > low { high } else { 10.0 * low };
        let (floor, ceiling) = (low.log10().floor(), high.log10().ceil());
        Self { low: floor, high: ceiling.max(floor + 1.0), start, end, logarithmic: true }
    }

    /// Whether it is logarithmic.
    #[must_use]
    pub fn is_logarithmic(&self) -> bool {
        self.logarithmic
    }

    /// The values at the start and at the end; of a logarithmic axis their powers of ten.
    #[must_use]
    pub fn ends(&self) -> [f64; 2] {
        [self.low, self.high]
    }

    /// On a logarithmic axis, two to nine times each decade: where the lines lie closer and closer.
    #[must_use]
    pub fn between_decades(&self) -> Vec<f64> {
        if !self.logarithmic || self.high - self.low > 8.0 {
            return Vec::new();
        }
        let (mut values, mut exponent) = (Vec::new(), self.low);
        while exponent < self.high {
            values.extend((2..10).map(|times| f64::from(times) * 10f64.powf(exponent)));
            exponent += 1.0;
        }
        values
    }

    /// The drawing coordinate of a value; on a logarithmic axis what is not positive lies at the start.
    #[must_use]
    pub fn at(&self, value: f64) -> f64 {
        let value = match (self.logarithmic, value > 0.0) {
            (false, _) => value,
            (true, true) => value.log10(),
            (true, false) => self.low,
        };
        self.start + (value - self.low) / (self.high - self.low) * (self.end - self.start)
    }

    /// As [`Self::at`], held within the axis.
    #[must_use]
    pub fn clamped(&self, value: f64) -> f64 {
        self.at(value).clamp(self.start.min(self.end), self.start.max(self.end))
    }

    /// The power of ten that tick labels are given in, where plain numbers would be long: `Some(-7)` for labels in 10^-7.
    #[must_use]
    pub fn power(&self) -> Option<i32> {
        let largest = self.low.abs().max(self.high.abs());
        if self.logarithmic || (1e-3..1e5).contains(&largest) {
            return None;
        }
        // The axis is a little longer than the data: half its length names the same decade as the data.
        #[expect(clippy::cast_possible_truncation, reason = "an exponent of a float")]
        let power = (0.9 * largest).log10().floor() as i32;
        Some(power)
    }

    /// About `count` ticks at 1, 2, 2.5 or 5 times a power of ten; on a logarithmic axis every decade, thinned to about `count`.
    #[must_use]
    pub fn ticks(&self, count: usize) -> Vec<Tick> {
        let span = self.high - self.low;
        let count = count.max(2) as f64;
        if self.logarithmic {
            let step = (span / count).ceil().max(1.0);
            let decade = |index: f64| {
                let exponent = self.low + index * step;
                #[expect(clippy::cast_possible_truncation, reason = "a whole exponent of a float")]
                let label = super::text::superscript(exponent as i32);
                Tick { value: 10f64.powf(exponent), label: format!("10{label}") }
            };
            #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a small count")]
            let steps = (span / step).floor() as usize;
            return (0..=steps).map(|index| decade(index as f64)).collect();
        }
        let rough = span / count;
        let decade = 10f64.powf(rough.log10().floor());
        let step =
            [1.0, 2.0, 2.5, 5.0, 10.0].map(|factor| factor * decade).into_iter().find(|step| *step >= 0.999 * rough).unwrap_or(rough);
        let unit = self.power().map_or(1.0, |power| 10f64.powi(power));
        // As many decimals as the step needs, one more for 2.5.
        let decimals = (0..12).find(|&decimals| {
            let scaled = step / unit * 10f64.powi(decimals);
            (scaled - scaled.round()).abs() < 1e-6 * scaled
        });
        let decimals = usize::try_from(decimals.unwrap_or(0)).unwrap_or(0);
        let first = (self.low / step - 1e-9).ceil();
        let mut ticks = Vec::new();
        let mut index = first;
        while index * step <= self.high + 1e-9 * span && ticks.len() < 50 {
            let value = index * step;
            let label = if index == 0.0 { "0".to_owned() } else { label(value / unit, decimals) };
            ticks.push(Tick { value, label });
            index += 1.0;
        }
        ticks
    }
}

fn label(value: f64, decimals: usize) -> String {
    let magnitude = value.abs();
    format!("{}{magnitude:.decimals$}", if value < 0.0 { "\u{2212}" } else { "" })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn labels(axis: &Axis, count: usize) -> Vec<String> {
        axis.ticks(count).into_iter().map(|tick| tick.label).collect()
    }

    #[test]
    fn ticks_stand_at_round_numbers_inside_the_axis() {
        assert_eq!(labels(&Axis::over([0.0, 20.0], 0.0, 0.0, 100.0), 5), ["0", "5", "10", "15", "20"]);
        assert_eq!(labels(&Axis::over([-0.0031, 0.0029], 0.0, 0.0, 1.0), 4), ["\u{2212}0.002", "0", "0.002"]);
        let small = Axis::over([-2.1e-7, 2.2e-7], 0.0, 0.0, 1.0);
        assert_eq!((small.power(), labels(&small, 4)), (Some(-7), vec!["\u{2212}2".into(), "0".into(), "2".into()]));
        assert_eq!(labels(&Axis::over([0.0, 1.0], 0.0, 0.0, 1.0), 4), ["0", "0.25", "0.50", "0.75", "1.00"]);
        for (low, high) in [(0.0, 1e-9), (-1e9, 1e9), (1e5, 1e5 + 3.0), (-7.3, 0.2), (1e-300, 3e-300)] {
            let ticks = Axis::over([low, high], 0.05, 0.0, 1.0).ticks(5);
            assert!((2..=12).contains(&ticks.len()), "{low} {high}: {ticks:?}");
            assert!(ticks.iter().all(|tick| (-1e-6..=1.0 + 1e-6).contains(&Axis::over([low, high], 0.05, 0.0, 1.0).at(tick.value))));
        }
    }

    #[test]
    fn an_axis_over_nothing_one_value_or_nonsense_is_finite_and_not_empty() {
        for values in [vec![], vec![f64::NAN, f64::INFINITY], vec![0.0], vec![5.0, 5.0], vec![-3e20; 4]] {
            let axis = Axis::over(values.clone(), 0.05, 10.0, 110.0);
            let at = values.iter().copied().find(|value| value.is_finite()).unwrap_or(0.5);
            assert!((axis.at(at) - 60.0).abs() < 1e-6, "{values:?}");
            assert!(axis.ticks(5).len() >= 2, "{values:?}");
        }
    }

    #[test]
    fn decades_enclose_the_values_and_what_is_not_positive_lies_at_the_start() {
        let axis = Axis::decades(3e-4, 0.02, 0.0, 300.0);
        assert_eq!(labels(&axis, 10), ["10\u{207b}\u{2074}", "10\u{207b}\u{b3}", "10\u{207b}\u{b2}", "10\u{207b}\u{b9}"]);
        assert!((axis.at(1e-3) - 100.0).abs() < 1e-9);
        assert_eq!(axis.at(0.0), 0.0);
        assert_eq!(axis.clamped(1e9), 300.0);
        assert!(Axis::decades(f64::NAN, 0.0, 0.0, 1.0).ticks(5).len() >= 2);
    }
}
