//! The supervisor: which state the device is in, what latches, and whether there may be pressure at all.
//!
//! Terms. **Energised** states ([`State::Armed`], [`State::Running`]) close the dump valve; all others **vent**: dump valve released, output
//! zero, and the measured pressure watched until it is below [`VENTED_BELOW_BAR`] within [`VENT_WITHIN_TICKS`], else a second fault. A
//! fault **latches**: the first one is kept with time and context, and only an acknowledgement leaves the fault state, into a new
//! self-test. The way to pressure always leads through idle, an arm command and a start command; nothing re-arms by itself.
//!
//! [`TRANSITIONS`] is the whole machine. It knows no inputs but events, so a test explores it exhaustively.

use model_export::link::fault::{Blocker, BlockerSet, Fault, FaultSet};
use model_export::link::message::{FaultRecord, Refusal};
use model_export::link::state::State;

use crate::redundant::{Choice, Redundant};

/// Pressure below which the device counts as vented.
pub const VENTED_BELOW_BAR: f32 = 0.1;
/// Ticks of 1 ms within which venting must get there.
pub const VENT_WITHIN_TICKS: u16 = 1000;
/// Ticks in a row below the limit that count as vented: one noisy sample must not.
pub const VENTED_FOR_TICKS: u16 = 5;
/// Ticks in a row that must be seen before the deadline can pass: after a stall, what was missed says nothing about the pressure.
pub const VENT_SEEN_TICKS: u16 = VENTED_FOR_TICKS + 1;
/// Pressure that must not come back once vented; twice the limit, so that noise at the limit does not.
pub const PRESSURE_BACK_BAR: f32 = 2.0 * VENTED_BELOW_BAR;
/// Ticks in a row at that pressure that count as back.
pub const PRESSURE_BACK_TICKS: u16 = 50;
/// Ticks from the start until the self-test: the sensors prove themselves meanwhile.
pub const BOOT_TICKS: u32 = 200;
/// Ticks within which the self-test must report.
pub const SELF_TEST_TICKS: u32 = 10_000;

/// What can happen to the device.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Event {
    /// The sensors had their time to settle.
    BootFinished,
    /// The self-test found nothing wrong.
    SelfTestPassed,
    /// Another model was activated.
    Retest,
    /// The host arms.
    Arm,
    /// The host disarms.
    Disarm,
    /// The host starts.
    Start,
    /// The host stops.
    Stop,
    /// The control law has come to its end.
    Finished,
    /// Nobody started in time.
    ArmExpired,
    /// Somebody wants the pressure gone.
    Vent,
    /// The host has read the fault and wants to go on.
    Acknowledge,
    /// Something is wrong.
    FaultRaised,
}

impl Event {
    /// All events, in the order of the table's columns.
    pub const ALL: [Self; 12] = [
        Self::BootFinished,
        Self::SelfTestPassed,
        Self::Retest,
        Self::Arm,
        Self::Disarm,
        Self::Start,
        Self::Stop,
        Self::Finished,
        Self::ArmExpired,
        Self::Vent,
        Self::Acknowledge,
        Self::FaultRaised,
    ];

    /// Whether the host may ask for it.
    pub const fn is_host_request(self) -> bool {
        matches!(self, Self::Arm | Self::Disarm | Self::Start | Self::Stop | Self::Vent | Self::Acknowledge)
    }

    /// Whether the background may bring it; the others the supervisor makes itself.
    pub const fn is_request(self) -> bool {
        self.is_host_request() || matches!(self, Self::Retest | Self::SelfTestPassed)
    }
}

/// What an event does in a state.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Transition {
    /// Goes there.
    To(State),
    /// Goes there if nothing blocks it.
    IfUnblocked(State),
    /// Nothing; a command is answered with a refusal.
    Refuse,
}

use State::{Armed, Boot, Fault as Faulted, Idle, Running, SelfTest};
use Transition::{IfUnblocked, Refuse, To};

