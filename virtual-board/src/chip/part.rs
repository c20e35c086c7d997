//! The part: which model answers for which instance, and what breaks.

use std::num::{NonZeroU32, NonZeroU64};

use rigless::chip::uart::Rate;
use rigless::cpu::armv7m::{self, Dwt};
use rigless::device::{ErasedDevice, Level, ResetCause};
use rigless::emulator::CoreSpec;
use rigless::mcu::{Mcu, Operate};
use rigless::snapshot::Store;
use rigless::soc::stm32f427::generated::{flash as flash_registers, gpioa, rcc as rcc_registers, tim11};
use rigless::soc::stm32f427::peripherals::adc::{Adc, AdcCommon, Channel};
use rigless::soc::stm32f427::peripherals::dbg::Dbg;
use rigless::soc::stm32f427::peripherals::dma::Dma;
use rigless::soc::stm32f427::peripherals::gpio::{Gpio, Pin};
use rigless::soc::stm32f427::peripherals::iwdg::Iwdg;
use rigless::soc::stm32f427::peripherals::pwr::Pwr;
use rigless::soc::stm32f427::peripherals::rcc::{Apb, HSI_HZ, Rcc};
use rigless::soc::stm32f427::peripherals::tim::{self as timer, Counter, General, Tim};
use rigless::soc::stm32f427::peripherals::usart::{Kind, Usart};
use rigless::soc::{Bus, Error};
use rigless::time::VirtualNanos;

use crate::line::FarEnd;

use super::beside::{Beside, With};
use super::bus::{self, PORTS, TIMERS, TRANSFERS};
use super::capture::{Capture, Rates};
use super::dac::Dac;
use super::flash::{Flash, Speed};
use super::held::{Held, pulse_on_pin};
use super::lines::{Lines, MonitorOutput};
use super::oscillators::Oscillators;
use super::pins::{Pins, SUPPLY_MV};
use super::sampling::{InjectedGroup, TriggerOutput};
use crate::boards::stm32f405::wiring::{self, DRIVE, PULSE, Wiring};
use crate::part::{Change, Outputs, RigPart};
use crate::protocol::Fault;

/// Codes of a pin's mode: an output, one that a peripheral has, an analogue one (8.4.1).
const OUTPUT: u64 = 0b01;
const ALTERNATE: u64 = 0b10;
const ANALOGUE: u64 = 0b11;
/// Alternate functions of TIM3 and USART1 (DS8626 table 9).
const AF_TIM3: u64 = 2;
const AF_USART1: u64 = 7;

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

/// Code of a converter at full scale.
const FULL_CODE: u32 = 4095;
/// Channel of PA4 (DS8626 table 7).
const DRIVE_CHANNEL: Option<Channel> = Channel::new(4);

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
        let bus = bus::bus()?;
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
        self.clocks.model.attach_crystals(pins.hse_hz, 0);
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

    /// The HSE stops or swings again. Gives whether the clock security system noticed, which is an NMI (7.2.7).
    pub fn set_hse(&mut self, swings: bool, at: VirtualNanos) -> bool {
        self.pins.oscillators.hse = swings;
        self.clocks.beside.hse = swings;
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

    /// Another HSE.
    pub fn set_hse_hz(&mut self, hz: u64) {
        self.pins.hse_hz = hz;
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
            // 7.2.11: the HSE over RTCPRE; a divider of 0 or 1 is none (7.3.3).
            let registers = self.bus.slots()[self.slot(Model::Clocks)].registers();
            let divider = rcc_registers::cfgr::RTCPRE.get(registers.get(rcc_registers::Register::Cfgr));
            let swings = self.pins.oscillators.hse && rcc_registers::cr::HSEON.is_set(registers.get(rcc_registers::Register::Cr));
            self.capture.rates = Rates {
                timer_hz: self.clocks.model.timer_clock(registers, Apb::Two),
                input_hz: if swings && divider > 1 { self.pins.hse_hz / divider } else { 0 },
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
        let [laser, pressure] = codes;
        // Voltages on the pins do not know of the analogue supply; codes are their share of it.
        let supply_mv = self.pins.analogue_mv.unwrap_or(SUPPLY_MV);
        let share = |code: u16| u16::try_from((u32::from(code) * SUPPLY_MV / supply_mv.max(1)).min(FULL_CODE)).unwrap_or_default();
        let [laser, pressure] = [laser, pressure].map(|pair| pair.map(share));
        self.converter.beside.codes = if self.pins.swapped { [pressure, laser] } else { [laser, pressure] };
    }

    fn press_stop(&mut self, pressed: bool, at: VirtualNanos) {
        if self.pins.stop_pressed != pressed {
            Self::press_stop(self, pressed, at);
        }
    }

    fn outputs(&self) -> Outputs {
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

    fn groups(&self) -> u64 {
        self.converter.beside.groups
    }

    fn line_is_connected(&self) -> (bool, bool) {
        let Wiring { transmit, receive, .. } = self.pins.wiring;
        (self.has_function(transmit, AF_USART1), self.has_function(receive, AF_USART1))
    }

    fn break_something(&mut self, fault: Fault, at: VirtualNanos) -> Result<bool, String> {
        match fault {
            Fault::Hse(swings) => return Ok(self.set_hse(swings, at)),
            Fault::HseHz(hz) => self.set_hse_hz(hz),
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
        self.lowest_mv < POWER_DOWN_MV
    }

    fn flash_running(&self) -> Option<Change> {
        self.flash.running()
    }

    fn take_flash_changes(&mut self) -> Vec<Change> {
        self.pins.option_bytes = self.flash.option_bytes;
        self.flash.take_finished()
    }
}
