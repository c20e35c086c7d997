//! Replay: the library runs a journal's inputs again, and every output must be the same to the bit.

use firmware::tick::TickOutputs;
use model_export::link::fault::Fault;
use model_export::link::state::ResetCause;
use serde::Serialize;

use super::{Event, Journal, Outputs, Tick};
use crate::link::{HostDevice, InProcess, LinkError, device_outputs};

/// What a replay found.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Replay {
    /// Ticks run again.
    pub ticks: u64,
    /// The first tick that came out otherwise.
    pub first_difference: Option<Difference>,
}

/// A tick that came out otherwise than recorded.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Difference {
    /// Number of the tick in the journal, from 0.
    pub tick: u64,
    /// Time of its end, s after the beginning.
    pub time_s: f64,
    /// As recorded.
    pub recorded: Outputs,
    /// As it came out.
    pub replayed: Outputs,
}

impl Replay {
    /// Whether every tick came out as recorded.
    #[must_use]
    pub fn is_identical(&self) -> bool {
        self.first_difference.is_none()
    }
}

/// What a replay shows of each event to whoever watches.
pub(super) enum Step<'a> {
    /// The processor started.
    Boot { crash: Option<Fault>, reset_cause: ResetCause },
    /// A tick came out like this.
    Tick { tick: &'a Tick, outputs: &'a TickOutputs, device: &'a HostDevice },
    /// A tick passed without the processor.
    Silence,
}

/// Runs a journal again.
///
/// # Errors
/// When the device cannot be built at all.
pub fn replay(journal: &Journal) -> Result<Replay, LinkError> {
    watch(journal, |_, _| ())
}

/// As [`replay`], showing each step with the ms since the beginning.
pub(super) fn watch(journal: &Journal, mut show: impl FnMut(u64, Step<'_>)) -> Result<Replay, LinkError> {
    let mut processor = InProcess::new(journal.header.flash());
    let mut replay = Replay::default();
    let mut time_ms = 0;
    let mut to_host = Vec::new();
    for event in &journal.events {
        match event {
            Event::Boot { reset_cause, line_bytes_per_tick, crash } => {
                let crash = Fault::from_number(*crash);
                if let Some(fault) = crash {
                    processor.crash(fault);
                }
                processor.start(*reset_cause, *line_bytes_per_tick, &journal.header.board)?;
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
                    return Err(LinkError::Rig("the journal has a tick before the first start".to_owned()));
                };
                let replayed = Outputs::new(&device_outputs(&outputs), &to_host);
                if replay.first_difference.is_none() && replayed != tick.outputs {
                    let (tick, recorded, time_s) = (replay.ticks, tick.outputs, time_ms as f64 * 1e-3);
                    replay.first_difference = Some(Difference { tick, time_s, recorded, replayed });
                }
                if let Some(device) = processor.device() {
                    show(time_ms, Step::Tick { tick, outputs: &outputs, device });
                }
                replay.ticks += 1;
            }
        }
    }
    Ok(replay)
}