/// The machine: a row per state in the order of [`State::ALL`], a column per event in the order of [`Event::ALL`].
#[rustfmt::skip]
pub const TRANSITIONS: [[Transition; Event::ALL.len()]; State::ALL.len()] = [
    // BootFinished  SelfTestPassed  Retest        Arm                 Disarm       Start                 Stop         Finished   ArmExpired  Vent          Acknowledge            FaultRaised
    [To(SelfTest),   Refuse,         Refuse,       Refuse,             Refuse,      Refuse,               Refuse,      Refuse,    Refuse,     To(Boot),     Refuse,                To(Faulted)], // Boot
    [Refuse,         To(Idle),       To(SelfTest), Refuse,             Refuse,      Refuse,               Refuse,      Refuse,    Refuse,     To(SelfTest), Refuse,                To(Faulted)], // SelfTest
    [Refuse,         Refuse,         To(SelfTest), IfUnblocked(Armed), To(Idle),    Refuse,               Refuse,      Refuse,    Refuse,     To(Idle),     Refuse,                To(Faulted)], // Idle
    [Refuse,         Refuse,         Refuse,       Refuse,             To(Idle),    IfUnblocked(Running), To(Armed),   Refuse,    To(Idle),   To(Idle),     Refuse,                To(Faulted)], // Armed
    [Refuse,         Refuse,         Refuse,       Refuse,             To(Idle),    Refuse,               To(Armed),   To(Armed), Refuse,     To(Idle),     Refuse,                To(Faulted)], // Running
    [Refuse,         Refuse,         Refuse,       Refuse,             To(Faulted), Refuse,               Refuse,      Refuse,    Refuse,     To(Faulted),  IfUnblocked(SelfTest), To(Faulted)], // Fault
];

/// What `event` does in `state`.
pub fn transition(state: State, event: Event) -> Transition {
    // A search instead of an index: no path to a panic, and six by twelve entries are few.
    let row = State::ALL.iter().zip(&TRANSITIONS).find(|(candidate, _)| **candidate == state).map(|(_, row)| row);
    let cell = row.and_then(|row| Event::ALL.iter().zip(row).find(|(candidate, _)| **candidate == event));
    cell.map_or(Refuse, |(_, transition)| *transition)
}

/// How venting goes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Vent {
    /// No low pressure seen yet, and no deadline: after a clean start.
    #[default]
    Unverified,
    /// Must be seen low before the deadline.
    Watching,
    /// Seen low.
    Verified,
    /// Not seen low in time; the second fault is out, the watch goes on.
    Failed,
}

impl Choice for State {
    const ALL: &'static [Self] = &State::ALL;
}

impl Choice for Vent {
    const ALL: &'static [Self] = &[Self::Unverified, Self::Watching, Self::Verified, Self::Failed];
}

/// What the dump valve is to do. Only the supervisor's state can make one that closes it, and nobody can keep a copy for later.
#[derive(Debug)]
pub struct DumpOrder {
    closes: bool,
}

impl DumpOrder {
    /// Whether to energise the valve, so that it closes and there may be pressure.
    pub fn closes(&self) -> bool {
        self.closes
    }
}

/// What the operator may choose.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SupervisorConfig {
    /// Seconds after which an armed device disarms itself.
    pub arming_timeout_s: u16,
}

/// The supervisor, ready to run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Supervisor {
    arming_ticks: u32,
}

/// State, latch and vent watch.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SupervisorState {
    state: Redundant<State>,
    ticks_in_state: u32,
    record: FaultRecord,
    vent: Redundant<Vent>,
    vent_ticks: u16,
    low_ticks: u16,
    back_ticks: u16,
}

/// What the supervisor sees at a tick.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Observation {
    /// Ticks since the last observation: one, and more if some were lost.
    pub elapsed_ticks: u16,
    /// What is wrong now, to be acted on in this state.
    pub faults: FaultSet,
    /// What would be wrong in an energised state: keeps the acknowledgement back.
    pub causes: FaultSet,
    /// What speaks against arming, seen from outside the supervisor.
    pub arm_blockers: BlockerSet,
    /// What speaks against starting.
    pub start_blockers: BlockerSet,
    /// Measured pressure, bar; `None` while not plausible.
    pub pressure_bar: Option<f32>,
    /// The control law's end.
    pub finished: bool,
    /// What the host or the self-test wants, at most one a tick.
    pub request: Option<Event>,
    /// Context for the record of a first fault.
    pub context: FaultRecord,
}

/// What the supervisor decides at a tick.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Decision {
    /// The state from now on.
    pub state: State,
    /// Whether there may be pressure.
    pub energised: bool,
    /// Running began with this tick.
    pub started: bool,
    /// The device disarmed itself with this tick.
    pub arm_expired: bool,
    /// Why the request was refused.
    pub refusal: Option<Refusal>,
    /// The fault record changed with this tick.
    pub record_changed: bool,
}

