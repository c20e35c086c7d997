//! The boards: their pins, their chips, and the tasks that drive the rig on them.
//!
//! # Signal path
//!
//! ```text
//! timer, 1 kHz ─trigger─► injected conversions: laser, pressure, pressure, laser ─end─► interrupt = the tick
//!   SysTick, half a period later: no tick since the last time? starts one without a sample
//! tick ─► dump valve ─► DAC or PWM ─► watchdog
//!   ▲ commands         │ answers, telemetry
//! background: link, storage, self-test ◄─ queues ─► serial interrupt ◄─► host
//! ```
//!
//! # Layers
//!
//! The modules of this folder know no chip. Each chip has a folder with its rates and addresses, and with sequences and decisions over small
//! traits of registers, tested on the desktop; its `registers` implement those traits and exist only on the target. The image in
//! `src/bin/rig.rs` puts them together.
//!
//! No HAL is used: of those there are for this chip, none waits for the HSE with a bound, triggers injected conversions from a timer, or comes
//! up in the emulator, whose clock never reports ready. The register definitions come from the crate `stm32f4`.
//!
//! # Start-up
//!
//! 1. Before there is RAM: dump valve released (`entry`).
//! 2. Clocks, reset cause, what survived in RAM (`crash_record`).
//! 3. Brown-out level, memory protection, pins, drives at zero, watchdog, supply monitor.
//! 4. Settings from flash, rig, queues.
//! 5. Sampling begins; from now on the tick decides about the dump valve.

pub mod background_task;
pub mod circular;
pub mod clock;
pub mod contract;
pub mod converter;
pub mod custom_f405;
pub mod feather_f405;
#[cfg(target_os = "none")]
pub mod log;
pub mod memory_map;
pub mod nucleo_h743zi;
pub mod periods;
pub mod pulse;
pub mod pulse_drive;
pub mod rates;
pub mod read_back;
pub mod rest_noise;
pub mod shared_atomics;
pub mod stm32f405;
pub mod stm32h743;
pub mod supply;
pub mod tick_task;
pub mod transfer_line;
pub mod watchdog;

#[cfg(target_os = "none")]
#[expect(unsafe_code, reason = "registers of the processor, linker symbols and memory that survives a reset")]
pub mod target;

/// The chip of the board that this build is for.
#[cfg(chip = "stm32f405")]
pub use stm32f405 as chip;
#[cfg(chip = "stm32h743")]
pub use stm32h743 as chip;
/// The wiring of the board that this build is for.
pub const SELECTED: chip::wiring::Wiring = selected::WIRING;
#[cfg(board = "custom-f405")]
use custom_f405 as selected;
#[cfg(board = "feather-f405")]
use feather_f405 as selected;
#[cfg(board = "nucleo-h743zi")]
use nucleo_h743zi as selected;
