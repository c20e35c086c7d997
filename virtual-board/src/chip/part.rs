//! The part: its bus, and which model answers for which instance.

use std::num::{NonZeroU32, NonZeroU64};

use rigless::chip::uart::Rate;
use rigless::cpu::armv7m::{self, Dwt};
use rigless::device::{ErasedDevice, Level, ResetCause};
use rigless::emulator::CoreSpec;
use rigless::mcu::{Mcu, Operate};
use rigless::snapshot::Store;
use rigless::soc::stm32f427::generated::{self, flash as flash_registers, gpioa, rcc as rcc_registers, tim11};
use rigless::soc::stm32f427::peripherals::adc::{Adc, AdcCommon, Channel};
use rigless::soc::stm32f427::peripherals::dbg::Dbg;
use rigless::soc::stm32f427::peripherals::dma::{Dma, Wire};
use rigless::soc::stm32f427::peripherals::gpio::{Gpio, Pin};
use rigless::soc::stm32f427::peripherals::iwdg::Iwdg;
use rigless::soc::stm32f427::peripherals::pwr::Pwr;
use rigless::soc::stm32f427::peripherals::rcc::{Apb, HSI_HZ, Rcc};
use rigless::soc::stm32f427::peripherals::tim::{self as timer, Counter, General, Tim};
use rigless::soc::stm32f427::peripherals::usart::{self, Kind, Usart};
use rigless::soc::{self, Bus, Cpu, Endian, EraseBlocks, Error, Gate, Peripheral, Region, WriteModify};
use rigless::time::VirtualNanos;

use crate::line::FarEnd;

use super::beside::{Beside, With};
use super::capture::{Capture, Rates};
use super::crystal::Oscillators;
use super::dac::Dac;
use super::flash::{Flash, Speed};
use super::held::{Held, pulse_on_pin};
use super::lines::{Lines, MonitorOutput};
use super::sampling::{InjectedGroup, TriggerOutput};
use crate::boards::stm32f405::wiring::{self, DRIVE, PULSE, Wiring};
use crate::part::{Change, Outputs, RigPart};
use crate::protocol::Fault;

// What the STM32F405 has where the STM32F427 has something else. RM0090 gives both families, each in sections of its own.

/// | what | STM32F427 | STM32F405 | RM0090 |
/// |---|---|---|---|
/// | flash | two banks, 2 MiB | one bank, 1 MiB, sectors 0 to 11 | table 5 |
/// | SRAM | 192 KiB | 112 + 16 KiB | section 2.3.1 |
/// | core-coupled memory | 64 KiB | 64 KiB, on the data bus only | section 2.3.1 |
/// | interrupt lines | 91 | 82 | table 62 |
/// | peripherals | | none of [`ABSENT`] | section 2.3 |
/// | reset values | | [`RESETS`] | chapter 7, section 5.4 |
/// | device number | 0x419 | 0x413 | section 38.6.1 |
pub static MEMORY: [Region; 5] = [
    Region::flash("flash", 0x0800_0000, 1 << 20).erased_in(&SECTORS).erased_to(0xff).programmed_by("FLASH"),
    Region::ram("ccm", 0x1000_0000, 64 << 10),
    Region::system("system", 0x1fff_0000, 32 << 10),
    Region::ram("sram", 0x2000_0000, 128 << 10),
    Region::ram("backup_sram", 0x4002_4000, 4 << 10),
];
static SECTORS: [EraseBlocks; 3] = [blocks(16, 4), blocks(64, 1), blocks(128, 7)];
const INTERRUPT_LINES: u16 = 82;
/// Peripherals of the STM32F427 (and of the STM32F407, for the camera and Ethernet) that the STM32F405 lacks.
const ABSENT: [&str; 18] = [
    "UART7",
    "UART8",
    "SPI4",
    "SPI5",
    "SPI6",
    "SAI1",
    "GPIOJ",
    "GPIOK",
    "DMA2D",
    "FMC",
    "DCMI",
    "CRYP",
    "HASH",
    "Ethernet_MAC",
    "Ethernet_MMC",
    "Ethernet_PTP",
    "Ethernet_DMA",
    "I2S2ext",
];
/// Reset values of the STM32F405 where the register tables have another: the sibling's, or one that the manual corrects.
const RESETS: [(&str, &str, u64); 14] = [
    ("RCC", "AHB1LPENR", 0x7e67_91ff),     // 7.3.15
    ("RCC", "APB1LPENR", 0x36fe_c9ff),     // 7.3.18
    ("RCC", "APB2LPENR", 0x0007_5f33),     // 7.3.19
    ("RCC", "PLLI2SCFGR", 0x2000_3000),    // 7.3.23
    ("PWR", "CR", 0x0000_4000),            // 5.4.1: VOS is one bit
    ("FLASH", "CR", 0x8000_0000),          // 3.9.5: locked
    ("DBG", "DBGMCU_IDCODE", 0x100f_6413), // 38.6.1, revision Y
    ("USART1", "SR", 0x0000_00c0),         // 30.6.1
    ("TIM2", "ARR", 0xffff_ffff),          // 18.4.12
    ("TIM5", "ARR", 0xffff_ffff),
    ("TIM3", "ARR", 0x0000_ffff),
    ("TIM4", "ARR", 0x0000_ffff),
    ("TIM11", "ARR", 0x0000_0000), // 19.5.9
    ("RCC", "CSR", 0x0e00_0000),   // 7.3.21
];
/// Reset values of MODER, OSPEEDR and PUPDR of ports A and B; the others' are zero (8.4.1, 8.4.3, 8.4.4).
const PORT_RESETS: [[u64; 3]; 2] = [[0xa800_0000, 0x0c00_0000, 0x6400_0000], [0x0000_0280, 0x0000_00c0, 0x0000_0100]];
/// Interrupts of the instances with a model whose list in the tables is incomplete (table 62).
const INTERRUPTS: [(&str, &[u16]); 3] = [("ADC1", &[18]), ("TIM11", &[26]), ("EXTI", &[1])];

