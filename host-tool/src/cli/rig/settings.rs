//! `catheter rig settings`.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use clap::Subcommand;
use model_export::link::message::{Baseline, Refusal, Reply, Request, SettingDifference};
use model_export::link::profiles::{PROFILES, Profile};
use model_export::link::settings::{INFO, SettingInfo, SettingValue, by_number};
use serde::Serialize;

use super::Which;
use crate::backend::Rig;
use crate::cli::Outcome;
use crate::device_settings;
use crate::device_settings::differences;
use crate::link::{Client, LinkError, version};
use crate::setting_words::{self, named, shown, shown_by_number, wanted};
use crate::{output, say};

/// A setting and its new value.
type Change = (&'static SettingInfo, SettingValue);

/// What to do with settings.
#[derive(Subcommand)]
pub enum Command {
    /// Show settings in use, all of them or those named, with units.
    Get {
        /// Names, for example limits.ceiling_bar.
        #[arg(value_name = "NAME")]
        names: Vec<String>,
    },
    /// Change settings in use, until the next reset or until they are saved; refused while the rig is armed.
    Set {
        /// NAME=VALUE, for example limits.ceiling_bar=2.5 laser.required=false control.law=pressure.
        #[arg(required = true, value_name = "NAME=VALUE")]
        changes: Vec<String>,
        /// Write them to flash too.
        #[arg(long)]
        save: bool,
    },
    /// Take the settings of a valve or a sensor that labs buy, or list which there are.
    Profile {
        /// Its name.
        #[arg(value_name = "NAME")]
        name: Option<String>,
        /// Write them to flash too.
        #[arg(long)]
        save: bool,
    },
    /// Write the settings in use to a file, every one with its unit and meaning.
    Export {
        /// The file.
        #[arg(value_name = "FILE.toml", value_parser = output::file_argument(".toml"))]
        file: PathBuf,
    },
    /// Take the settings of a file: of `export`, or of `catheter tune`. All of them or, if the device refuses one, none.
    Import {
        /// The file.
        #[arg(value_name = "FILE.toml")]
        file: PathBuf,
        /// Write them to flash too.
        #[arg(long)]
        save: bool,
    },
    /// Write the settings in use to flash.
    Save,
    /// Show what differs from the saved settings.
    Diff {
        /// From the defaults instead.
        #[arg(long)]
        defaults: bool,
    },
    /// Go back to the saved settings.
    Revert {
        /// To the defaults instead.
        #[arg(long)]
        defaults: bool,
    },
}

/// A value as JSON has it.
#[derive(Serialize)]
#[serde(untagged)]
enum Value {
    Float(f32),
    Integer(u32),
    Flag(bool),
}

impl From<SettingValue> for Value {
    fn from(value: SettingValue) -> Self {
        match value {
            SettingValue::Float(number) => Self::Float(number),
            SettingValue::Integer(number) => Self::Integer(number),
            SettingValue::Flag(flag) => Self::Flag(flag),
        }
    }
}

#[derive(Serialize)]
struct Difference {
    name: String,
    in_use: Value,
    baseline: Value,
}

/// Runs the command.
pub fn run(command: &Command, rig: &mut Client<Rig>, which: &Which) -> Result<Outcome> {
    match command {
        Command::Get { names } => get(names, rig, which)?,
        Command::Set { changes, save } => {
            set(changes, rig, which)?;
            if *save {
                self::save(rig, which)?;
            } else if which.forgets() {
                say!("This device ends with this command; name a file with --flash and add --save to keep its settings.");
            } else {
                say!("In use until the next reset; `settings save` keeps them.");
            }
        }
        Command::Profile { name: None, .. } => list_profiles(which)?,
        Command::Profile { name: Some(name), save } => {
            profile(name, rig, which)?;
            if *save {
                self::save(rig, which)?;
            }
        }
        Command::Export { file } => export(file, rig, which)?,
        Command::Import { file, save } => {
            import(file, rig, which)?;
            if *save {
                self::save(rig, which)?;
            }
        }
        Command::Save => self::save(rig, which)?,
        Command::Diff { defaults } => difference(baseline(*defaults), rig, which)?,
        Command::Revert { defaults } => {
            rig.command(&Request::SettingsRevert(baseline(*defaults)))?;
            say!("The {} settings are in use.", if *defaults { "default" } else { "saved" });
            which.write(&serde_json::json!({"reverted": true}))?;
        }
    }
    Ok(Outcome::Success)
}

fn baseline(defaults: bool) -> Baseline {
    if defaults { Baseline::Defaults } else { Baseline::Saved }
}

fn get(names: &[String], rig: &mut Client<Rig>, which: &Which) -> Result<()> {
    let wanted = if names.is_empty() { INFO.iter().collect() } else { names.iter().map(|name| named(name)).collect::<Result<Vec<_>>>()? };
    let mut written = BTreeMap::new();
    for info in wanted {
        let request = Request::SettingGet { number: info.number };
        match rig.request(&request)? {
            Reply::Setting(value) => {
                say!("{:<36} {:>15} {:<6} {}", info.name, shown(info, value), info.unit, info.meaning);
                written.insert(info.name, Value::from(value));
            }
            _ => return Err(rig.unexpected(&request).into()),
        }
    }
    which.write(&written)
}

/// `NAME=VALUE` as the setting wants it, its bounds in the error.
fn parse(change: &str) -> Result<Change> {
    let (name, text) =
        change.split_once('=').with_context(|| format!("{change}: NAME=VALUE is wanted, for example limits.ceiling_bar=2.5"))?;
    let info = named(name.trim())?;
    Ok((info, setting_words::parse(info, text)?))
}

fn list_profiles(which: &Which) -> Result<()> {
    for profile in PROFILES {
        say!("{:<24} {}", profile.name, profile.device);
    }
    which.write(&PROFILES.iter().map(|profile| profile.name).collect::<Vec<_>>())
}

fn profile(name: &str, rig: &mut Client<Rig>, which: &Which) -> Result<()> {
    let profile = Profile::named(name).with_context(|| {
        let names: Vec<&str> = PROFILES.iter().map(|profile| profile.name).collect();
        format!("there is no profile {name}; there are {}", names.join(", "))
    })?;
    say!("{}\nby {}", profile.device, profile.data_sheet);
    let changes = profile.settings.iter().map(|(name, value)| Ok((named(name)?, *value))).collect::<Result<Vec<Change>>>()?;
    apply(&changes, rig, which)
}

fn set(changes: &[String], rig: &mut Client<Rig>, which: &Which) -> Result<()> {
    // All of them are understood before the first is sent.
    let changes = changes.iter().map(|change| parse(change)).collect::<Result<Vec<Change>>>()?;
    apply(&changes, rig, which)
}

/// Changes settings one after the other and tells each.
fn apply(changes: &[Change], rig: &mut Client<Rig>, which: &Which) -> Result<()> {
    let mut written = BTreeMap::new();
    for (info, value) in changes {
        send(info, *value, rig)?;
        say!("{} = {} {}", info.name, shown(info, *value), info.unit);
        written.insert(info.name, Value::from(*value));
    }
    which.write(&written)
}

fn send(info: &SettingInfo, value: SettingValue, rig: &mut Client<Rig>) -> Result<()> {
    match rig.command(&Request::SettingSet { number: info.number, value }) {
        Err(LinkError::Refused(Refusal::Setting(_))) => bail!("{}={}: {}", info.name, shown(info, value), wanted(info)),
        other => other.with_context(|| info.name.to_owned()),
    }
}

/// Every setting in use.
fn in_use(rig: &mut Client<Rig>) -> Result<BTreeMap<u16, SettingValue>> {
    INFO.iter().map(|info| Ok((info.number, device_settings::setting(rig, info.name)?))).collect()
}

fn export(path: &Path, rig: &mut Client<Rig>, which: &Which) -> Result<()> {
    let settings = in_use(rig)?;
    let hello = rig.hello();
    let heading = format!(
        "Settings of a board `{}` with firmware {}.\n`catheter rig settings import FILE` takes them.",
        hello.board,
        version(hello.firmware)
    );
    output::write_atomic(path, setting_words::file(&heading, &settings).as_bytes())?;
    say!("{} settings in {}", settings.len(), path.display());
    let written: BTreeMap<&str, Value> =
        settings.iter().filter_map(|(number, value)| Some((by_number(*number)?.name, Value::from(*value)))).collect();
    which.write(&written)
}

/// Takes the settings of a file: those that differ, in an order in which none contradicts another, or none at all.
fn import(path: &Path, rig: &mut Client<Rig>, which: &Which) -> Result<()> {
    let wanted = setting_words::read(path)?;
    let before = in_use(rig)?;
    let mut left: Vec<Change> = wanted.iter().copied().filter(|(info, value)| before.get(&info.number) != Some(value)).collect();
    let changed = left.len();
    let mut done: Vec<Change> = Vec::new();
    while !left.is_empty() {
        let mut later = Vec::new();
        let mut refusal = None;
        for (info, value) in &left {
            match send(info, *value, rig) {
                Ok(()) => done.push((info, *value)),
                // Beside the others that are still to come it may be right.
                Err(error) => {
                    later.push((*info, *value));
                    refusal.get_or_insert(error);
                }
            }
        }
        if let Some(error) = refusal
            && later.len() == left.len()
        {
            for (info, _) in done.iter().rev() {
                if let Some(value) = before.get(&info.number) {
                    send(info, *value, rig).context("the settings cannot be set back; `settings revert` does")?;
                }
            }
            return Err(error).with_context(|| format!("{}: nothing was changed", path.display()));
        }
        left = later;
    }
    for (info, value) in &done {
        let old = before.get(&info.number).map_or_else(String::new, |old| format!(", was {}", shown(info, *old)));
        say!("{} = {} {}{old}", info.name, shown(info, *value), info.unit);
    }
    say!("{changed} of {} settings of {} differed and are in use now.", wanted.len(), path.display());
    let written: BTreeMap<&str, Value> = done.iter().map(|(info, value)| (info.name, Value::from(*value))).collect();
    which.write(&written)
}

fn save(rig: &mut Client<Rig>, which: &Which) -> Result<()> {
    rig.command(&Request::SettingsSave)?;
    which.say_saved();
    which.write(&serde_json::json!({"saved": true}))
}

fn difference(baseline: Baseline, rig: &mut Client<Rig>, which: &Which) -> Result<()> {
    let mut written = Vec::new();
    for SettingDifference { number, in_use, baseline } in differences(rig, baseline)? {
        let name = by_number(number).map_or_else(|| format!("number {number}"), |info| info.name.to_owned());
        say!("{name:<36} {:>15}, not {}", shown_by_number(number, in_use), shown_by_number(number, baseline));
        written.push(Difference { name, in_use: in_use.into(), baseline: baseline.into() });
    }
    if written.is_empty() {
        say!("No setting differs.");
    }
    which.write(&written)
}
