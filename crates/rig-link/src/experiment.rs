//! Experiments on a rig: an excitation is sent ahead piece by piece, played back by the device, and the telemetry becomes a recording.
//!
//! The settings that a recording needs (control law, playback and telemetry period) are changed for the experiment and set back after it;
//! nothing is saved. Samples that do not arrive are counted and leave a gap; nothing is filled in.

use std::path::Path;
use std::time::Duration;

use anyhow::{Context, Result, bail, ensure};
use model_export::blob::crc32;
use model_export::link::fault::Blocker;
use model_export::link::message::{FaultRecord, MAX_CHUNK_BYTES, Reply, Request, Status, Telemetry};
use model_export::link::settings::SettingValue;
use model_export::link::state::State;

use crate::device_settings;
use crate::feed::Feed;
use crate::interrupt;
use crate::link::{Account, Client, LinkError, Transport, fault_in_words, state_name};
use crate::replay_log::{ReplayLog, Tracing};
use crate::status::{PATIENCE, wait};
pub use crate::status::{settle, settle_after_change, status};
use recording::{ExtraColumn, Recording, Signal};
use simulation::excitation::{ExcitationConfig, Limits};

/// Points in the device's buffer before the start: more than a second, so that a busy host is not noticed.
const POINTS_AHEAD: u32 = 128;
/// How often a host that has nothing to send says that it is there; a fifth of the default host timeout.
const KEEP_ALIVE: Duration = Duration::from_millis(50);
/// What an experiment gave.
#[derive(Clone, Debug)]
pub struct Outcome {
    /// Samples from the first played point to the last.
    pub samples: Vec<Telemetry>,
    /// What did not arrive.
    pub account: Account,
    /// Why it ended early.
    pub fault: Option<FaultRecord>,
    /// Points of the excitation.
    pub points: usize,
    /// What the device told of its ticks, if that was wanted.
    pub replay_log: Option<ReplayLog>,
}

/// A replay log that is wanted over the link.
#[derive(Clone, Copy, Debug)]
pub struct OverTheLink<'a> {
    /// Name of the backend, for the replay log.
    pub backend: &'a str,
    /// The model in use, if there is one.
    pub blob: Option<&'a [u8]>,
}

/// Sends a blob piece by piece, which the device then checks; `each` is told the bytes that have arrived.
///
/// # Errors
/// When the device refuses it or is gone.
pub fn upload(rig: &mut Client<impl Transport>, bytes: &[u8], each: &mut dyn FnMut(u32)) -> Result<()> {
    let length = u32::try_from(bytes.len()).context("the blob is too long")?;
    rig.command(&Request::ModelBegin { length, crc32: crc32(0, bytes) })?;
    for (index, piece) in bytes.chunks(MAX_CHUNK_BYTES).enumerate() {
        let offset = u32::try_from(index * MAX_CHUNK_BYTES).context("the blob is too long")?;
        let bytes = heapless::Vec::from_slice(piece).unwrap_or_default();
        let request = Request::ModelChunk { offset, bytes };
        let Reply::Uploaded(next) = rig.request(&request)? else { return Err(rig.unexpected(&request).into()) };
        each(next);
    }
    rig.command(&Request::ModelFinish)?;
    // The check may take the place of the model in use, after which the device tests itself.
    settle_after_change(rig)?;
    Ok(())
}

/// Whole milliseconds of a sample period.
fn period_ms(excitation: &ExcitationConfig) -> Result<u32> {
    let period_ms = (excitation.sample_period_s * 1e3).round();
    let whole = (excitation.sample_period_s * 1e3 - period_ms).abs() < 1e-6 && (1.0..=1000.0).contains(&period_ms);
    ensure!(whole, "sample_period_s is {}: a rig plays whole milliseconds, from 0.001 to 1 s", excitation.sample_period_s);
    Ok(period_ms as u32)
}

