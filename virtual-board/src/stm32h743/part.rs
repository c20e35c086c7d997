//! The part: the crate's bus, and which model answers for which instance.

use std::num::{NonZeroU32, NonZeroU64};

use rigless::chip::uart::Rate;
use rigless::cpu::armv7m::{self, Dwt};
use rigless::device::{ErasedDevice, Level, ResetCause};
use rigless::emulator::CoreSpec;
use rigless::machine::armv7m::{BranchPrediction, Caches, Config, Core, Fpu, MpuRegions, Variant};
use rigless::mcu::{Mcu, Operate};
use rigless::snapshot::Store;
use rigless::soc::stm32h743::generated::{self, gpioa, rcc as rcc_registers, tim17};
use rigless::soc::stm32h743::peripherals::adc::{Adc, AdcCommon, Block, Channel, Converter};
use rigless::soc::stm32h743::peripherals::dbg::Dbg;
use rigless::soc::stm32h743::peripherals::dma::{DMA1_FIRST_CHANNEL, Dma};
use rigless::soc::stm32h743::peripherals::dmamux::Dmamux1;
use rigless::soc::stm32h743::peripherals::exti::Exti;
use rigless::soc::stm32h743::peripherals::flash::Flash;
use rigless::soc::stm32h743::peripherals::gpio::{Gpio, PORTS, Pin};
use rigless::soc::stm32h743::peripherals::pwr::Pwr;
use rigless::soc::stm32h743::peripherals::rcc::{Rcc, TimerBus};
use rigless::soc::stm32h743::peripherals::tim::{self as timer, General, TIMERS, Tim};
use rigless::soc::stm32h743::peripherals::usart::Usart;
use rigless::soc::{self, Bus, Error};
use rigless::time::VirtualNanos;

use super::dac::Dac;
use super::sampling::{FULL_INPUT, TriggeredGroup};
use super::watchdog::Iwdg;
use crate::boards::stm32f405::wiring::Pin as BoardPin;
use crate::boards::stm32h743::wiring::{DRIVE, PULSE, RECEIVE, TRANSMIT, Wiring, channel};
use crate::chip::beside::With;
use crate::chip::capture::{Capture, Rates};
use crate::chip::held::{Held, pulse_on_pin};
use crate::chip::sampling::TriggerOutput;
use crate::core::with_nmi;
use crate::line::FarEnd;
use crate::part::{Outputs, RigPart};
use crate::protocol::Fault;

/// Codes of a pin's mode (RM0433 section 11.4.1), and alternate functions of TIM3 and USART3 (DS12110 tables 11 and 14).
const OUTPUT: u64 = 0b01;
const ALTERNATE: u64 = 0b10;
const ANALOGUE: u64 = 0b11;
const AF_TIM3: u64 = 2;
const AF_USART3: u64 = 7;
/// The supply as it should be, mV.
const SUPPLY_MV: u32 = 3300;
/// What the core runs at out of reset, Hz (RM0433 section 8.5.2).
const RESET_HZ: u64 = 64_000_000;
/// Places of TIM2, TIM3 and TIM5 in the crate's list.
const SAMPLING_TIMER: usize = 0;
const OTHER_TIMERS: [usize; 2] = [1, 3];
/// Instructions in a second of virtual time: eight nanoseconds would be too slow for the chip and four are about right.
const INSTRUCTIONS_PER_SECOND: NonZeroU64 = const { NonZeroU64::new(250_000_000).unwrap() };
/// The caches' identification registers (PM0253 tables 77 and 81).
const CACHES: Caches = Caches { clidr: 0x0900_0003, ctr: 0x8303_c003, ccsidr: &[0xf00f_e019, 0xf01f_e009] };

/// Who answers for a slot of the bus.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Model {
    None,
    Clocks,
    Supply,
    Flash,
    Lines,
    Port(usize),
    Line,
    Converter,
    DriveConverter,
    ReferenceConverter,
    ConverterClock(usize),
    SamplingTimer,
    Timer(usize),
    Dac,
    Transfers,
    TransferRequests,
    Capture,
    Watchdog,
    Debug,
    Cycles,
}

