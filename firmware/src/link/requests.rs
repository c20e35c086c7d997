//! What a session keeps besides its bytes, and what becomes of each request.

use model_export::link::fault::{Blocker, BlockerSet, Fault, FaultSet};
use model_export::link::hello::Hello;
use model_export::link::message::{Baseline, Refusal, Reply, Request, RestNoise};
use model_export::link::settings::{SettingError, Settings};
use model_export::link::state::State;
use model_export::link::{PROTOCOL, SCHEMA_HASH};

use super::session::Sessions;
use super::{CommandSink, Event, Identity, LinkConfig, Measured};
use crate::control::SetPoint;
use crate::model::{self, ModelFacts};
use crate::settings::{self, STORE_KIND, STORE_VERSION, Stored};
use crate::storage::{Flash, Store, Upload};
use crate::supervisor;
use crate::tick::{Action, Command, TickConfig};

/// Everything but the bytes.
#[derive(Debug)]
pub(super) struct SessionState<S, M> {
    pub(super) config: LinkConfig,
    pub(super) settings_store: Store<S>,
    pub(super) model_store: Store<M>,
    pub(super) settings: Settings,
    pub(super) saved: Settings,
    /// Settings on their way through the tick, and the token of the request they came with.
    pub(super) proposed: Settings,
    pub(super) proposal: Option<u32>,
    pub(super) boot_faults: FaultSet,
    /// What was saved is damaged or not acceptable, and nothing was saved since.
    pub(super) settings_unreliable: bool,
    pub(super) upload: Option<Upload>,
    /// Token of the request that waits for the check of the upload.
    pub(super) checking: Option<u32>,
    pub(super) model: Option<ModelFacts>,
    pub(super) state: State,
    pub(super) vent_verified: bool,
    pub(super) awaited: u16,
    pub(super) measured: Measured,
    pub(super) damaged_frames: u32,
    pub(super) telemetry_dropped: u32,
    pub(super) trace: TraceProgress,
    pub(super) sessions: Sessions,
    pub(super) identity: Identity,
    /// Token and first row of the request that waits for the history.
    pub(super) history_wanted: Option<(u32, u16)>,
    pub(super) bootloader_wanted: bool,
}

/// How far a trace is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum TraceProgress {
    /// None runs; what is left of the last one goes at once.
    Off,
    /// The tick was asked for one by the request with this token.
    Asked(u32),
    /// One runs.
    On,
}

/// What becomes of a request.
pub(super) enum Outcome {
    /// It is answered.
    Reply(Reply),
    /// It is carried out, or not.
    Done(Result<(), Refusal>),
    /// The tick will answer.
    Sent,
    /// The board has to do something; a change of the model is done, the check of one answers later.
    Event(Event),
}

impl<S: Flash, M: Flash> SessionState<S, M> {
    pub(super) fn new(config: LinkConfig, settings_flash: S, model_flash: M) -> Self {
        let settings_store = Store::new(settings_flash, STORE_KIND, STORE_VERSION);
        let model_store = Store::new(model_flash, model::STORE_KIND, model::STORE_VERSION);
        let mut boot_faults = FaultSet::EMPTY;
        let Stored { mut settings, is_damaged, .. } = settings::load(&settings_store);
        let goes_together = TickConfig { settings: &settings, facts: config.facts }.build().is_ok();
        let settings_unreliable = is_damaged || !goes_together;
        boot_faults.insert_if(settings_unreliable, Fault::SettingsInvalid);
        boot_faults.insert_if(model_store.select().is_damaged, Fault::ModelCorrupt);
        if !goes_together {
            settings.clone_from(&Settings::DEFAULT);
        }
        Self {
            config,
            settings_store,
            model_store,
            saved: settings.clone(),
            proposed: settings.clone(),
            settings,
            proposal: None,
            boot_faults,
            settings_unreliable,
            upload: None,
            checking: None,
            model: None,
            state: State::Boot,
            vent_verified: false,
            awaited: 0,
            measured: Measured::default(),
            damaged_frames: 0,
            telemetry_dropped: 0,
            trace: TraceProgress::Off,
            sessions: Sessions::default(),
            identity: Identity::default(),
            history_wanted: None,
            bootloader_wanted: false,
        }
    }