const fn blocks(kib: u64, count: u32) -> EraseBlocks {
    match (NonZeroU64::new(kib << 10), NonZeroU32::new(count)) {
        (Some(size), Some(count)) => EraseBlocks { size, count },
        _ => panic!("a sector has bytes"),
    }
}

/// Ports.
pub const PORTS: [&str; 9] = ["GPIOA", "GPIOB", "GPIOC", "GPIOD", "GPIOE", "GPIOF", "GPIOG", "GPIOH", "GPIOI"];
const TIMERS: [(&str, Counter); 3] = [("TIM3", Counter::Narrow), ("TIM4", Counter::Narrow), ("TIM5", Counter::Wide)];

/// Instance, enable register and bit, reset register and bit (7.3.5 to 7.3.14).
const CLOCKED: [[&str; 5]; 22] = [
    ["PWR", "APB1ENR", "PWREN", "APB1RSTR", "PWRRST"],
    ["DAC", "APB1ENR", "DACEN", "APB1RSTR", "DACRST"],
    ["TIM2", "APB1ENR", "TIM2EN", "APB1RSTR", "TIM2RST"],
    ["TIM3", "APB1ENR", "TIM3EN", "APB1RSTR", "TIM3RST"],
    ["TIM4", "APB1ENR", "TIM4EN", "APB1RSTR", "TIM4RST"],
    ["TIM5", "APB1ENR", "TIM5EN", "APB1RSTR", "TIM5RST"],
    ["USART1", "APB2ENR", "USART1EN", "APB2RSTR", "USART1RST"],
    ["ADC1", "APB2ENR", "ADC1EN", "APB2RSTR", "ADCRST"],
    ["C_ADC", "APB2ENR", "ADC1EN", "APB2RSTR", "ADCRST"],
    ["TIM11", "APB2ENR", "TIM11EN", "APB2RSTR", "TIM11RST"],
    ["SYSCFG", "APB2ENR", "SYSCFGEN", "APB2RSTR", "SYSCFGRST"],
    ["CRC", "AHB1ENR", "CRCEN", "AHB1RSTR", "CRCRST"],
    ["DMA2", "AHB1ENR", "DMA2EN", "AHB1RSTR", "DMA2RST"],
    ["GPIOA", "AHB1ENR", "GPIOAEN", "AHB1RSTR", "GPIOARST"],
    ["GPIOB", "AHB1ENR", "GPIOBEN", "AHB1RSTR", "GPIOBRST"],
    ["GPIOC", "AHB1ENR", "GPIOCEN", "AHB1RSTR", "GPIOCRST"],
    ["GPIOD", "AHB1ENR", "GPIODEN", "AHB1RSTR", "GPIODRST"],
    ["GPIOE", "AHB1ENR", "GPIOEEN", "AHB1RSTR", "GPIOERST"],
    ["GPIOF", "AHB1ENR", "GPIOFEN", "AHB1RSTR", "GPIOFRST"],
    ["GPIOG", "AHB1ENR", "GPIOGEN", "AHB1RSTR", "GPIOGRST"],
    ["GPIOH", "AHB1ENR", "GPIOHEN", "AHB1RSTR", "GPIOHRST"],
    ["GPIOI", "AHB1ENR", "GPIOIEN", "AHB1RSTR", "GPIOIRST"],
];
/// Instances that keep time, and those that hear other instances' requests.
const TIMED: [&str; 8] = ["TIM2", "TIM3", "TIM4", "TIM5", "USART1", "IWDG", "C_ADC", "ADC1"];
const LISTENING: [&str; 5] = ["RCC", "C_ADC", "ADC1", "EXTI", "DMA2"];
/// The line's requests to the transfer controller (table 43); no other instance's reach it here.
static TRANSFERS: [Wire; 2] = [
    Wire { instance: "USART1", request: usart::RECEIVE_REQUEST, channel: 4, streams: &[2, 5] },
    Wire { instance: "USART1", request: usart::TRANSMIT_REQUEST, channel: 4, streams: &[7] },
];