impl SupervisorConfig {
    /// Builds the supervisor.
    pub fn build(&self) -> Supervisor {
        Supervisor { arming_ticks: u32::from(self.arming_timeout_s).saturating_mul(1000) }
    }
}

impl SupervisorState {
    /// The state.
    pub fn state(&self) -> State {
        self.state.get().unwrap_or(Faulted)
    }

    /// What the dump valve is to do in this state.
    pub fn dump_order(&self) -> DumpOrder {
        DumpOrder { closes: self.state().is_energised() }
    }

    /// How venting goes.
    pub fn vent(&self) -> Vent {
        self.vent.get().unwrap_or(Vent::Unverified)
    }

    /// First and second fault with context; all zero without a fault.
    pub fn record(&self) -> &FaultRecord {
        &self.record
    }

    /// What refuses arming now, given what speaks against it from outside.
    pub fn blockers(&self, outside: BlockerSet) -> BlockerSet {
        let mut blockers = outside;
        blockers.insert_if(self.state() != Idle, Blocker::WrongState);
        blockers.insert_if(self.record.first != 0, Blocker::FaultLatched);
        blockers.insert_if(self.vent() != Vent::Verified, Blocker::VentNotVerified);
        blockers
    }

    /// As after a start, but with a vent that must be seen to work: nothing that was watched goes unwatched. Only for a vented state without a
    /// fault.
    pub(crate) fn begin_again(&mut self) {
        *self = Self::default();
        self.enter(Boot, true);
    }

    fn enter(&mut self, next: State, begin_vent: bool) {
        if begin_vent {
            self.vent = Redundant::new(Vent::Watching);
            self.vent_ticks = 0;
            self.low_ticks = 0;
            self.back_ticks = 0;
        }
        if next != self.state() {
            self.ticks_in_state = 0;
        }
        if next.is_energised() {
            self.vent = Redundant::new(Vent::Unverified);
        }
        self.state = Redundant::new(next);
    }

    fn latch(&mut self, faults: FaultSet, context: &FaultRecord) -> bool {
        let new = FaultSet(faults.0 & !self.record.all.0);
        let Some(fault) = new.first() else { return false };
        if self.record.first == 0 {
            let second = new.iter().nth(1).map_or(0, Fault::number);
            self.record = FaultRecord { first: fault.number(), second, all: faults, state: self.state(), ..*context };
        } else {
            if self.record.second == 0 {
                self.record.second = fault.number();
            }
            self.record.all = self.record.all.union(faults);
        }
        true
    }

    /// Watches the pressure in a vented state.
    fn watch_vent(&mut self, elapsed_ticks: u16, pressure_bar: Option<f32>) -> FaultSet {
        let mut faults = FaultSet::EMPTY;
        let low = pressure_bar.is_some_and(|bar| bar < VENTED_BELOW_BAR);
        self.low_ticks = if low { self.low_ticks.saturating_add(1) } else { 0 };
        let back = pressure_bar.is_some_and(|bar| bar >= PRESSURE_BACK_BAR);
        self.back_ticks = if back { self.back_ticks.saturating_add(1) } else { 0 };
        if self.vent() == Vent::Verified {
            if self.back_ticks >= PRESSURE_BACK_TICKS {
                self.vent = Redundant::new(Vent::Failed);
                faults.insert(Fault::PressureWhileVented);
            }
            return faults;
        }
        if self.low_ticks >= VENTED_FOR_TICKS {
            self.vent = Redundant::new(Vent::Verified);
            return faults;
        }
        if self.vent() == Vent::Watching {
            let last = VENT_WITHIN_TICKS.saturating_sub(VENT_SEEN_TICKS).max(self.vent_ticks.saturating_add(1));
            self.vent_ticks = self.vent_ticks.saturating_add(elapsed_ticks).min(last);
            if self.vent_ticks >= VENT_WITHIN_TICKS {
                self.vent = Redundant::new(Vent::Failed);
                faults.insert(if pressure_bar.is_some() { Fault::VentNotVerified } else { Fault::VentUnverifiable });
            }
        }
        faults
    }
}

