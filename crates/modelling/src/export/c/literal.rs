//! Numbers and texts as C writes them: every number exactly, every text harmless.

use std::fmt::{Display, Write};

/// Most columns of a line of numbers.
const COLUMNS: usize = 120;

/// An `f32` to the bit, as a hexadecimal constant.
pub fn float(value: f32) -> String {
    let sign = if value.is_sign_negative() { "-" } else { "" };
    let magnitude = value.abs();
    if magnitude == 0.0 {
        return format!("{sign}0.0f");
    }
    let (exponent, mantissa) = (magnitude.to_bits() >> 23, magnitude.to_bits() & 0x007f_ffff);
    // 23 bits are five digits and three quarters: one more bit makes six.
    let digits = format!("{:06x}", mantissa << 1);
    let digits = digits.trim_end_matches('0');
    let point = if digits.is_empty() { "" } else { "." };
    let (lead, power) = if exponent == 0 { (0, -126) } else { (1, i64::from(exponent) - 127) };
    format!("{sign}0x{lead}{point}{digits}p{power:+}f")
}

/// The end of a definition: an `f32` to the bit, and its value in decimals where that is easier to read.
pub fn constant(value: f32) -> String {
    if value == 0.0 { format!("{};", float(value)) } else { format!("{}; /* {value:?} */", float(value)) }
}

/// An `f32` as an operand: a negative one in parentheses.
pub fn operand(value: f32) -> String {
    if value.is_sign_negative() { format!("({})", float(value)) } else { float(value) }
}

/// The shortest decimal that a C compiler reads as this `f32`, for headers: C++ before 2017 has no hexadecimal constants.
pub fn decimal(value: f32) -> String {
    if value.is_sign_negative() { format!("({value:?}f)") } else { format!("{value:?}f") }
}

/// An initialiser of numbers, each on a line of its own with its value in decimals.
pub fn floats(values: &[f32]) -> String {
    let mut text = String::new();
    for value in values {
        let _ = writeln!(text, "    {}, /* {value:?} */", float(*value));
    }
    text
}

/// An initialiser of numbers without their decimals, several to a line.
pub fn dense_floats(values: &[f32]) -> String {
    wrapped(values.iter().map(|value| float(*value)))
}

/// An `i32`; the smallest has no constant of its own in C.
pub fn integer(value: i32) -> String {
    if value == i32::MIN { "(-2147483647 - 1)".to_owned() } else { value.to_string() }
}

/// Items with commas between them, in lines of at most [`COLUMNS`].
pub fn wrapped(items: impl IntoIterator<Item = impl Display>) -> String {
    let (mut text, mut line) = (String::new(), String::new());
    for item in items {
        let item = format!("{item},");
        if 4 + line.len() + item.len() > COLUMNS {
            let _ = writeln!(text, "   {line}");
            line.clear();
        }
        line.push(' ');
        line.push_str(&item);
    }
    if !line.is_empty() {
        let _ = writeln!(text, "   {line}");
    }
    text
}

/// A text for a comment or a string constant: ASCII only, and nothing that ends either or begins something else.
pub fn plain(text: &str) -> String {
    let mut result = String::new();
    for letter in text.chars() {
        match letter {
            'µ' | 'μ' => result.push('u'),
            '°' => result.push_str("deg"),
            '²' => result.push('2'),
            '³' => result.push('3'),
            '·' => result.push('.'),
            '"' => result.push('\''),
            // No end of a comment, no escape, no trigraph.
            '*' | '\\' | '?' => result.push('_'),
            ' '..='~' => result.push(letter),
            _ => result.push('_'),
        }
    }
    result
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// What a C compiler reads.
    fn read(text: &str) -> f64 {
        let (negative, text) = text.strip_prefix('-').map_or((false, text), |rest| (true, rest));
        let text = text.strip_suffix('f').unwrap();
        let magnitude = match text.strip_prefix("0x") {
            None => text.parse().unwrap(),
            Some(text) => {
                let (digits, power) = text.split_once('p').unwrap();
                let (whole, fraction) = digits.split_once('.').unwrap_or((digits, ""));
                let number = i64::from_str_radix(&format!("{whole}{fraction}"), 16).unwrap();
                number as f64 * 2f64.powi(power.parse::<i32>().unwrap() - 4 * i32::try_from(fraction.len()).unwrap())
            }
        };
        if negative { -magnitude } else { magnitude }
    }

    #[test]
    fn constants_look_as_expected() {
        for (value, text) in [
            (0.0, "0.0f"),
            (-0.0, "-0.0f"),
            (1.0, "0x1p+0f"),
            (-2.5, "-0x1.4p+1f"),
            (0.1, "0x1.99999ap-4f"),
            (f32::MAX, "0x1.fffffep+127f"),
            (f32::MIN_POSITIVE, "0x1p-126f"),
            (1e-45, "0x0.000002p-126f"),
        ] {
            assert_eq!(float(value), text);
        }
        assert_eq!((decimal(0.02), decimal(-1e-7), decimal(3.0)), ("0.02f".into(), "(-1e-7f)".into(), "3.0f".into()));
        assert_eq!((integer(i32::MIN), integer(-7)), ("(-2147483647 - 1)".into(), "-7".into()));
    }

    #[test]
    fn texts_cannot_leave_their_comment_or_string() {
        assert_eq!(plain("a */ int b; /* \"\\ ??/\n\u{202e}"), "a _/ int b; /_ '_ __/__");
        assert_eq!(plain("µm, °C, mm²"), "um, degC, mm2");
    }

    #[test]
    fn long_lines_wrap() {
        let text = wrapped(0..200);
        assert!(text.lines().all(|line| line.len() <= COLUMNS && line.starts_with("    ") && line.ends_with(',')));
        let numbers: Vec<i32> = text.split(',').filter_map(|number| number.trim().parse().ok()).collect();
        assert_eq!(numbers, Vec::from_iter(0..200));
    }

    proptest! {
        #[test]
        fn every_finite_number_is_read_back_to_the_bit(bits: u32) {
            let value = f32::from_bits(bits);
            prop_assume!(value.is_finite());
            let back = read(&float(value));
            prop_assert_eq!(back.to_bits(), f64::from(value).to_bits(), "{} became {}", value, float(value));
        }
    }
}