/// Codes of a pin's mode: an output, one that a peripheral has, an analogue one (8.4.1).
const OUTPUT: u64 = 0b01;
const ALTERNATE: u64 = 0b10;
const ANALOGUE: u64 = 0b11;
/// Alternate functions of TIM3 and USART1 (DS8626 table 9).
const AF_TIM3: u64 = 2;
const AF_USART1: u64 = 7;

fn cpu() -> Cpu {
    Cpu::new("CM4", true, INTERRUPT_LINES, Endian::Little)
}

fn instances() -> impl Iterator<Item = Peripheral> {
    generated::PERIPHERALS
        .iter()
        .copied()
        .filter(|peripheral| !ABSENT.contains(&peripheral.name))
        .map(|mut peripheral| {
            if let Some((_, lines)) = INTERRUPTS.iter().find(|(name, _)| *name == peripheral.name) {
                peripheral.interrupts = lines;
            }
            if PORTS.contains(&peripheral.name) {
                peripheral.registers = &gpioa::REGISTERS;
            }
            match peripheral.name {
                "TIM2" | "TIM5" => peripheral.registers = Counter::Wide.layout(),
                "TIM3" | "TIM4" => peripheral.registers = Counter::Narrow.layout(),
                _ => {}
            }
            peripheral
        })
        .chain(std::iter::once(armv7m::PERIPHERAL))
}

fn bus() -> Result<Bus, Error> {
    // Which output of the clock tree an instance runs on is the same in both families; the crate knows the outputs' numbers.
    let sibling = soc::stm32f427::builder().build()?;
    let mut builder = Bus::builder(cpu(), &MEMORY, instances());
    for (instance, register, value) in RESETS {
        builder = builder.reset(instance, register, value);
    }
    for (port, values) in PORTS.iter().zip(PORT_RESETS.into_iter().chain(std::iter::repeat([0; 3]))) {
        for (register, value) in ["MODER", "OSPEEDR", "PUPDR"].into_iter().zip(values) {
            builder = builder.reset(port, register, value);
        }
    }
    // Flags that a written zero clears (18.4.5, 19.5.3), and those that a written one clears (3.9.4).
    for timer in ["TIM2", "TIM3", "TIM4", "TIM5"] {
        builder = builder.write_modify(timer, "SR", WriteModify::ZeroToClear);
    }
    builder = builder.write_modify("FLASH", "SR", WriteModify::OneToClear);
    for [instance, enable_register, enable, reset_register, reset] in CLOCKED {
        builder = builder.gate(instance, Gate::by("RCC", enable_register, enable));
        builder = builder.reset_by(instance, Gate::by("RCC", reset_register, reset));
    }
    for instance in TIMED.into_iter().chain([armv7m::DWT]) {
        if let Some(clock) = sibling.clock_of(instance) {
            builder = builder.clocked_by(instance, clock);
        }
    }
    for instance in LISTENING {
        builder = builder.reads_requests(instance);
    }
    builder.build()
}

/// Who answers for a slot of the bus.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Model {
    None,
    Clocks,
    Supply,
    Lines,
    Flash,
    Port(usize),
    Line,
    Converter,
    ConverterClock,
    SamplingTimer,
    Timer(usize),
    Dac,
    Transfers,
    Capture,
    Watchdog,
    Debug,
    Cycles,
}

/// The supply as it should be, mV.
pub const SUPPLY_MV: u32 = 3300;
/// The option bytes as delivered: no protection, brown-out reset off (RM0090 section 3.9.6).
const OPTIONS_OF_THE_FACTORY: u64 = 0x0fff_aaed;
/// Code of a converter at full scale.
const FULL_CODE: u32 = 4095;
/// Channel of PA4 (DS8626 table 7).
const DRIVE_CHANNEL: Option<Channel> = Channel::new(4);

