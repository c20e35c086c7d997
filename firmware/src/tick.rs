//! The tick: everything the rig does in one millisecond, as one function without hardware.
//!
//! ```text
//! command ─► host and self-test requests
//! codes ─► calibration ─► plausibility ─► decimation ─► model ─► control law ─► supervisor ─► LIMITER ─► valve, dump valve
//!                              └─ faults ─────────────────────────────────────────┘             telemetry
//! ```
//!
//! Between model and control law stands [`crate::adaptation`], while it is switched on. The comparison of laser and model
//! ([`Fault::ModelMismatch`](model_export::link::fault::Fault::ModelMismatch)) sees the model's own estimate, so that adaptation hides nothing from it.
//!
//! # How a board drives it
//!
//! Once, at the start: build a [`Rig`] with [`Rig::new`] from the settings, the board's [`RigFacts`] and a [`BootReport`]. Keep the dump
//! valve released until the first tick says otherwise.
//!
//! Every millisecond, in the interrupt of the end of the ADC's conversion:
//!
//! 1. fill [`TickInputs`]: the two codes, the emergency stop, ticks lost since the last call, the background's beat counter, the flag that
//!    wants a vent, and at most one [`Command`] from the queue that the link fills (queue places: at least as many for answers as for
//!    commands, since every command with a token gets exactly one answer and none may be dropped);
//! 2. call [`Rig::tick`] with the model (or [`NoModel`]);
//! 3. apply [`TickOutputs`] in this order: dump valve, valve drive, then feed the watchdog if told so; push the answer and the telemetry
//!    sample into their queues without waiting (a full telemetry queue drops the sample; count it and hand the count to the link). A trace
//!    record goes before the answer, and where it does not fit the trace ends ([`Rig::end_trace`]).
//!
//! The background (link, storage, self-test) never touches the rig; it sends commands. When [`TickOutputs::self_test_wanted`] is set it runs
//! the self-test once and sends [`Action::SelfTestReport`]. It must advance the beat counter at least every
//! [`BACKGROUND_TICKS_ENERGISED`] ms while energised. When the fault record changed, copy it to the RAM that survives a reset (`crash_record`).
//!
//! The watchdog's period must stay below 50 ms while [`TickOutputs::energised`]; while vented it may be longer than a flash erase.

mod blockers;
mod commands;
mod config;
mod control;
mod estimate;
mod ports;
mod reports;
mod state;
mod step;
mod timing;
mod trace;

pub use crate::time::{TICKS_IN_A_SECOND, TICKS_PER_S};
pub use config::{Inconsistent, RigFacts, Tick, TickConfig, ValveOutput};
pub use ports::{Action, Answer, BootReport, Command, Direction, ModelStep, NoModel, TickInputs, TickOutputs};
pub use reports::{Insight, TakenIn};
pub use state::{DEFAULT_MODEL_PERIOD, Rig, TickState};
pub use timing::{BACKGROUND_TICKS_ENERGISED, BACKGROUND_TICKS_VENTED, LOST_AT_ONCE};
pub use trace::Origin;
