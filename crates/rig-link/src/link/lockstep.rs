//! A rig in simulated time: a processor and the hardware around it, one tick after the other, and a line to the host.
//!
//! Time passes only in [`Transport::receive`]. The watchdog belongs to the hardware here: a processor that does not feed it for
//! [`WATCHDOG_MS`] is reset, and in reset its pins drive nothing, which vents.

use std::time::Duration;

use firmware::device::DeviceInputs;
use firmware::device::exchange::{DeviceOutputs, InjectedFault};
use model_export::link::fault::Fault;
use model_export::link::state::ResetCause;

use super::{Breakage, FlashMemory, Hardware, LinkError, Transport};

/// Period of the watchdog: below the 50 ms in which any fault must end in the safe state.
pub const WATCHDOG_MS: u32 = 40;
/// Bytes a tick at 921,600 baud with ten bits a byte.
pub const LINE_BYTES_PER_TICK: u16 = 92;

/// What a processor is told when it starts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Boot {
    /// Why.
    pub reset_cause: ResetCause,
    /// How fast its line to the host is.
    pub line_bytes_per_tick: u16,
    /// The name it gives in its Hello.
    pub board: &'static str,
}

/// What became of a tick.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Turn {
    /// It was done.
    Done(DeviceOutputs),
    /// The processor crashed, reset itself and waits for its boot.
    Restarted,
    /// It does not answer any more.
    Hung,
}

/// What runs the firmware.
pub trait Processor {
    /// Starts, or starts again; gives what crashed the run before, as the processor itself found it.
    ///
    /// # Errors
    /// When it cannot be started.
    fn boot(&mut self, boot: Boot) -> Result<Option<Fault>, LinkError>;

    /// One tick: the bytes from the host, then the tick; the bytes for the host are added to `to_host`.
    ///
    /// # Errors
    /// When the processor is not there any more.
    fn tick(&mut self, inputs: DeviceInputs, from_host: &[u8], injected: InjectedFault, to_host: &mut Vec<u8>) -> Result<Turn, LinkError>;

    /// What its reset flags say after it restarted by itself.
    fn cause_of_restart(&self) -> ResetCause;

    /// What can be seen of it when it does not answer, for messages.
    fn condition(&self) -> String {
        String::new()
    }

    /// The flash as it is now.
    ///
    /// # Errors
    /// When it cannot be read.
    fn read_flash(&mut self) -> Result<FlashMemory, LinkError>;
}

/// One thing that happened, for whoever keeps a replay log.
#[derive(Clone, Debug, PartialEq)]
pub enum TickRecord<'a> {
    /// The processor started.
    Boot {
        /// What it was told.
        boot: Boot,
        /// What crashed it before.
        crash: Option<Fault>,
    },
    /// It did a tick.
    Tick {
        /// What went in.
        inputs: DeviceInputs,
        /// Bytes from the host before the tick.
        from_host: &'a [u8],
        /// What came out.
        outputs: DeviceOutputs,
        /// Bytes for the host.
        to_host: &'a [u8],
    },
    /// A tick passed without it.
    Silence,
}

/// Somebody who sees every tick.
pub trait Observer {
    /// Something happened; `hardware` is as it was before.
    fn see(&mut self, record: &TickRecord<'_>, hardware: &Hardware);
}

/// Nobody.
impl Observer for () {
    fn see(&mut self, _record: &TickRecord<'_>, _hardware: &Hardware) {}
}

/// A processor, its hardware and its line.
pub struct Lockstep<P, O = ()> {
    processor: P,
    hardware: Hardware,
    observer: O,
    place: String,
    board: &'static str,
    to_device: Vec<u8>,
    to_host: Vec<u8>,
    ticks: u64,
    watchdog_ms: u32,
    hung: bool,
    injected: InjectedFault,
    resets: u32,
    outputs: DeviceOutputs,
}

impl<P: Processor, O: Observer> Lockstep<P, O> {
    /// Starts the processor; `place` is for messages, `board` for its Hello.
    ///
    /// # Errors
    /// When it cannot be started.
    pub fn new(processor: P, hardware: Hardware, observer: O, place: impl Into<String>, board: &'static str) -> Result<Self, LinkError> {
        let mut rig = Self {
            processor,
            hardware,
            observer,
            place: place.into(),
            board,
            to_device: Vec::new(),
            to_host: Vec::new(),
            ticks: 0,
            watchdog_ms: 0,
            hung: false,
            injected: InjectedFault::None,
            resets: 0,
            outputs: DeviceOutputs::default(),
        };
        rig.boot(ResetCause::PowerOn)?;
        Ok(rig)
    }

    /// The hardware, to look at and to break.
    pub fn hardware(&mut self) -> &mut Hardware {
        &mut self.hardware
    }

    /// The processor.
    pub fn processor(&mut self) -> &mut P {
        &mut self.processor
    }