/// What is on the part's pins; it outlasts resets.
#[derive(Debug, Clone, Copy)]
pub struct Pins {
    /// Which pin is what.
    pub wiring: Wiring,
    /// Frequency of the crystal, Hz.
    pub crystal_hz: u64,
    /// Frequency of the watchdog's oscillator, Hz: 17 to 47 kHz (DS8626 table 42).
    pub watchdog_hz: u64,
    /// The oscillators' health.
    pub oscillators: Oscillators,
    /// The supply, mV.
    pub supply_mv: u32,
    /// The analogue supply, mV, where it is not the supply itself.
    pub analogue_mv: Option<u32>,
    /// The code at the drive's pin whatever the converter does there.
    pub drive_stuck: Option<u16>,
    /// The level at the dump valve's pin whatever the port does there.
    pub dump_stuck: Option<bool>,
    /// The level at the pulse width's pin whatever the timer does there.
    pub pulse_stuck: Option<bool>,
    /// Whether the two analogue inputs are exchanged.
    pub swapped: bool,
    /// The option bytes, as OPTCR shows them after a reset (3.9.6).
    pub option_bytes: u64,
    /// Whether the emergency stop's contact is open.
    pub stop_pressed: bool,
    /// How fast flash is.
    pub flash: Speed,
}

impl Pins {
    /// A board as it should be.
    pub fn of(wiring: Wiring) -> Self {
        Self {
            wiring,
            crystal_hz: u64::from(wiring.crystal_hz),
            watchdog_hz: 32_000,
            oscillators: Oscillators::default(),
            supply_mv: SUPPLY_MV,
            analogue_mv: None,
            drive_stuck: None,
            dump_stuck: None,
            pulse_stuck: None,
            swapped: false,
            option_bytes: OPTIONS_OF_THE_FACTORY,
            stop_pressed: false,
            flash: Speed::Typical,
        }
    }
}

/// The part.
#[derive(Debug)]
pub struct Stm32f405 {
    bus: Bus,
    models: Vec<Model>,
    /// What is on its pins.
    pub pins: Pins,
    clocks: With<Rcc, Oscillators>,
    supply: With<Pwr, MonitorOutput>,
    lines: Lines,
    /// The flash interface.
    pub flash: Flash,
    ports: [With<Gpio, Held>; PORTS.len()],
    /// The link's line.
    pub line: Usart,
    converter: With<Adc, InjectedGroup>,
    converter_clock: AdcCommon,
    sampling_timer: With<Tim<General>, TriggerOutput>,
    timers: [Tim<General>; TIMERS.len()],
    dac: Dac,
    transfers: Dma,
    capture: Capture<tim11::Register>,
    watchdog: Iwdg,
    debug: Dbg,
    cycles: Dwt,
    powered: bool,
    /// The option bytes as the last reset loaded them (3.7.1).
    options_in_force: u64,
    /// The lowest supply since the part was in force.
    lowest_mv: u32,
}

impl Stm32f405 {
    /// The part out of its power-on reset.
    ///
    /// # Errors
    /// When its description contradicts itself.
    pub fn new(pins: Pins) -> Result<Self, Error> {
        let bus = bus()?;
        let mut models = vec![Model::None; bus.slots().len()];
        let mut wired = vec![
            ("RCC", Model::Clocks),
            ("PWR", Model::Supply),
            ("EXTI", Model::Lines),
            ("FLASH", Model::Flash),
            ("USART1", Model::Line),
            ("ADC1", Model::Converter),
            ("C_ADC", Model::ConverterClock),
            ("TIM2", Model::SamplingTimer),
            ("DAC", Model::Dac),
            ("DMA2", Model::Transfers),
            ("TIM11", Model::Capture),
            ("IWDG", Model::Watchdog),
            ("DBG", Model::Debug),
            (armv7m::DWT, Model::Cycles),
        ];
        wired.extend(PORTS.iter().enumerate().map(|(nth, port)| (*port, Model::Port(nth))));
        wired.extend(TIMERS.iter().enumerate().map(|(nth, (timer, _))| (*timer, Model::Timer(nth))));
        for (instance, model) in wired {
            models[bus.slot(instance)?] = model;
        }
        let converter_clock = AdcCommon::with_clock(HSI_HZ);
        let mut part = Self {
            bus,
            models,
            pins,
            clocks: With { model: Rcc::new(), beside: pins.oscillators },
            supply: With { model: Pwr::new(), beside: MonitorOutput::default() },
            lines: Lines::default(),
            flash: Flash::new(pins.flash, pins.option_bytes),
            ports: std::array::from_fn(|_| With { model: Gpio::default(), beside: Held::default() }),
            line: Usart::with_clock(Kind::Usart, HSI_HZ),
            // ADCPRE is 2 out of reset (13.13.16).
            converter: With { model: Adc::with_clock(HSI_HZ / 2), beside: InjectedGroup::on([pins.wiring.laser, pins.wiring.pressure]) },
            converter_clock,
            sampling_timer: With { model: Tim::with_clock(HSI_HZ, Counter::Wide), beside: TriggerOutput::default() },
            timers: std::array::from_fn(|nth| Tim::with_clock(HSI_HZ, TIMERS[nth].1)),
            dac: Dac::default(),
            transfers: Dma::new(&TRANSFERS, &[], true),
            capture: Capture::default(),
            watchdog: Iwdg::new(),
            debug: Dbg,
            cycles: Dwt::with_clock(HSI_HZ),
            powered: true,
            options_in_force: pins.option_bytes,
            lowest_mv: pins.supply_mv,
        };
        part.check()?;
        part.fit(VirtualNanos(0));
        Ok(part)
    }

