//! What a board brings to the image: the types behind the tick's and the background's traits, and the start that makes them.
//!
//! A board is a folder of constants and a chip. The chip's folder implements [`Board`] for the board that the build is for, on its registers;
//! the image in `src/bin/rig.rs` knows this trait and the names of the chip's interrupts, and nothing else of either.

use embedded_hal::digital::{InputPin, OutputPin};
use model_export::link::fault::{Fault, FaultSet};
use model_export::link::hello::Build;
use model_export::link::state::ResetCause;

use super::background_task::Line;
use super::clock::{ClockReport, ClockTree};
use super::pulse_drive::{ExpectedPulse, PulseExpectation, PulseReading};
use super::read_back::ChipThermometer;
use super::shared_atomics::SharedAtomics;
use super::tick_task::{CrashMemory, CycleCounter, TickIo};
use super::watchdog::WatchdogTimer;
use crate::crash_record::CrashRecord;
use crate::drivers::{PulseFrequency, SampleSource, ValveDrive};
use crate::storage::Flash;

/// The interrupt's side of the line.
pub trait LineInterrupt {
    /// Moves what there is to move between line and queues.
    fn interrupt(&mut self);
}

/// The interrupt's side of the supply monitor.
pub trait SupplyMonitor {
    /// The supply falls: vents, remembers, and starts again when it is back.
    fn fell(&mut self) -> !;
}

/// A board.
pub trait Board: Sized {
    /// Its name, in the Hello.
    const NAME: &'static str;
    /// Whether the chip's ROM has a bootloader on the line to the host.
    const HAS_BOOTLOADER: bool;
    /// First addresses of the two slots for models, mapped into memory.
    const MODEL_SLOTS: [usize; 2];
    /// Length of each, in bytes.
    const SLOT_BYTES: usize;

    /// The chip's and the processor's peripherals.
    type Peripherals;
    /// The queues' and buffers' places of the line.
    type LineMemory: 'static;
    /// The registers behind the clock.
    type Clock<'a>: ClockTree;
    /// Samples both measured channels, once a tick.
    type Sampling: SampleSource;
    /// The valve's drive by voltage.
    type AnalogueDrive: ValveDrive;
    /// The valve's drive by pulse width.
    type PulseDrive: ValveDrive + PulseFrequency;
    /// The dump valve's pin.
    type DumpPin: OutputPin;
    /// The emergency stop's pin.
    type StopPin: InputPin;
    /// The watchdog.
    type Watchdog: WatchdogTimer;
    /// Counts processor cycles.
    type Counter: CycleCounter;
    /// Keeps the fault record.
    type CrashMemory: CrashMemory;
    /// The line to the host.
    type Line: Line;
    /// Its interrupt.
    type LineInterrupt: LineInterrupt;
    /// A pair of slots in flash.
    type Flash: Flash;
    /// The supply monitor.
    type Supply: SupplyMonitor;
    /// What is left to do when everything stands: see [`Self::begin`].
    type Beginning;

    /// Brings the chip up, with every output at rest, in the order that [`super`] gives. Every wait is bounded. Time in which the processor
    /// stands still for flash is booked in `shared`.
    fn start(peripherals: Self::Peripherals, line: &'static mut Self::LineMemory, shared: &'static SharedAtomics) -> Started<Self>;

    /// Begins to sample, and to watch that sampling goes on: from now on there are ticks.
    fn begin(beginning: Self::Beginning, sampling: &mut Self::Sampling);

    /// Looks at the pulse width's pin, with what it should do at that instant.
    fn read_pulse(expectation: &PulseExpectation) -> (ExpectedPulse, PulseReading);

    /// Vents, remembers what struck, and starts again, from wherever it is called.
    fn crash(fault: Fault) -> !;

    /// Vents, and starts again in the chip's bootloader, where it [has one](Self::HAS_BOOTLOADER).
    fn enter_bootloader() -> !;
}

/// The tick's outputs and inputs on a board.
pub type TickIoOf<B> = TickIo<
    <B as Board>::Sampling,
    <B as Board>::AnalogueDrive,
    <B as Board>::PulseDrive,
    <B as Board>::DumpPin,
    <B as Board>::StopPin,
    <B as Board>::Watchdog,
    <B as Board>::Counter,
    <B as Board>::CrashMemory,
>;

/// A board that has come up.
pub struct Started<B: Board> {
    /// Why it started.
    pub reset_cause: ResetCause,
    /// What the run before left.
    pub crash_record: Option<CrashRecord>,
    /// How the clock came up.
    pub clock: ClockReport,
    /// What else is wrong with the chip until its next start.
    pub standing: FaultSet,
    /// What was found wrong just now.
    pub found: FaultSet,
    /// The factory's code of the reference voltage, if it can be relied on.
    pub reference_calibration: Option<u16>,
    /// The factory's calibration of the chip's temperature sensor, where there is one.
    pub thermometer: Option<ChipThermometer>,
    /// What the chip says of itself.
    pub build: Build,
    /// The tick's outputs and inputs.
    pub io: TickIoOf<B>,
    /// The line.
    pub line: B::Line,
    /// Its interrupt.
    pub line_interrupt: B::LineInterrupt,
    /// The slots of settings.
    pub settings: B::Flash,
    /// The slots of models.
    pub models: B::Flash,
    /// The supply monitor.
    pub supply: B::Supply,
    /// For [`Board::begin`].
    pub beginning: B::Beginning,
}