    pub(super) fn begin_session(&mut self) {
        self.sessions.begin(self.measured.noise);
    }

    pub(super) fn hello(&self) -> Hello {
        Hello {
            firmware: self.config.firmware,
            protocol: PROTOCOL,
            schema_hash: SCHEMA_HASH,
            model_id: self.model.map_or([0; 8], |model| model.id),
            reset_cause: self.config.reset_cause,
            board: self.config.board.clone(),
            session: self.sessions.number.unwrap_or(0),
            build: self.identity.build,
        }
    }

    /// What an answer of the tick settles, and what the tick could not know for it.
    pub(super) fn complete(&mut self, token: u32, reply: &mut Reply) {
        self.awaited = self.awaited.saturating_sub(1);
        if self.proposal.take_if(|proposal| *proposal == token).is_some() && matches!(reply, Reply::Done) {
            self.settings.clone_from(&self.proposed);
        }
        if self.trace == TraceProgress::Asked(token) {
            self.trace = if matches!(reply, Reply::Status(_)) { TraceProgress::On } else { TraceProgress::Off };
        }
        if let Reply::Status(status) = reply {
            status.longest_tick_cycles = self.measured.longest_tick_cycles;
            status.stack_unused_bytes = self.measured.stack_unused_bytes;
            status.damaged_frames = self.damaged_frames;
            status.telemetry_dropped = self.telemetry_dropped;
            status.settings_unsaved = self.settings != self.saved;
        }
    }

    pub(super) fn request(&mut self, token: u32, request: &Request, commands: &mut impl CommandSink) -> Outcome {
        if self.trace != TraceProgress::Off && request.is_beyond_a_trace() {
            return Outcome::Done(Err(Refusal::Traced));
        }
        match request {
            Request::Status => self.send(token, Action::Status, commands),
            Request::Arm => self.send(token, Action::Request(supervisor::Event::Arm), commands),
            Request::Disarm => self.send(token, Action::Request(supervisor::Event::Disarm), commands),
            Request::Start => self.send(token, Action::Request(supervisor::Event::Start), commands),
            Request::Stop => self.send(token, Action::Request(supervisor::Event::Stop), commands),
            Request::Vent => {
                // Past the queue, and never refused.
                commands.vent();
                Outcome::Reply(Reply::Done)
            }
            Request::Acknowledge => self.send(token, Action::Request(supervisor::Event::Acknowledge), commands),
            Request::SetPoint { quantity, value } => self.send(token, Action::SetPoint(SetPoint::Value(*quantity, *value)), commands),
            Request::Playback(chunk) => self.send(token, Action::SetPoint(SetPoint::Chunk(chunk.clone())), commands),
            Request::PlaybackClear => self.send(token, Action::PlaybackClear, commands),
            Request::FaultRecord => self.send(token, Action::FaultRecord, commands),
            Request::ControlReport => self.send(token, Action::ControlReport, commands),
            Request::AdaptationReport => self.send(token, Action::AdaptationReport, commands),
            Request::RestNoise => Outcome::Reply(self.rest_noise().map_or(Reply::Refused(Refusal::NoRecord), Reply::RestNoise)),
            Request::History { .. } if !self.identity.has_history => Outcome::Done(Err(Refusal::NoRecord)),
            Request::History { from_row } => {
                self.history_wanted = Some((token, *from_row));
                Outcome::Sent
            }
            Request::EnterBootloader if !self.identity.has_bootloader => Outcome::Done(Err(Refusal::NotUnderstood)),
            // The program that is rewritten must not be the one that holds the pressure.
            Request::EnterBootloader => Outcome::Done(self.may_write().map(|()| self.bootloader_wanted = true)),
            Request::TraceBegin => {
                let outcome = self.send(token, Action::TraceBegin, commands);
                if matches!(outcome, Outcome::Sent) && self.trace == TraceProgress::Off {
                    self.trace = TraceProgress::Asked(token);
                }
                outcome
            }
            Request::TraceEnd => {
                self.trace = TraceProgress::Off;
                self.send(token, Action::TraceEnd, commands)
            }
            Request::PreviousFaultRecord => {
                Outcome::Reply(self.config.previous_record.map_or(Reply::Refused(Refusal::NoRecord), Reply::FaultRecord))
            }
            Request::SettingGet { number } => Outcome::Reply(match self.settings.get(*number) {
                Some(value) => Reply::Setting(value),
                None => Reply::Refused(Refusal::Setting(SettingError::Unknown)),
            }),
            Request::SettingSet { number, value } => {
                if self.proposal.is_some() {
                    return Outcome::Done(Err(Refusal::Busy));
                }
                self.proposed.clone_from(&self.settings);
                match self.proposed.set(*number, *value) {
                    Ok(()) => self.propose(token, commands),
                    Err(error) => Outcome::Done(Err(Refusal::Setting(error))),
                }
            }
            Request::SettingsRevert(baseline) => {
                if self.proposal.is_some() {
                    return Outcome::Done(Err(Refusal::Busy));
                }
                match baseline {
                    Baseline::Saved => self.proposed.clone_from(&self.saved),
                    Baseline::Defaults => self.proposed.clone_from(&Settings::DEFAULT),
                }
                self.propose(token, commands)
            }
            Request::SettingsDifference { baseline, from_number } => Outcome::Reply(self.differences(*baseline, *from_number)),
            Request::SettingsSave => Outcome::Done(self.save_settings()),
            Request::ModelBegin { length, crc32 } => Outcome::Done(self.begin_upload(*length, *crc32)),
            Request::ModelChunk { offset, bytes } => match self.write_upload(*offset, bytes) {
                Ok(next_offset) => Outcome::Reply(Reply::Uploaded(next_offset)),
                Err(refusal) => Outcome::Done(Err(refusal)),
            },
            Request::ModelFinish => match self.check_upload() {
                Ok(()) => {
                    self.checking = Some(token);
                    Outcome::Event(Event::ModelUploaded)
                }
                Err(refusal) => Outcome::Done(Err(refusal)),
            },
            Request::ModelActivate { id } => {
                // As often as it is asked for: the reply to the first request may have been lost.
                if self.active_model() == Some(*id) {
                    return Outcome::Done(Ok(()));
                }
                match self.activate(*id) {
                    Ok(()) => Outcome::Event(Event::ModelChanged),
                    Err(refusal) => Outcome::Done(Err(refusal)),
                }
            }
            Request::Models => {
                let other = self.model_store.inactive_whole().and_then(|slot| self.model_in(slot));
                Outcome::Reply(Reply::Models { active: self.active_model().unwrap_or([0; 8]), other: other.unwrap_or([0; 8]) })
            }
        }
    }

