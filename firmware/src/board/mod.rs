//! The board: an STM32F405RG, its pins, and the tasks that drive the rig on it.
//!
//! # Signal path
//!
//! ```text
//! TIM2, 1 kHz ─TRGO─► ADC1 injected: laser, pressure, pressure, laser ─JEOC─► ADC interrupt = the tick
//!   SysTick, half a period later: no tick since the last time? starts one without a sample
//! tick ─► dump valve (PB1) ─► DAC (PA4) or PWM (PA6) ─► watchdog
//!   ▲ commands         │ answers, telemetry
//! background: link, storage, self-test ◄─ queues ─► USART1 interrupt ◄─► host
//! ```
//!
//! # Layers
//!
//! [`hardware`] holds every pin, rate and address. The modules beside it are sequences and decisions over small traits of registers; they know
//! no register and are tested on the desktop. `chip` implements those traits on the registers and exists only on the target. The image in
//! `src/bin/rig.rs` puts them together.
//!
//! No HAL is used: of those there are for this chip, none waits for the crystal with a bound, triggers injected conversions from a timer, or comes
//! up in the emulator, whose clock never reports ready. The register definitions come from the crate `stm32f4`.
//!
//! # Start-up
//!
//! 1. Before there is RAM: dump valve released (`chip::entry`).
//! 2. Clocks ([`clock`]), reset cause ([`reset_cause()`]), what survived in RAM (`retain`).
//! 3. Brown-out level, memory protection, pins, drives at zero, watchdog, supply monitor.
//! 4. Settings from flash, rig, queues.
//! 5. Sampling begins; from now on the tick decides about the dump valve.

pub mod background_task;
pub mod brown_out;
pub mod clock;
pub mod exchange;
pub mod flash;
pub mod hardware;
pub mod memory_map;
pub mod periods;
pub mod pulse;
pub mod read_back;
mod reset_cause;
pub mod tick_task;
pub mod watchdog;

#[cfg(target_os = "none")]
#[expect(unsafe_code, reason = "registers, linker symbols and memory that survives a reset")]
pub mod chip;

pub use reset_cause::reset_cause;
