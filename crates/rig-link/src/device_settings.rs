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

/// Changes settings for a time, all or none; nothing is saved.
///
/// # Errors
/// When the device refuses one.
pub fn borrow(rig: &mut Client<impl Transport>, wanted: &[(&str, SettingValue)]) -> Result<Borrowed> {
    let mut borrowed = Borrowed::default();
    for (name, value) in wanted {
        if let Err(error) = borrowed.add(rig, name, *value) {
            // What could be changed is set back as far as the device answers.
            let _ = give_back(rig, borrowed);
            return Err(error);
        }
    }
    Ok(borrowed)
}

impl Borrowed {
    fn add(&mut self, rig: &mut Client<impl Transport>, name: &str, value: SettingValue) -> Result<()> {
        let number = named(name)?.number;
        let before = setting(rig, name)?;
        if before != value {
            rig.command(&Request::SettingSet { number, value }).with_context(|| format!("{name} cannot be set"))?;
            self.0.push((number, before));
        }
        Ok(())
    }
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

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use model_export::link::hello::{Build, Hello};
    use model_export::link::message::{Message, ReplyFrame, RequestFrame};
    use model_export::link::state::ResetCause;
    use model_export::link::{PROTOCOL, SCHEMA_HASH, frame};

    use super::*;
    use crate::link::{FlashMemory, Hardware, HardwareConfig, InProcess, LinkError, Lockstep};
    use simulation::plant::{Plant, PlantConfig};

    /// A device whose pages of differences lead back to where they came from.
    #[derive(Default)]
    struct Endless {
        answers: Vec<u8>,
        now: Duration,
    }

    impl Transport for Endless {
        fn send(&mut self, bytes: &[u8]) -> Result<(), LinkError> {
            let greeting = Hello {
                firmware: [1, 0, 0],
                protocol: PROTOCOL,
                schema_hash: SCHEMA_HASH,
                model_id: [0; 8],
                reset_cause: ResetCause::PowerOn,
                board: heapless::String::default(),
                session: 1,
                build: Build::default(),
            };
            let page = Reply::Differences { entries: heapless::Vec::new(), next_number: 7 };
            let mut decoder = frame::Decoder::default();
            let asked = bytes.iter().find_map(|byte| match decoder.push(*byte) {
                Some(Ok(payload)) => RequestFrame::from_payload(payload).ok(),
                _ => None,
            });
            self.answers.extend(match asked {
                None => frame::encode(&greeting.encode()).unwrap(),
                Some(RequestFrame { token, .. }) => ReplyFrame { token, reply: page }.to_wire().unwrap(),
            });
            Ok(())
        }

        fn receive(&mut self, limit: Duration, into: &mut Vec<u8>) -> Result<(), LinkError> {
            self.now += limit;
            into.append(&mut self.answers);
            Ok(())
        }

        fn elapsed(&self) -> Duration {
            self.now
        }

        fn place(&self) -> &str {
            "test"
        }
    }

    #[test]
    fn an_answer_without_an_end_is_refused_by_whoever_asks() {
        let refused = differences(&mut Client::connect(Endless::default()).unwrap(), Baseline::Saved).unwrap_err();
        assert!(refused.to_string().contains("told already"), "{refused:#}");
        let refused = crate::history::settings_in_use(&mut Client::connect(Endless::default()).unwrap()).unwrap_err();
        assert!(refused.to_string().contains("told already"), "{refused:#}");
    }

    #[test]
    fn settings_are_borrowed_all_or_none_and_come_back() {
        let plant = Plant::new(PlantConfig::default()).unwrap();
        let hardware = Hardware::new(HardwareConfig::default(), Box::new(plant.start(0.0)));
        let processor = InProcess::new(FlashMemory::default());
        let mut rig = Client::connect(Lockstep::new(processor, hardware, (), "the rig in this process", "virtual").unwrap()).unwrap();
        crate::experiment::settle(&mut rig).unwrap();
        let own = setting(&mut rig, "telemetry.period_ms").unwrap();
        let wanted = ("telemetry.period_ms", SettingValue::Integer(7));
        assert!(borrow(&mut rig, &[wanted, ("limits.ceiling_bar", SettingValue::Float(1e9))]).is_err());
        assert_eq!(setting(&mut rig, "telemetry.period_ms").unwrap(), own);
        let borrowed = borrow(&mut rig, &[wanted]).unwrap();
        assert_eq!(setting(&mut rig, "telemetry.period_ms").unwrap(), wanted.1);
        give_back(&mut rig, borrowed).unwrap();
        assert_eq!(setting(&mut rig, "telemetry.period_ms").unwrap(), own);
    }
}