    /// The observer.
    pub fn observer(&self) -> &O {
        &self.observer
    }

    /// Takes the rig apart.
    pub fn into_parts(self) -> (P, Hardware, O) {
        (self.processor, self.hardware, self.observer)
    }

    /// Makes the processor do something else in its next tick.
    pub fn injected(&mut self, injected: InjectedFault) {
        self.injected = injected;
    }

    /// Ticks so far, those without a processor included.
    #[must_use]
    pub fn ticks(&self) -> u64 {
        self.ticks
    }

    /// Resets since the start.
    #[must_use]
    pub fn resets(&self) -> u32 {
        self.resets
    }

    /// The last tick's outputs.
    #[must_use]
    pub fn outputs(&self) -> &DeviceOutputs {
        &self.outputs
    }

    /// Lets ticks pass without listening; what comes from the device waits.
    ///
    /// # Errors
    /// When the processor is not there any more.
    pub fn advance_for(&mut self, ticks: u32) -> Result<(), LinkError> {
        (0..ticks).try_for_each(|_| self.advance())
    }

    /// Lets one tick pass.
    ///
    /// # Errors
    /// When the processor is not there any more.
    pub fn advance(&mut self) -> Result<(), LinkError> {
        let sample = self.hardware.sample();
        let lost = |breakage| if let Breakage::TicksLost(ticks) = breakage { Some(ticks) } else { None };
        let lost_ticks = self.hardware.broken().find_map(lost).unwrap_or(0);
        let inputs = DeviceInputs {
            sample,
            emergency_stop: self.hardware.has(Breakage::EmergencyStop),
            overran: self.hardware.has(Breakage::EveryTickLate),
            lost_ticks,
        };
        let turn = if self.hung { Turn::Hung } else { self.turn(inputs)? };
        match turn {
            Turn::Done(outputs) => {
                self.hardware.apply(&outputs);
                self.outputs = outputs;
                self.watchdog_ms = if outputs.feed_watchdog { 0 } else { self.watchdog_ms + 1 };
            }
            Turn::Restarted => {
                self.observer.see(&TickRecord::Silence, &self.hardware);
                self.boot(self.processor.cause_of_restart())?;
            }
            Turn::Hung => {
                // The pins stay as they were until the watchdog runs out.
                self.hung = true;
                self.observer.see(&TickRecord::Silence, &self.hardware);
                self.watchdog_ms += 1;
            }
        }
        for _ in 0..=lost_ticks {
            self.hardware.advance();
            self.ticks += 1;
        }
        if self.watchdog_ms >= WATCHDOG_MS {
            self.boot(ResetCause::Watchdog)?;
        }
        Ok(())
    }

    fn turn(&mut self, inputs: DeviceInputs) -> Result<Turn, LinkError> {
        let is_cut = self.hardware.has(Breakage::LineCut);
        let mut from_host = std::mem::take(&mut self.to_device);
        if is_cut {
            from_host.clear();
        }
        let received = self.to_host.len();
        let turn = self.processor.tick(inputs, &from_host, std::mem::take(&mut self.injected), &mut self.to_host)?;
        if let Turn::Done(outputs) = turn {
            let record = TickRecord::Tick { inputs, from_host: &from_host, outputs, to_host: &self.to_host[received..] };
            self.observer.see(&record, &self.hardware);
        }
        if is_cut {
            self.to_host.truncate(received);
        }
        Ok(turn)
    }

    fn boot(&mut self, reset_cause: ResetCause) -> Result<(), LinkError> {
        self.hardware.release_pins();
        self.watchdog_ms = 0;
        self.hung = false;
        self.resets += u32::from(reset_cause != ResetCause::PowerOn);
        self.outputs = DeviceOutputs::default();
        // Bytes on their way to a processor in reset are lost.
        self.to_device.clear();
        let boot = Boot { reset_cause, line_bytes_per_tick: LINE_BYTES_PER_TICK, board: self.board };
        let crash = self.processor.boot(boot)?;
        self.observer.see(&TickRecord::Boot { boot, crash }, &self.hardware);
        Ok(())
    }
}

impl<P: Processor, O: Observer> Transport for Lockstep<P, O> {
    fn send(&mut self, bytes: &[u8]) -> Result<(), LinkError> {
        self.to_device.extend_from_slice(bytes);
        Ok(())
    }

    fn receive(&mut self, limit: Duration, into: &mut Vec<u8>) -> Result<(), LinkError> {
        let until = self.elapsed() + limit;
        while self.to_host.is_empty() && self.elapsed() < until {
            self.advance()?;
        }
        into.append(&mut self.to_host);
        Ok(())
    }

    fn elapsed(&self) -> Duration {
        Duration::from_millis(self.ticks)
    }

    fn place(&self) -> &str {
        &self.place
    }

    fn condition(&self) -> String {
        self.processor.condition()
    }
}