/// What is on the part's pins; it outlasts resets.
#[derive(Debug, Clone, Copy)]
pub struct Pins {
    /// Which pin is what.
    pub wiring: Wiring,
    /// Whether the emergency stop's contact is open.
    pub stop_pressed: bool,
    /// The code at the drive's pin whatever the converter does there.
    pub drive_stuck: Option<u16>,
    /// The level at the dump valve's pin whatever the port does there.
    pub dump_stuck: Option<bool>,
    /// The level at the pulse width's pin whatever the timer does there.
    pub pulse_stuck: Option<bool>,
    /// Whether the two analogue inputs are exchanged.
    pub swapped: bool,
}

impl Pins {
    /// A board as it should be.
    pub fn of(wiring: Wiring) -> Self {
        Self { wiring, stop_pressed: false, drive_stuck: None, dump_stuck: None, pulse_stuck: None, swapped: false }
    }
}

/// The part.
#[derive(Debug)]
pub struct Stm32h743 {
    bus: Bus,
    models: Vec<Model>,
    pins: Pins,
    clocks: Rcc,
    supply: Pwr,
    flash: Flash,
    lines: Exti,
    ports: [With<Gpio, Held>; PORTS.len()],
    line: Usart,
    converter: With<Adc, TriggeredGroup>,
    drive_converter: Adc,
    reference_converter: Adc,
    converter_clocks: [AdcCommon; Block::ALL.len()],
    sampling_timer: With<Tim<General>, TriggerOutput>,
    timers: [Tim<General>; OTHER_TIMERS.len()],
    dac: Dac,
    transfers: Dma,
    transfer_requests: Dmamux1,
    capture: Capture<tim17::Register>,
    watchdog: Iwdg,
    debug: Dbg,
    cycles: Dwt,
}

impl Stm32h743 {
    /// The part out of its power-on reset.
    ///
    /// # Errors
    /// When its description contradicts itself.
    pub fn new(pins: Pins) -> Result<Self, Error> {
        let bus = soc::stm32h743::builder().reads_requests(Converter::Adc1.instance()).build()?;
        let mut models = vec![Model::None; bus.slots().len()];
        let mut wired = vec![
            (generated::RCC.name, Model::Clocks),
            (generated::PWR.name, Model::Supply),
            (generated::FLASH.name, Model::Flash),
            (generated::EXTI.name, Model::Lines),
            ("USART3", Model::Line),
            (Converter::Adc1.instance(), Model::Converter),
            (Converter::Adc2.instance(), Model::DriveConverter),
            (Converter::Adc3.instance(), Model::ReferenceConverter),
            ("TIM2", Model::SamplingTimer),
            (generated::DAC.name, Model::Dac),
            (generated::DMA1.name, Model::Transfers),
            (generated::DMAMUX1.name, Model::TransferRequests),
            (generated::TIM17.name, Model::Capture),
            (generated::IWDG.name, Model::Watchdog),
            (generated::DBGMCU.name, Model::Debug),
            (armv7m::DWT, Model::Cycles),
        ];
        wired.extend(PORTS.iter().enumerate().map(|(nth, port)| (*port, Model::Port(nth))));
        wired.extend(Block::ALL.iter().enumerate().map(|(nth, block)| (block.instance(), Model::ConverterClock(nth))));
        wired.extend(OTHER_TIMERS.iter().enumerate().map(|(nth, timer)| (TIMERS[*timer].instance, Model::Timer(nth))));
        for (instance, model) in wired {
            models[bus.slot(instance)?] = model;
        }
        let Wiring { laser, pressure, .. } = pins.wiring;
        let mut part = Self {
            bus,
            models,
            pins,
            clocks: Rcc::new(),
            supply: Pwr::new(),
            flash: Flash::new(),
            lines: Exti::new(generated::SYSCFG.base),
            ports: std::array::from_fn(|_| With { model: Gpio::default(), beside: Held::default() }),
            line: Usart::new(),
            converter: With { model: Adc::new(Converter::Adc1, 0), beside: TriggeredGroup::on([channel(laser), channel(pressure)]) },
            drive_converter: Adc::new(Converter::Adc2, 0),
            reference_converter: Adc::new(Converter::Adc3, 0),
            converter_clocks: Block::ALL.map(|block| AdcCommon::new(block, 0)),
            sampling_timer: With { model: Tim::new(TIMERS[SAMPLING_TIMER]), beside: TriggerOutput::default() },
            timers: OTHER_TIMERS.map(|timer| Tim::new(TIMERS[timer])),
            dac: Dac::default(),
            transfers: Dma::new(DMA1_FIRST_CHANNEL),
            transfer_requests: Dmamux1::new(),
            capture: Capture::default(),
            watchdog: Iwdg::default(),
            debug: Dbg,
            cycles: Dwt::with_clock(RESET_HZ),
        };
        part.check()?;
        part.fit(VirtualNanos(0));
        Ok(part)
    }

