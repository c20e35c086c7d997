//! Archives of numpy arrays: a ZIP file with one `.npy` for each array. Format: NumPy Enhancement Proposal 1, versions 1 to 3.

use std::io::{Cursor, Read, Write};

use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, ZipArchive, ZipWriter};

use crate::arrays::Arrays;
use crate::parts::MOST_VALUES;
use crate::{Note, Subject};

/// More arrays than this are no recording.
const MOST_ARRAYS: usize = 4096;
/// A header is one line that names type and shape.
const LONGEST_HEADER: usize = 64 * 1024;

/// Type of the elements of an array.
#[derive(Clone, Copy)]
struct Element {
    /// `f`, `i`, `u` or `b`.
    kind: u8,
    bytes: usize,
    big_endian: bool,
}

impl Element {
    /// From a text such as `<f8`; none for text, complex numbers and objects.
    fn parse(text: &str) -> Option<Self> {
        let (order, rest) = text.split_at_checked(1)?;
        let (kind, bytes) = rest.split_at_checked(1)?;
        let element = Self { kind: kind.as_bytes()[0], bytes: bytes.parse().ok()?, big_endian: order == ">" };
        let known = matches!((element.kind, element.bytes), (b'f', 4 | 8) | (b'i' | b'u', 1 | 2 | 4 | 8) | (b'b', 1));
        (known && matches!(order, "<" | ">" | "|" | "=")).then_some(element)
    }

    /// The value of one element.
    fn value(self, bytes: &[u8]) -> f64 {
        let mut little = [0; 8];
        for (index, &byte) in bytes.iter().enumerate() {
            little[if self.big_endian { bytes.len() - 1 - index } else { index }] = byte;
        }
        let unsigned = u64::from_le_bytes(little);
        // Sign extension of the shorter ones.
        let shift = 64 - 8 * self.bytes as u32;
        let signed = (unsigned << shift).cast_signed() >> shift;
        match (self.kind, self.bytes) {
            (b'f', 4) => f64::from(f32::from_le_bytes([little[0], little[1], little[2], little[3]])),
            (b'f', _) => f64::from_le_bytes(little),
            (b'i', _) => signed as f64,
            _ => unsigned as f64,
        }
    }
}

/// What the header of an array says.
struct Header {
    element: Option<Element>,
    column_major: bool,
    shape: Vec<usize>,
}

/// Reads magic, version and header; the rest of `reader` are the elements.
fn header(reader: &mut impl Read) -> Result<Header, String> {
    let mut begin = [0; 8];
    reader.read_exact(&mut begin).map_err(|_| "ends within its header".to_owned())?;
    if !begin.starts_with(b"\x93NUMPY") || !(1..=3).contains(&begin[6]) {
        return Err("is no array of numpy".to_owned());
    }
    let mut length = [0; 4];
    let field = if begin[6] == 1 { &mut length[..2] } else { &mut length[..] };
    reader.read_exact(field).map_err(|_| "ends within its header".to_owned())?;
    let length = u32::from_le_bytes(length) as usize;
    if length > LONGEST_HEADER {
        return Err(format!("has a header of {length} bytes"));
    }
    let mut text = vec![0; length];
    reader.read_exact(&mut text).map_err(|_| "ends within its header".to_owned())?;
    let text = String::from_utf8_lossy(&text).into_owned();
    let after = |key: &str| text.split_once(&format!("'{key}':")).map(|(_, rest)| rest.trim_start());
    let unreadable = || format!("has an unreadable header ({})", text.chars().take(80).collect::<String>());
    let element = after("descr").ok_or_else(unreadable)?;
    let element = element.strip_prefix('\'').and_then(|rest| rest.split_once('\'')).and_then(|(text, _)| Element::parse(text));
    let column_major = after("fortran_order").ok_or_else(unreadable)?.starts_with("True");
    let shape = after("shape").and_then(|rest| rest.strip_prefix('(')).and_then(|rest| rest.split_once(')')).ok_or_else(unreadable)?.0;
    let lengths = shape.split(',').map(str::trim).filter(|length| !length.is_empty());
    let shape = lengths.map(|length| length.trim_end_matches('L').parse().map_err(|_| unreadable())).collect::<Result<Vec<usize>, _>>()?;
    Ok(Header { element, column_major, shape })
}

