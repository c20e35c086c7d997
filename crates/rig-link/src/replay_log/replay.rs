//! Replay: the library runs a replay log's inputs again, and every output must be the same to the bit.

use firmware::tick::{Origin, Rig, TickOutputs};
use model_export::link::fault::Fault;
use model_export::link::state::ResetCause;
use model_export::link::trace::TraceRecord;
use serde::Serialize;

use super::file::{Event, Outputs, ReplayLog};
use super::traced::TracedRig;
use crate::link::{Cut, InProcess, LinkError, device_outputs};

/// What a replay found.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Replay {
    /// Ticks run again.
    pub ticks: u64,
    /// The first tick that came out otherwise.
    pub first_difference: Option<Difference>,
    /// Why the replay log does not go on, where it should.
    pub cut: Option<Cut>,
}

/// A tick that came out otherwise than recorded.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Difference {
    /// Number of the tick in the replay log, from 0.
    pub tick: u64,
    /// Time of its end, s after the beginning.
    pub time_s: f64,
    /// As recorded.
    pub recorded: Seen,
    /// As it came out.
    pub replayed: Seen,
}

/// What of a tick's outputs is compared.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(untagged)]
pub enum Seen {
    /// All of them.
    Outputs(Outputs),
    /// The record of a traced tick, with a check over its outputs and those of all before; absent where it would not be traced.
    Record(Option<TraceRecord>),
}

impl Replay {
    /// Counts a tick that ended at this time.
    fn count(&mut self, time_ms: u64, recorded: Seen, replayed: Seen) {
        if self.first_difference.is_none() && replayed != recorded {
            let (tick, time_s) = (self.ticks, time_ms as f64 * 1e-3);
            self.first_difference = Some(Difference { tick, time_s, recorded, replayed });
        }
        self.ticks += 1;
    }

    /// Whether every tick that there is came out as recorded.
    #[must_use]
    pub fn is_identical(&self) -> bool {
        self.first_difference.is_none()
    }
}

/// What a replay shows of each event to whoever watches.
pub(super) enum Step<'a> {
    /// The processor started.
    Boot { crash: Option<Fault>, reset_cause: ResetCause },
    /// It began again, for a trace.
    Begin,
    /// A tick came out like this.
    Tick { from_host: &'a [u8], outputs: &'a TickOutputs, rig: &'a Rig },
    /// A tick passed without the processor.
    Silence,
}

/// Runs a replay log again.
///
/// # Errors
/// When the device cannot be built at all.
pub fn replay(replay_log: &ReplayLog) -> Result<Replay, LinkError> {
    watch(replay_log, |_, _| ())
}

/// As [`replay`], showing each step with the ms since the beginning.
pub(super) fn watch(replay_log: &ReplayLog, mut show: impl FnMut(u64, Step<'_>)) -> Result<Replay, LinkError> {
    let mut processor = InProcess::new(replay_log.header.flash());
    let mut traced: Option<TracedRig> = None;
    let mut replay = Replay::default();
    let mut time_ms = 0;
    let mut to_host = Vec::new();
    for event in &replay_log.events {
        match event {
            Event::Boot { reset_cause, line_bytes_per_tick, crash } => {
                let crash = Fault::from_number(*crash);
                if let Some(fault) = crash {
                    processor.crash(fault);
                }
                processor.start(*reset_cause, *line_bytes_per_tick, &replay_log.header.board)?;
                show(time_ms, Step::Boot { crash, reset_cause: *reset_cause });
            }
            Event::Silence => {
                time_ms += 1;
                show(time_ms, Step::Silence);
            }
            Event::Tick(tick) => {
                time_ms += 1 + u64::from(tick.lost_ticks);
                to_host.clear();
                let Some(outputs) = processor.step(tick.inputs(), &tick.from_host, &mut to_host) else {
                    return Err(LinkError::Rig("the replay log has a tick before the first start".to_owned()));
                };
                let replayed = Outputs::new(&device_outputs(&outputs), &to_host);
                replay.count(time_ms, Seen::Outputs(tick.outputs), Seen::Outputs(replayed));
                if let Some(device) = processor.device() {
                    show(time_ms, Step::Tick { from_host: &tick.from_host, outputs: &outputs, rig: device.rig() });
                }
            }
            Event::Begin { time_ms: device_ms, late_ticks, reset_cause } => {
                let origin = Origin { time_ms: *device_ms, late_ticks: *late_ticks, reset_cause: *reset_cause };
                traced = Some(TracedRig::new(&replay_log.header, origin)?);
                show(time_ms, Step::Begin);
            }
            Event::Traced(tick) => {
                time_ms += 1 + tick.record.extra.map_or(0, |extra| u64::from(extra.lost_ticks));
                let Some(rig) = &mut traced else {
                    return Err(LinkError::Rig("the replay log has a traced tick before the trace's beginning".to_owned()));
                };
                let outputs = rig.step(tick)?;
                replay.count(time_ms, Seen::Record(Some(tick.record)), Seen::Record(outputs.trace));
                show(time_ms, Step::Tick { from_host: &tick.from_host, outputs: &outputs, rig: rig.rig() });
            }
            Event::Cut(cut) => replay.cut = Some(*cut),
            Event::Recording { .. } => {}
        }
    }
    Ok(replay)
}
