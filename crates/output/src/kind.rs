//! What kind of file bytes are, by their beginning.

/// What is not recognised.
pub(crate) const UNKNOWN: &str = "a file of another kind";

/// What bytes are, as far as their beginning tells.
pub(crate) fn kind(bytes: &[u8]) -> &'static str {
    let starts = |magic: &[u8]| bytes.starts_with(magic);
    match bytes {
        _ if starts(b"CATHBLOB") => "a blob",
        _ if starts(b"CATHJRNL") => "a replay log",
        _ if starts(b"\x1f\x8b") => "a compressed file",
        _ if starts(b"PK") => "an archive",
        _ if starts(b"\x89MCAP") => "an MCAP file",
        _ if starts(b"MATLAB") => "a MAT file",
        _ if starts(b"\x7fELF") => "a program",
        _ if bytes.get(8) == Some(&b'{') && bytes[..8].contains(&0) => "a network in safetensors",
        _ if bytes.contains(&0) => UNKNOWN,
        _ => text_kind(bytes),
    }
}

/// What a text is: HTML, JSON, TOML or a table.
fn text_kind(bytes: &[u8]) -> &'static str {
    let text = String::from_utf8_lossy(&bytes[..bytes.len().min(512)]).into_owned();
    let mut lines = text.lines().map(str::trim).filter(|line| !line.is_empty() && !line.starts_with('#'));
    let first = lines.next().unwrap_or_default();
    if first.get(..9).is_some_and(|begin| begin.eq_ignore_ascii_case("<!doctype")) || first.starts_with("<html") {
        return "a page in HTML";
    }
    let names = first.split(',').collect::<Vec<_>>();
    let is_header = names.len() >= 2 && names.iter().all(|name| !name.is_empty() && !name.contains(['=', '{', '[', '"', ' ']));
    if is_header && first.contains("time") {
        return "a recording";
    }
    let is_key =
        first.split_once(" = ").is_some_and(|(key, _)| key.chars().all(|letter| letter.is_ascii_alphanumeric() || "_-.".contains(letter)));
    match first.chars().next() {
        Some('{') => "a result in JSON",
        _ if is_key || (first.starts_with('[') && first.ends_with(']') && first.len() > 2 && !first.contains(',')) => "a file in TOML",
        _ => UNKNOWN,
    }
}
