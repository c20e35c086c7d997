//! The clock's registers: RCC, and TIM11 to count the HSE (RM0090 sections 7.3, 3.9.1 and 19.5).

use stm32f4::stm32f405::{FLASH, RCC, TIM11};

use crate::board::clock::{COUNTED_PERIODS, ClockTree, wait};
use crate::board::stm32f405::facts::{FLASH_WAIT_STATES, PLL_48_MHZ_DIVIDER, Pll};

/// Divider of the HSE on its way to the timer, and events per capture: one capture every 496 cycles, time enough for the loop.
const HSE_DIVIDER: u8 = 31;
const EVENTS_PER_CAPTURE: u32 = 8;
const CAPTURES: u32 = COUNTED_PERIODS / (EVENTS_PER_CAPTURE * HSE_DIVIDER as u32);
/// Polls for one capture, many times what the slowest HSE needs.
const CAPTURE_POLLS: u32 = 10_000;

/// The registers while the clock starts.
pub struct Registers<'a> {
    /// Reset and clock control.
    pub rcc: &'a RCC,
    /// Wait states.
    pub flash: &'a FLASH,
    /// Counts the HSE.
    pub timer: &'a TIM11,
}

impl Registers<'_> {
    /// Waits for a capture and gives its value; `None` without one in time, or if one was missed.
    fn capture(&self) -> Option<u16> {
        let captured = wait(CAPTURE_POLLS, || self.timer.sr().read().cc1if().bit_is_set());
        let missed = self.timer.sr().read().cc1of().bit_is_set();
        // Reading the value clears the flag.
        let value = self.timer.ccr1().read().ccr().bits();
        (captured && !missed).then_some(value)
    }
}

impl ClockTree for Registers<'_> {
    type Pll = Pll;

    fn start_hse(&mut self) {
        self.rcc.cr().modify(|_, w| w.hsebyp().clear_bit().hseon().set_bit());
    }

    fn hse_is_ready(&mut self) -> bool {
        self.rcc.cr().read().hserdy().bit_is_set()
    }

    fn count_hse(&mut self) -> Option<u32> {
        // SAFETY: 31 is a divider the field has (RM0090 section 7.3.3).
        self.rcc.cfgr().modify(|_, w| unsafe { w.rtcpre().bits(HSE_DIVIDER) });
        let rcc = self.rcc;
        enable_clock!(rcc.apb2enr: tim11en);
        self.rcc.apb2rstr().modify(|_, w| w.tim11rst().set_bit());
        self.rcc.apb2rstr().modify(|_, w| w.tim11rst().clear_bit());
        // SAFETY: values of the manual: input 1 is the divided HSE (RMP = 10); input 1 to channel 1 (CC1S = 01), a capture every eighth
        // event (IC1PSC = 11), no filter; counting through all 16 bits.
        unsafe {
            self.timer.or().write(|w| w.rmp().bits(0b10));
            self.timer.ccmr1_input().write(|w| w.bits(0b1101));
            self.timer.arr().write(|w| w.bits(0xffff));
        }
        self.timer.ccer().write(|w| w.cc1e().set_bit());
        self.timer.cr1().write(|w| w.cen().set_bit());
        // The first capture is early by the prescaler's start.
        let counted = self.capture().and_then(|_| self.capture()).and_then(|first| {
            // Capture by capture: all of them together exceed the timer's 16 bits with a slow HSE.
            let (mut last, mut counted) = (first, 0);
            for _ in 0..CAPTURES {
                let next = self.capture()?;
                counted += u32::from(next.wrapping_sub(last));
                last = next;
            }
            Some(counted)
        });
        self.timer.cr1().write(|w| w.cen().clear_bit());
        self.rcc.apb2enr().modify(|_, w| w.tim11en().clear_bit());
        counted
    }

    fn stop_hse(&mut self) {
        self.rcc.cr().modify(|_, w| w.hseon().clear_bit());
    }

    fn start_pll(&mut self, from_hse: bool, pll: Pll) {
        self.rcc.cr().modify(|_, w| w.pllon().clear_bit());
        // SAFETY: dividers and multiplier within the fields' ranges (RM0090 section 7.3.2): `Pll` has no others.
        self.rcc.pllcfgr().modify(|_, w| unsafe {
            w.pllsrc().bit(from_hse).pllm().bits(pll.divider).plln().bits(pll.multiplier).pllp().div2().pllq().bits(PLL_48_MHZ_DIVIDER)
        });
        self.rcc.cr().modify(|_, w| w.pllon().set_bit());
    }

    fn pll_is_ready(&mut self) -> bool {
        self.rcc.cr().read().pllrdy().bit_is_set()
    }

    fn stop_pll(&mut self) {
        self.rcc.cr().modify(|_, w| w.pllon().clear_bit());
    }

    fn prepare_fast(&mut self) {
        self.flash.acr().modify(|_, w| w.latency().ws5().prften().set_bit().icen().set_bit().dcen().set_bit());
        self.rcc.cfgr().modify(|_, w| w.hpre().div1().ppre1().div4().ppre2().div2());
    }

    fn is_prepared(&mut self) -> bool {
        let bus = self.rcc.cfgr().read();
        self.flash.acr().read().latency().bits() == FLASH_WAIT_STATES && bus.ppre1().is_div4() && bus.ppre2().is_div2()
    }

    fn select_pll(&mut self, pll: bool) {
        if pll {
            self.rcc.cfgr().modify(|_, w| w.sw().pll());
        } else {
            // The wait states may stay: too many are only slow.
            self.rcc.cfgr().modify(|_, w| w.sw().hsi().ppre1().div1().ppre2().div1());
        }
    }

    fn runs_from_pll(&mut self) -> bool {
        self.rcc.cfgr().read().sws().is_pll()
    }

    fn watch_hse(&mut self) {
        self.rcc.cr().modify(|_, w| w.csson().set_bit());
    }
}
