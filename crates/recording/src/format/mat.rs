//! MAT files of version 5, as MATLAB writes them with `-v7` or `-v6` and scipy with `savemat`. Format: MathWorks, "MAT-File Format",
//! "MAT-File Level 5". Read are full numeric arrays of two dimensions, and those in structures of one element, whose names become
//! `structure.field`.

use std::io::Read;

use flate2::read::ZlibDecoder;

use crate::arrays::Arrays;
use crate::parts::MOST_VALUES;
use crate::{Note, Subject};

/// Data types of elements.
const INT8: u32 = 1;
const INT32: u32 = 5;
const UINT16: u32 = 4;
const UINT32: u32 = 6;
const DOUBLE: u32 = 9;
const MATRIX: u32 = 14;
const COMPRESSED: u32 = 15;
/// Classes of arrays.
const STRUCTURE: u32 = 2;
const CHARACTERS: u32 = 4;
const DOUBLES: u32 = 6;
const NEWEST_INTEGER: u32 = 15;
/// An array of complex numbers.
const COMPLEX: u32 = 0x0800;
/// Structures within structures.
const DEEPEST: usize = 4;
/// More arrays than this are no recording.
const MOST_ARRAYS: usize = 4096;
/// Unpacked bytes of all arrays together.
const MOST_BYTES: u64 = 8 * MOST_VALUES as u64;

/// A reader of elements.
struct Elements<'a> {
    bytes: &'a [u8],
    big_endian: bool,
}

/// One element: its type and its bytes.
struct Element<'a> {
    kind: u32,
    data: &'a [u8],
}

fn damaged() -> String {
    "is a damaged MAT file: it ends within an element; save it again".to_owned()
}

impl<'a> Elements<'a> {
    fn word(&self, bytes: &[u8]) -> u32 {
        let word = [bytes[0], bytes[1], bytes[2], bytes[3]];
        if self.big_endian { u32::from_be_bytes(word) } else { u32::from_le_bytes(word) }
    }

    /// The next element; nothing at the end.
    fn next(&mut self) -> Result<Option<Element<'a>>, String> {
        if self.bytes.is_empty() {
            return Ok(None);
        }
        let (tag, rest) = self.bytes.split_at_checked(8).ok_or_else(damaged)?;
        let kind = self.word(tag);
        // A short element has its length in the upper half of the first word and its data in the second.
        if kind >> 16 != 0 {
            let length = (kind >> 16) as usize;
            let data = tag[4..].get(..length).ok_or_else(damaged)?;
            self.bytes = rest;
            return Ok(Some(Element { kind: kind & 0xffff, data }));
        }
        let length = self.word(&tag[4..]) as usize;
        let data = rest.get(..length).ok_or_else(damaged)?;
        // Elements end on a multiple of eight bytes, compressed ones where they end.
        let padded = if kind == COMPRESSED { length } else { length.next_multiple_of(8) };
        self.bytes = rest.get(padded..).unwrap_or_default();
        Ok(Some(Element { kind, data }))
    }

    fn needed(&mut self) -> Result<Element<'a>, String> {
        self.next()?.ok_or_else(damaged)
    }
}

impl Element<'_> {
    /// Number of elements and the value of each.
    fn values(&self, big_endian: bool) -> Option<Vec<f64>> {
        let (bytes, kind) = match self.kind {
            1 => (1, 'i'),
            2 => (1, 'u'),
            3 => (2, 'i'),
            4 => (2, 'u'),
            5 => (4, 'i'),
            6 => (4, 'u'),
            7 => (4, 'f'),
            9 => (8, 'f'),
            12 => (8, 'i'),
            13 => (8, 'u'),
            _ => return None,
        };
        let value = |piece: &[u8]| {
            let mut little = [0; 8];
            for (index, &byte) in piece.iter().enumerate() {
                little[if big_endian { piece.len() - 1 - index } else { index }] = byte;
            }
            let unsigned = u64::from_le_bytes(little);
            let shift = 64 - 8 * piece.len() as u32;
            match (kind, bytes) {
                ('f', 4) => f64::from(f32::from_le_bytes([little[0], little[1], little[2], little[3]])),
                ('f', _) => f64::from_le_bytes(little),
                ('i', _) => ((unsigned << shift).cast_signed() >> shift) as f64,
                _ => unsigned as f64,
            }
        };
        Some(self.data.chunks_exact(bytes).map(value).collect())
    }

    fn text(&self) -> String {
        self.data.iter().take_while(|&&byte| byte != 0).map(|&byte| char::from(byte)).collect()
    }
}

