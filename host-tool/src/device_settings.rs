//! Settings of a connected device: read by name, compared with a baseline, changed for a time and set back.

use anyhow::{Context, Result, ensure};
use model_export::link::message::{Baseline, Reply, Request, SettingDifference};
use model_export::link::settings::{SettingInfo, SettingValue, by_name};

use crate::link::{Client, Transport};

/// What a setting of this name is.
///
/// # Errors
/// When there is none.
pub fn named(name: &str) -> Result<&'static SettingInfo> {
    by_name(name).with_context(|| format!("there is no setting {name}"))
}

/// One setting's value.
///
/// # Errors
/// When there is no such setting, or the device is gone.
pub fn setting(rig: &mut Client<impl Transport>, name: &str) -> Result<SettingValue> {
    let request = Request::SettingGet { number: named(name)?.number };
    match rig.request(&request)? {
        Reply::Setting(value) => Ok(value),
        _ => Err(rig.unexpected(&request).into()),
    }
}

/// The settings in use that differ from a baseline.
///
/// # Errors
/// When the device is gone, or its answer has no end.
pub fn differences(rig: &mut Client<impl Transport>, baseline: Baseline) -> Result<Vec<SettingDifference>> {
    let mut found = Vec::new();
    let mut from_number = 0;
    loop {
        let request = Request::SettingsDifference { baseline, from_number };
        let Reply::Differences { entries, next_number } = rig.request(&request)? else { return Err(rig.unexpected(&request).into()) };
        found.extend(entries);
        if next_number == 0 {
            return Ok(found);
        }
        // A device that never gets to the end would be asked for ever.
        ensure!(next_number > from_number, "the device repeats settings it has told already; is this program made for its firmware?");
        from_number = next_number;
    }
}

/// Settings that were changed for a time, with what they were.
#[derive(Default)]
pub struct Borrowed(Vec<(u16, SettingValue)>);

/// Changes settings for a time; nothing is saved.
///
/// # Errors
/// When the device refuses one.
pub fn borrow(rig: &mut Client<impl Transport>, wanted: &[(&str, SettingValue)]) -> Result<Borrowed> {
    let mut borrowed = Borrowed::default();
    for (name, value) in wanted {
        let number = named(name)?.number;
        let before = setting(rig, name)?;
        if before != *value {
            rig.command(&Request::SettingSet { number, value: *value }).with_context(|| format!("{name} cannot be set"))?;
            borrowed.0.push((number, before));
        }
    }
    Ok(borrowed)
}

/// Sets borrowed settings back.
///
/// # Errors
/// When the device refuses; it does so while it is armed.
pub fn give_back(rig: &mut Client<impl Transport>, borrowed: Borrowed) -> Result<()> {
    for (number, value) in borrowed.0.into_iter().rev() {
        rig.command(&Request::SettingSet { number, value }).context("the settings cannot be set back; `settings revert` does")?;
    }
    Ok(())
}