    /// Puts what is on the pins on a part fresh out of reset.
    fn fit(&mut self, at: VirtualNanos) {
        let pins = self.pins;
        self.clocks.model.attach_crystals(pins.crystal_hz, 0);
        self.clocks.model.calibrate_lsi(pins.watchdog_hz);
        self.converter.model.set_backup_battery(pins.supply_mv);
        self.set_supply(pins.supply_mv, at);
        self.press_stop(pins.stop_pressed, at);
        self.hold_dump_pin(pins.dump_stuck);
        self.hold_pulse_pin(pins.pulse_stuck);
        // The option bytes come with the reset (3.7.1).
        let slot = self.slot(Model::Flash);
        self.bus.slot_mut(slot).registers_mut().set(flash_registers::Register::Optcr, pins.option_bytes);
    }

    fn slot(&self, model: Model) -> usize {
        // Note(unwrap): every model is wired in `new`.
        self.models.iter().position(|candidate| *candidate == model).expect("a wired model")
    }

    /// Whether the supply went so low that memory forgets.
    pub fn forgets(&self) -> bool {
        self.lowest_mv < POWER_DOWN_MV
    }

    /// Codes of the next groups of conversions, at 3.3 V.
    pub fn set_codes(&mut self, codes: [[u16; 2]; 2]) {
        let [laser, pressure] = codes;
        // Voltages on the pins do not know of the analogue supply; codes are their share of it.
        let supply_mv = self.pins.analogue_mv.unwrap_or(SUPPLY_MV);
        let share = |code: u16| u16::try_from((u32::from(code) * SUPPLY_MV / supply_mv.max(1)).min(FULL_CODE)).unwrap_or_default();
        let [laser, pressure] = [laser, pressure].map(|pair| pair.map(share));
        self.converter.beside.codes = if self.pins.swapped { [pressure, laser] } else { [laser, pressure] };
    }

    /// Groups of conversions so far.
    pub fn groups(&self) -> u64 {
        self.converter.beside.groups
    }

    /// Opens or closes the emergency stop's contact: high is pressed, or a broken wire.
    pub fn press_stop(&mut self, pressed: bool, at: VirtualNanos) {
        self.pins.stop_pressed = pressed;
        let stop = self.pins.wiring.emergency_stop;
        let port = stop.port as usize;
        let slot = self.slot(Model::Port(port));
        let (registers, mut context) = self.bus.drive(at, slot);
        if let Some(pin) = u8::try_from(stop.number).ok().and_then(Pin::new) {
            self.ports[port].model.drive(pin, Some(Level::from(pressed)), registers, &mut context);
        }
    }

    /// The analogue supply alone, whose share the converters measure; `None`: it follows the supply again.
    pub fn set_analogue_supply(&mut self, millivolts: Option<u32>) {
        self.pins.analogue_mv = millivolts;
        self.converter.model.set_reference(millivolts.unwrap_or(self.pins.supply_mv));
    }

    /// Holds the dump valve's pin at a level, or lets it go.
    pub fn hold_dump_pin(&mut self, level: Option<bool>) {
        self.pins.dump_stuck = level;
        let dump = self.pins.wiring.dump_valve;
        self.ports[dump.port as usize].beside.force(dump, level);
    }

    /// Holds the pulse width's pin at a level, or lets it go.
    pub fn hold_pulse_pin(&mut self, level: Option<bool>) {
        self.pins.pulse_stuck = level;
        self.ports[PULSE.port as usize].beside.force(PULSE, level);
    }

