//! Escaping and number formats of the report: text that came from a file is shown, never interpreted.

/// `text` as the content of an HTML or SVG element or of a quoted attribute.
#[must_use]
pub fn escape(text: &str) -> String {
    let mut escaped = String::with_capacity(text.len());
    for character in text.chars() {
        match character {
            '&' => escaped.push_str("&amp;"),
            '<' => escaped.push_str("&lt;"),
            '>' => escaped.push_str("&gt;"),
            '"' => escaped.push_str("&quot;"),
            '\'' => escaped.push_str("&#39;"),
            // XML knows no control characters but these; a file name may hold any.
            '\t' | '\n' | '\r' => escaped.push(character),
            control if control.is_control() => escaped.push('\u{fffd}'),
            plain => escaped.push(plain),
        }
    }
    escaped
}

/// A number as read by people: so many significant digits, powers of ten only where zeros would hide the number, a real minus sign.
#[must_use]
pub fn number(value: f64, digits: usize) -> String {
    if !value.is_finite() {
        return "\u{2013}".to_owned();
    }
    if value == 0.0 {
        return "0".to_owned();
    }
    let sign = if value < 0.0 { "\u{2212}" } else { "" };
    let plain = plain_number(value.abs(), digits);
    match plain.split_once('e') {
        Some((mantissa, exponent)) => format!("{sign}{mantissa}\u{202f}\u{b7}\u{202f}10{}", superscript(exponent.parse().unwrap_or(0))),
        None => format!("{sign}{plain}"),
    }
}

/// A number as read on a terminal: as [`number`], in ASCII, powers of ten as in `1.5e-7`.
#[must_use]
pub fn plain_number(value: f64, digits: usize) -> String {
    let scientific = format!("{value:.*e}", digits.max(1) - 1);
    let exponent: i32 = scientific.split_once('e').and_then(|(_, exponent)| exponent.parse().ok()).unwrap_or(0);
    if (-4..6).contains(&exponent) {
        let decimals = usize::try_from(i32::try_from(digits).unwrap_or(3) - 1 - exponent).unwrap_or(0);
        format!("{value:.decimals$}")
    } else {
        scientific
    }
}

/// A share in per cent.
#[must_use]
pub fn percent(share: Option<f64>) -> String {
    share.map_or_else(|| "\u{2013}".to_owned(), |share| format!("{}\u{202f}%", number(100.0 * share, 2)))
}

/// A whole number with thin spaces between thousands.
#[must_use]
pub fn count(value: usize) -> String {
    let digits = value.to_string();
    let mut grouped = String::new();
    for (index, digit) in digits.chars().enumerate() {
        if index > 0 && (digits.len() - index).is_multiple_of(3) {
            grouped.push('\u{202f}');
        }
        grouped.push(digit);
    }
    grouped
}

/// A whole number as an exponent.
#[must_use]
pub fn superscript(value: i32) -> String {
    value
        .to_string()
        .chars()
        .map(|digit| match digit {
            '-' => '\u{207b}',
            '1' => '\u{b9}',
            '2' => '\u{b2}',
            '3' => '\u{b3}',
            '0' => '\u{2070}',
            // The superscripts four to nine lie in order.
            other => char::from_u32(0x2070 + other.to_digit(10).unwrap_or(0)).unwrap_or(other),
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nothing_from_a_file_name_reaches_the_page_as_markup() {
        assert_eq!(
            escape("<img src=x onerror=\"a('b')\">&\u{1}\u{8}"),
            "&lt;img src=x onerror=&quot;a(&#39;b&#39;)&quot;&gt;&amp;\u{fffd}\u{fffd}"
        );
    }

    #[test]
    fn numbers_read_well() {
        let cases = [
            (0.0, "0"),
            (0.00123456, "0.00123"),
            (-1.5, "\u{2212}1.50"),
            (12345.6, "12346"),
            (0.9999, "1.00"),
            (1.0e-13, "1.00\u{202f}\u{b7}\u{202f}10\u{207b}\u{b9}\u{b3}"),
            (f64::NAN, "\u{2013}"),
            (f64::INFINITY, "\u{2013}"),
        ];
        for (value, expected) in cases {
            assert_eq!(number(value, 3), expected);
        }
        assert_eq!([-0.25, 2.0e-7, 0.0].map(|value| plain_number(value, 3)), ["-0.250", "2.00e-7", "0.00"]);
        assert_eq!(count(1_234_567), "1\u{202f}234\u{202f}567");
        assert_eq!(count(12), "12");
        assert_eq!(superscript(-4567890), "\u{207b}\u{2074}\u{2075}\u{2076}\u{2077}\u{2078}\u{2079}\u{2070}");
        assert_eq!(percent(Some(0.0123)), "1.2\u{202f}%");
    }
}