    /// Puts what is on the pins on a part fresh out of reset.
    fn fit(&mut self, at: VirtualNanos) {
        self.clocks.attach_crystals(u64::from(self.pins.wiring.hse_hz), 0);
        let slot = self.slot(Model::Supply);
        let registers = self.bus.slot_mut(slot).registers_mut();
        self.supply.set_supply(SUPPLY_MV, registers);
        self.supply.set_analog_supply(SUPPLY_MV, registers);
        self.converter.model.set_reference(FULL_INPUT);
        self.drive_converter.set_reference(FULL_INPUT);
        self.reference_converter.set_reference(SUPPLY_MV);
        let pressed = self.pins.stop_pressed;
        self.drive_stop(pressed, at);
        self.hold_pins();
    }

    /// Puts what something outside holds on the digital pins.
    fn hold_pins(&mut self) {
        let Pins { wiring, dump_stuck, pulse_stuck, .. } = self.pins;
        self.ports[wiring.dump_valve.port as usize].beside.force(wiring.dump_valve, dump_stuck);
        self.ports[PULSE.port as usize].beside.force(PULSE, pulse_stuck);
    }

    fn slot(&self, model: Model) -> usize {
        // Note(unwrap): every model is wired in `new`.
        self.models.iter().position(|candidate| *candidate == model).expect("a wired model")
    }

    fn drive_stop(&mut self, pressed: bool, at: VirtualNanos) {
        self.pins.stop_pressed = pressed;
        let stop = self.pins.wiring.emergency_stop;
        let port = stop.port as usize;
        let slot = self.slot(Model::Port(port));
        let (registers, mut context) = self.bus.drive(at, slot);
        if let Some(pin) = u8::try_from(stop.number).ok().and_then(Pin::new) {
            self.ports[port].model.drive(pin, Some(Level::from(pressed)), registers, &mut context);
        }
    }

    fn mode(&self, pin: BoardPin) -> u64 {
        let registers = self.bus.slots()[self.slot(Model::Port(pin.port as usize))].registers();
        registers.get(gpioa::Register::Moder) >> (2 * pin.number) & 0b11
    }

    fn has_function(&self, pin: BoardPin, function: u64) -> bool {
        let registers = self.bus.slots()[self.slot(Model::Port(pin.port as usize))].registers();
        let register = if pin.number < 8 { gpioa::Register::Afrl } else { gpioa::Register::Afrh };
        self.mode(pin) == ALTERNATE && registers.get(register) >> (4 * (pin.number % 8)) & 0b1111 == function
    }

    /// The code that the converter puts on its pin.
    fn driven_code(&self) -> Option<u16> {
        Dac::output(self.bus.slots()[self.slot(Model::Dac)].registers(), 0).filter(|_| self.mode(DRIVE) == ANALOGUE)
    }
}

impl Mcu for Stm32h743 {
    fn bus(&self) -> &Bus {
        &self.bus
    }

    fn bus_mut(&mut self) -> &mut Bus {
        &mut self.bus
    }