    /// Supply below which the part is held in reset, and above which it comes out again, mV: the option bytes' brown-out level, typical
    /// voltages of DS8626 table 24.
    fn reset_mv(&self) -> (u32, u32) {
        match self.options_in_force >> 2 & 0b11 {
            0 => (2830, 2920),
            1 => (2500, 2590),
            2 => (2190, 2290),
            _ => (POWER_DOWN_MV, POWER_DOWN_MV),
        }
    }

    /// Moves the supply. Below the brown-out level, or the power-down reset's 1.7 V (DS8626 table 23), the part has none.
    pub fn set_supply(&mut self, millivolts: u32, at: VirtualNanos) {
        let (falling_mv, rising_mv) = self.reset_mv();
        let was_on = self.powered;
        self.pins.supply_mv = millivolts;
        self.lowest_mv = self.lowest_mv.min(millivolts);
        self.set_analogue_supply(self.pins.analogue_mv);
        let slot = self.slot(Model::Supply);
        let (registers, mut context) = self.bus.drive(at, slot);
        self.supply.model.set_supply(millivolts, registers);
        Beside::after(&mut self.supply.beside, &mut self.supply.model, registers, &mut context);
        let is_on = millivolts >= if was_on { falling_mv } else { rising_mv };
        self.powered = is_on;
        if is_on != was_on {
            context.request_power(is_on);
        }
    }

    /// The crystal stops or swings again. Gives whether the clock security system noticed, which is an NMI (7.2.7).
    pub fn set_crystal(&mut self, swings: bool, at: VirtualNanos) -> bool {
        self.pins.oscillators.crystal = swings;
        self.clocks.beside.crystal = swings;
        if swings {
            return false;
        }
        let slot = self.slot(Model::Clocks);
        let (registers, mut context) = self.bus.drive(at, slot);
        let flag = |registers: &rigless::device::RegisterFile| rcc_registers::cir::CSSF.is_set(registers.get(rcc_registers::Register::Cir));
        let before = flag(registers);
        self.clocks.model.fail_hse(registers, &mut context);
        !before && flag(registers)
    }

    /// Another crystal.
    pub fn set_crystal_hz(&mut self, hz: u64) {
        self.pins.crystal_hz = hz;
        self.clocks.model.attach_crystals(hz, 0);
    }

    /// Whether the phase-locked loop locks from now on.
    pub fn set_loop(&mut self, locks: bool) {
        self.pins.oscillators.loop_locks = locks;
        self.clocks.beside.loop_locks = locks;
    }

    /// Another frequency of the watchdog's oscillator.
    pub fn set_watchdog_hz(&mut self, hz: u64) {
        self.pins.watchdog_hz = hz;
        self.clocks.model.calibrate_lsi(hz);
    }

    /// What the part does to its pins.
    pub fn outputs(&self) -> Outputs {
        let registers = |model| self.bus.slots()[self.slot(model)].registers();
        // As share of 3.3 V, which the valve's driver measures.
        let supply_mv = self.pins.analogue_mv.unwrap_or(SUPPLY_MV);
        let share = |code: u16| u16::try_from((u32::from(code) * supply_mv / SUPPLY_MV).min(FULL_CODE)).unwrap_or_default();
        let drive_code = self.pins.drive_stuck.or_else(|| self.driven_code()).map(share);
        let pulse = {
            use rigless::soc::stm32f427::generated::tim3::{Register, ccer, cr1};
            let timer = registers(Model::Timer(0));
            let on = cr1::CEN.is_set(timer.get(Register::Cr1)) && ccer::CC1E.is_set(timer.get(Register::Ccer));
            let number = |register| u16::try_from(timer.get(register)).unwrap_or(u16::MAX);
            (on && self.has_function(PULSE, AF_TIM3)).then(|| (number(Register::Ccr1), number(Register::Arr)))
        };
        let dump = self.pins.wiring.dump_valve;
        let driven = self.mode(dump) == OUTPUT;
        let high = registers(Model::Port(dump.port as usize)).get(gpioa::Register::Odr) >> dump.number & 1 != 0;
        let pulse = pulse_on_pin(pulse, self.pins.pulse_stuck);
        Outputs { drive_code, pulse, dump_valve: self.pins.dump_stuck.unwrap_or(driven && high) }
    }

    /// The code that the converter puts on its pin.
    fn driven_code(&self) -> Option<u16> {
        Dac::output(self.bus.slots()[self.slot(Model::Dac)].registers(), 0).filter(|_| self.mode(DRIVE) == ANALOGUE)
    }

    /// What the port makes of a pin.
    fn mode(&self, pin: wiring::Pin) -> u64 {
        let registers = self.bus.slots()[self.slot(Model::Port(pin.port as usize))].registers();
        registers.get(gpioa::Register::Moder) >> (2 * pin.number) & 0b11
    }

