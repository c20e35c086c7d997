//! Rows of plain numbers, as nearly all rows are, taken from a text many at a time.
//!
//! A row that is anything else (quoted, blank, a comment, too short, wrong) is left where it stands: [`table`](crate::table) knows what it is.
//! First the ends of all cells are marked, 64 bytes at a time. So no cell waits for the one before it, and each column is converted in one go.
//! Digits are converted eight at a time: the bytes of a word are added up in pairs, these in fours, these in one number.

use crate::number::{self, EXACT_TENS};
use crate::parts::{Wanted, is_readable};
use crate::scale::Scale;

/// Cells that are marked before they are converted, at most; text and marks stay in the nearest caches.
const MARKS: usize = 2048;

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

/// The rows whose ends are marked: where each cell begins, and behind the last one where the next row does.
struct Marked<'a> {
    text: &'a [u8],
    begins: &'a [usize],
    columns: usize,
    /// Whether a carriage return stands at the end of the first row.
    returns: bool,
}

impl Marked<'_> {
    /// Where a cell begins and ends.
    fn cell(&self, row: usize, column: usize) -> (usize, usize) {
        let index = row * self.columns + column;
        (self.begins[index], self.begins[index + 1] - 1 - self.returns(column))
    }

    /// Bytes between a cell of this column and the byte that ends it: the lines of Windows end in two.
    fn returns(&self, column: usize) -> usize {
        usize::from(self.returns && column + 1 == self.columns)
    }
}

impl PlainRows {
    /// Adds the numbers of the rows at the beginning of a text to `values`, those of each `wanted` column in its unit, until a row is no plain one,
    /// or does not end in this text, or has a value that no sensor gives, or there are `most` rows.
    pub(super) fn take(&self, text: &[u8], most: usize, wanted: &[Wanted], values: &mut [Vec<f64>]) -> Taken {
        let mut begins = vec![0; MARKS.max(self.wanted.len()) + 64 + 1];
        let mut taken = Taken::default();
        loop {
            let marked = self.mark(&text[taken.bytes..], &mut begins);
            let rows = self.whole_rows(&marked, most - taken.rows);
            if rows == 0 {
                return taken;
            }
            let (good, decimal_commas) = self.convert(&marked, rows, wanted, values);
            taken.bytes += marked.begins[good * marked.columns];
            taken.rows += good;
            taken.decimal_commas += decimal_commas;
            if good < rows {
                return taken;
            }
        }
    }

    /// Marks the ends of cells from the beginning of a text on.
    fn mark<'a>(&self, text: &'a [u8], begins: &'a mut [usize]) -> Marked<'a> {
        begins[0] = 0;
        let mut count = 1;
        let (blocks, rest) = text.as_chunks::<64>();
        for (index, block) in blocks.iter().enumerate() {
            if count + 64 > begins.len() {
                break;
            }
            let mut ends = self.ends(block);
            while ends != 0 {
                begins[count] = index * 64 + ends.trailing_zeros() as usize + 1;
                count += 1;
                ends &= ends - 1;
            }
        }
        if count + 64 <= begins.len() {
            for (place, _) in rest.iter().enumerate().filter(|&(_, &byte)| byte == self.separator || byte == b'\n') {
                begins[count] = text.len() - rest.len() + place + 1;
                count += 1;
            }
        }
        let (begins, columns) = (&begins[..count], self.wanted.len());
        let returns = begins.get(columns).is_some_and(|&next| next > 1 && text[next - 2] == b'\r');
        Marked { text, begins, columns, returns }
    }