    /// A system reset (RM0433 section 8.4.2): the clock and supply controllers keep what it leaves them, flash its option bytes.
    fn reset(&mut self, at: VirtualNanos, cause: ResetCause) {
        use rigless::device::Device;
        // Note(unwrap): it went together before.
        let mut fresh = Self::new(self.pins).expect("a part that went together goes together again");
        if cause != ResetCause::PowerOn {
            let flags = self.bus.slots()[self.slot(Model::Clocks)].registers().get(rcc_registers::Register::Rsr);
            std::mem::swap(&mut fresh.clocks, &mut self.clocks);
            Device::reset(&mut fresh.clocks);
            std::mem::swap(&mut fresh.supply, &mut self.supply);
            Device::reset(&mut fresh.supply);
            let slot = fresh.slot(Model::Clocks);
            fresh.clocks.restarted(cause, flags, fresh.bus.slot_mut(slot).registers_mut());
        }
        let options = self.flash.committed_options();
        let slot = fresh.slot(Model::Flash);
        fresh.flash.keep_options(options, fresh.bus.slot_mut(slot).registers_mut());
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
        match model {
            Model::Capture => {
                let registers = self.bus.slots()[self.slot(Model::Clocks)].registers();
                let divider = rcc_registers::cfgr::RTCPRE.get(registers.get(rcc_registers::Register::Cfgr));
                let swings = rcc_registers::cr::HSEON.is_set(registers.get(rcc_registers::Register::Cr));
                let hse_hz = u64::from(self.pins.wiring.hse_hz);
                self.capture.rates = Rates {
                    timer_hz: self.clocks.timer_clock(registers, TimerBus::Apb2),
                    input_hz: if swings && divider > 1 { hse_hz / divider } else { 0 },
                };
            }
            Model::Converter => {
                let Wiring { laser, pressure, .. } = self.pins.wiring;
                self.converter.beside.connected = [laser, pressure].map(|pin| self.mode(pin) == ANALOGUE);
            }
            Model::DriveConverter => {
                if let Some(channel) = channel(DRIVE).and_then(Channel::new) {
                    let code = u32::from(self.pins.drive_stuck.or_else(|| self.driven_code()).unwrap_or(0));
                    self.drive_converter.set_input(channel, code * 1000 + 500);
                }
            }
            Model::Port(port) if port == PULSE.port as usize => {
                // A pin that a timer has shows the timer's output (RM0433 section 11.3.12).
                let registers = self.bus.slots()[self.slot(Model::Timer(0))].registers();
                let level = timer::Channel::new(1).and_then(|channel| self.timers[0].output(channel, registers));
                let level = level.filter(|_| self.has_function(PULSE, AF_TIM3));
                self.ports[port].beside.drive(PULSE, level);
            }
            _ => {}
        }
        let Self { bus, clocks, supply, flash, lines, ports, line, converter, drive_converter, reference_converter, .. } = self;
        let answering: Option<&mut dyn ErasedDevice> = match model {
            Model::None => None,
            Model::Clocks => Some(clocks),
            Model::Supply => Some(supply),
            Model::Flash => Some(flash),
            Model::Lines => Some(lines),
            Model::Port(nth) => Some(&mut ports[nth]),
            Model::Line => Some(line),
            Model::Converter => Some(converter),
            Model::DriveConverter => Some(drive_converter),
            Model::ReferenceConverter => Some(reference_converter),
            Model::ConverterClock(nth) => Some(&mut self.converter_clocks[nth]),
            Model::SamplingTimer => Some(&mut self.sampling_timer),
            Model::Timer(nth) => Some(&mut self.timers[nth]),
            Model::Dac => Some(&mut self.dac),
            Model::Transfers => Some(&mut self.transfers),
            Model::TransferRequests => Some(&mut self.transfer_requests),
            Model::Capture => Some(&mut self.capture),
            Model::Watchdog => Some(&mut self.watchdog),
            Model::Debug => Some(&mut self.debug),
            Model::Cycles => Some(&mut self.cycles),
        };
        (bus, answering)
    }
}

impl Store for Stm32h743 {}

