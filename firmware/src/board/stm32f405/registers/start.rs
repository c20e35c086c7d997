//! The chip's start, as [`Board`] asks for it.

use cortex_m::peripheral::{SCB, SYST};
use model_export::link::fault::{Fault, FaultSet};

use super::clock::Registers;
use super::drives::{self, AnalogueDrive, PulseDrive};
use super::flash::Controller;
use super::sampling::{self, Milliseconds, Sampler};
use super::{bootloader, pac, pins, serial, supply, watchdog};
use crate::board::clock::{self, Source};
use crate::board::contract::{Board, Started};
use crate::board::log::Logged;
use crate::board::pulse_drive::{ExpectedPulse, PulseExpectation, PulseReading};
use crate::board::rates::Rates;
use crate::board::selected::WIRING;
use crate::board::shared_atomics::SharedAtomics;
use crate::board::stm32f405::facts::{self, MODEL_SECTORS, SECTOR_BYTES, SETTINGS_SECTORS};
use crate::board::stm32f405::flash::InternalFlash;
use crate::board::stm32f405::{brown_out, reset_cause};
use crate::board::target::cycles::Cycles;
use crate::board::target::{crash, identity, protection};
use crate::board::tick_task::TickIo;
use crate::storage::Sectors;

/// The board that this build is for, on its chip.
pub struct ThisBoard;

/// What the image takes from its framework.
pub struct Peripherals {
    /// The chip's.
    pub device: pac::Peripherals,
    /// The processor's.
    pub core: cortex_m::Peripherals,
}

impl Board for ThisBoard {
    const NAME: &'static str = WIRING.name;
    const HAS_BOOTLOADER: bool = true;
    const MODEL_SLOTS: [usize; 2] = [MODEL_SECTORS[0].0 as usize, MODEL_SECTORS[1].0 as usize];
    const SLOT_BYTES: usize = SECTOR_BYTES;

    type Peripherals = Peripherals;
    type LineMemory = serial::Memory;
    type Clock<'a> = Registers<'a>;
    type Sampling = Sampler;
    type AnalogueDrive = AnalogueDrive;
    type PulseDrive = PulseDrive;
    type DumpPin = pins::DumpPin;
    type StopPin = pins::StopPin;
    type Watchdog = watchdog::Timer;
    type Counter = Cycles;
    type CrashMemory = crash::NoInitMemory;
    type Line = serial::SerialLine;
    type LineInterrupt = serial::Port;
    type Flash = Sectors<Logged<InternalFlash<Controller>>>;
    type Supply = supply::Monitor;
    type Beginning = (SYST, Rates);

    fn start(peripherals: Peripherals, line: &'static mut serial::Memory, shared: &'static SharedAtomics) -> Started<Self> {
        let Peripherals { device, mut core } = peripherals;
        let rcc = &device.RCC;
        bootloader::follow(rcc, &device.SYSCFG);

        // Why are we here, and in what time.
        let crash_record = crash::take();
        let reset_cause = reset_cause(rcc.csr().read().bits(), crash_record.and_then(|crash_record| crash_record.crash));
        rcc.csr().modify(|_, w| w.rmvf().set_bit());
        let mut registers = Registers { rcc, flash: &device.FLASH, timer: &device.TIM11 };
        let clock = clock::start(&mut registers, &const { facts::plan(WIRING.hse_hz) });
        let rates = clock.rates;
        let mut found = FaultSet::EMPTY;

        let level = brown_out::ensure(&mut &device.FLASH);
        if level == brown_out::Outcome::Programmed {
            defmt::info!("brown-out level programmed");
        }
        protection::start(&core.MPU);

        // Outputs, all of them at rest.
        let (dump_valve, emergency_stop) = pins::set_up(rcc);
        let analogue = AnalogueDrive::new(rcc, device.DAC);
        let pulse = drives::pulse_drive(rcc, device.TIM3, rates, &shared.pulse);
        let (watchdog, watchdog_lives) = watchdog::start(device.IWDG);
        let mut standing = clock.faults;
        standing.insert_if(!watchdog_lives, Fault::ClockInaccurate);
        let (supply, is_low) = supply::start(rcc, device.PWR, &device.EXTI);
        found.insert_if(is_low, Fault::BrownOut);
        let source = Sampler::new(rcc, device.ADC1, &device.ADC_COMMON, device.TIM2, rates);
        let milliseconds = Milliseconds::start(rcc, device.TIM5, rates);
        let (line_interrupt, line) = serial::start(rcc, device.USART1, device.DMA2, rates, line);

        // SAFETY: both controllers go into the link, which runs in the background alone.
        let controller = || unsafe { Controller::new(milliseconds, shared) };
        Started {
            reset_cause,
            crash_record,
            clock,
            standing,
            found,
            // SAFETY: an HSE that runs is on the chip itself.
            reference_calibration: (clock.source == Source::Hse).then(|| unsafe { sampling::reference_calibration() }),
            // SAFETY: as above.
            thermometer: (clock.source == Source::Hse).then(|| unsafe { sampling::chip_calibration() }).flatten(),
            build: identity::read(clock.source == Source::Hse),
            io: TickIo {
                source,
                analogue,
                pulse,
                dump_valve,
                emergency_stop,
                watchdog,
                counter: Cycles::start(&mut core.DCB, core.DWT),
                // SAFETY: the only one.
                crash_memory: unsafe { crash::NoInitMemory::new() },
            },
            line,
            line_interrupt,
            settings: Sectors::new(Logged::new(InternalFlash::new(controller(), SETTINGS_SECTORS), "settings")),
            models: Sectors::new(Logged::new(InternalFlash::new(controller(), MODEL_SECTORS), "models")),
            supply,
            beginning: (core.SYST, rates),
        }
    }

    fn begin((mut tick_monitor, rates): (SYST, Rates), sampling: &mut Sampler) {
        sampling.begin();
        sampling::start_tick_monitor(&mut tick_monitor, sampling, rates);
    }

    fn read_pulse(expectation: &PulseExpectation) -> (ExpectedPulse, PulseReading) {
        drives::read_pulse(expectation)
    }

    fn crash(fault: Fault) -> ! {
        crash::vent_and_remember(fault);
        SCB::sys_reset()
    }

    fn enter_bootloader() -> ! {
        bootloader::enter()
    }
}
