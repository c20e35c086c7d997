//! Traces: a replay log that came over the link, and the rig that runs it again.
//!
//! On a board link and tick run side by side, and what comes first is chance; only what the tick took, and when, can be run again. So
//! the tick alone runs here, with the code of the link that turns requests into its commands, and the model that the replay log brought.

use std::time::Duration;

use firmware::background::ModelPlace;
use firmware::link::{CommandSink, Link, LinkConfig, Measured};
use firmware::tick::{Action, Command, ModelStep, Origin, Rig, TickConfig, TickInputs, TickOutputs};
use model_export::link::fault::{Blocker, Fault};
use model_export::link::settings::{INFO, Settings};
use model_export::link::trace::{TraceCommand, TraceExtra, TraceFlags};

use super::file::{Event, Header, ReplayLog};
use crate::device_settings;
use crate::link::{Client, FACTS, FlashMemory, Heap, LinkError, SlotPair, Trace, TracedTick, Transport};
use crate::status;

/// How long venting may take; the device itself calls it a fault after a second.
const VENTED_WITHIN: Duration = Duration::from_millis(1500);

/// A replay log over the link while it is being written.
pub struct Tracing {
    header: Header,
    origin: Origin,
}

/// Why no replay log can be written over the link.
#[derive(Debug, thiserror::Error)]
pub enum TracingError {
    /// The device or the line to it.
    #[error(transparent)]
    Link(#[from] LinkError),
    /// The model is not at hand.
    #[error(
        "the device runs the model {id}, and a replay log without it could not be run again; name its blob with --model, or do without a replay log (--no-journal)"
    )]
    Model {
        /// First bytes of its content hash.
        id: String,
    },
    /// Something on the way.
    #[error("{0:#}")]
    Other(anyhow::Error),
}

impl Tracing {
    /// Makes the device begin again and tell every tick from then on; it must be idle, and is so afterwards. `blob` is the model in use.
    ///
    /// # Errors
    /// When the device refuses, or has a model that is not `blob`.
    pub fn begin<T: Transport>(client: &mut Client<T>, backend: &str, blob: Option<&[u8]>) -> Result<Self, TracingError> {
        let hello = client.greet_again()?.clone();
        let id = |blob: &[u8]| model_export::blob::decode(blob).ok().and_then(|blob| blob.content_hash.first_chunk::<8>().copied());
        let wanted = Some(hello.model_id).filter(|id| *id != [0; 8]);
        let blob = blob.filter(|_| wanted.is_some());
        if blob.and_then(id) != wanted {
            return Err(TracingError::Model { id: hello.model_id.iter().map(|byte| format!("{byte:02x}")).collect() });
        }
        let settings = settings_in_use(client).map_err(TracingError::Other)?;
        let flash = blob.map_or_else(|| Ok(FlashMemory::default()), FlashMemory::with_model);
        let flash = flash.and_then(|flash| flash.with_settings(&settings)).map_err(TracingError::Other)?;
        let header = Header::new(backend, &hello.board, String::new(), &flash);
        // After a run the muscle may still be emptying.
        let until = client.elapsed() + VENTED_WITHIN;
        while status::status(client)?.blockers.contains(Blocker::VentNotVerified) && client.elapsed() < until {
            client.listen_for(Duration::from_millis(20))?;
        }
        let origin = client.begin_trace()?;
        status::settle(client).map_err(TracingError::Other)?;
        Ok(Self { header, origin })
    }

    /// Ends it, whatever state the device is in; a device that does not answer any more leaves a replay log of what it told.
    pub fn end<T: Transport>(self, client: &mut Client<T>) -> ReplayLog {
        let Trace { origin, ticks, cut } = client.end_trace(self.origin);
        let Origin { time_ms, late_ticks, reset_cause } = origin;
        let mut events = vec![Event::Begin { time_ms, late_ticks, reset_cause }];
        events.extend(ticks.into_iter().map(Event::Traced));
        events.extend(cut.map(Event::Cut));
        ReplayLog { header: self.header, events }
    }
}

/// Every setting in use.
fn settings_in_use<T: Transport>(client: &mut Client<T>) -> anyhow::Result<Settings> {
    let mut settings = Settings::default();
    for info in INFO {
        let value = device_settings::setting(client, info.name)?;
        settings.set(info.number, value).map_err(|error| anyhow::anyhow!("{}: the device has {value:?} ({error:?})", info.name))?;
    }
    Ok(settings)
}

