//! Numbers in cells of text: what most loggers write in a few nanoseconds, everything else by the standard library. Both round correctly.

/// Powers of ten that `f64` holds exactly.
pub(super) const EXACT_TENS: [f64; 23] =
    [1e0, 1e1, 1e2, 1e3, 1e4, 1e5, 1e6, 1e7, 1e8, 1e9, 1e10, 1e11, 1e12, 1e13, 1e14, 1e15, 1e16, 1e17, 1e18, 1e19, 1e20, 1e21, 1e22];
/// Integers up to this are exact in `f64`.
const EXACT_INTEGER: u64 = 1 << 53;

/// The number in a cell without blanks around it, infinite and undefined ones included; with `decimal_comma` a comma stands for the point.
pub(super) fn parse(cell: &[u8], decimal_comma: bool) -> Option<f64> {
    if let Some(value) = plain(cell, decimal_comma) {
        return Some(value);
    }
    let text = std::str::from_utf8(cell).ok()?;
    if decimal_comma && is_decimal_comma(cell) { text.replace(',', ".").parse().ok() } else { text.parse().ok() }
}

/// Whether a cell is written with one comma and no point.
pub(super) fn is_decimal_comma(cell: &[u8]) -> bool {
    let commas = cell.iter().filter(|&&byte| byte == b',').count();
    commas == 1 && !cell.contains(&b'.')
}

/// Digits with a sign and a point: exact, and so rounded once, while the digits and the power of ten are exact themselves.
fn plain(cell: &[u8], decimal_comma: bool) -> Option<f64> {
    let (negative, digits) = match cell {
        [b'-', rest @ ..] => (true, rest),
        rest => (false, rest),
    };
    if digits.is_empty() || digits.len() > 18 {
        return None;
    }
    let mut mantissa = 0_u64;
    let mut point = None;
    for (index, &byte) in digits.iter().enumerate() {
        if byte.is_ascii_digit() {
            // Eighteen digits fit.
            mantissa = mantissa * 10 + u64::from(byte - b'0');
        } else if point.is_none() && (byte == b'.' || (decimal_comma && byte == b',')) {
            point = Some(index);
        } else {
            return None;
        }
    }
    let decimals = point.map_or(0, |point| digits.len() - 1 - point);
    if mantissa > EXACT_INTEGER || (point.is_some() && digits.len() == 1) {
        return None;
    }
    #[expect(clippy::cast_precision_loss, reason = "exact up to 2^53")]
    let value = mantissa as f64 / EXACT_TENS[decimals];
    Some(if negative { -value } else { value })
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn every_text_gives_the_bits_that_the_standard_library_gives(text in "[-+]?[0-9]{0,20}([.,][0-9]{0,20})?([eE][-+]?[0-9]{1,3})?") {
            let wanted = text.parse::<f64>().ok().map(f64::to_bits);
            prop_assert_eq!(parse(text.as_bytes(), false).map(f64::to_bits), wanted);
            let wanted = text.replace(',', ".").parse::<f64>().ok().map(f64::to_bits);
            prop_assert_eq!(parse(text.as_bytes(), true).map(f64::to_bits), wanted);
        }
    }

    #[test]
    fn odd_cells_are_told_from_numbers() {
        for cell in ["", "-", ".", ",", "1.2.3", "1,2,3", "0x10", "1 2", "--1", "1,2.3"] {
            assert_eq!(parse(cell.as_bytes(), true), None, "{cell}");
        }
        assert_eq!(parse(b"-0", false).map(f64::to_bits), Some((-0.0_f64).to_bits()));
    }
}
