//! The clock's registers: RCC, PWR for the core's voltage, and TIM17 to count the HSE (RM0433 sections 8.7, 6.8 and 41.6).

use stm32h7::stm32h743v::{FLASH, PWR, RCC, TIM17};

use crate::board::clock::{COUNTED_PERIODS, ClockTree, SWITCH_POLLS, wait};
use crate::board::selected::WIRING;
use crate::board::stm32h743::facts::{FLASH_DELAY, FLASH_WAIT_STATES, LOOP_CORE_DIVIDER, LOOP_MULTIPLIER, Pll};

/// Divider of the HSE on its way to the timer, and events per capture: one capture every 248 periods, time enough for the loop.
const HSE_DIVIDER: u8 = 31;
const EVENTS_PER_CAPTURE: u32 = 8;
const CAPTURES: u32 = COUNTED_PERIODS / (EVENTS_PER_CAPTURE * HSE_DIVIDER as u32);
/// Polls for one capture, many times what the slowest HSE needs.
const CAPTURE_POLLS: u32 = 10_000;
/// Polls for the regulator, 0.2 ms at most.
const REGULATOR_POLLS: u32 = 20_000;
/// Code of a divider by two of the core's clock to buses and memories, and of the buses' to the peripherals (RM0433 sections 8.7.6 to 8.7.8).
const BUS_HALF: u8 = 0b1000;
const PERIPHERAL_HALF: u8 = 0b100;

/// The registers while the clock starts.
pub struct Registers<'a> {
    /// Reset and clock control.
    pub rcc: &'a RCC,
    /// Wait states.
    pub flash: &'a FLASH,
    /// The core's voltage.
    pub power: &'a PWR,
    /// Counts the HSE.
    pub timer: &'a TIM17,
}

impl Registers<'_> {
    /// Waits for a capture and gives its value; `None` without one in time, or if one was missed.
    fn capture(&self) -> Option<u16> {
        let captured = wait(CAPTURE_POLLS, || self.timer.sr().read().cc1if().bit_is_set());
        let missed = self.timer.sr().read().cc1of().bit_is_set();
        // Reading the value clears the flag.
        let [low, high, ..] = self.timer.ccr1().read().bits().to_le_bytes();
        (captured && !missed).then_some(u16::from_le_bytes([low, high]))
    }
}