    /// The noise at rest in the settings' units.
    fn rest_noise(&self) -> Option<RestNoise> {
        let [laser_codes, pressure_codes] = self.measured.rest_noise_codes?;
        let config = TickConfig { settings: &self.settings, facts: self.config.facts };
        let laser_mm = laser_codes * config.laser_calibration().ok()?.resolution();
        let pressure_bar = pressure_codes * config.pressure_calibration().ok()?.resolution();
        Some(RestNoise { laser_codes, laser_mm, pressure_codes, pressure_bar })
    }

    /// Sends a command to the tick, which answers it.
    #[inline(never)]
    pub(super) fn send(&mut self, token: u32, action: Action, commands: &mut impl CommandSink) -> Outcome {
        if commands.send(Command { token: Some(token), action }) {
            self.awaited = self.awaited.saturating_add(1);
            Outcome::Sent
        } else {
            Outcome::Done(Err(Refusal::Busy))
        }
    }

    /// Flash stops the processor, so it is written only once the pressure was seen to be gone, and with no command on its way that could change
    /// that.
    pub(super) fn may_write(&self) -> Result<(), Refusal> {
        if self.awaited > 0 {
            return Err(Refusal::Busy);
        }
        match self.state {
            State::Idle | State::Fault if self.vent_verified => Ok(()),
            State::Idle | State::Fault => {
                let mut blockers = BlockerSet::EMPTY;
                blockers.insert(Blocker::VentNotVerified);
                Err(Refusal::Blocked(blockers))
            }
            state => Err(Refusal::State(state)),
        }
    }
}