/// Plays an excitation and records it; the excitation is checked against the device's ceiling first.
///
/// A fault on the way ends the experiment and is part of the outcome.
///
/// # Errors
/// When the excitation does not fit the rig, the rig is not ready, the replay log cannot be had, or the device is gone.
pub fn record(
    rig: &mut Client<impl Transport>,
    excitation: &ExcitationConfig,
    limits: &Limits,
    replay_log: Option<OverTheLink<'_>>,
) -> Result<Outcome> {
    let period_ms = period_ms(excitation)?;
    let SettingValue::Float(ceiling_bar) = device_settings::setting(rig, "limits.ceiling_bar")? else {
        bail!("limits.ceiling_bar is no pressure")
    };
    let limits = Limits { maximum_bar: limits.maximum_bar.min(f64::from(ceiling_bar)), ..*limits };
    let samples = excitation.sample_within(&limits)?;
    let points: Vec<f32> = samples.pressure_bar.iter().map(|bar| *bar as f32).collect();
    record_points(rig, &points, period_ms, replay_log)
}

/// As [`record`], for pressures in bar, one each period; the limiter of the device sees to the limits.
///
/// # Errors
/// As [`record`].
pub fn record_points(
    rig: &mut Client<impl Transport>,
    points: &[f32],
    period_ms: u32,
    replay_log: Option<OverTheLink<'_>>,
) -> Result<Outcome> {
    let ready = settle(rig)?;
    if ready.state != State::Idle {
        bail!(
            "the rig is not idle but in the state `{}`{}; `catheter rig ... explain` says what to do",
            state_name(ready.state),
            if ready.first_fault == 0 { String::new() } else { format!(" ({})", fault_in_words(ready.first_fault)) }
        );
    }
    let wanted = [
        ("control.law", SettingValue::Integer(0)),
        ("playback.period_ms", SettingValue::Integer(period_ms)),
        ("telemetry.period_ms", SettingValue::Integer(period_ms)),
    ];
    let borrowed = device_settings::borrow(rig, &wanted)?;
    let outcome = play_for(rig, points, Duration::from_millis(period_ms.into()), replay_log);
    // Whatever happened: out of the energised states, and the settings back.
    let _ = rig.ask(&Request::Disarm);
    device_settings::give_back(rig, borrowed)?;
    outcome
}

/// As [`play`], with the replay log that is wanted.
fn play_for(rig: &mut Client<impl Transport>, points: &[f32], period: Duration, replay_log: Option<OverTheLink<'_>>) -> Result<Outcome> {
    let Some(OverTheLink { backend, blob }) = replay_log else { return play(rig, points, period) };
    let tracing = Tracing::begin(rig, backend, blob)?;
    let played = play(rig, points, period);
    let replay_log = Some(tracing.end(rig));
    played.map(|outcome| Outcome { replay_log, ..outcome })
}

