//! The part: its bus, and which model answers for which instance.

use std::num::{NonZeroU32, NonZeroU64};

use rigless::cpu::armv7m::{self, Dwt};
use rigless::device::{ErasedDevice, Level, ResetCause};
use rigless::mcu::{Mcu, Operate};
use rigless::soc::stm32f427::generated::{self, gpioa, rcc as rcc_registers};
use rigless::soc::stm32f427::peripherals::adc::{Adc, AdcCommon};
use rigless::soc::stm32f427::peripherals::dbg::Dbg;
use rigless::soc::stm32f427::peripherals::gpio::{Gpio, Pin};
use rigless::soc::stm32f427::peripherals::iwdg::Iwdg;
use rigless::soc::stm32f427::peripherals::pwr::Pwr;
use rigless::soc::stm32f427::peripherals::rcc::{Apb, HSI_HZ, Rcc};
use rigless::soc::stm32f427::peripherals::tim::{Counter, General, Tim};
use rigless::soc::stm32f427::peripherals::usart::{Kind, Usart};
use rigless::soc::{self, Bus, Cpu, Endian, EraseBlocks, Error, Gate, Peripheral, Region, WriteModify};
use rigless::time::VirtualNanos;

use super::beside::With;
use super::capture::{Capture, Rates};
use super::crystal::Oscillators;
use super::dac::Dac;
use super::flash::{Flash, Speed};
use super::lines::{Lines, MonitorOutput};
use super::sampling::{InjectedGroup, TriggerOutput};

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
const CLOCKED: [[&str; 5]; 21] = [
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
const LISTENING: [&str; 4] = ["RCC", "C_ADC", "ADC1", "EXTI"];

/// The pin of the emergency stop, the dump valve and the pulse width (`firmware/src/board/hardware.rs`).
const PORT_A: usize = 0;
const PORT_B: usize = 1;
const STOP_PIN: u8 = 0;
const DUMP_PIN: u8 = 1;
const DRIVE_PIN: u8 = 4;
const PULSE_PIN: u8 = 6;

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
    Capture,
    Watchdog,
    Debug,
    Cycles,
}

/// What is on the part's pins; it outlasts resets.
#[derive(Debug, Clone, Copy)]
pub struct Pins {
    /// Frequency of the crystal, Hz.
    pub crystal_hz: u64,
    /// Frequency of the watchdog's oscillator, Hz: 17 to 47 kHz (DS8626 table 42).
    pub watchdog_hz: u64,
    /// The oscillators' health.
    pub oscillators: Oscillators,
    /// The supply, mV.
    pub supply_mv: u32,
    /// Whether the emergency stop's contact is open.
    pub stop_pressed: bool,
    /// How fast flash is.
    pub flash: Speed,
}

impl Default for Pins {
    fn default() -> Self {
        Self {
            crystal_hz: 8_000_000,
            watchdog_hz: 32_000,
            oscillators: Oscillators::default(),
            supply_mv: 3300,
            stop_pressed: false,
            flash: Speed::Typical,
        }
    }
}

