//! The rig a reference is run on: a processor with simulated hardware around it, and who watches the true tip.

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
use crate::plant::{Plant, PlantError};
use crate::replay_log::{Header, Recorder, ReplayLog};
use crate::rig::live::{Probe, RealisticRig};

/// The name of the realistic rig.
pub const REALISTIC: &str = "realistic";
/// Ticks of a window of the decimation filter.
const WINDOW_TICKS: usize = 20;

/// Settings that the realistic rig needs whatever the controller: its pneumatics are slower than the defaults expect, and telemetry
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
    /// Where the tip is, if the hardware does not know it.
    probe: Option<Probe>,
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
        tips_mm.push(self.probe.as_ref().map_or_else(|| hardware.config().rest_mm + hardware.displacement_mm(), Probe::tip_mm));
        outputs_ubar.push(output_ubar);
    }
}

/// What moves the tip.
#[derive(Clone, Debug)]
pub enum Mover {
    /// The realistic rig of [`crate::rig::live`].
    Realistic,
    /// As a plant says.
    Plant(Box<Plant>),
}

impl Mover {
    /// What this name means: `realistic`, or a plant by name or file.
    ///
    /// # Errors
    /// When there is no such plant.
    pub fn named(name: &str) -> Result<Self, PlantError> {
        if name == REALISTIC { Ok(Self::Realistic) } else { Ok(Self::Plant(Box::new(Plant::named(name)?))) }
    }

    /// The hardware around it, and its probe. The laser was remounted once in every session but the first, 0, of the realistic rig.
    #[must_use]
    pub fn hardware(&self, seed: u64, session: usize) -> (Hardware, Option<Probe>) {
        let noise = seed as u32 ^ 0x5eed;
        match self {
            Self::Realistic => {
                let rig = RealisticRig::new(seed, session);
                let probe = rig.probe();
                // The rig has its own valve, tube and tip: what the hardware adds is the regulator's electronics.
                let config = HardwareConfig { regulator_ms: 5.0, tip_ms: 1.0, seed: noise, ..HardwareConfig::default() };
                (Hardware::new(config, Box::new(rig)), Some(probe))
            }
            Self::Plant(plant) => {
                let config = HardwareConfig { seed: noise, ..HardwareConfig::default() };
                (Hardware::new(config, Box::new(plant.start(0.0))), None)
            }
        }
    }

    /// Settings that it needs beside [`rig_settings`]: a plant with a dead time and a lag moves later than the laser is expected to by default.
    #[must_use]
    pub fn settings(&self) -> SettingValues {
        match self {
            Self::Realistic => Vec::new(),
            Self::Plant(_) => vec![setting("plausibility.still_response_ms", SettingValue::Float(600.0))],
        }
    }

    /// What it is, for a replay log.
    #[must_use]
    pub fn description(&self, seed: u64) -> String {
        match self {
            Self::Realistic => format!("the realistic rig with seed {seed}"),
            Self::Plant(plant) => plant.config().to_toml(),
        }
    }
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
pub fn recorder(backend: &str, mover: &Mover, seed: u64) -> Recorder {
    // The emulated image has a name of its own in its Hello, which a replay must give too.
    let board = if backend == EMULATED_BOARD { EMULATED_BOARD } else { VIRTUAL_BOARD };
    Recorder::new(Header::new(backend, board, mover.description(seed), &FlashMemory::default()))
}

/// A client of a processor with an empty flash and this hardware around it.
///
/// # Errors
/// When the processor does not start or answer.
pub fn connect<P: Processor>(
    processor: P,
    (hardware, probe): (Hardware, Option<Probe>),
    place: &str,
    recorder: Option<Recorder>,
) -> Result<(Client<Lockstep<P, Watch>>, Truth), LinkError> {
    let truth = Truth::default();
    let watch = Watch { probe, truth: truth.clone(), recorder };
    let lockstep = Lockstep::new(processor, hardware, watch, place, VIRTUAL_BOARD)?;
    Ok((Client::connect(lockstep)?, truth))
}

/// A client of a rig with the firmware in this process.
///
/// # Errors
/// When it does not start.
pub fn in_process(mover: &Mover, seed: u64, session: usize) -> Result<(Client<Lockstep<InProcess, Watch>>, Truth), LinkError> {
    connect(InProcess::new(FlashMemory::default()), mover.hardware(seed, session), "the rig in this process", None)
}

#[cfg(test)]
mod tests {
    use firmware::device::exchange::DeviceOutputs;

    use super::*;
    use crate::backend::Simulated;

    /// Where the tip is in every millisecond while the valve opens, closes and opens again.
    fn path_mm(mut hardware: Hardware) -> Vec<f64> {
        (0..1500_u16)
            .map(|tick| {
                let valve_share = if tick % 600 < 400 { u16::MAX / 4 } else { 0 };
                hardware.apply(&DeviceOutputs { energised: true, valve_share, ..DeviceOutputs::default() });
                hardware.advance();
                hardware.displacement_mm()
            })
            .collect()
    }

    #[test]
    fn a_plant_is_the_same_rig_by_its_name_here_as_for_every_other_command() {
        let plant = Plant::named("all-effects").unwrap();
        let elsewhere = Simulated::around(&plant, 7, FlashMemory::default(), VIRTUAL_BOARD);
        let here = Mover::named("all-effects").unwrap();
        assert_eq!(here.description(7), elsewhere.plant);
        let path = path_mm(here.hardware(7, 1).0);
        assert!(path.iter().any(|tip_mm| *tip_mm > 0.5), "it moves");
        assert_eq!(path, path_mm(Hardware::new(elsewhere.hardware, elsewhere.muscle)));
        assert_ne!(path, path_mm(Mover::named(REALISTIC).unwrap().hardware(7, 1).0), "another name is another rig");
    }
}