/// What is gathered while reading.
struct Gathered {
    arrays: Arrays,
    passed_over: Vec<String>,
    values: usize,
    /// Bytes that may still be unpacked.
    unpack: u64,
}

/// Reads all numeric arrays.
pub(super) fn read(bytes: &[u8]) -> Result<Arrays, String> {
    let (head, body) = bytes.split_at_checked(128).ok_or_else(damaged)?;
    let big_endian = match &head[126..] {
        b"IM" => false,
        b"MI" => true,
        _ => return Err("is no MAT file of version 5: its header names no order of bytes".to_owned()),
    };
    let mut gathered = Gathered { arrays: Arrays::default(), passed_over: Vec::new(), values: 0, unpack: MOST_BYTES };
    let mut elements = Elements { bytes: body, big_endian };
    while let Some(element) = elements.next()? {
        match element.kind {
            MATRIX => array(&mut Elements { bytes: element.data, big_endian }, None, 0, &mut gathered)?,
            COMPRESSED => {
                let mut unpacked = Vec::new();
                let read = ZlibDecoder::new(element.data).take(gathered.unpack + 1).read_to_end(&mut unpacked);
                read.map_err(|error| format!("is a damaged MAT file ({error}); save it again"))?;
                gathered.unpack = gathered
                    .unpack
                    .checked_sub(unpacked.len() as u64)
                    .ok_or("unfolds to more than 50 million numbers; split the recording")?;
                let inner = Elements { bytes: &unpacked, big_endian }.needed()?;
                if inner.kind == MATRIX {
                    array(&mut Elements { bytes: inner.data, big_endian }, None, 0, &mut gathered)?;
                }
            }
            _ => {}
        }
    }
    let Gathered { mut arrays, mut passed_over, .. } = gathered;
    passed_over.retain(|name| name != "provenance");
    if !passed_over.is_empty() {
        let names = passed_over.iter().take(10).cloned().collect::<Vec<_>>().join(", ");
        arrays.notes.push(Note::new(Subject::Layout, format!("Variables that are no lists of numbers were passed over: {names}.")));
    }
    Ok(arrays)
}

/// Reads the parts of one array; within a structure its name is `called`.
fn array(parts: &mut Elements<'_>, called: Option<&str>, depth: usize, gathered: &mut Gathered) -> Result<(), String> {
    // An empty element stands for an empty array.
    let Some(flags) = parts.next()? else { return Ok(()) };
    let flags = if flags.data.len() >= 8 { parts.word(flags.data) } else { return Err(damaged()) };
    let class = flags & 0xff;
    let dimensions = parts.needed()?;
    let lengths: Vec<usize> = dimensions.data.chunks_exact(4).map(|word| parts.word(word) as usize).collect();
    let own_name = parts.needed()?.text();
    let name = called.map_or(own_name, str::to_owned);
    let count = lengths.iter().try_fold(1_usize, |product, &length| product.checked_mul(length)).ok_or_else(damaged)?;
    if class == STRUCTURE && count == 1 && depth < DEEPEST {
        return structure(parts, &name, depth, gathered);
    }
    if !(DOUBLES..=NEWEST_INTEGER).contains(&class) || flags & COMPLEX != 0 || lengths.len() != 2 {
        gathered.passed_over.push(name);
        return Ok(());
    }
    if count == 0 {
        return Ok(());
    }
    gathered.values = gathered.values.saturating_add(count);
    if gathered.values > MOST_VALUES {
        return Err("holds more than 50 million numbers; split the recording".to_owned());
    }
    let data = parts.needed()?;
    let values = data.values(parts.big_endian).filter(|values| values.len() == count);
    let values = values.ok_or_else(|| format!("is a damaged MAT file: `{name}` has other than the {count} values it says"))?;
    let (rows, width) = (lengths[0], lengths[1]);
    if gathered.arrays.names.len() + if rows == 1 { 1 } else { width } > MOST_ARRAYS {
        return Err(format!("holds more than {MOST_ARRAYS} columns, a recording has a few"));
    }
    gathered.arrays.push(&name, rows, width, |row, column| values[column * rows + row]);
    Ok(())
}