    /// A bit for each byte that ends a cell.
    #[inline]
    fn ends(&self, block: &[u8; 64]) -> u64 {
        const EACH: u64 = 0x0101_0101_0101_0101;
        const LOW: u64 = 0x7f * EACH;
        let separators = u64::from(self.separator) * EACH;
        let lines = u64::from(b'\n') * EACH;
        let (words, _) = block.as_chunks::<8>();
        words.iter().rev().fold(0, |ends, word| {
            let word = u64::from_le_bytes(*word);
            // The highest bit of each byte that is another one.
            let others = |bytes: u64| (((word ^ bytes) & LOW) + LOW) | (word ^ bytes);
            let found = !(others(separators) & others(lines)) & !LOW;
            // The multiplication brings the eight bits together in the highest byte.
            ends << 8 | (found >> 7).wrapping_mul(0x0102_0408_1020_4080) >> 56
        })
    }

    /// How many rows have all their cells and nothing that asks for more than conversion.
    fn whole_rows(&self, marked: &Marked<'_>, most: usize) -> usize {
        let Marked { text, begins, columns, returns } = marked;
        let whole = ((begins.len() - 1) / columns).min(most);
        let is_plain = |row: usize| {
            let begins = &begins[row * columns..][..=*columns];
            let (last, separated) = begins[1..].split_last().unwrap_or((&0, &[]));
            // Neither blank nor a quotation mark nor a comment.
            text[begins[0]] > b'#'
                && text[last - 1] == b'\n'
                && (text[last - 2] == b'\r') == *returns
                && separated.iter().all(|begin| text[begin - 1] == self.separator)
        };
        let rows = (0..whole).find(|&row| !is_plain(row)).unwrap_or(whole);
        // Behind a quotation mark an end may be none.
        let hides = |&byte: &u8| byte == b'"' || byte == b'\r' || !byte.is_ascii();
        let unwanted = self.wanted.iter().enumerate().filter(|(_, wanted)| !**wanted);
        unwanted.fold(rows, |rows, (column, _)| {
            let may_hide = |&row: &usize| {
                let (start, end) = marked.cell(row, column);
                text[start..end].iter().any(hides)
            };
            (0..rows).find(may_hide).unwrap_or(rows)
        })
    }

    /// Converts rows column by column: how many of them were all numbers, and how many decimal commas these have.
    fn convert(&self, marked: &Marked<'_>, rows: usize, wanted: &[Wanted], values: &mut [Vec<f64>]) -> (usize, usize) {
        let before: Vec<usize> = values.iter().map(Vec::len).collect();
        let mut good = rows;
        for (wanted, values) in wanted.iter().zip(values.iter_mut()) {
            let begin = values.len();
            values.resize(begin + good, 0.0);
            let values = &mut values[begin..];
            let returns = marked.returns(wanted.index);
            let cells = marked.begins[wanted.index..].windows(2).step_by(marked.columns);
            for (value, cell) in values.iter_mut().zip(cells) {
                *value = short(marked.text, cell[0], cell[1] - 1 - returns, self.decimal_comma);
            }
            // All of them at once, several at a time.
            let mut all_short = true;
            for value in values.iter_mut() {
                *value /= SHORT_UNIT;
                all_short &= !value.is_nan();
            }
            let mut row = if all_short { good } else { 0 };
            while let Some(more) = values[row..].iter().position(|value| value.is_nan()) {
                row += more;
                let (start, end) = marked.cell(row, wanted.index);
                let Some(number) = number::parse(&marked.text[start..end], self.decimal_comma) else { break };
                values[row] = number;
                row += 1;
            }
            if all_short && wanted.scale == Scale::NONE {
                continue;
            }
            if wanted.scale != Scale::NONE {
                values.iter_mut().for_each(|value| *value = wanted.scale.apply(*value));
            }
            good = values.iter().position(|value| !is_readable(*value)).unwrap_or(good);
        }
        values.iter_mut().zip(before).for_each(|(values, before)| values.truncate(before + good));
        let is_comma = |row: usize, column: usize| {
            let (start, end) = marked.cell(row, column);
            number::is_decimal_comma(&marked.text[start..end])
        };
        let commas = |wanted: &Wanted| (0..good).filter(|&row| is_comma(row, wanted.index)).count();
        (good, if self.decimal_comma { wanted.iter().map(commas).sum() } else { 0 })
    }
}

