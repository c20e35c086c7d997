//! The rig a reference is run on: the firmware library in this process with the all-effects rig around it, and who watches the true tip.

use std::cell::RefCell;
use std::path::Path;
use std::rc::Rc;

use model_export::link::settings::SettingValue;

use crate::backend::{EMULATED_BOARD, VIRTUAL_BOARD};
use crate::control::{SettingValues, setting};
use crate::link::{
    BoardModel, BoardModelConfig, Client, FlashMemory, Hardware, HardwareConfig, InProcess, LinkError, Lockstep, Observer, Processor, Qemu,
    QemuConfig, TickRecord,
};
use crate::replay_log::{Header, Recorder, ReplayLog};
use crate::rig::live::{AllEffects, Probe};

/// Ticks of a window of the decimation filter.
const WINDOW_TICKS: usize = 20;

/// Settings that the all-effects rig needs whatever the controller: its pneumatics are slower than the defaults expect, and telemetry
/// every 10 ms.
#[must_use]
pub fn rig_settings() -> SettingValues {
    vec![
        setting("mismatch.pressure_bar", SettingValue::Float(0.6)),
        setting("mismatch.pressure_ms", SettingValue::Integer(100)),
        setting("mismatch.displacement_mm", SettingValue::Float(0.0)),
        setting("telemetry.period_ms", SettingValue::Integer(10)),
        setting("limits.host_timeout_ms", SettingValue::Integer(1000)),
        setting("limits.slew_up_bar_per_s", SettingValue::Float(40.0)),
        setting("limits.slew_down_bar_per_s", SettingValue::Float(40.0)),
    ]
}

/// The true tip and the output at every tick, where somebody can see them.
#[derive(Clone, Default)]
pub struct Truth {
    tips_mm: Rc<RefCell<Vec<f64>>>,
    outputs_ubar: Rc<RefCell<Vec<i32>>>,
}

impl Truth {
    /// Where the tip was when the device's clock showed this time, mm; `None` on a real rig.
    #[must_use]
    pub fn tip_mm(&self, time_ms: u64) -> Option<f64> {
        // The first tick after the start shows one.
        let index = usize::try_from(time_ms.checked_sub(1)?).ok()?;
        self.tips_mm.borrow().get(index).copied()
    }

    /// What went to the valve in every tick from this time of the device's clock on, microbar; nothing on a real rig.
    #[must_use]
    pub fn outputs_from(&self, time_ms: u64) -> Vec<i32> {
        let begin = usize::try_from(time_ms.saturating_sub(1)).unwrap_or(usize::MAX);
        self.outputs_ubar.borrow().get(begin..).unwrap_or_default().to_vec()
    }

    /// Mean of the tip over the window of the decimation filter that an estimate in a sample of this time belongs to, mm.
    #[must_use]
    pub fn window_mm(&self, time_ms: u64) -> Option<f64> {
        let end = usize::try_from(time_ms).ok()?;
        let tips_mm = self.tips_mm.borrow();
        let window = tips_mm.get(end.checked_sub(WINDOW_TICKS)?..end)?;
        Some(window.iter().sum::<f64>() / WINDOW_TICKS as f64)
    }
}

/// Writes tip and output down at every tick, and a replay log if one is wanted.
pub struct Watch {
    probe: Probe,
    truth: Truth,
    recorder: Option<Recorder>,
}

impl Watch {
    /// What went into the device and came out of it.
    #[must_use]
    pub fn replay_log(&self) -> Option<&ReplayLog> {
        self.recorder.as_ref().map(Recorder::replay_log)
    }
}

impl Observer for Watch {
    fn see(&mut self, record: &TickRecord<'_>, hardware: &Hardware) {
        if let Some(recorder) = &mut self.recorder {
            recorder.see(record, hardware);
        }
        let (mut tips_mm, mut outputs_ubar) = (self.truth.tips_mm.borrow_mut(), self.truth.outputs_ubar.borrow_mut());
        let output_ubar = match record {
            TickRecord::Boot { .. } => {
                tips_mm.clear();
                outputs_ubar.clear();
                return;
            }
            TickRecord::Tick { outputs, .. } => outputs.output_ubar,
            TickRecord::Silence => 0,
        };
        tips_mm.push(self.probe.tip_mm());
        outputs_ubar.push(output_ubar);
    }
}

/// The hardware of the all-effects rig, and its probe.
#[must_use]
pub fn hardware(seed: u64, session: usize) -> (Hardware, Probe) {
    let rig = AllEffects::new(seed, session);
    let probe = rig.probe();
    // The rig has its own valve, tube and tip: what the hardware adds is the regulator's electronics.
    let config = HardwareConfig { regulator_ms: 5.0, tip_ms: 1.0, seed: seed as u32 ^ 0x5eed, ..HardwareConfig::default() };
    (Hardware::new(config, Box::new(rig)), probe)
}

/// The firmware as ARM code in the emulator with an empty flash; the image is looked for where cargo leaves it when absent.
///
/// # Errors
/// When emulator or image are missing.
pub fn emulator(image: Option<&Path>) -> Result<Qemu, LinkError> {
    Qemu::start(QemuConfig::find(image)?, &FlashMemory::default())
}

/// The flashable image on the board's model with an empty flash; program and image are looked for where cargo leaves them.
///
/// # Errors
/// When one of them is missing.
pub fn board_model(image: Option<&Path>) -> Result<BoardModel, LinkError> {
    BoardModel::start(BoardModelConfig::find(image)?, &FlashMemory::default())
}

/// A replay log's beginning, for [`connect`].
#[must_use]
pub fn recorder(backend: &str, seed: u64) -> Recorder {
    // The emulated image has a name of its own in its Hello, which a replay must give too.
    let board = if backend == EMULATED_BOARD { EMULATED_BOARD } else { VIRTUAL_BOARD };
    Recorder::new(Header::new(backend, board, format!("the all-effects rig with seed {seed}"), &FlashMemory::default()))
}

/// A client of the all-effects rig around a processor with an empty flash.
///
/// # Errors
/// When the processor does not start or answer.
pub fn connect<P: Processor>(
    processor: P,
    seed: u64,
    session: usize,
    place: &str,
    recorder: Option<Recorder>,
) -> Result<(Client<Lockstep<P, Watch>>, Truth), LinkError> {
    let (hardware, probe) = hardware(seed, session);
    let truth = Truth::default();
    let watch = Watch { probe, truth: truth.clone(), recorder };
    let lockstep = Lockstep::new(processor, hardware, watch, place, VIRTUAL_BOARD)?;
    Ok((Client::connect(lockstep)?, truth))
}

/// A client of the all-effects rig with the firmware in this process.
///
/// # Errors
/// When it does not start.
pub fn in_process(seed: u64, session: usize) -> Result<(Client<Lockstep<InProcess, Watch>>, Truth), LinkError> {
    connect(InProcess::new(FlashMemory::default()), seed, session, "the all-effects rig in this process", None)
}
