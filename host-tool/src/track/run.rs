//! Running a path on a device: settings and model in, points sent ahead, telemetry out. The device can be any [`Transport`]'s.

use std::time::Duration;

use model_export::link::fault::Notice;
use model_export::link::message::{MAX_CHUNK_POINTS, PlaybackChunk, Reply, Request, Telemetry};
use model_export::link::state::State;

use super::rig::Truth;
use crate::control::{Sample, SettingValues};
use crate::experiment::{self, status};
use crate::interrupt;
use crate::link::{Client, LinkError, Transport};

/// How often the host looks after the device.
const ROUND: Duration = Duration::from_millis(20);
/// How long a device may take from one state to the next.
const STATE_WITHIN: Duration = Duration::from_secs(10);

/// What is in the way of a run.
#[derive(Debug, thiserror::Error)]
pub enum RunError {
    /// The link or the device refused.
    #[error(transparent)]
    Link(#[from] LinkError),
    /// The model did not get onto the device.
    #[error("{0:#}")]
    Model(anyhow::Error),
    /// The device did not get there.
    #[error("the device stays {found:?} instead of becoming {wanted:?}{}", why(*.fault))]
    State {
        /// Where it should be.
        wanted: State,
        /// Where it is.
        found: State,
        /// Its first fault.
        fault: u8,
    },
    /// Somebody pressed Ctrl-C.
    #[error("interrupted; the rig was told to vent")]
    Interrupted,
    /// The run ended before its last point.
    #[error("the device vented in mid-run{}", why(*.fault))]
    Vented {
        /// Its first fault.
        fault: u8,
    },
}

fn why(fault: u8) -> String {
    if fault == 0 { String::new() } else { format!(": {}", crate::link::fault_in_words(fault)) }
}

fn wait_for<T: Transport>(client: &mut Client<T>, wanted: State) -> Result<(), RunError> {
    let until = client.elapsed() + STATE_WITHIN;
    loop {
        let status = status(client)?;
        if status.state == wanted {
            return Ok(());
        }
        if client.elapsed() > until || status.state == State::Fault {
            return Err(RunError::State { wanted, found: status.state, fault: status.first_fault });
        }
        client.listen_for(Duration::from_millis(50))?;
    }
}

/// Puts settings and, if given, a model into force; the device is idle afterwards.
///
/// # Errors
/// When the device refuses one of them.
pub fn prepare<T: Transport>(client: &mut Client<T>, settings: &SettingValues, blob: Option<&[u8]>) -> Result<(), RunError> {
    wait_for(client, State::Idle)?;
    for (number, value) in settings {
        client.command(&Request::SettingSet { number: *number, value: *value })?;
    }
    if let Some(blob) = blob {
        experiment::upload(client, blob, &mut |_| {}).map_err(RunError::Model)?;
        let id = model_export::blob::content_id(blob).unwrap_or_default();
        client.command(&Request::ModelActivate { id })?;
        experiment::settle_after_change(client).map_err(RunError::Model)?;
        wait_for(client, State::Idle)?;
    }
    // New settings make the sensors prove themselves again.
    client.listen_for(Duration::from_millis(500))?;
    Ok(())
}

/// Runs a path of points, one each playback period, in the unit of the control law; gives the telemetry from the first point on.
/// `each` is called with every sample as it comes.
///
/// # Errors
/// When the device refuses to start or vents on the way.
pub fn run<T: Transport>(
    client: &mut Client<T>,
    points: &[f64],
    each: &mut dyn FnMut(&mut T, &Telemetry),
) -> Result<Vec<Telemetry>, RunError> {
    client.command(&Request::PlaybackClear)?;
    // The muscle may still be emptying from the run before.
    let until = client.elapsed() + STATE_WITHIN;
    while !status(client)?.blockers.is_empty() && client.elapsed() < until {
        client.listen_for(Duration::from_millis(50))?;
    }
    client.command(&Request::Arm)?;
    wait_for(client, State::Armed)?;
    let mut next = 0;
    let mut samples = Vec::new();
    let mut started = false;
    client.begin_account();
    let mut reply = feed(client, points, &mut next)?;
    loop {
        if let Some(Reply::Playback { next_index, free }) = reply {
            next = next_index as usize;
            if next < points.len() && usize::from(free) >= MAX_CHUNK_POINTS {
                reply = feed(client, points, &mut next)?;
                continue;
            }
        }
        if !started {
            client.command(&Request::Start)?;
            started = true;
        }
        if interrupt::is_requested() {
            client.ask(&Request::Vent)?;
            return Err(RunError::Interrupted);
        }
        client.listen_for(ROUND)?;
        let mut finished = false;
        while let Some(sample) = client.take_telemetry() {
            each(client.transport(), &sample);
            match sample.state {
                State::Running if sample.playback_index > 0 => samples.push(sample),
                State::Fault => return Err(RunError::Vented { fault: sample.first_fault }),
                State::Armed | State::Idle => finished = !samples.is_empty(),
                _ => {}
            }
        }
        if finished {
            break;
        }
        reply = feed(client, points, &mut next)?;
    }
    client.command(&Request::Disarm)?;
    wait_for(client, State::Idle)?;
    Ok(samples)
}

/// Sends the next piece of the path; an empty one says that the host still stands behind it.
fn feed<T: Transport>(client: &mut Client<T>, points: &[f64], next: &mut usize) -> Result<Option<Reply>, RunError> {
    let end = (*next + MAX_CHUNK_POINTS).min(points.len());
    let values_bar = points[*next..end].iter().map(|point| *point as f32).collect();
    let chunk = PlaybackChunk { first_index: *next as u32, last: end == points.len(), values_bar };
    match client.ask(&Request::Playback(chunk))? {
        Reply::Refused(model_export::link::message::Refusal::PlaybackFull(_)) => Ok(None),
        Reply::Refused(refusal) => Err(LinkError::Refused(refusal).into()),
        reply => Ok(Some(reply)),
    }
}

/// Telemetry with the true tip, where it is known; elsewhere the laser's.
#[must_use]
pub fn samples(telemetry: &[Telemetry], truth: &Truth) -> Vec<Sample> {
    let begin_ms = telemetry.first().map_or(0, |sample| sample.time_ms);
    let one = |sample: &Telemetry| {
        let tip_mm = truth.tip_mm(sample.time_ms).or(sample.displacement_mm.map(f64::from))?;
        let limited = [Notice::Ceiling, Notice::Floor, Notice::Slew].iter().any(|notice| sample.notices.contains(*notice));
        Some(Sample {
            time_s: (sample.time_ms - begin_ms) as f64 / 1000.0,
            reference_mm: f64::from(sample.set_point),
            tip_mm,
            output_bar: f64::from(sample.output_ubar) * 1e-6,
            pressure_bar: sample.pressure_bar.map(f64::from),
            estimate_mm: sample.estimate_mm.map(f64::from),
            limited,
            estimate_error_mm: sample.estimate_mm.and_then(|estimate| Some(f64::from(estimate) - truth.window_mm(sample.time_ms)?)),
        })
    };
    telemetry.iter().filter_map(one).collect()
}
