//! Settings as people write them: choices by their names, values with their bounds in the error, and files of them.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::Path;

use anyhow::{Context, Result, bail};
use model_export::link::settings::{INFO, SettingInfo, SettingValue, by_name, by_number};

/// Names of the values of settings that are choices, by the setting's name; a value is an index.
const CHOICES: &[(&str, &[&str])] = &[
    ("valve.drive", &["analogue", "pulse-width"]),
    ("control.law", &["playback", "pressure", "tracking"]),
    ("control.feed_forward", &["none", "linear-map", "pi-inverse", "physics-inverse", "learned-inverse"]),
    ("control.sensor", &["none", "laser", "estimate", "blend"]),
    ("control.outside_domain", &["report", "physics", "hold"]),
];

/// The names of a setting's values, if it is a choice.
#[must_use]
pub fn choices(info: &SettingInfo) -> Option<&'static [&'static str]> {
    CHOICES.iter().find(|(name, _)| *name == info.name).map(|(_, names)| *names)
}

/// A value as people read it.
#[must_use]
pub fn shown(info: &SettingInfo, value: SettingValue) -> String {
    match value {
        SettingValue::Float(number) => number.to_string(),
        SettingValue::Integer(number) => {
            let name = choices(info).and_then(|names| names.get(usize::try_from(number).ok()?));
            name.map_or_else(|| number.to_string(), |name| (*name).to_owned())
        }
        SettingValue::Flag(flag) => flag.to_string(),
    }
}

/// As [`shown`], for a setting known by its number only.
#[must_use]
pub fn shown_by_number(number: u16, value: SettingValue) -> String {
    match (by_number(number), value) {
        (Some(info), value) => shown(info, value),
        (None, SettingValue::Float(value)) => value.to_string(),
        (None, SettingValue::Integer(value)) => value.to_string(),
        (None, SettingValue::Flag(value)) => value.to_string(),
    }
}

/// What a setting may be, for an error.
#[must_use]
pub fn wanted(info: &SettingInfo) -> String {
    match (choices(info), info.default) {
        (Some(names), _) => format!("one of {} is wanted", names.join(", ")),
        (None, SettingValue::Flag(_)) => "true or false is wanted".to_owned(),
        (None, _) => {
            let unit = if info.unit.is_empty() { String::new() } else { format!(" {}", info.unit) };
            format!("{} to {}{unit} is wanted", shown(info, info.minimum), shown(info, info.maximum))
        }
    }
}

/// The setting with this name.
///
/// # Errors
/// With the likely ones, when there is none.
pub fn named(name: &str) -> Result<&'static SettingInfo> {
    by_name(name).with_context(|| {
        let group = name.split('.').next().unwrap_or(name);
        let same: Vec<&str> = INFO.iter().map(|info| info.name).filter(|known| known.starts_with(group)).collect();
        let all = INFO.iter().map(|info| info.name).collect();
        format!("there is no setting {name}; there are {}", if same.is_empty() { all } else { same }.join(", "))
    })
}

/// A value from text: a number, true or false, or the name of a choice.
///
/// # Errors
/// With what is wanted, when it is none that the setting may have.
pub fn parse(info: &'static SettingInfo, text: &str) -> Result<SettingValue> {
    let text = text.trim();
    let by_choice = || choices(info)?.iter().position(|name| *name == text).and_then(|index| u32::try_from(index).ok());
    let value = match info.default {
        SettingValue::Float(_) => text.parse().ok().map(SettingValue::Float),
        SettingValue::Integer(_) => text.parse().ok().or_else(by_choice).map(SettingValue::Integer),
        SettingValue::Flag(_) => text.parse().ok().map(SettingValue::Flag),
    };
    value
        .filter(|value| model_export::link::settings::Settings::default().set(info.number, *value).is_ok())
        .with_context(|| format!("{}={text}: {}", info.name, wanted(info)))
}

/// A value as files have it.
#[must_use]
pub fn in_file(info: &SettingInfo, value: SettingValue) -> toml::Value {
    match value {
        // Through text, so that 0.1 stays 0.1.
        SettingValue::Float(number) => toml::Value::Float(number.to_string().parse().unwrap_or(f64::from(number))),
        SettingValue::Integer(number) if choices(info).is_none() => toml::Value::Integer(number.into()),
        SettingValue::Integer(_) => toml::Value::String(shown(info, value)),
        SettingValue::Flag(flag) => toml::Value::Boolean(flag),
    }
}

