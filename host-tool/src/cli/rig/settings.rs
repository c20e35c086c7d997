//! `catheter rig settings`.

use std::collections::BTreeMap;

use anyhow::{Context, Result, bail};
use clap::Subcommand;
use model_export::link::message::{Baseline, Refusal, Reply, Request, SettingDifference};
use model_export::link::profiles::{PROFILES, Profile};
use model_export::link::settings::{INFO, SettingInfo, SettingValue, by_name, by_number};
use serde::Serialize;

use super::Which;
use crate::backend::Rig;
use crate::cli::Outcome;
use crate::link::{Client, LinkError};
use crate::say;

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
        /// NAME=VALUE, for example limits.ceiling_bar=2.5 laser.required=false.
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

/// The setting with this name, or an error that lists the likely ones.
fn named(name: &str) -> Result<&'static SettingInfo> {
    by_name(name).with_context(|| {
        let group = name.split('.').next().unwrap_or(name);
        let same: Vec<&str> = INFO.iter().map(|info| info.name).filter(|known| known.starts_with(group)).collect();
        let all = INFO.iter().map(|info| info.name).collect();
        format!("there is no setting {name}; there are {}", if same.is_empty() { all } else { same }.join(", "))
    })
}

fn shown(value: SettingValue) -> String {
    match value {
        SettingValue::Float(number) => number.to_string(),
        SettingValue::Integer(number) => number.to_string(),
        SettingValue::Flag(flag) => flag.to_string(),
    }
}

fn get(names: &[String], rig: &mut Client<Rig>, which: &Which) -> Result<()> {
    let wanted = if names.is_empty() { INFO.iter().collect() } else { names.iter().map(|name| named(name)).collect::<Result<Vec<_>>>()? };
    let mut written = BTreeMap::new();
    for info in wanted {
        let request = Request::SettingGet { number: info.number };
        match rig.request(&request)? {
            Reply::Setting(value) => {
                say!("{:<36} {:>10} {:<6} {}", info.name, shown(value), info.unit, info.meaning);
                written.insert(info.name, Value::from(value));
            }
            _ => return Err(rig.unexpected(&request).into()),
        }
    }
    which.write(&written)
}

/// `NAME=VALUE` as the setting wants it, its bounds in the error.
fn parse(change: &str) -> Result<(&'static SettingInfo, SettingValue)> {
    let (name, text) =
        change.split_once('=').with_context(|| format!("{change}: NAME=VALUE is wanted, for example limits.ceiling_bar=2.5"))?;
    let info = named(name.trim())?;
    let text = text.trim();
    let bounds = || format!("{}={text}: {} to {} {} is wanted", info.name, shown(info.minimum), shown(info.maximum), info.unit);
    let value = match info.default {
        SettingValue::Float(_) => text.parse().ok().map(SettingValue::Float),
        SettingValue::Integer(_) => text.parse().ok().map(SettingValue::Integer),
        SettingValue::Flag(_) => text.parse().ok().map(SettingValue::Flag),
    };
    Ok((info, value.with_context(bounds)?))
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
    let changes: Vec<String> = profile.settings.iter().map(|(name, value)| format!("{name}={}", shown(*value))).collect();
    set(&changes, rig, which)
}

fn set(changes: &[String], rig: &mut Client<Rig>, which: &Which) -> Result<()> {
    // All of them are understood before the first is sent.
    let changes = changes.iter().map(|change| parse(change)).collect::<Result<Vec<_>>>()?;
    let mut written = BTreeMap::new();
    for (info, value) in changes {
        let sent = rig.command(&Request::SettingSet { number: info.number, value });
        match sent {
            Err(LinkError::Refused(Refusal::Setting(_))) => {
                bail!("{}={}: {} to {} {} is wanted", info.name, shown(value), shown(info.minimum), shown(info.maximum), info.unit)
            }
            other => other.with_context(|| info.name.to_owned())?,
        }
        say!("{} = {} {}", info.name, shown(value), info.unit);
        written.insert(info.name, Value::from(value));
    }
    which.write(&written)
}

fn save(rig: &mut Client<Rig>, which: &Which) -> Result<()> {
    rig.command(&Request::SettingsSave)?;
    if which.forgets() {
        say!("Saved, on a device that ends with this command; name a file with --flash to keep it.");
    } else {
        say!("Saved: the device starts with these settings from now on.");
    }
    which.write(&serde_json::json!({"saved": true}))
}

fn difference(baseline: Baseline, rig: &mut Client<Rig>, which: &Which) -> Result<()> {
    let mut written = Vec::new();
    let mut from_number = 0;
    loop {
        let request = Request::SettingsDifference { baseline, from_number };
        let Reply::Differences { entries, next_number } = rig.request(&request)? else { return Err(rig.unexpected(&request).into()) };
        for SettingDifference { number, in_use, baseline } in &entries {
            let name = by_number(*number).map_or_else(|| format!("number {number}"), |info| info.name.to_owned());
            say!("{name:<36} {:>10}, not {}", shown(*in_use), shown(*baseline));
            written.push(Difference { name, in_use: (*in_use).into(), baseline: (*baseline).into() });
        }
        if next_number == 0 {
            break;
        }
        // A device that never gets to the end would be asked for ever.
        anyhow::ensure!(
            next_number > from_number,
            "the device repeats settings it has told already; is this program made for its firmware?"
        );
        from_number = next_number;
    }
    if written.is_empty() {
        say!("No setting differs.");
    }
    which.write(&written)
}