impl Supervisor {
    /// Decides on this tick. Faults come first, then what the device does by itself, then the request.
    ///
    /// # Deadline
    /// Two searches in the table at most.
    pub fn step(&self, state: &mut SupervisorState, observation: &Observation) -> Decision {
        let is_damaged = state.state.get().is_none() || state.vent.get().is_none();
        if is_damaged {
            state.enter(Faulted, true);
        }
        let before = state.state();
        state.ticks_in_state = state.ticks_in_state.saturating_add(u32::from(observation.elapsed_ticks));
        let mut faults = observation.faults;
        faults.insert_if(is_damaged, Fault::InternalInconsistent);
        if !state.state().is_energised() {
            faults = faults.union(state.watch_vent(observation.elapsed_ticks, observation.pressure_bar));
        }
        if state.state() == SelfTest && state.ticks_in_state > SELF_TEST_TICKS {
            faults.insert(Fault::SelfTestTimeout);
        }
        let mut decision = Decision {
            state: state.state(),
            energised: false,
            started: false,
            arm_expired: false,
            refusal: None,
            record_changed: state.latch(faults, &observation.context),
        };
        if decision.record_changed {
            // A later fault in the fault state does not restart the vent watch: it would put the deadline off for ever.
            let begin_vent = state.state() != Faulted;
            if let To(next) = transition(state.state(), Event::FaultRaised) {
                state.enter(next, begin_vent);
            }
        }
        if let Some(event) = self.own_event(state, observation)
            && let To(next) = transition(state.state(), event)
        {
            decision.arm_expired = event == Event::ArmExpired;
            state.enter(next, state.state().is_energised() && !next.is_energised());
        }
        if let Some(event) = observation.request {
            let moved_already = state.state() != before;
            decision.refusal = if moved_already && event != Event::Vent {
                // The request was meant for the state before.
                Some(Refusal::State(state.state()))
            } else {
                self.request(state, observation, event).err()
            };
            decision.started = before != Running && state.state() == Running;
            // Acknowledging empties the record, and the copy beyond the reset must follow.
            decision.record_changed |= before == Faulted && state.state() != Faulted;
        }
        decision.state = state.state();
        decision.energised = state.state().is_energised();
        decision
    }

    /// Raises a fault that showed after [`Supervisor::step`], in the same tick.
    pub fn raise(&self, state: &mut SupervisorState, fault: Fault, context: &FaultRecord, decision: &mut Decision) {
        let mut faults = FaultSet::EMPTY;
        faults.insert(fault);
        if state.latch(faults, context) {
            decision.record_changed = true;
        }
        if let To(next) = transition(state.state(), Event::FaultRaised) {
            state.enter(next, state.state() != Faulted);
        }
        decision.state = state.state();
        decision.energised = state.state().is_energised();
        decision.started = false;
    }

    fn own_event(&self, state: &SupervisorState, observation: &Observation) -> Option<Event> {
        match state.state() {
            Boot if state.ticks_in_state >= BOOT_TICKS => Some(Event::BootFinished),
            Armed if state.ticks_in_state >= self.arming_ticks => Some(Event::ArmExpired),
            Running if observation.finished => Some(Event::Finished),
            _ => None,
        }
    }

    fn request(&self, state: &mut SupervisorState, observation: &Observation, event: Event) -> Result<(), Refusal> {
        if !event.is_request() {
            return Err(Refusal::NotUnderstood);
        }
        let next = match transition(state.state(), event) {
            To(next) => next,
            IfUnblocked(next) => {
                let blockers = match event {
                    Event::Arm => state.blockers(observation.arm_blockers),
                    Event::Start => observation.start_blockers,
                    _ => {
                        let mut blockers = BlockerSet::EMPTY;
                        let present = observation.causes.union(observation.faults);
                        blockers.insert_if(present.0 & state.record.all.0 != 0, Blocker::FaultCausePresent);
                        blockers.insert_if(state.vent() != Vent::Verified, Blocker::VentNotVerified);
                        blockers
                    }
                };
                if !blockers.is_empty() {
                    return Err(Refusal::Blocked(blockers));
                }
                next
            }
            Refuse => {
                let mut blockers = match event {
                    Event::Arm => state.blockers(observation.arm_blockers),
                    _ => BlockerSet::EMPTY,
                };
                blockers.insert(Blocker::WrongState);
                blockers.insert_if(state.record.first != 0, Blocker::FaultLatched);
                return Err(Refusal::Blocked(blockers));
            }
        };
        if event == Event::Acknowledge {
            state.record = FaultRecord::default();
        }
        let begin_vent = event == Event::Vent || (state.state().is_energised() && !next.is_energised());
        state.enter(next, begin_vent && state.state() != Faulted);
        Ok(())
    }
}

#[cfg(test)]
mod tests;
