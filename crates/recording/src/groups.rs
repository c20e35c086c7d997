//! Which recordings belong together: those of one day, load or amplitude, as a column or their names show.

use std::path::Path;

use super::Recording;

/// What a word of a file's name can stand for, most telling first.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    Day,
    Load,
    Amplitude,
}

/// Fewest folders that are taken as groups: two may as well be training and test.
const FEWEST_FOLDERS: usize = 3;

/// Gives recordings without a group the one that their names show; parts of several files are grouped by file.
pub(super) fn assign(recordings: &mut [Recording]) {
    if recordings.iter().any(|recording| !recording.group.is_empty()) {
        return;
    }
    let files: Vec<_> = recordings.iter().map(Recording::file).collect();
    let chosen = [Kind::Day, Kind::Load, Kind::Amplitude].into_iter().find_map(|kind| {
        let names: Vec<String> = files.iter().map(|file| word(file, kind).unwrap_or_default()).collect();
        tells_groups(&names, 2).then_some(names)
    });
    let by_file = || -> Option<Vec<String>> {
        let names: Vec<String> = files.iter().map(|file| stem(file)).collect();
        let parts = recordings.iter().zip(&files).any(|(recording, file)| recording.path != *file);
        (parts && tells_groups(&names, 2)).then_some(names)
    };
    let by_folder = || -> Option<Vec<String>> {
        let folder =
            |file: &Path| file.parent().and_then(Path::file_name).map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
        let names: Vec<String> = files.iter().map(|file| folder(file)).collect();
        tells_groups(&names, FEWEST_FOLDERS).then_some(names)
    };
    let Some(names) = chosen.or_else(by_file).or_else(by_folder) else { return };
    recordings.iter_mut().zip(names).for_each(|(recording, name)| recording.group = name);
}

/// How recordings would be left out for cross-validation, in words.
#[must_use]
pub fn splits(recordings: &[Recording]) -> String {
    let mut names: Vec<&str> = recordings.iter().map(|recording| recording.group.as_str()).filter(|name| !name.is_empty()).collect();
    names.sort_unstable();
    names.dedup();
    match (recordings.len(), names.len()) {
        (0 | 1, _) => "One recording: it is cut into blocks, which says less about the next recording.".to_owned(),
        (2, _) => "Two recordings: they are cut into blocks, which says less about the next recording.".to_owned(),
        (count, 2) => {
            format!(
                "{count} recordings in 2 groups ({}), too few groups to leave one out: each recording is left out in turn.",
                listed(&names)
            )
        }
        (count, 0 | 1) => format!("{count} recordings, none of which belong together: each is left out in turn."),
        (count, groups) => format!("{count} recordings in {groups} groups ({}): each group is left out in turn.", listed(&names)),
    }
}

/// The first few names.
fn listed(names: &[&str]) -> String {
    let more = if names.len() > 6 { ", ..." } else { "" };
    format!("{}{more}", names[..names.len().min(6)].join(", "))
}

/// Whether there are so many different names, and one of them occurs twice.
fn tells_groups(names: &[String], fewest: usize) -> bool {
    let mut known: Vec<&String> = names.iter().filter(|name| !name.is_empty()).collect();
    let all = known.len();
    known.sort_unstable();
    known.dedup();
    known.len() >= fewest && known.len() < all
}

fn stem(file: &Path) -> String {
    file.file_stem().map(|stem| stem.to_string_lossy().into_owned()).unwrap_or_default()
}

/// The word of a file's or its folder's name that is of this kind.
fn word(file: &Path, kind: Kind) -> Option<String> {
    let folder = file.parent().and_then(Path::file_name).map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
    [stem(file), folder].iter().find_map(|name| name.split(['_', ' ']).find(|word| is_of(word, kind)).map(str::to_lowercase))
}

fn is_of(word: &str, kind: Kind) -> bool {
    let word = word.to_lowercase();
    let numbered = |prefixes: &[&str]| {
        prefixes.iter().any(|prefix| {
            word.strip_prefix(prefix).is_some_and(|rest| rest.trim_start_matches('-').starts_with(|c: char| c.is_ascii_digit()))
        })
    };
    // A number with a unit, such as `30lb` or `1.5in`.
    let unit = word.trim_start_matches(|character: char| character.is_ascii_digit() || character == '.' || character == ',');
    let measured = |units: &[&str]| unit.len() < word.len() && units.contains(&unit);
    match kind {
        Kind::Day => is_date(&word) || numbered(&["day", "session"]),
        Kind::Load => measured(&["g", "kg", "lb", "lbs", "n", "kn"]) || numbered(&["load", "mass", "weight"]),
        Kind::Amplitude => measured(&["mm", "um", "cm", "in", "v", "a", "bar", "kpa", "psi", "deg"]) || numbered(&["amp", "amplitude"]),
    }
}

/// Whether a word is a date such as `20190807` or `2019-08-07`.
fn is_date(word: &str) -> bool {
    let digits: String = word.chars().filter(char::is_ascii_digit).collect();
    let others: Vec<char> = word.chars().filter(|character| !character.is_ascii_digit()).collect();
    let (month, day) = (digits.get(4..6).unwrap_or_default(), digits.get(6..8).unwrap_or_default());
    let within = |text: &str, most: u32| text.parse().is_ok_and(|number: u32| (1..=most).contains(&number));
    digits.len() == 8
        && (others.is_empty() || others == ['-', '-'])
        && within(month, 12)
        && within(day, 31)
        && (word.starts_with("19") || word.starts_with("20"))
}
