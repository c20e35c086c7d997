//! Rows of plain numbers, as nearly all rows are, taken from a text many at a time.
//!
//! A row that is anything else (quoted, blank, a comment, too short, wrong) is left where it stands: [`table`](crate::table) knows what it is.
//! Digits are converted eight at a time: the bytes of a word are added up in pairs, these in fours, these in one number.

use crate::number::{self, EXACT_TENS};

/// How the rows of a text are written.
pub(super) struct PlainRows {
    pub(super) separator: u8,
    pub(super) decimal_comma: bool,
    /// Whether the cells of a column are numbers that somebody wants.
    pub(super) wanted: Vec<bool>,
}

/// What was taken.
#[derive(Debug, Default, PartialEq)]
pub(super) struct Taken {
    pub(super) bytes: usize,
    pub(super) rows: usize,
    /// Cells with a decimal comma.
    pub(super) decimal_commas: usize,
}

/// A cell that was read: its number, where it ends, and whether it has a decimal comma.
type Cell = (f64, usize, bool);

impl PlainRows {
    /// Gives the rows at the beginning of a text to `take`, each with a number for every column (zero where nobody wants one), until one is no
    /// plain row, or does not end in this text, or is not taken.
    pub(super) fn take(&self, text: &[u8], mut take: impl FnMut(&[f64]) -> bool) -> Taken {
        let mut numbers = vec![0.0; self.wanted.len()];
        let mut taken = Taken::default();
        while let Some((end, decimal_commas)) = self.row(text, taken.bytes, &mut numbers) {
            if !take(&numbers) {
                break;
            }
            taken = Taken { bytes: end, rows: taken.rows + 1, decimal_commas: taken.decimal_commas + decimal_commas };
        }
        taken
    }

    /// The numbers of the row that begins here: where the next one begins, and how many decimal commas there are.
    #[inline]
    fn row(&self, text: &[u8], start: usize, numbers: &mut [f64]) -> Option<(usize, usize)> {
        // Neither blank nor a quotation mark nor a comment.
        text.get(start).filter(|&&first| first > b'#')?;
        let (mut at, mut decimal_commas) = (start, 0);
        let last = numbers.len() - 1;
        for (column, (number, &wanted)) in numbers.iter_mut().zip(&self.wanted).enumerate() {
            // What stands behind the cell must be what ends it.
            let ends = |byte: u8| if column < last { byte == self.separator } else { byte == b'\n' || byte == b'\r' };
            if wanted {
                let cell = plain(text, at, self.decimal_comma).filter(|&(_, end, _)| text.get(end).is_some_and(|&byte| ends(byte)));
                let (value, end, comma) = match cell {
                    Some(cell) => cell,
                    None => self.any(text, at)?,
                };
                (*number, at) = (value, end);
                decimal_commas += usize::from(comma);
            } else {
                at += self.passed_over(&text[at..])?;
            }
            if column < last {
                if text.get(at) != Some(&self.separator) {
                    return None;
                }
                at += 1;
            }
        }
        at += usize::from(text.get(at) == Some(&b'\r'));
        (text.get(at) == Some(&b'\n')).then_some((at + 1, decimal_commas))
    }

    /// A number that is written in another way.
    #[cold]
    #[inline(never)]
    fn any(&self, text: &[u8], start: usize) -> Option<Cell> {
        let length = text[start..].iter().position(|&byte| byte == self.separator || byte == b'\n' || byte == b'\r')?;
        let cell = &text[start..start + length];
        let value = number::parse(cell, self.decimal_comma)?;
        Some((value, start + length, self.decimal_comma && number::is_decimal_comma(cell)))
    }

    /// The length of a cell that nobody wants; none where a quotation mark may hide its end, or it is more than plain text.
    fn passed_over(&self, text: &[u8]) -> Option<usize> {
        let length = text.iter().position(|&byte| byte == self.separator || byte == b'\n' || byte == b'\r')?;
        text[..length].iter().all(|&byte| byte != b'"' && byte.is_ascii()).then_some(length)
    }
}