    /// Whether a peripheral has a pin.
    fn has_function(&self, pin: wiring::Pin, function: u64) -> bool {
        let registers = self.bus.slots()[self.slot(Model::Port(pin.port as usize))].registers();
        let register = if pin.number < 8 { gpioa::Register::Afrl } else { gpioa::Register::Afrh };
        self.mode(pin) == ALTERNATE && registers.get(register) >> (4 * (pin.number % 8)) & 0b1111 == function
    }

    /// Whether the serial port has the pins that the line to the host is soldered to: from the part, and to it.
    pub fn line_is_connected(&self) -> (bool, bool) {
        let Wiring { transmit, receive, .. } = self.pins.wiring;
        (self.has_function(transmit, AF_USART1), self.has_function(receive, AF_USART1))
    }
}

/// Supply below which the part is in reset, mV (DS8626 table 23).
const POWER_DOWN_MV: u32 = 1700;

impl Mcu for Stm32f405 {
    fn bus(&self) -> &Bus {
        &self.bus
    }

    fn bus_mut(&mut self) -> &mut Bus {
        &mut self.bus
    }

    /// Every register at its reset value (7.1.1); what is on the pins stays, the flags of the resets before too, unless power was gone.
    fn reset(&mut self, at: VirtualNanos, cause: ResetCause) {
        // Note(unwrap): it went together before.
        let mut fresh = Self::new(self.pins).expect("a part that went together goes together again");
        let flags = self.bus.slots()[self.slot(Model::Clocks)].registers().get(rcc_registers::Register::Csr);
        let slot = fresh.slot(Model::Clocks);
        if cause != ResetCause::PowerOn {
            fresh.clocks.model.restarted(cause, flags, fresh.bus.slot_mut(slot).registers_mut());
        } else if self.lowest_mv >= POWER_DOWN_MV {
            // The brown-out level alone: BORRSTF and PINRSTF (7.3.21).
            fresh.bus.slot_mut(slot).registers_mut().set(rcc_registers::Register::Csr, 0x0600_0000);
        }
        fresh.line.inherit(&mut self.line);
        fresh.converter.beside.codes = self.converter.beside.codes;
        fresh.powered = self.powered;
        *self = fresh;
        self.fit(at);
    }

    fn poll(&mut self, now: VirtualNanos) {
        let slot = self.slot(Model::Line);
        let (registers, mut context) = self.bus.drive(now, slot);
        rigless::device::Device::poll(&mut self.line, registers, &mut context);
    }

    fn split(&mut self, slot: usize) -> (&mut Bus, Option<&mut dyn ErasedDevice>) {
        let model = self.models.get(slot).copied().unwrap_or(Model::None);
        if model == Model::Capture {
            // 7.2.11: the crystal over RTCPRE; a divider of 0 or 1 is none (7.3.3).
            let registers = self.bus.slots()[self.slot(Model::Clocks)].registers();
            let divider = rcc_registers::cfgr::RTCPRE.get(registers.get(rcc_registers::Register::Cfgr));
            let swings = self.pins.oscillators.crystal && rcc_registers::cr::HSEON.is_set(registers.get(rcc_registers::Register::Cr));
            self.capture.rates = Rates {
                timer_hz: self.clocks.model.timer_clock(registers, Apb::Two),
                input_hz: if swings && divider > 1 { self.pins.crystal_hz / divider } else { 0 },
            };
        }
        if model == Model::Port(PULSE.port as usize) {
            // A pin that a timer has shows the timer's output (8.3.11).
            let registers = self.bus.slots()[self.slot(Model::Timer(0))].registers();
            let level = timer::Channel::new(1).and_then(|channel| self.timers[0].output(channel, registers));
            let level = level.filter(|_| self.has_function(PULSE, AF_TIM3));
            self.ports[PULSE.port as usize].beside.drive(PULSE, level);
        }
        if model == Model::Converter {
            let Wiring { laser, pressure, .. } = self.pins.wiring;
            self.converter.beside.connected = [laser, pressure].map(|pin| self.mode(pin) == ANALOGUE);
        }
        if let (Model::Converter, Some(channel)) = (model, DRIVE_CHANNEL) {
            // The drive's pin is an input of the converter too, and both have one reference. Rounded up, because the model rounds down again.
            let code = self.pins.drive_stuck.or_else(|| self.driven_code()).unwrap_or(0);
            let reference_mv = self.pins.analogue_mv.unwrap_or(self.pins.supply_mv);
            self.converter.model.set_input(channel, (u32::from(code) * reference_mv).div_ceil(FULL_CODE));
        }
        let Self { bus, clocks, supply, lines, flash, ports, line, converter, converter_clock, sampling_timer, .. } = self;
        let answering: Option<&mut dyn ErasedDevice> = match model {
            Model::None => None,
            Model::Clocks => Some(clocks),
            Model::Supply => Some(supply),
            Model::Lines => Some(lines),
            Model::Flash => Some(flash),
            Model::Port(nth) => Some(&mut ports[nth]),
            Model::Line => Some(line),
            Model::Converter => Some(converter),
            Model::ConverterClock => Some(converter_clock),
            Model::SamplingTimer => Some(sampling_timer),
            Model::Timer(nth) => Some(&mut self.timers[nth]),
            Model::Dac => Some(&mut self.dac),
            Model::Transfers => Some(&mut self.transfers),
            Model::Capture => Some(&mut self.capture),
            Model::Watchdog => Some(&mut self.watchdog),
            Model::Debug => Some(&mut self.debug),
            Model::Cycles => Some(&mut self.cycles),
        };
        (bus, answering)
    }
}

