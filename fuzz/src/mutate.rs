//! Changes to valid files.

use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Texts that hurt where a number or a name stands.
const WORDS: [&str; 40] = [
    "nan",
    "NaN",
    "inf",
    "-inf",
    "1e999",
    "1e308",
    "-1e308",
    "1e160",
    "1e-320",
    "5e-324",
    "1e31",
    "-0",
    "0",
    "1",
    "-1",
    "18446744073709551615",
    "18446744073709551616",
    "9223372036854775807",
    "4294967296",
    "2147483648",
    "65536",
    "1e10",
    "0.1",
    "",
    " ",
    ",",
    ";",
    "\t",
    "\n",
    "\"",
    "#",
    "\u{1b}[2J",
    "\u{202e}",
    "\u{0}",
    "time_s",
    "[]",
    "{}",
    "null",
    "true",
    "[[[[[[[[",
];

/// Integers that hurt where a length stands.
const LENGTHS: [u64; 12] =
    [0, 1, 7, 8, 255, 65_535, 65_536, 0x7fff_ffff, 0x8000_0000, 0xffff_ffff, 0x7fff_ffff_ffff_ffff, 0xffff_ffff_ffff_ffff];

/// A changed file is no longer than this.
const LONGEST: usize = 4 << 20;

/// The changed file number `number` of a seed; `files` are valid ones of one kind.
#[must_use]
pub fn mutated(files: &[Vec<u8>], seed: u64, number: u64) -> Vec<u8> {
    let mut random = ChaCha8Rng::seed_from_u64(seed ^ number.wrapping_mul(0x9e37_79b9_7f4a_7c15));
    let mut bytes = files[random.random_range(0..files.len())].clone();
    // One change finds what many would hide behind the first refusal.
    let changes = [1, 1, 1, 2, 3, 8][random.random_range(0..6)];
    for _ in 0..changes {
        change(&mut bytes, files, &mut random);
        bytes.truncate(LONGEST);
    }
    bytes
}

/// A place in a file; every second one near its beginning, where lengths and names stand.
fn place(length: usize, random: &mut impl Rng) -> usize {
    let most = if random.random_range(0..2) == 0 { length.min(256) } else { length };
    random.random_range(0..most.max(1)).min(length)
}

/// One change.
fn change(bytes: &mut Vec<u8>, files: &[Vec<u8>], random: &mut impl Rng) {
    let at = place(bytes.len(), random);
    let span = |random: &mut _, length: usize| -> usize { RngExt::random_range(random, 0..=length.min(64)) };
    match random.random_range(0..12_u32) {
        0 if at < bytes.len() => bytes[at] ^= 1 << random.random_range(0..8_u32),
        1 if at < bytes.len() => bytes[at] = random.random(),
        2 => bytes.truncate(at),
        3 => {
            let end = at + span(random, bytes.len() - at);
            bytes.drain(at..end);
        }
        4 => {
            let end = at + span(random, bytes.len() - at);
            let piece = bytes[at..end].to_vec();
            let times = [1, 2, 100, 5000][random.random_range(0..4)];
            bytes.splice(at..at, piece.repeat(times.min(LONGEST / piece.len().max(1))));
        }
        5 | 6 => number(bytes, at, random),
        7 => {
            let word = WORDS[random.random_range(0..WORDS.len())];
            bytes.splice(at..at, word.bytes());
        }
        8 => {
            let value = LENGTHS[random.random_range(0..LENGTHS.len())];
            let width = [1, 2, 4, 8][random.random_range(0..4)];
            let value = if random.random_range(0..4) == 0 { value.to_be_bytes() } else { value.to_le_bytes() };
            for (byte, new) in bytes[at..].iter_mut().zip(value).take(width) {
                *byte = new;
            }
        }
        9 => {
            let other = &files[random.random_range(0..files.len())];
            let from = place(other.len(), random);
            bytes.truncate(at);
            bytes.extend_from_slice(&other[from..]);
        }
        10 => {
            let other = place(bytes.len(), random);
            let length = span(random, bytes.len() - at.max(other));
            for offset in 0..length {
                bytes.swap(at + offset, other + offset);
            }
        }
        _ => line(bytes, at, random),
    }
}

/// Puts a hurtful word in the place of the number, or the word, at a place.
fn number(bytes: &mut Vec<u8>, at: usize, random: &mut impl Rng) {
    let is_part = |byte: u8| byte.is_ascii_alphanumeric() || matches!(byte, b'.' | b'-' | b'+' | b'_');
    let Some(start) = (at..bytes.len()).find(|&index| is_part(bytes[index])) else { return };
    let end = (start..bytes.len()).find(|&index| !is_part(bytes[index])).unwrap_or(bytes.len());
    let word = WORDS[random.random_range(0..WORDS.len())];
    bytes.splice(start..end, word.bytes());
}

/// Removes or repeats the line at a place.
fn line(bytes: &mut Vec<u8>, at: usize, random: &mut impl Rng) {
    let start = bytes[..at].iter().rposition(|&byte| byte == b'\n').map_or(0, |end| end + 1);
    let end = bytes[at..].iter().position(|&byte| byte == b'\n').map_or(bytes.len(), |end| at + end + 1);
    if random.random_range(0..2) == 0 {
        bytes.drain(start..end);
    } else {
        let line = bytes[start..end].to_vec();
        bytes.splice(start..start, line.repeat([1, 3, 1000][random.random_range(0..3)].min(LONGEST / line.len().max(1))));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_input_can_be_made_again_and_inputs_differ() {
        let files = [b"time_s,pressure_bar,displacement_mm\n0,1,2\n1,2,3\n".to_vec(), vec![0; 100]];
        let made: Vec<Vec<u8>> = (0..500).map(|number| mutated(&files, 7, number)).collect();
        assert!((0..500).all(|number| made[number as usize] == mutated(&files, 7, number)));
        let mut different = made.clone();
        different.sort();
        different.dedup();
        assert!(different.len() > 300, "{}", different.len());
    }
}