impl RigPart for Stm32h743 {
    const NAME: &'static str = "stm32h743";
    const CORE_HZ: NonZeroU64 = const { NonZeroU64::new(400_000_000).unwrap() };
    // The data TCM, the AXI SRAM and SRAM1.
    const FORGETFUL: &'static [(u64, u64)] = &[(0x2000_0000, 128 << 10), (0x2400_0000, 512 << 10), (0x3000_0000, 128 << 10)];
    // DS12110 table 118: 16 bits at 3.3 V, of the 1.216 V of the converter's model.
    const CALIBRATION: (u64, u32) = (0x1ff1_e860, 1216 * 65535 / 3300);

    fn board(&self) -> &'static str {
        self.pins.wiring.name
    }

    fn core(&self, clock_hz: NonZeroU64) -> CoreSpec {
        let core = Core {
            variant: Variant::M7,
            clock_hz,
            interrupt_lines: NonZeroU32::new(u32::from(Operate::cpu(self).interrupt_lines)).unwrap_or(NonZeroU32::MIN),
            priority_bits: 4,
            refclk_divider: const { NonZeroU32::new(8).unwrap() },
            instructions_per_second: INSTRUCTIONS_PER_SECOND,
            boot: "flash",
        };
        let mut config = Config::new(core, &armv7m::windows(self.bus()));
        config.fpu = Fpu::FpV5Dp;
        config.mpu_regions = MpuRegions::Sixteen;
        config.cpuid = 0x411f_c271;
        config.caches = Some(CACHES);
        config.branch_prediction = BranchPrediction::Always;
        config.vector_table = Some(0x0800_0000);
        with_nmi(config.spec())
    }

    fn attach(&mut self, far_end: FarEnd) {
        self.line.attach(far_end);
    }

    fn set_codes(&mut self, codes: [[u16; 2]; 2]) {
        let [laser, pressure] = codes;
        self.converter.beside.codes = if self.pins.swapped { [pressure, laser] } else { codes };
    }

    fn press_stop(&mut self, pressed: bool, at: VirtualNanos) {
        if self.pins.stop_pressed != pressed {
            self.drive_stop(pressed, at);
        }
    }

    fn outputs(&self) -> Outputs {
        use rigless::soc::stm32h743::generated::tim2::{Register, ccer, cr1};
        let registers = |model| self.bus.slots()[self.slot(model)].registers();
        let timer = registers(Model::Timer(0));
        let on = cr1::CEN.is_set(timer.get(Register::Cr1)) && ccer::CC1E.is_set(timer.get(Register::Ccer));
        let number = |register| u16::try_from(timer.get(register)).unwrap_or(u16::MAX);
        let pulse = (on && self.has_function(PULSE, AF_TIM3)).then(|| (number(Register::Ccr1), number(Register::Arr)));
        let dump = self.pins.wiring.dump_valve;
        let high = registers(Model::Port(dump.port as usize)).get(gpioa::Register::Odr) >> dump.number & 1 != 0;
        Outputs {
            drive_code: self.pins.drive_stuck.or_else(|| self.driven_code()),
            pulse: pulse_on_pin(pulse, self.pins.pulse_stuck),
            dump_valve: self.pins.dump_stuck.unwrap_or(self.mode(dump) == OUTPUT && high),
        }
    }

    fn groups(&self) -> u64 {
        self.converter.beside.groups
    }

    fn line_is_connected(&self) -> (bool, bool) {
        (self.has_function(TRANSMIT, AF_USART3), self.has_function(RECEIVE, AF_USART3))
    }

    fn break_something(&mut self, fault: Fault, _at: VirtualNanos) -> Result<bool, String> {
        match fault {
            Fault::Noise(words) => self.line.errors_mut().noise = Rate { name: "line-noise", per_million: words },
            Fault::DrivePin(code) => self.pins.drive_stuck = code,
            Fault::DumpPin(level) => self.pins.dump_stuck = level,
            Fault::PulsePin(level) => self.pins.pulse_stuck = level,
            Fault::Swapped => self.pins.swapped = true,
            other => return Err(format!("{other:?} is in no model of the {}", Self::NAME)),
        }
        self.hold_pins();
        Ok(false)
    }

    fn set_supply(&mut self, millivolts: u32, _at: VirtualNanos) {
        let slot = self.slot(Model::Supply);
        self.supply.set_supply(millivolts, self.bus.slot_mut(slot).registers_mut());
    }
}