/// The fields of a structure of one element.
fn structure(parts: &mut Elements<'_>, name: &str, depth: usize, gathered: &mut Gathered) -> Result<(), String> {
    let length = parts.needed()?;
    let length = if length.data.len() == 4 { parts.word(length.data) as usize } else { return Err(damaged()) };
    let names = parts.needed()?;
    if length == 0 {
        return Err(damaged());
    }
    for field in names.data.chunks_exact(length) {
        let field = Element { kind: INT8, data: field }.text();
        let Some(element) = parts.next()? else { return Err(damaged()) };
        let called = format!("{name}.{field}");
        if called.len() > 1000 || gathered.passed_over.len() > MOST_ARRAYS {
            return Err(damaged());
        }
        array(&mut Elements { bytes: element.data, big_endian: parts.big_endian }, Some(&called), depth + 1, gathered)?;
    }
    Ok(())
}

/// An element with its tag, padded.
fn element(kind: u32, data: &[u8]) -> Vec<u8> {
    let mut bytes = kind.to_le_bytes().to_vec();
    bytes.extend_from_slice(&(data.len() as u32).to_le_bytes());
    bytes.extend_from_slice(data);
    bytes.resize(bytes.len().next_multiple_of(8), 0);
    bytes
}

/// An array of one column or one row.
fn matrix(name: &str, class: u32, lengths: [usize; 2], kind: u32, data: &[u8]) -> Vec<u8> {
    let lengths: Vec<u8> = lengths.iter().flat_map(|&length| (length as u32).to_le_bytes()).collect();
    let flags: Vec<u8> = [class, 0].iter().flat_map(|word| word.to_le_bytes()).collect();
    element(MATRIX, &[element(UINT32, &flags), element(INT32, &lengths), element(INT8, name.as_bytes()), element(kind, data)].concat())
}

/// Writes columns as variables, uncompressed.
pub(super) fn write(columns: &[(String, &[f64])], provenance: &str) -> Result<Vec<u8>, String> {
    let mut text = b"MATLAB 5.0 MAT-file, written by catheter".to_vec();
    text.resize(116, b' ');
    text.resize(124, 0);
    text.extend_from_slice(&[0x00, 0x01, b'I', b'M']);
    for (name, values) in columns {
        let usable = name.len() <= 63
            && name.starts_with(|first: char| first.is_ascii_alphabetic())
            && name.bytes().all(|byte| byte.is_ascii_alphanumeric() || byte == b'_');
        if !usable {
            return Err(format!("`{name}` cannot be the name of a variable in MATLAB; write another format, or rename the column"));
        }
        if values.len() > u32::MAX as usize / 16 {
            return Err(format!("`{name}` has {} values, more than a MAT file of version 5 holds", values.len()));
        }
        let data: Vec<u8> = values.iter().flat_map(|value| value.to_le_bytes()).collect();
        text.extend_from_slice(&matrix(name, DOUBLES, [values.len(), 1], DOUBLE, &data));
    }
    let letters: Vec<u8> = provenance.encode_utf16().flat_map(u16::to_le_bytes).collect();
    if !letters.is_empty() {
        text.extend_from_slice(&matrix("provenance", CHARACTERS, [1, letters.len() / 2], UINT16, &letters));
    }
    Ok(text)
}
