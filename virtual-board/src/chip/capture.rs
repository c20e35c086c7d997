//! TIM11's input capture of the divided crystal (RM0090 sections 7.2.11 and 19.5).
//!
//! | register | behaviour | RM0090 |
//! |---|---|---|
//! | CR1.CEN | counts the timer clock, up to ARR and on from zero | 19.3.1, 19.5.1 |
//! | SR.CC1IF, CC1OF | a capture, and one more before the first was read; cleared by writing zero, CC1IF also by reading CCR1 | 19.5.3 |
//! | CCMR1.CC1S = 01, IC1PSC | a capture every 1, 2, 4 or 8 events of the input | 19.5.5 |
//! | CCER.CC1E | captures | 19.5.6 |
//! | CNT, PSC, ARR, CCR1 | the counter, its divider, its end, the captured count | 19.5.7 to 19.5.10 |
//! | OR.RMP = 10 | the input is HSE over CFGR.RTCPRE | 19.5.11 |
//!
//! Left out: output compare, the input filter (IC1F is stored), interrupts, the other inputs of OR.RMP, and CNT writes while counting.

use rigless::device::{Device, DeviceContext, RegisterFile};
use rigless::soc::stm32f427::generated::tim11::Register;
use rigless::time::{EventId, Run, VirtualNanos};

const CEN: u64 = 1;
const CC1IF: u64 = 1 << 1;
const CC1OF: u64 = 1 << 9;
const CC1E: u64 = 1;
const INPUT_IS_TI1: u64 = 0b01;
const REMAP_HSE: u64 = 0b10;
const NANOS_PER_SECOND: u128 = 1_000_000_000;

/// What clocks the timer and its input, Hz; zero for none.
#[derive(Debug, Clone, Copy, Default)]
pub struct Rates {
    /// The timer's clock.
    pub timer_hz: u64,
    /// The crystal over its divider.
    pub input_hz: u64,
}

/// The timer.
#[derive(Debug, Default)]
pub struct Capture {
    /// Rates in force; the chip keeps them current.
    pub rates: Rates,
    since: Option<VirtualNanos>,
    next: Option<(EventId, Run)>,
    flags: u64,
}

impl Capture {
    fn count(&self, now: VirtualNanos, registers: &RegisterFile) -> u64 {
        let Some(since) = self.since else { return registers.get(Register::Cnt) };
        let divider = u128::from(registers.get(Register::Psc)) + 1;
        let counts = u128::from(now.0 - since.0) * u128::from(self.rates.timer_hz) / NANOS_PER_SECOND / divider;
        // An end of zero blocks the counter (RM0090 section 19.5.9).
        let period = u128::from(registers.get(Register::Arr) & 0xffff) + 1;
        if period == 1 { 0 } else { u64::try_from(counts % period).unwrap_or_default() }
    }

    fn capturing(&self, registers: &RegisterFile) -> bool {
        self.since.is_some()
            && registers.get(Register::Ccer) & CC1E != 0
            && registers.get(Register::Ccmr1Input) & 0b11 == INPUT_IS_TI1
            && registers.get(Register::Or) & 0b11 == REMAP_HSE
            && self.rates.input_hz > 0
    }

    fn schedule(&mut self, run: Run, registers: &RegisterFile, context: &mut DeviceContext<'_>) {
        let events = 1u128 << (registers.get(Register::Ccmr1Input) >> 2 & 0b11);
        let mut run = run;
        run.extend(events, self.rates.input_hz);
        self.next = Some((context.schedule(run.ends), run));
    }
}

impl Device for Capture {
    type Register = Register;

    fn read(&mut self, register: Register, registers: &mut RegisterFile, context: &mut DeviceContext<'_>) -> Option<u64> {
        match register {
            Register::Cnt => Some(self.count(context.now(), registers)),
            Register::Sr => Some(self.flags),
            Register::Ccr1 => {
                self.flags &= !CC1IF;
                None
            }
            _ => None,
        }
    }

    fn write(&mut self, register: Register, value: u64, registers: &mut RegisterFile, context: &mut DeviceContext<'_>) {
        match register {
            Register::Sr => self.flags &= value,
            Register::Cr1 if value & CEN == 0 => {
                let held = self.count(context.now(), registers);
                registers.set(Register::Cnt, held);
                self.since = None;
            }
            Register::Cr1 if self.since.is_none() => self.since = Some(context.now()),
            _ => {}
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
        registers.set(Register::Ccr1, self.count(context.now(), registers));
        self.flags |= if self.flags & CC1IF != 0 { CC1IF | CC1OF } else { CC1IF };
        self.schedule(run, registers, context);
    }

    fn reset(&mut self) {
        *self = Self { rates: self.rates, ..Self::default() };
    }
}