/// Sends points ahead, starts, and listens until the end.
fn play(rig: &mut Client<impl Transport>, points: &[f32], period: Duration) -> Result<Outcome> {
    rig.command(&Request::PlaybackClear)?;
    let mut feed = Feed::new(points.to_vec());
    while feed.confirmed() < POINTS_AHEAD.min(feed.length()) {
        let chunk = feed.chunk();
        feed.take(&rig.request(&Request::Playback(chunk))?);
    }
    // Changed settings and a fresh vent make the device ask for a moment.
    wait(rig, "readiness for arming", |status| status.blockers.is_empty() || blocked_for_long(status))?;
    rig.command(&Request::Arm)?;
    rig.command(&Request::Start)?;
    rig.begin_account();
    let bar = output::progress(feed.length().into(), "recording");
    let length = period * feed.length();
    let until = rig.elapsed() + length + PATIENCE;
    let mut outcome = Outcome { samples: Vec::new(), account: Account::default(), fault: None, points: points.len(), replay_log: None };
    let mut waiting = None;
    let mut last_sent = rig.elapsed();
    let (mut started, mut ended) = (false, false);
    while !ended {
        if interrupt::is_requested() {
            let _ = rig.ask(&Request::Vent);
            bail!("interrupted; the rig was told to vent");
        }
        rig.listen(Duration::from_millis(5))?;
        if let Some(token) = waiting
            && let Some(reply) = rig.take_reply(token)
        {
            feed.take(&reply);
            waiting = None;
        }
        // A reply that does not come was lost; the device confirms again what it has.
        let due = rig.elapsed() >= last_sent + KEEP_ALIVE;
        if due || (waiting.is_none() && feed.has_room()) {
            waiting = Some(rig.send(&Request::Playback(feed.chunk()))?);
            last_sent = rig.elapsed();
        }
        while let Some(sample) = rig.take_telemetry() {
            bar.set_position(sample.playback_index.into());
            match sample.state {
                State::Running => {
                    started = true;
                    if sample.playback_index > 0 {
                        outcome.samples.push(sample);
                    }
                }
                State::Fault => ended = true,
                // One from before the start may still have been on its way.
                _ => ended |= started,
            }
        }
        if rig.elapsed() > until {
            bail!("the experiment should be over and the device does not say so; it vents by itself");
        }
    }
    bar.finish_and_clear();
    outcome.account = rig.account().clone();
    let ended_as = status(rig)?;
    if ended_as.first_fault != 0 {
        outcome.fault = fault_record(rig)?;
    }
    Ok(outcome)
}

/// What may speak against arming for a moment, after changed settings or a vent, and passes by itself.
pub const PASSING: [Blocker; 4] = [Blocker::LaserNotPlausible, Blocker::PressureNotPlausible, Blocker::VentNotVerified, Blocker::LoopLate];

/// What can only go away if somebody does something.
#[must_use]
pub fn blocked_for_long(status: &Status) -> bool {
    status.blockers.iter().any(|blocker| !PASSING.contains(&blocker))
}

/// The fault record of this run, if there is one.
///
/// # Errors
/// When the device is gone.
pub fn fault_record(rig: &mut Client<impl Transport>) -> Result<Option<FaultRecord>, LinkError> {
    match rig.ask(&Request::FaultRecord)? {
        Reply::FaultRecord(record) => Ok(Some(record)),
        _ => Ok(None),
    }
}

impl Outcome {
    /// The samples as a recording; those without a believed displacement are left out, which makes a gap.
    ///
    /// # Errors
    /// When nothing is left.
    pub fn recording(&self, path: &Path) -> Result<Recording> {
        let rows: Vec<(&Telemetry, f32)> = self.samples.iter().filter_map(|sample| Some((sample, sample.displacement_mm?))).collect();
        ensure!(!rows.is_empty(), "not one sample arrived; {} were lost on the line", self.account.lost_on_the_line);
        let start_ms = rows.first().map_or(0, |(sample, _)| sample.time_ms);
        let start_sequence = rows.first().map_or(0, |(sample, _)| sample.sequence);
        let time_s = rows.iter().map(|(sample, _)| (sample.time_ms - start_ms) as f64 * 1e-3).collect();
        let input = rows.iter().map(|(sample, _)| f64::from(sample.command_bar)).collect();
        let output = rows.iter().map(|(_, displacement_mm)| f64::from(*displacement_mm)).collect();
        let signals = (Signal::pressure_bar(), Signal::displacement_mm());
        let mut recording = Recording::new(path, signals.0, signals.1, time_s, input, output)?;
        let column = |name: &str, value: &dyn Fn(&Telemetry) -> f64| ExtraColumn {
            name: name.to_owned(),
            values: rows.iter().map(|(sample, _)| value(sample)).collect(),
        };
        recording.extra.push(column("sequence", &|sample| f64::from(sample.sequence.wrapping_sub(start_sequence))));
        recording.mark_lost_samples();
        if rows.iter().all(|(sample, _)| sample.pressure_bar.is_some()) {
            recording.extra.push(column("pressure_measured_bar", &|sample| f64::from(sample.pressure_bar.unwrap_or_default())));
        }
        Ok(recording)
    }
}
