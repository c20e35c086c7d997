//! The firmware library in this process, as the processor of a simulated rig.

use firmware::background::ModelPlace;
use firmware::calibration::ConverterConfig;
use firmware::control::Compensator;
use firmware::crash_record::CrashRecord;
use firmware::device::exchange::{DeviceOutputs, InjectedFault};
use firmware::device::{Device, DeviceConfig, DeviceInputs};
use firmware::estimator::Portable;
use firmware::history::RamHistory;
use firmware::model::{ModelFacts, RunningModel};
use firmware::tick::{Direction, ModelStep, RigFacts, TickOutputs};
use model_export::link::fault::Fault;
use model_export::link::state::ResetCause;

use super::lockstep::{Boot, Processor, Turn};
use super::{FlashMemory, LinkError, SlotPair};

/// Two conversions of 12 bits summed, 3.3 V reference: the board's converter.
pub const FACTS: RigFacts = RigFacts { converter: ConverterConfig { full_scale_code: 8190, full_scale_v: 3.3 } };

/// The version that the firmware library says it has.
pub const FIRMWARE: [u16; 3] = firmware::VERSION;

self_cell::self_cell! {
    /// A model together with the blob it borrows.
    struct Loaded {
        owner: Vec<u8>,
        #[covariant]
        dependent: Running,
    }
}

type Running<'a> = RunningModel<'a, Portable>;

/// The model in use, in a copy of its own.
pub struct Heap {
    loaded: Loaded,
}

impl Default for Heap {
    fn default() -> Self {
        Self { loaded: Loaded::new(Vec::new(), |_| RunningModel::default()) }
    }
}

impl ModelStep for Heap {
    fn step(&mut self, pressure_bar: f32) -> f32 {
        self.loaded.with_dependent_mut(|_, running| running.step(pressure_bar))
    }

    fn reset(&mut self) {
        self.loaded.with_dependent_mut(|_, running| running.reset());
    }

    fn is_present(&self) -> bool {
        self.loaded.borrow_dependent().is_present()
    }

    fn direction(&self) -> Direction {
        self.loaded.borrow_dependent().direction()
    }

    fn compensator(&self) -> Option<&Compensator> {
        self.loaded.borrow_dependent().compensator()
    }

    fn is_outside_domain(&self) -> bool {
        self.loaded.borrow_dependent().is_outside_domain()
    }

    fn identity(&self) -> [u8; 8] {
        self.loaded.borrow_dependent().identity()
    }
}

impl ModelPlace for Heap {
    fn load(&mut self, blob: &[u8]) -> Result<ModelFacts, Fault> {
        let mut admitted = Err(Fault::ModelCorrupt);
        self.loaded = Loaded::new(blob.to_vec(), |bytes| {
            let mut running = RunningModel::default();
            admitted = running.load(bytes, Portable);
            running
        });
        admitted
    }

    fn forget(&mut self) {
        *self = Self::default();
    }
}

/// The device as this process runs it.
pub type HostDevice = Device<SlotPair, SlotPair, Heap>;

/// The firmware library as the processor.
pub struct InProcess {
    device: Option<HostDevice>,
    flash: FlashMemory,
    crash_record: Option<CrashRecord>,
    history: Box<RamHistory>,
    crash: Option<Fault>,
}

impl InProcess {
    /// A processor with this flash; it starts with its first boot.
    #[must_use]
    pub fn new(flash: FlashMemory) -> Self {
        Self { device: None, flash, crash_record: None, history: Box::default(), crash: None }
    }

    /// The device, once it has started.
    #[must_use]
    pub fn device(&self) -> Option<&HostDevice> {
        self.device.as_ref()
    }

    /// The flash as it is now.
    #[must_use]
    pub fn flash(&self) -> FlashMemory {
        match &self.device {
            Some(device) => {
                let (settings, models) = device.link().flash();
                FlashMemory { settings: settings.clone(), models: models.clone() }
            }
            None => self.flash.clone(),
        }
    }

    /// Starts the device again, with the flash as it is now and what survived the reset.
    pub(crate) fn start(&mut self, reset_cause: ResetCause, line_bytes_per_tick: u16, board: &str) -> Result<(), LinkError> {
        self.flash = self.flash();
        let config = DeviceConfig {
            firmware: FIRMWARE,
            board: heapless::String::try_from(board).unwrap_or_default(),
            reset_cause,
            crash_record: self.crash_record,
            facts: FACTS,
            line_bytes_per_tick,
        };
        let device = Device::new(config, self.flash.settings.clone(), self.flash.models.clone(), Heap::default());
        self.device = Some(device.map_err(|number| LinkError::Rig(format!("the default settings do not go together: {number:?}")))?);
        Ok(())
    }

    /// Does a tick and gives everything that came of it; the bytes for the host go to `to_host`.
    pub(crate) fn step(&mut self, inputs: DeviceInputs, from_host: &[u8], to_host: &mut Vec<u8>) -> Option<TickOutputs> {
        let device = self.device.as_mut()?;
        from_host.iter().for_each(|byte| device.receive(*byte));
        let outputs = device.tick_remembering(inputs, self.history.as_mut());
        if outputs.record_changed {
            self.crash_record = Some(CrashRecord { record: *device.record(), crash: None });
        }
        to_host.extend_from_slice(&device.transmit());
        Some(outputs)
    }

    /// What the crash handler does: writes down what struck, and restarts.
    pub(crate) fn crash(&mut self, fault: Fault) {
        let record = self.crash_record.map(|crash_record| crash_record.record).unwrap_or_default();
        self.crash_record = Some(CrashRecord { record, crash: Some(fault) });
        self.crash = Some(fault);
    }
}

impl Processor for InProcess {
    fn boot(&mut self, boot: Boot) -> Result<Option<Fault>, LinkError> {
        self.start(boot.reset_cause, boot.line_bytes_per_tick, boot.board)?;
        Ok(self.crash.take())
    }

    fn tick(&mut self, inputs: DeviceInputs, from_host: &[u8], injected: InjectedFault, to_host: &mut Vec<u8>) -> Result<Turn, LinkError> {
        match injected {
            InjectedFault::None => {}
            InjectedFault::Hang => return Ok(Turn::Hung),
            InjectedFault::StackOverflow => {
                self.crash(Fault::HardFault);
                return Ok(Turn::Restarted);
            }
            InjectedFault::Panic => {
                self.crash(Fault::Panicked);
                return Ok(Turn::Restarted);
            }
        }
        match self.step(inputs, from_host, to_host) {
            Some(outputs) => Ok(Turn::Done(device_outputs(&outputs))),
            None => Ok(Turn::Restarted),
        }
    }

    fn cause_of_restart(&self) -> ResetCause {
        ResetCause::Software
    }

    fn read_flash(&mut self) -> Result<FlashMemory, LinkError> {
        Ok(self.flash())
    }
}

/// What of a tick reaches the hardware.
pub(crate) fn device_outputs(outputs: &TickOutputs) -> DeviceOutputs {
    DeviceOutputs {
        energised: outputs.energised,
        feed_watchdog: outputs.feed_watchdog,
        state: outputs.state,
        valve_share: outputs.valve_share,
        output_ubar: outputs.output.0,
        link_bytes: 0,
    }
}