/// Reads all arrays of one or two dimensions.
pub(super) fn read(bytes: &[u8]) -> Result<Arrays, String> {
    let mut archive = ZipArchive::new(Cursor::new(bytes)).map_err(|error| format!("is no readable archive ({error}); save it again"))?;
    if archive.len() > MOST_ARRAYS {
        return Err(format!("holds {} files, a recording has a few arrays", archive.len()));
    }
    if archive.file_names().flatten().any(|name| name == "[Content_Types].xml") {
        return Err("is a workbook or document; save the sheet as CSV (UTF-8)".to_owned());
    }
    let mut arrays = Arrays::default();
    let (mut values, mut passed_over) = (0_usize, Vec::new());
    for index in 0..archive.len() {
        let mut entry = archive.by_index(index).map_err(|error| format!("is a damaged archive ({error}); save it again"))?;
        let name = entry.name().map_err(|error| format!("is a damaged archive ({error}); save it again"))?.into_owned();
        let Some(name) = name.strip_suffix(".npy").map(str::to_owned) else { continue };
        let problem = |problem: String| format!("its array `{}` {problem}", name.chars().take(60).collect::<String>());
        let Header { element, column_major, shape } = header(&mut entry).map_err(problem)?;
        let (Some(element), 1..=2) = (element, shape.len()) else {
            passed_over.push(name);
            continue;
        };
        let (rows, width) = (shape[0], shape.get(1).copied().unwrap_or(1));
        let count = rows.checked_mul(width).filter(|count| values.saturating_add(*count) <= MOST_VALUES);
        let count = count.ok_or_else(|| problem("holds more than 50 million numbers; split the recording".to_owned()))?;
        if width > MOST_ARRAYS && rows > 1 {
            return Err(problem(format!("has {width} columns")));
        }
        values += count;
        // As many as are there, whatever the header says.
        let mut raw = Vec::new();
        entry.take((count * element.bytes) as u64).read_to_end(&mut raw).map_err(|error| problem(format!("is damaged ({error})")))?;
        if raw.len() != count * element.bytes {
            return Err(problem(format!("ends after {} of {count} elements", raw.len() / element.bytes)));
        }
        arrays.push(&name, rows, width, |row, column| {
            let place = if column_major { column * rows + row } else { row * width + column };
            element.value(&raw[place * element.bytes..][..element.bytes])
        });
    }
    passed_over.retain(|name| name != "provenance");
    if !passed_over.is_empty() {
        let names = passed_over.iter().take(10).cloned().collect::<Vec<_>>().join(", ");
        arrays.notes.push(Note::new(Subject::Layout, format!("Arrays that are no lists of numbers were passed over: {names}.")));
    }
    Ok(arrays)
}

/// One array as a `.npy`: its type, its shape, its elements.
fn array(kind: &str, shape: &str, elements: &[u8]) -> Vec<u8> {
    let mut header = format!("{{'descr': '{kind}', 'fortran_order': False, 'shape': {shape}, }}");
    // Magic, version, length and header end on a multiple of 64 bytes, with a line end last.
    while (10 + header.len() + 1) % 64 != 0 {
        header.push(' ');
    }
    header.push('\n');
    let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
    bytes.extend_from_slice(&(header.len() as u16).to_le_bytes());
    bytes.extend_from_slice(header.as_bytes());
    bytes.extend_from_slice(elements);
    bytes
}

/// Writes columns as arrays, compressed.
pub(super) fn write(columns: &[(String, &[f64])], provenance: &str) -> Result<Vec<u8>, String> {
    let mut archive = ZipWriter::new(Cursor::new(Vec::new()));
    // No date: equal recordings give equal files.
    let options = SimpleFileOptions::default().compression_method(CompressionMethod::Deflated).last_modified_time(zip::DateTime::default());
    let mut add = |name: &str, bytes: &[u8]| -> Result<(), String> {
        archive.start_file(format!("{name}.npy"), options).map_err(|error| error.to_string())?;
        archive.write_all(bytes).map_err(|error| error.to_string())
    };
    for (name, values) in columns {
        let elements: Vec<u8> = values.iter().flat_map(|value| value.to_le_bytes()).collect();
        add(name, &array("<f8", &format!("({},)", values.len()), &elements))?;
    }
    let letters: Vec<u8> = provenance.chars().flat_map(|letter| u32::from(letter).to_le_bytes()).collect();
    if !letters.is_empty() {
        add("provenance", &array(&format!("<U{}", letters.len() / 4), "()", &letters))?;
    }
    archive.finish().map(Cursor::into_inner).map_err(|error| error.to_string())
}