/// The rig that runs a trace again.
pub(super) struct TracedRig {
    rig: Rig,
    link: Link<SlotPair, SlotPair>,
    place: Heap,
    beat: u32,
}

#[derive(Default)]
struct Queue {
    command: Option<Command>,
}

impl CommandSink for Queue {
    fn send(&mut self, command: Command) -> bool {
        self.command = Some(command);
        true
    }

    /// The record says in which tick.
    fn vent(&mut self) {}
}

impl TracedRig {
    /// The rig as the device was when the trace began.
    pub(super) fn new(header: &Header, origin: Origin) -> Result<Self, LinkError> {
        let FlashMemory { settings, models } = header.flash();
        let config = LinkConfig {
            firmware: header.firmware,
            board: heapless::String::try_from(header.board.as_str()).unwrap_or_default(),
            reset_cause: origin.reset_cause,
            previous_record: None,
            facts: FACTS,
        };
        let mut link = Link::new(config, settings, models);
        link.take_every_session();
        let tick = TickConfig { settings: link.settings(), facts: FACTS }.build();
        let tick = tick.map_err(|number| LinkError::Rig(format!("the replay log's settings do not go together: {number:?}")))?;
        Ok(Self { rig: Rig::begun_again(tick, origin), link, place: Heap::default(), beat: 0 })
    }

    /// The rig after its last tick.
    pub(super) fn rig(&self) -> &Rig {
        &self.rig
    }

    /// Does a tick again.
    pub(super) fn step(&mut self, TracedTick { record, from_host }: &TracedTick) -> Result<TickOutputs, LinkError> {
        let flags = record.flags;
        let has = |flag| flags.contains(flag);
        self.beat = self.beat.wrapping_add(u32::from(has(TraceFlags::BEAT)));
        if has(TraceFlags::MODEL) != self.place.is_present() {
            self.change_model()?;
        }
        let TraceExtra { lost_ticks, command } = record.extra.unwrap_or_default();
        let inputs = TickInputs {
            sample: firmware::drivers::RawSample { laser_code: record.laser_code, pressure_code: record.pressure_code },
            emergency_stop: has(TraceFlags::EMERGENCY_STOP),
            overran: has(TraceFlags::OVERRAN),
            lost_ticks,
            background_beat: self.beat,
            vent: has(TraceFlags::VENT),
            command: self.command(command, from_host)?,
            telemetry_dropped: 0,
        };
        let outputs = self.rig.tick(&mut self.place, inputs);
        self.link.observe(outputs.state, outputs.vent_verified, Measured::default());
        if let Some(answer) = &outputs.answer {
            self.link.answer(answer.clone());
        }
        // What it would say to the host is of no interest here.
        while self.link.transmit().is_some() {}
        Ok(outputs)
    }

    /// A model came or went, as the background wanted it.
    fn change_model(&mut self) -> Result<(), LinkError> {
        if self.place.is_present() {
            self.place.forget();
            return Ok(());
        }
        let blob = self.link.model_blob().ok_or_else(|| LinkError::Rig("the trace has a model and the replay log has none".to_owned()))?;
        let admitted = self.place.load(blob);
        admitted.map(|_| ()).map_err(|fault| LinkError::Rig(format!("the replay log's model does not pass the self-test: {fault:?}")))
    }

    /// The command that the tick took.
    fn command(&mut self, named: TraceCommand, from_host: &[u8]) -> Result<Option<Command>, LinkError> {
        let own = |action| Some(Command { token: None, action });
        Ok(match named {
            TraceCommand::None => None,
            TraceCommand::Retest => own(Action::Request(firmware::supervisor::Event::Retest)),
            TraceCommand::Raise(number) => own(Action::Raise(Fault::from_number(number).unwrap_or(Fault::InternalInconsistent))),
            TraceCommand::SelfTestReport { faults, model_period } => {
                own(Action::SelfTestReport { faults, model_period: core::num::NonZeroU16::new(model_period) })
            }
            TraceCommand::Request(token) => {
                let mut queue = Queue::default();
                for byte in from_host {
                    self.link.receive(*byte, &mut queue);
                }
                let command = queue.command.filter(|command| command.token == Some(token));
                Some(command.ok_or_else(|| LinkError::Rig(format!("the replay log does not have the request {token} that a tick took")))?)
            }
        })
    }
}
