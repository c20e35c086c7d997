//! An excitation: sampled, checked against the device's limits, loaded, and sent ahead.

use anyhow::{Context, Result, bail, ensure};
use model_export::link::message::Request;
use model_export::link::settings::SettingValue;
use serde_json::Value;
use simulation::excitation::{ExcitationConfig, Limits};

use super::limits::KnownLimits;
use super::play::Play;
use super::rig::OperatedRig;

/// Points that the device has before a start: more than a second at 20 ms.
const POINTS_AHEAD: u32 = 128;
/// Longest excitation that is drawn and played from the page: what takes longer to sample would keep heartbeats waiting.
const MOST_POINTS: f64 = 100_000.0;

/// Limits of the device for an excitation.
fn limits(known: &KnownLimits) -> Limits {
    Limits { maximum_bar: known.ceiling_bar.into(), maximum_slew_bar_per_s: known.slew_bar_per_s.into(), ..Limits::default() }
}

impl OperatedRig {
    /// Sends what the device shall have before the start.
    pub(super) fn send_ahead(&mut self) -> Result<()> {
        let play = self.play.as_mut().context("load an excitation first")?;
        self.borrowed.borrow(&mut self.client, "playback.period_ms", SettingValue::Integer(play.period_ms))?;
        self.client.command(&Request::PlaybackClear)?;
        play.rewind();
        while play.feed.confirmed() < POINTS_AHEAD.min(play.feed.length()) {
            let reply = self.client.request(&Request::Playback(play.feed.chunk()))?;
            play.take(&reply);
        }
        Ok(())
    }

    pub(super) fn sampled(&self, excitation: &Value) -> Result<(ExcitationConfig, Vec<f64>, Option<String>)> {
        let config: ExcitationConfig = serde_json::from_value(excitation.clone()).context("this is no excitation")?;
        let points = config.segments.iter().map(|segment| segment.duration_s).sum::<f64>() / config.sample_period_s;
        ensure!(
            points <= MOST_POINTS,
            "{points:.0} points are too many for the page, which plays up to {MOST_POINTS:.0}; `catheter rig record` plays more"
        );
        let samples = config.sample()?;
        let checked = limits(&self.limits).check(&samples, &config);
        let period_ms = config.sample_period_s * 1e3;
        let whole = (period_ms - period_ms.round()).abs() < 1e-6 && (1.0..=1000.0).contains(&period_ms.round());
        let not_whole =
            (!whole).then(|| format!("sample_period_s is {}: a rig plays whole milliseconds, 0.001 to 1 s", config.sample_period_s));
        let problem = checked.err().map(|error| error.to_string()).or(not_whole);
        Ok((config, samples.pressure_bar, problem))
    }

    pub(super) fn load(&mut self, excitation: &Value) -> Result<()> {
        ensure!(!self.phase.is_energised(), "not while the rig is armed: vent first");
        let (config, pressure_bar, problem) = self.sampled(excitation)?;
        if let Some(problem) = problem {
            bail!("{problem}");
        }
        let points = pressure_bar.iter().map(|bar| *bar as f32).collect();
        self.play = Some(Play::new(points, (config.sample_period_s * 1e3).round() as u32));
        Ok(())
    }
}