impl ClockTree for Registers<'_> {
    type Pll = Pll;

    fn start_hse(&mut self) {
        // The supply first: the regulator alone, which is written once after power comes up (RM0433 section 6.8.4).
        self.power.cr3().modify(|_, w| w.scuen().set_bit().ldoen().set_bit().bypass().clear_bit());
        let _ = wait(REGULATOR_POLLS, || self.power.csr1().read().actvosrdy().bit_is_set());
        self.rcc.cr().modify(|_, w| w.hsebyp().bit(WIRING.has_clock_signal));
        self.rcc.cr().modify(|_, w| w.hseon().set_bit());
    }

    fn hse_is_ready(&mut self) -> bool {
        self.rcc.cr().read().hserdy().bit_is_set()
    }

    fn count_hse(&mut self) -> Option<u32> {
        // SAFETY: 31 is a divider the field has (RM0433 section 8.7.5).
        self.rcc.cfgr().modify(|_, w| unsafe { w.rtcpre().bits(HSE_DIVIDER) });
        let rcc = self.rcc;
        enable_clock!(rcc.apb2enr: tim17en);
        self.rcc.apb2rstr().modify(|_, w| w.tim17rst().set_bit());
        self.rcc.apb2rstr().modify(|_, w| w.tim17rst().clear_bit());
        // SAFETY: values of the manual: input 1 is the divided HSE (TI1SEL = 2, section 41.6.19); input 1 to channel 1 (CC1S = 01), a
        // capture every eighth event (IC1PSC = 11), no filter; counting through all 16 bits.
        unsafe {
            self.timer.tim17_tisel().write(|w| w.bits(0b10));
            self.timer.ccmr1_input().write(|w| w.bits(0b1101));
            self.timer.arr().write(|w| w.bits(0xffff));
        }
        self.timer.ccer().write(|w| w.cc1e().set_bit());
        self.timer.cr1().write(|w| w.cen().set_bit());
        // The first capture is early by the prescaler's start.
        let counted = self.capture().and_then(|_| self.capture()).and_then(|first| {
            // Capture by capture: all of them together exceed the timer's 16 bits.
            let (mut last, mut counted) = (first, 0);
            for _ in 0..CAPTURES {
                let next = self.capture()?;
                counted += u32::from(next.wrapping_sub(last));
                last = next;
            }
            Some(counted)
        });
        self.timer.cr1().write(|w| w.cen().clear_bit());
        self.rcc.apb2enr().modify(|_, w| w.tim17en().clear_bit());
        counted
    }

    fn stop_hse(&mut self) {
        self.rcc.cr().modify(|_, w| w.hseon().clear_bit());
    }

    fn start_pll(&mut self, from_hse: bool, pll: Pll) {
        self.rcc.cr().modify(|_, w| w.pll1on().clear_bit());
        // SAFETY: sources 0 (internal) and 2 (HSE), a divider of 1 to 63 (RM0433 section 8.7.11); a divided input of 4 to 8 MHz (range 10), the
        // wide oscillator, output P (section 8.7.12); multiplier and divider less one (section 8.7.13).
        unsafe {
            self.rcc.pllckselr().modify(|_, w| w.pllsrc().bits(if from_hse { 2 } else { 0 }).divm1().bits(pll.divider));
            self.rcc.pllcfgr().modify(|r, w| w.bits(r.bits() & !0b1111 | 0b10 << 2 | 1 << 16));
            self.rcc.pll1divr().modify(|r, w| w.bits(r.bits() & !0xffff | (LOOP_CORE_DIVIDER - 1) << 9 | (LOOP_MULTIPLIER - 1)));
        }
        self.rcc.cr().modify(|_, w| w.pll1on().set_bit());
    }

    fn pll_is_ready(&mut self) -> bool {
        self.rcc.cr().read().pll1rdy().bit_is_set()
    }

    fn stop_pll(&mut self) {
        self.rcc.cr().modify(|_, w| w.pll1on().clear_bit());
    }

    fn prepare_fast(&mut self) {
        // SAFETY: voltage scale 1 (RM0433 section 6.8.6), codes of the dividers, and the wait states for what comes of them.
        unsafe {
            self.power.d3cr().modify(|_, w| w.vos().bits(0b11));
            let _ = wait(REGULATOR_POLLS, || self.power.d3cr().read().bits() & (1 << 13) != 0);
            self.rcc.d1cfgr().modify(|_, w| w.bits(u32::from(BUS_HALF) | u32::from(PERIPHERAL_HALF) << 4));
            self.rcc.d2cfgr().modify(|_, w| w.bits(u32::from(PERIPHERAL_HALF) << 4 | u32::from(PERIPHERAL_HALF) << 8));
            self.rcc.d3cfgr().modify(|_, w| w.bits(u32::from(PERIPHERAL_HALF) << 4));
            self.flash.acr().modify(|_, w| w.bits(u32::from(FLASH_WAIT_STATES) | u32::from(FLASH_DELAY) << 4));
        }
    }

    fn is_prepared(&mut self) -> bool {
        let voltage = self.power.d3cr().read().bits();
        self.flash.acr().read().bits() & 0xf == u32::from(FLASH_WAIT_STATES)
            && self.rcc.d1cfgr().read().bits() & 0xf == u32::from(BUS_HALF)
            && voltage >> 14 & 0b11 == 0b11
            && voltage & (1 << 13) != 0
    }

    fn select_pll(&mut self, pll: bool) {
        // SAFETY: the loop (3) or the internal oscillator (0), by RM0433 section 8.7.5.
        self.rcc.cfgr().modify(|r, w| unsafe { w.bits(r.bits() & !0b111 | if pll { 0b11 } else { 0 }) });
        if !pll {
            let _ = wait(SWITCH_POLLS, || self.rcc.cfgr().read().bits() >> 3 & 0b111 == 0);
            // The wait states may stay: too many are only slow.
            // SAFETY: nothing divided.
            unsafe {
                self.rcc.d1cfgr().write(|w| w.bits(0));
                self.rcc.d2cfgr().write(|w| w.bits(0));
                self.rcc.d3cfgr().write(|w| w.bits(0));
            }
        }
    }

    fn runs_from_pll(&mut self) -> bool {
        self.rcc.cfgr().read().bits() >> 3 & 0b111 == 0b11
    }

    fn watch_hse(&mut self) {
        self.rcc.cr().modify(|_, w| w.hsecsson().set_bit());
    }
}