/// Fewer than eight digits, a point and fewer than eight digits more; rounded once, as both numbers of the quotient are exact.
#[inline]
fn plain(text: &[u8], start: usize, decimal_comma: bool) -> Option<Cell> {
    let negative = *text.get(start)? == b'-';
    let start = start + usize::from(negative);
    let (whole, count) = digits(text, start)?;
    let point = start + count;
    let comma = decimal_comma && text[point] == b',';
    let (mantissa, decimals, end) = if comma || text[point] == b'.' {
        let (fraction, decimals) = digits(text, point + 1)?;
        (whole * WHOLE_TENS[decimals] + fraction, decimals, point + 1 + decimals)
    } else {
        (whole, 0, point)
    };
    if count + decimals == 0 {
        return None;
    }
    #[expect(clippy::cast_precision_loss, reason = "fourteen digits are exact")]
    let value = mantissa as f64 / EXACT_TENS[decimals];
    Some((if negative { -value } else { value }, end, comma))
}

/// Powers of ten of up to seven digits.
const WHOLE_TENS: [u64; 8] = [1, 10, 100, 1_000, 10_000, 100_000, 1_000_000, 10_000_000];

/// The number that the digits from here on make, and how many they are; none where the next eight bytes are no word or all digits.
#[inline]
fn digits(text: &[u8], start: usize) -> Option<(u64, usize)> {
    let word: [u8; 8] = text.get(start..start + 8)?.try_into().ok()?;
    let values = u64::from_le_bytes(word) ^ 0x3030_3030_3030_3030;
    // The highest bit of each byte that is above nine; behind the first of them a carry may set others.
    let others = (values | values.wrapping_add(0x7676_7676_7676_7676)) & 0x8080_8080_8080_8080;
    if others == 0 {
        return None;
    }
    let bits = others.trailing_zeros() & !7;
    // The digits move to the end of the word, and zeros stand before them.
    let values = (values << (56 - bits)) << 8;
    let pairs = (values.wrapping_mul(10 << 8 | 1) >> 8) & 0x00ff_00ff_00ff_00ff;
    let fours = (pairs.wrapping_mul(100 << 16 | 1) >> 16) & 0x0000_ffff_0000_ffff;
    let number = fours.wrapping_mul(10_000 << 32 | 1) >> 32;
    Some((number, (bits / 8) as usize))
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn rows(text: &str, separator: u8, wanted: &[bool]) -> (Vec<Vec<f64>>, Taken) {
        let mut rows = Vec::new();
        let plain = PlainRows { separator, decimal_comma: separator != b',', wanted: wanted.to_vec() };
        let taken = plain.take(text.as_bytes(), |numbers| {
            rows.push(numbers.to_vec());
            true
        });
        (rows, taken)
    }

    proptest! {
        #[test]
        fn every_cell_gives_the_bits_that_the_standard_library_gives(
            cells in prop::collection::vec("-?[0-9]{0,9}([.][0-9]{0,9})?(e-?[0-9]{1,2})?", 1..5),
        ) {
            let text = format!("{}\n0\n", cells.join(";"));
            let wanted: Option<Vec<u64>> = cells.iter().map(|cell| cell.parse::<f64>().ok().map(f64::to_bits)).collect();
            for text in [text.clone(), text.replace('\n', "\r\n"), text.replace('.', ",")] {
                let found = rows(&text, b';', &vec![true; cells.len()]).0;
                let found = found.first().map(|row| row.iter().map(|number| number.to_bits()).collect());
                prop_assert_eq!(&found, &wanted, "{}", text);
            }
        }
    }

    #[test]
    fn rows_are_taken_up_to_the_first_that_is_not_plain() {
        let plain = "1.5,x y,-0.25\r\n20,,1e-3\n";
        let numbers = vec![vec![1.5, 0.0, -0.25], vec![20.0, 0.0, 1e-3]];
        let wanted = [true, false, true];
        for rest in [
            "",
            "1",
            "1,2",
            "1,2,3",
            "# 1,2,3\n",
            "\"1\",2,3\n",
            "1,\"2\",3\n",
            "1,µ,3\n",
            " 1,2,3\n",
            "1,2\n",
            "1,2,3,4\n",
            "\n",
            "1,2,x\n",
        ] {
            let taken = Taken { bytes: plain.len(), rows: 2, decimal_commas: 0 };
            assert_eq!(rows(&format!("{plain}{rest}"), b',', &wanted), (numbers.clone(), taken), "{rest:?}");
        }
        let commas = rows("1,5;2.5;3\n0,25;,5;5,\n1,2.3;1;1\n", b';', &[true; 3]);
        assert_eq!(commas.0, [[1.5, 2.5, 3.0], [0.25, 0.5, 5.0]]);
        assert_eq!((commas.1.rows, commas.1.decimal_commas), (2, 4));
    }
}