/// What the part does to the pins.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Outputs {
    /// Code at PA4, if the converter drives it.
    pub drive_code: Option<u16>,
    /// Duty cycle at PA6 as compare value and period, if the timer drives it.
    pub pulse: Option<(u16, u16)>,
    /// Whether PB1 is driven high.
    pub dump_valve: bool,
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
    ports: [Gpio; PORTS.len()],
    /// The link's line.
    pub line: Usart,
    converter: With<Adc, InjectedGroup>,
    converter_clock: AdcCommon,
    sampling_timer: With<Tim<General>, TriggerOutput>,
    timers: [Tim<General>; TIMERS.len()],
    dac: Dac,
    capture: Capture,
    watchdog: Iwdg,
    debug: Dbg,
    cycles: Dwt,
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
            flash: Flash::new(pins.flash),
            ports: std::array::from_fn(|_| Gpio::default()),
            line: Usart::with_clock(Kind::Usart, HSI_HZ),
            // ADCPRE is 2 out of reset (13.13.16).
            converter: With { model: Adc::with_clock(HSI_HZ / 2), beside: InjectedGroup::default() },
            converter_clock,
            sampling_timer: With { model: Tim::with_clock(HSI_HZ, Counter::Wide), beside: TriggerOutput::default() },
            timers: std::array::from_fn(|nth| Tim::with_clock(HSI_HZ, TIMERS[nth].1)),
            dac: Dac::default(),
            capture: Capture::default(),
            watchdog: Iwdg::new(),
            debug: Dbg,
            cycles: Dwt::with_clock(HSI_HZ),
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
        self.converter.model.set_reference(pins.supply_mv);
        self.converter.model.set_backup_battery(pins.supply_mv);
        self.set_supply(pins.supply_mv, at);
        self.press_stop(pins.stop_pressed, at);
    }

    fn slot(&self, model: Model) -> usize {
        // Note(unwrap): every model is wired in `new`.
        self.models.iter().position(|candidate| *candidate == model).expect("a wired model")
    }

    /// Codes of the next groups of conversions.
    pub fn set_codes(&mut self, codes: [[u16; 2]; 2]) {
        self.converter.beside.codes = codes;
    }

    /// Groups of conversions so far.
    pub fn groups(&self) -> u64 {
        self.converter.beside.groups
    }

    /// Opens or closes the emergency stop's contact: high is pressed, or a broken wire.
    pub fn press_stop(&mut self, pressed: bool, at: VirtualNanos) {
        self.pins.stop_pressed = pressed;
        let slot = self.slot(Model::Port(PORT_B));
        let (registers, mut context) = self.bus.drive(at, slot);
        if let Some(pin) = Pin::new(STOP_PIN) {
            self.ports[PORT_B].drive(pin, Some(Level::from(pressed)), registers, &mut context);
        }
    }

    /// Moves the supply. Below what the power-down reset takes, the part has none (DS8626 table 23: 1.7 V).
    pub fn set_supply(&mut self, millivolts: u32, at: VirtualNanos) {
        let was_on = self.pins.supply_mv >= POWER_DOWN_MV;
        self.pins.supply_mv = millivolts;
        self.converter.model.set_reference(millivolts);
        let slot = self.slot(Model::Supply);
        let (registers, mut context) = self.bus.drive(at, slot);
        self.supply.model.set_supply(millivolts, registers);
        super::beside::Beside::after(&mut self.supply.beside, &mut self.supply.model, registers, &mut context);
        let is_on = millivolts >= POWER_DOWN_MV;
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
        let port_a = registers(Model::Port(PORT_A));
        let mode = |pin: u8| port_a.get(gpioa::Register::Moder) >> (2 * pin) & 0b11;
        let drive_code = Dac::output(registers(Model::Dac), 0).filter(|_| mode(DRIVE_PIN) == 0b11);
        let pulse = {
            use rigless::soc::stm32f427::generated::tim3::{Register, ccer, cr1};
            let timer = registers(Model::Timer(0));
            let on = cr1::CEN.is_set(timer.get(Register::Cr1)) && ccer::CC1E.is_set(timer.get(Register::Ccer));
            let number = |register| u16::try_from(timer.get(register)).unwrap_or(u16::MAX);
            (on && mode(PULSE_PIN) == 0b10).then(|| (number(Register::Ccr1), number(Register::Arr)))
        };
        let port_b = registers(Model::Port(PORT_B));
        let driven = port_b.get(gpioa::Register::Moder) >> (2 * DUMP_PIN) & 0b11 == 0b01;
        let high = port_b.get(gpioa::Register::Odr) >> DUMP_PIN & 1 != 0;
        Outputs { drive_code, pulse, dump_valve: driven && high }
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
        }
        fresh.line.inherit(&mut self.line);
        fresh.converter.beside.codes = self.converter.beside.codes;
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
            Model::Capture => Some(&mut self.capture),
            Model::Watchdog => Some(&mut self.watchdog),
            Model::Debug => Some(&mut self.debug),
            Model::Cycles => Some(&mut self.cycles),
        };
        (bus, answering)
    }
}
