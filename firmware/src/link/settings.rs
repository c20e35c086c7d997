//! Requests about settings: proposing, comparing, saving.

use heapless::Vec;
use model_export::link::message::{Baseline, MAX_PAGE, Refusal, Reply, SettingDifference};
use model_export::link::settings::Settings;

use super::CommandSink;
use super::models::refusal;
use super::requests::{Outcome, SessionState};
use crate::settings;
use crate::storage::Flash;
use crate::tick::{Action, Inconsistent, TickConfig};

impl<S: Flash, M: Flash> SessionState<S, M> {
    /// Sends the proposed settings to the tick; they are in use once it has taken them.
    #[inline(never)]
    pub(super) fn propose(&mut self, token: u32, commands: &mut impl CommandSink) -> Outcome {
        match (TickConfig { settings: &self.proposed, facts: self.config.facts }).build() {
            Ok(tick) => {
                let outcome = self.send(token, Action::Configure(tick), commands);
                if matches!(outcome, Outcome::Sent) {
                    self.proposal = Some(token);
                }
                outcome
            }
            Err(Inconsistent::Setting(number)) => Outcome::Done(Err(Refusal::SettingsInconsistent(number))),
            Err(Inconsistent::Adaptation(condition)) => Outcome::Done(Err(Refusal::Uncertified(condition.number()))),
        }
    }

    pub(super) fn differences(&self, baseline: Baseline, from_number: u16) -> Reply {
        let baseline = match baseline {
            Baseline::Saved => &self.saved,
            Baseline::Defaults => &Settings::DEFAULT,
        };
        let mut entries = Vec::new();
        for (number, in_use, baseline) in self.settings.differences(baseline).filter(|entry| entry.0 >= from_number) {
            if entries.len() == MAX_PAGE {
                return Reply::Differences { entries, next_number: number };
            }
            let _ = entries.push(SettingDifference { number, in_use, baseline });
        }
        Reply::Differences { entries, next_number: 0 }
    }

    #[inline(never)]
    pub(super) fn save_settings(&mut self) -> Result<(), Refusal> {
        self.may_write()?;
        let mut bytes = Vec::new();
        settings::encode_into(&self.settings, &mut bytes).ok_or(Refusal::Storage)?;
        self.settings_store.save(&bytes).map_err(refusal)?;
        self.saved.clone_from(&self.settings);
        self.settings_unreliable = false;
        Ok(())
    }
}
