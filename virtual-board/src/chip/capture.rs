//! A timer's input capture of the divided HSE: TIM11 of the STM32F405 (RM0090 sections 7.2.11 and 19.5), TIM17 of the STM32H743 (RM0433
//! section 41.6), which differ in the register that selects the input.
//!
//! | register | behaviour | RM0090 |
//! |---|---|---|
//! | CR1.CEN | counts the timer clock, up to ARR and on from zero | 19.3.1, 19.5.1 |
//! | SR.CC1IF, CC1OF | a capture, and one more before the first was read; cleared by writing zero, CC1IF also by reading CCR1 | 19.5.3 |
//! | CCMR1.CC1S = 01, IC1PSC | a capture every 1, 2, 4 or 8 events of the input | 19.5.5 |
//! | CCER.CC1E | captures | 19.5.6 |
//! | CNT, PSC, ARR, CCR1 | the counter, its divider, its end, the captured count | 19.5.7 to 19.5.10 |
//! | OR.RMP = 10; TISEL.TI1SEL = 2 | the input is HSE over CFGR.RTCPRE | 19.5.11; RM0433 41.6.19 |
//!
//! Left out: output compare, the input filter (IC1F is stored), interrupts, the other inputs of OR.RMP, and CNT writes while counting.

use std::marker::PhantomData;

use rigless::device::{Device, DeviceContext, RegisterFile};
use rigless::soc::Layout;
use rigless::soc::stm32f427::generated::tim11;
use rigless::soc::stm32h743::generated::tim17;
use rigless::time::{EventId, Run, VirtualNanos};

const CEN: u64 = 1;
const CC1IF: u64 = 1 << 1;
const CC1OF: u64 = 1 << 9;
const CC1E: u64 = 1;
const INPUT_IS_TI1: u64 = 0b01;
const NANOS_PER_SECOND: u128 = 1_000_000_000;

/// The registers of a timer with this input.
pub trait Registers: Layout + Copy + PartialEq + std::fmt::Debug + Send + 'static {
    /// Control.
    const CR1: Self;
    /// Status.
    const SR: Self;
    /// Capture mode.
    const CCMR1: Self;
    /// Capture enable.
    const CCER: Self;
    /// Counter.
    const CNT: Self;
    /// Its divider.
    const PSC: Self;
    /// Its end.
    const ARR: Self;
    /// The captured count.
    const CCR1: Self;
    /// Selects the input.
    const SELECTION: Self;
    /// The bits that select the divided HSE, and their mask.
    const HSE: (u64, u64);
}

impl Registers for tim11::Register {
    const CR1: Self = Self::Cr1;
    const SR: Self = Self::Sr;
    const CCMR1: Self = Self::Ccmr1Input;
    const CCER: Self = Self::Ccer;
    const CNT: Self = Self::Cnt;
    const PSC: Self = Self::Psc;
    const ARR: Self = Self::Arr;
    const CCR1: Self = Self::Ccr1;
    const SELECTION: Self = Self::Or;
    const HSE: (u64, u64) = (0b10, 0b11);
}

impl Registers for tim17::Register {
    const CR1: Self = Self::Cr1;
    const SR: Self = Self::Sr;
    const CCMR1: Self = Self::Ccmr1Input;
    const CCER: Self = Self::Ccer;
    const CNT: Self = Self::Cnt;
    const PSC: Self = Self::Psc;
    const ARR: Self = Self::Arr;
    const CCR1: Self = Self::Ccr1;
    const SELECTION: Self = Self::Tim17Tisel;
    const HSE: (u64, u64) = (0b0010, 0b1111);
}

/// What clocks the timer and its input, Hz; zero for none.
#[derive(Debug, Clone, Copy, Default)]
pub struct Rates {
    /// The timer's clock.
    pub timer_hz: u64,
    /// The HSE over its divider.
    pub input_hz: u64,
}

/// The timer.
#[derive(Debug)]
pub struct Capture<R> {
    /// Rates in force; the chip keeps them current.
    pub rates: Rates,
    since: Option<VirtualNanos>,
    next: Option<(EventId, Run)>,
    flags: u64,
    registers: PhantomData<R>,
}

impl<R> Default for Capture<R> {
    fn default() -> Self {
        Self { rates: Rates::default(), since: None, next: None, flags: 0, registers: PhantomData }
    }
}

impl<R: Registers> Capture<R> {
    fn count(&self, now: VirtualNanos, registers: &RegisterFile) -> u64 {
        let Some(since) = self.since else { return registers.get(R::CNT) };
        let divider = u128::from(registers.get(R::PSC)) + 1;
        let counts = u128::from(now.0 - since.0) * u128::from(self.rates.timer_hz) / NANOS_PER_SECOND / divider;
        // An end of zero blocks the counter (RM0090 section 19.5.9).
        let period = u128::from(registers.get(R::ARR) & 0xffff) + 1;
        if period == 1 { 0 } else { u64::try_from(counts % period).unwrap_or_default() }
    }

    fn capturing(&self, registers: &RegisterFile) -> bool {
        self.since.is_some()
            && registers.get(R::CCER) & CC1E != 0
            && registers.get(R::CCMR1) & 0b11 == INPUT_IS_TI1
            && registers.get(R::SELECTION) & R::HSE.1 == R::HSE.0
            && self.rates.input_hz > 0
    }

    fn schedule(&mut self, run: Run, registers: &RegisterFile, context: &mut DeviceContext<'_>) {
        let events = 1u128 << (registers.get(R::CCMR1) >> 2 & 0b11);
        let mut run = run;
        run.extend(events, self.rates.input_hz);
        self.next = Some((context.schedule(run.ends), run));
    }
}

impl<R: Registers> Device for Capture<R> {
    type Register = R;

    fn read(&mut self, register: R, registers: &mut RegisterFile, context: &mut DeviceContext<'_>) -> Option<u64> {
        if register == R::CCR1 {
            self.flags &= !CC1IF;
        }
        if register == R::CNT { Some(self.count(context.now(), registers)) } else { (register == R::SR).then_some(self.flags) }
    }

    fn write(&mut self, register: R, value: u64, registers: &mut RegisterFile, context: &mut DeviceContext<'_>) {
        if register == R::SR {
            self.flags &= value;
        } else if register == R::CR1 && value & CEN == 0 {
            let held = self.count(context.now(), registers);
            registers.set(R::CNT, held);
            self.since = None;
        } else if register == R::CR1 && self.since.is_none() {
            self.since = Some(context.now());
        }
        match (self.capturing(registers), self.next.is_some()) {
            (true, false) => self.schedule(Run::at(context.now()), registers, context),
            (false, true) => self.next = None,
            _ => {}
        }
    }

    fn on_event(&mut self, event: EventId, registers: &mut RegisterFile, context: &mut DeviceContext<'_>) {
        let Some((expected, run)) = self.next else { return };
        if expected != event {
            return;
        }
        if !self.capturing(registers) {
            self.next = None;
            return;
        }
        registers.set(R::CCR1, self.count(context.now(), registers));
        self.flags |= if self.flags & CC1IF != 0 { CC1IF | CC1OF } else { CC1IF };
        self.schedule(run, registers, context);
    }

    fn reset(&mut self) {
        *self = Self { rates: self.rates, ..Self::default() };
    }
}
