//! Settings, and those that a session borrows: in use while it lasts, never saved, and set back at its end.

use std::collections::BTreeMap;

use anyhow::{Context, Result};
use dashboard::Setting;
use model_export::link::message::{Baseline, Reply, Request};
use model_export::link::settings::{INFO, SettingValue};
use serde_json::Value;

use super::pace::Paced;
use super::words;
use crate::device_settings::{differences, named, setting};
use crate::link::Client;
use crate::setting_words;

/// Settings that a session changed for its own time, with what the operator has there.
#[derive(Default)]
pub struct Borrowed {
    own: BTreeMap<u16, SettingValue>,
}

fn set(rig: &mut Client<Paced>, number: u16, value: SettingValue) -> Result<()> {
    Ok(rig.command(&Request::SettingSet { number, value })?)
}

/// The saved value of each setting that differs from it.
fn saved_of_changed(rig: &mut Client<Paced>) -> Result<BTreeMap<u16, SettingValue>> {
    Ok(differences(rig, Baseline::Saved)?.into_iter().map(|difference| (difference.number, difference.baseline)).collect())
}

impl Borrowed {
    /// Puts a setting to a value for the time of the session.
    pub fn borrow(&mut self, rig: &mut Client<Paced>, name: &str, value: SettingValue) -> Result<()> {
        let number = named(name)?.number;
        let before = setting(rig, name)?;
        if before != value {
            set(rig, number, value).with_context(|| format!("{name} cannot be set"))?;
            self.own.entry(number).or_insert(before);
        }
        Ok(())
    }

    /// Puts a borrowed setting to what it was before a part of the session changed it.
    pub fn restore(&mut self, rig: &mut Client<Paced>, name: &str, value: SettingValue) -> Result<()> {
        let number = named(name)?.number;
        set(rig, number, value).with_context(|| format!("{name} cannot be set back"))?;
        if self.own.get(&number) == Some(&value) {
            self.own.remove(&number);
        }
        Ok(())
    }

    /// Changes a setting for the operator; one that is borrowed changes when the session ends.
    pub fn set(&mut self, rig: &mut Client<Paced>, name: &str, value: &Value) -> Result<()> {
        let info = named(name)?;
        let bounds = || format!("{name}: {}", setting_words::wanted(info));
        let value = words::setting_value(info.default, value).with_context(bounds)?;
        if let Some(own) = self.own.get_mut(&info.number) {
            let mut checked = model_export::link::settings::Settings::DEFAULT;
            checked.set(info.number, value).ok().with_context(bounds)?;
            *own = value;
            return Ok(());
        }
        set(rig, info.number, value).with_context(bounds)
    }

    /// Sets everything back, does something, and borrows again.
    pub fn without(&mut self, rig: &mut Client<Paced>, does: impl FnOnce(&mut Client<Paced>) -> Result<()>) -> Result<()> {
        let mut in_use = Vec::new();
        for (number, own) in &self.own {
            let name = INFO.iter().find(|info| info.number == *number).map_or("", |info| info.name);
            in_use.push((name, setting(rig, name)?));
            set(rig, *number, *own)?;
        }
        let done = does(rig);
        self.own.clear();
        for (name, value) in in_use {
            self.borrow(rig, name, value)?;
        }
        done
    }

    /// Sets everything back.
    pub fn give_back(&mut self, rig: &mut Client<Paced>) -> Result<()> {
        for (number, own) in std::mem::take(&mut self.own) {
            set(rig, number, own)?;
        }
        Ok(())
    }

    /// Whether settings differ from the saved ones that the operator changed.
    pub fn are_unsaved(&self, rig: &mut Client<Paced>) -> Result<bool> {
        let saved = saved_of_changed(rig)?;
        Ok(saved.iter().any(|(number, saved)| self.own.get(number).is_none_or(|own| own != saved))
            || self.own.iter().any(|(number, own)| saved.get(number).is_some_and(|saved| saved != own)))
    }

    /// Every setting as the operator has it.
    pub fn list(&self, rig: &mut Client<Paced>) -> Result<Vec<Setting>> {
        let saved = saved_of_changed(rig)?;
        let mut listed = Vec::new();
        for info in INFO {
            let request = Request::SettingGet { number: info.number };
            // One that this firmware does not know is left out.
            let Reply::Setting(in_use) = rig.ask(&request)? else { continue };
            let own = self.own.get(&info.number).copied().unwrap_or(in_use);
            listed.push(Setting {
                name: info.name.to_owned(),
                unit: info.unit.to_owned(),
                meaning: info.meaning.to_owned(),
                value: words::value(own),
                saved: words::value(saved.get(&info.number).copied().unwrap_or(in_use)),
                default: words::value(info.default),
                minimum: words::value(info.minimum),
                maximum: words::value(info.maximum),
            });
        }
        Ok(listed)
    }
}