/// Seven decimals are as many as a short number has.
const SHORT_UNIT: f64 = 1e7;

/// Eight characters at most behind the sign: digits and one point; what is anything else is no number here. It comes in units of the seventh
/// decimal: fifteen digits, which are exact, so that their quotient is rounded once.
#[inline]
fn short(text: &[u8], start: usize, end: usize, decimal_comma: bool) -> f64 {
    let negative = text[start] == b'-';
    let length = end.wrapping_sub(start + usize::from(negative));
    if length.wrapping_sub(1) >= 8 || end < 8 {
        return f64::NAN;
    }
    // The digits stand at the end of the word; zeros take the place of what is before them.
    let before = 64 - 8 * length as u32;
    let values = ((word(text, end) ^ ZEROS) >> before) << before;
    // The highest bit of each byte that is no digit.
    let others = (((values & !HIGHEST) + 0x7676_7676_7676_7676) | values) & HIGHEST;
    let (digits, unit) = if others == 0 {
        (values, SHORT_UNIT)
    } else {
        let place = others.trailing_zeros() & 0x38;
        let point = (values >> place) as u8 ^ b'0';
        let is_point = point == b'.' || (point == b',' && decimal_comma);
        if others & (others - 1) != 0 || length == 1 || !is_point {
            return f64::NAN;
        }
        // The digits before the point move up to those behind it.
        let whole = values & ((1 << place) - 1);
        let fraction = values >> place >> 8 << place << 8;
        (whole << 8 | fraction, EXACT_TENS[place as usize / 8])
    };
    let value = f64::from(number_of(digits)) * unit;
    f64::from_bits(value.to_bits() | u64::from(negative) << 63)
}

const ZEROS: u64 = 0x3030_3030_3030_3030;
const HIGHEST: u64 = 0x8080_8080_8080_8080;

/// The eight bytes before this place.
#[inline]
fn word(text: &[u8], end: usize) -> u64 {
    text[..end].last_chunk().map_or(0, |bytes| u64::from_le_bytes(*bytes))
}

/// The number that eight digits make, the first of them in the lowest byte.
#[inline]
fn number_of(digits: u64) -> u32 {
    let pairs = (digits.wrapping_mul(10 << 8 | 1) >> 8) & 0x00ff_00ff_00ff_00ff;
    let fours = (pairs.wrapping_mul(100 << 16 | 1) >> 16) & 0x0000_ffff_0000_ffff;
    (fours.wrapping_mul(10_000 << 32 | 1) >> 32) as u32
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn rows(text: &str, separator: u8, wanted: &[bool]) -> (Vec<Vec<f64>>, Taken) {
        let plain = PlainRows { separator, decimal_comma: separator != b',', wanted: wanted.to_vec() };
        let wanted: Vec<Wanted> =
            (0..wanted.len()).filter(|&index| wanted[index]).map(|index| Wanted { index, scale: Scale::NONE }).collect();
        let mut values = vec![Vec::new(); wanted.len()];
        let taken = plain.take(text.as_bytes(), usize::MAX, &wanted, &mut values);
        ((0..taken.rows).map(|row| values.iter().map(|values| values[row]).collect()).collect(), taken)
    }

    proptest! {
        #[test]
        fn every_cell_gives_the_bits_that_the_standard_library_gives(
            cells in prop::collection::vec("-?[0-9]{0,9}([.][0-9]{0,9})?(e-?[0-9]{1,2})?", 1..5),
        ) {
            let text = format!("{}\n0\n", cells.join(";"));
            let wanted: Option<Vec<u64>> = cells.iter().map(|cell| cell.parse().ok().filter(|value| is_readable(*value)).map(f64::to_bits)).collect();
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
        let numbers = vec![vec![1.5, -0.25], vec![20.0, 1e-3]];
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
