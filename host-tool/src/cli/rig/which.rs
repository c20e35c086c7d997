//! Which rig a command speaks to, and what a simulated one is made of.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail, ensure};
use clap::Args;
use serde::Serialize;

use crate::backend::{Backend, EMULATED_BOARD, Rig, Simulated, VIRTUAL_BOARD};
use crate::link::{FlashMemory, HardwareConfig, INJECTIONS, Injection};
use crate::plant::Plant;
use crate::{output, say};

/// Which rig, and what a simulated one is made of.
#[derive(Args, Clone, Debug)]
pub struct Which {
    /// Where the rig is: virtual (in this process), qemu (as ARM code), board-model (the flashable image on a model of its chip),
    /// serial:PORT, or serial for the one port at which a board answers.
    #[arg(long, global = true, default_value = "virtual", env = "CATHETER_BACKEND", value_name = "virtual|qemu|board-model|serial[:PORT]")]
    pub(super) backend: Backend,
    /// What moves the tip of a simulated rig.
    #[arg(long, global = true, default_value = "pi", value_name = "FILE|pi|all-effects")]
    pub(super) plant: String,
    /// Keep the flash of a simulated rig (settings, models) in this file from command to command; without it every command starts with a
    /// new device.
    #[arg(long, global = true, env = "CATHETER_FLASH", value_name = "FILE")]
    pub(super) flash: Option<PathBuf>,
    /// What breaks on a simulated rig, and when, in s after it was switched on: `laser-unplugged`, `emergency-stop@1.5`, `line-cut@1..1.4`; `help`
    /// lists them.
    #[arg(long, global = true, env = "CATHETER_INJECT", value_name = "NAME[=VALUE][@S[..S]],...", value_delimiter = ',')]
    pub(super) inject: Vec<String>,
    /// Numbers of a simulated rig's hardware, by name (TOML): supply, valve, sensors and how they err.
    #[arg(long, global = true, value_name = "FILE.toml")]
    pub(super) hardware: Option<PathBuf>,
    /// The image that the emulator or the board's model runs, if it is not where cargo leaves it.
    #[arg(long, global = true, value_name = "FILE")]
    pub(super) image: Option<PathBuf>,
    /// Seed of a simulated rig's sensor noise.
    #[arg(long, global = true, default_value_t = 1, value_name = "N")]
    pub(super) seed: u64,
    /// Write the result as JSON to this file; folders on the way are created.
    #[arg(long, global = true, value_name = "FILE", value_parser = output::file_argument(""))]
    pub(super) json: Option<PathBuf>,
}

/// Opens the rig.
pub(super) fn open(which: &Which) -> Result<Rig> {
    if which.backend.is_board() {
        let only: Vec<&str> =
            [("--inject", !which.inject.is_empty()), ("--hardware", which.hardware.is_some()), ("--flash", which.flash.is_some())]
                .into_iter()
                .filter_map(|(name, given)| given.then_some(name))
                .collect();
        ensure!(only.is_empty(), "{}: only on a simulated rig; {} is a board", only.join(", "), which.backend.name());
    }
    let injections = which.injections()?;
    Rig::open(&which.backend, || {
        let board = if which.backend == Backend::Qemu { EMULATED_BOARD } else { VIRTUAL_BOARD };
        let flash = which.flash.as_deref().map_or_else(|| Ok(FlashMemory::default()), FlashMemory::read)?;
        let mut simulated = Simulated::around(&Plant::named(&which.plant)?, which.seed, flash, board);
        simulated.image.clone_from(&which.image);
        if let Some(path) = &which.hardware {
            simulated.hardware = HardwareConfig { seed: simulated.hardware.seed, ..read_hardware(path)? };
        }
        simulated.injections = injections;
        Ok(simulated)
    })
}

/// Numbers of a simulated rig's hardware.
///
/// # Errors
/// When the file cannot be read, has other names, or holds what no hardware has.
pub(crate) fn read_hardware(path: &Path) -> Result<HardwareConfig> {
    let text = output::read_text(path).with_context(|| format!("{}: cannot be read", path.display()))?;
    let hardware: HardwareConfig = toml::from_str(&text).with_context(|| path.display().to_string())?;
    if let Some(problem) = hardware.problem() {
        bail!("{}: {problem}", path.display());
    }
    Ok(hardware)
}

impl Which {
    /// Writes the JSON result, if one is wanted.
    pub(super) fn write(&self, value: &impl Serialize) -> Result<()> {
        self.json.as_deref().map_or(Ok(()), |path: &Path| output::write_result(path, value))
    }

    /// Says what becomes of settings that were saved.
    pub(super) fn say_saved(&self) {
        if self.forgets() {
            say!("Saved, on a device that ends with this command; name a file with --flash to keep it.");
        } else {
            say!("Saved: the device starts with these settings from now on.");
        }
    }

    /// Whether what is kept on the device ends with this command.
    pub(super) fn forgets(&self) -> bool {
        self.flash.is_none() && !self.backend.is_board()
    }

    /// What is to break; `help` lists what there is.
    fn injections(&self) -> Result<Vec<Injection>> {
        if self.inject.iter().any(|name| name == "help") {
            let list: Vec<String> = INJECTIONS
                .iter()
                .map(|(name, unit, meaning)| {
                    let name = if unit.is_empty() { (*name).to_owned() } else { format!("{name}={unit}") };
                    format!("  {name:<22} {meaning}")
                })
                .collect();
            bail!("--inject takes\n{}", list.join("\n"));
        }
        let one = |text: &String| text.parse::<Injection>().map_err(|problem| anyhow::anyhow!("--inject {problem}"));
        self.inject.iter().filter(|text| !text.is_empty()).map(one).collect()
    }
}