/// The file of these settings: one a line, with unit and meaning.
#[must_use]
pub fn file(heading: &str, settings: &BTreeMap<u16, SettingValue>) -> String {
    let mut text: String = heading.lines().map(|line| format!("# {line}\n")).collect();
    for (number, value) in settings {
        let Some(info) = by_number(*number) else { continue };
        let unit = if info.unit.is_empty() { String::new() } else { format!("{}: ", info.unit) };
        let _ = writeln!(text, "\"{}\" = {} # {unit}{}", info.name, in_file(info, *value), info.meaning);
    }
    text
}

/// Reads a file of settings, in the order of their numbers; dotted names may be quoted keys or tables.
///
/// # Errors
/// When it is no TOML, a setting is unknown, or a value is none that it may have.
pub fn read(path: &Path) -> Result<Vec<(&'static SettingInfo, SettingValue)>> {
    let text = output::read_text(path).with_context(|| format!("{}: cannot be read", path.display()))?;
    let table: toml::Table = toml::from_str(&text).with_context(|| format!("{}: is no TOML", path.display()))?;
    let mut settings = BTreeMap::new();
    collect("", &table, &mut settings).with_context(|| path.display().to_string())?;
    Ok(settings.into_values().collect())
}

fn collect(before: &str, table: &toml::Table, into: &mut BTreeMap<u16, (&'static SettingInfo, SettingValue)>) -> Result<()> {
    for (key, value) in table {
        let name = if before.is_empty() { key.clone() } else { format!("{before}.{key}") };
        if let toml::Value::Table(inner) = value {
            collect(&name, inner, into)?;
            continue;
        }
        let info = named(&name)?;
        let text = match (info.default, value) {
            (SettingValue::Float(_), toml::Value::Float(number)) => number.to_string(),
            (SettingValue::Float(_) | SettingValue::Integer(_), toml::Value::Integer(number)) => number.to_string(),
            (SettingValue::Integer(_), toml::Value::String(text)) => text.clone(),
            (SettingValue::Flag(_), toml::Value::Boolean(flag)) => flag.to_string(),
            _ => bail!("{name} has the wrong type; {}", wanted(info)),
        };
        into.insert(info.number, (info, parse(info, &text)?));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_choice_has_a_name_for_every_value() {
        for (name, names) in CHOICES {
            let info = by_name(name).unwrap_or_else(|| panic!("{name}"));
            assert_eq!(info.maximum, SettingValue::Integer(u32::try_from(names.len() - 1).unwrap()), "{name}");
        }
        // A setting that is a small whole number without unit, and whose meaning lists numbers, is a choice.
        for info in INFO.iter().filter(|info| info.meaning.contains(": 0 ")) {
            assert!(choices(info).is_some(), "{} has no names", info.name);
        }
    }

    #[test]
    fn a_file_of_settings_reads_back_as_it_was() {
        let settings = model_export::link::settings::Settings { feed_forward: 2, ceiling_bar: 0.8, ..Default::default() };
        let all: BTreeMap<u16, SettingValue> = INFO.iter().filter_map(|info| Some((info.number, settings.get(info.number)?))).collect();
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("settings.toml");
        std::fs::write(&path, file("of a test\nrig", &all)).unwrap();
        let text = std::fs::read_to_string(&path).unwrap();
        assert!(
            text.contains("\"control.feed_forward\" = \"pi-inverse\"") && text.contains("\"limits.ceiling_bar\" = 0.8 # bar:"),
            "{text}"
        );
        let read: BTreeMap<u16, SettingValue> = read(&path).unwrap().into_iter().map(|(info, value)| (info.number, value)).collect();
        assert_eq!(read, all);
    }

    #[test]
    fn numbers_still_work_and_nonsense_says_what_is_wanted() {
        let law = by_name("control.law").unwrap();
        assert_eq!(parse(law, "2").unwrap(), SettingValue::Integer(2));
        assert_eq!(parse(law, "tracking").unwrap(), SettingValue::Integer(2));
        assert!(parse(law, "fast").unwrap_err().to_string().contains("playback, pressure, tracking"));
        assert!(parse(by_name("limits.ceiling_bar").unwrap(), "25").unwrap_err().to_string().contains("0 to 4 bar"));
    }
}
