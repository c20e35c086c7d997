//! From the unit of a column to the unit that is worked in: pressures become bar, lengths mm, times s; a calibration turns volts into either.
//!
//! Factors that are whole numbers are multiplied or divided by, so that a value is rounded once.

/// How the values of a column become values of another unit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Scale {
    /// Times a number.
    Times(f64),
    /// Divided by a number.
    Over(f64),
    /// Along the straight line through two points: the first values of both pairs belong together, and the second.
    Line {
        /// In the column's unit.
        from: [f64; 2],
        /// In the unit that is worked in.
        to: [f64; 2],
    },
}

impl Scale {
    /// Nothing changes.
    pub const NONE: Self = Self::Times(1.0);

    /// The value in the other unit.
    #[must_use]
    pub fn apply(self, value: f64) -> f64 {
        match self {
            Self::Times(factor) => value * factor,
            Self::Over(divisor) => value / divisor,
            Self::Line { from, to } => to[0] + (value - from[0]) * ((to[1] - to[0]) / (from[1] - from[0])),
        }
    }
}

/// What a unit is converted into, and how; none for a unit that is kept.
///
/// The pound per square inch is 6894.757293168 Pa (NIST SP 811, appendix B), the inch 25.4 mm by definition.
#[must_use]
pub fn conversion(unit: &str) -> Option<(&'static str, Scale)> {
    Some(match unit {
        "bar" => ("bar", Scale::NONE),
        "mbar" | "hPa" => ("bar", Scale::Over(1e3)),
        "Pa" => ("bar", Scale::Over(1e5)),
        "kPa" => ("bar", Scale::Over(100.0)),
        "MPa" => ("bar", Scale::Times(10.0)),
        "psi" => ("bar", Scale::Times(0.068_947_572_931_68)),
        "mm" => ("mm", Scale::NONE),
        "um" | "µm" | "μm" => ("mm", Scale::Over(1e3)),
        "cm" => ("mm", Scale::Times(10.0)),
        "m" => ("mm", Scale::Times(1e3)),
        "in" | "inch" => ("mm", Scale::Times(25.4)),
        _ => return time(unit).map(|scale| ("s", scale)),
    })
}

/// The unit of pressure or length that another word is but for small and capital letters; single letters have too many meanings.
#[must_use]
pub fn differs_in_case(unit: &str) -> Option<&'static str> {
    const UNITS: [&str; 10] = ["bar", "mbar", "hPa", "Pa", "kPa", "MPa", "psi", "mm", "um", "cm"];
    UNITS.into_iter().find(|known| known.eq_ignore_ascii_case(unit) && *known != unit)
}

/// How times of a unit become seconds.
#[must_use]
pub fn time(unit: &str) -> Option<Scale> {
    Some(match unit {
        "s" | "sec" | "second" | "seconds" => Scale::NONE,
        "ms" => Scale::Over(1e3),
        "us" | "µs" | "μs" => Scale::Over(1e6),
        "ns" => Scale::Over(1e9),
        "min" => Scale::Times(60.0),
        "h" => Scale::Times(3600.0),
        _ => return None,
    })
}

/// A calibration such as `mA@4..20=0..50mm`: the column's unit, the unit it gives, and the line between.
///
/// # Errors
/// What is wrong with it, in words.
pub fn calibration(text: &str) -> Result<(String, Scale), String> {
    let wrong = || format!("`{text}` is no calibration; write for example `mA@4..20=0..50mm`: 4 mA are 0 mm and 20 mA are 50 mm");
    let (_, ranges) = text.split_once('@').ok_or_else(wrong)?;
    let (from, to) = ranges.split_once('=').ok_or_else(wrong)?;
    let unit_at = to.rfind(|character: char| character.is_ascii_digit()).ok_or_else(wrong)? + 1;
    let (to, unit) = to.split_at(unit_at);
    let range = |text: &str| -> Result<[f64; 2], String> {
        let (low, high) = text.split_once("..").ok_or_else(wrong)?;
        let number = |text: &str| text.trim().parse::<f64>().ok().filter(|value| value.abs() < 1e12).ok_or_else(wrong);
        Ok([number(low)?, number(high)?])
    };
    let (from, to) = (range(from)?, range(to)?);
    if from[0] == from[1] || to[0] == to[1] || unit.trim().is_empty() {
        return Err(wrong());
    }
    // A calibration into kPa gives bar, as a column in kPa does.
    match conversion(unit.trim()) {
        Some((into, scale)) => Ok((into.to_owned(), Scale::Line { from, to: to.map(|value| scale.apply(value)) })),
        None => Ok((unit.trim().to_owned(), Scale::Line { from, to })),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_unit_in_other_letters_is_noticed() {
        assert_eq!(["Kpa", "KPA", "PSI", "Bar", "uM"].map(differs_in_case), ["kPa", "kPa", "psi", "bar", "um"].map(Some));
        assert_eq!(["kPa", "Pa", "mA", "V", "N", "rad", "m"].map(differs_in_case), [None; 7]);
    }

    #[test]
    fn units_of_the_field_become_ours() {
        for (unit, value, wanted, into) in [
            ("kPa", 250.0, 2.5, "bar"),
            ("MPa", 0.25, 2.5, "bar"),
            ("mbar", 2500.0, 2.5, "bar"),
            ("Pa", 250_000.0, 2.5, "bar"),
            ("bar", 2.5, 2.5, "bar"),
            ("um", 300.0, 0.3, "mm"),
            ("cm", 1.5, 15.0, "mm"),
            ("m", 0.002, 2.0, "mm"),
            ("in", 2.0, 50.8, "mm"),
            ("ms", 20.0, 0.02, "s"),
            ("us", 300.0, 0.0003, "s"),
            ("h", 0.5, 1800.0, "s"),
        ] {
            let (found, scale) = conversion(unit).expect(unit);
            assert_eq!((found, scale.apply(value)), (into, wanted), "{unit}");
        }
        // 36.259435 psi are 250 kPa to eight digits.
        let (_, psi) = conversion("psi").expect("psi");
        assert!((psi.apply(36.259_435) - 2.5).abs() < 1e-6);
        assert_eq!(conversion("V"), None);
    }

    #[test]
    fn a_calibration_is_a_line_through_two_points() {
        let (unit, scale) = calibration("mA@4..20=0..50mm").expect("a calibration");
        assert_eq!((unit.as_str(), scale.apply(4.0), scale.apply(12.0), scale.apply(20.0)), ("mm", 0.0, 25.0, 50.0));
        let (unit, scale) = calibration("V@0..10=-100..900kPa").expect("a calibration");
        assert_eq!((unit.as_str(), scale.apply(0.0), scale.apply(10.0)), ("bar", -1.0, 9.0));
        for wrong in ["V", "V@0..10", "V@0..0=1..2mm", "V@0..10=0..5", "V@0..nan=0..5mm", "V@a..b=0..5mm", "V@0..10=0..1e99mm"] {
            assert!(calibration(wrong).is_err(), "{wrong}");
        }
    }
}