impl Store for Stm32f405 {}

impl RigPart for Stm32f405 {
    const NAME: &'static str = "stm32f405";
    const CORE_HZ: NonZeroU64 = const { NonZeroU64::new(168_000_000).unwrap() };
    // SRAM and core-coupled memory.
    const FORGETFUL: &'static [(u64, u64)] = &[(0x2000_0000, 128 << 10), (0x1000_0000, 64 << 10)];
    // DS8626 table 77: in the upper half of this word, for the 1.21 V of the converter's model.
    const CALIBRATION: (u64, u32) = (0x1fff_7a28, 1501 << 16);

    fn board(&self) -> &'static str {
        self.pins.wiring.name
    }

    fn core(&self, clock_hz: NonZeroU64) -> CoreSpec {
        let lines = NonZeroU32::new(u32::from(Operate::cpu(self).interrupt_lines)).unwrap_or(NonZeroU32::MIN);
        crate::core::spec(clock_hz, lines, &armv7m::windows(self.bus()))
    }

    fn attach(&mut self, far_end: FarEnd) {
        self.line.attach(far_end);
    }

    fn set_codes(&mut self, codes: [[u16; 2]; 2]) {
        Self::set_codes(self, codes);
    }

    fn press_stop(&mut self, pressed: bool, at: VirtualNanos) {
        if self.pins.stop_pressed != pressed {
            Self::press_stop(self, pressed, at);
        }
    }

    fn outputs(&self) -> Outputs {
        Self::outputs(self)
    }

    fn groups(&self) -> u64 {
        Self::groups(self)
    }

    fn line_is_connected(&self) -> (bool, bool) {
        Self::line_is_connected(self)
    }

    fn break_something(&mut self, fault: Fault, at: VirtualNanos) -> Result<bool, String> {
        match fault {
            Fault::Crystal(swings) => return Ok(self.set_crystal(swings, at)),
            Fault::CrystalHz(hz) => self.set_crystal_hz(hz),
            Fault::Loop(locks) => self.set_loop(locks),
            Fault::WatchdogHz(hz) => self.set_watchdog_hz(hz),
            Fault::Supply(millivolts) => Self::set_supply(self, millivolts, at),
            Fault::Analogue(millivolts) => self.set_analogue_supply(millivolts),
            Fault::DrivePin(code) => self.pins.drive_stuck = code,
            Fault::DumpPin(level) => self.hold_dump_pin(level),
            Fault::PulsePin(level) => self.hold_pulse_pin(level),
            Fault::Swapped => self.pins.swapped = true,
            Fault::LateFlash => {
                self.pins.flash = Speed::Slowest;
                self.flash.speed = Speed::Slowest;
            }
            Fault::Noise(words) => self.line.errors_mut().noise = Rate { name: "line-noise", per_million: words },
            Fault::Store { .. } | Fault::Reset | Fault::Flip { .. } | Fault::Cut(_) | Fault::Hang => {
                return Err(format!("{fault:?} is no fault of the part's own"));
            }
        }
        Ok(false)
    }

    fn set_supply(&mut self, millivolts: u32, at: VirtualNanos) {
        Self::set_supply(self, millivolts, at);
    }

    fn forgets(&self) -> bool {
        Self::forgets(self)
    }

    fn flash_running(&self) -> Option<Change> {
        self.flash.running()
    }

    fn take_flash_changes(&mut self) -> Vec<Change> {
        self.pins.option_bytes = self.flash.option_bytes;
        self.flash.take_finished()
    }
}
