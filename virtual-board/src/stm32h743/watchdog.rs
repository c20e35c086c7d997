//! The independent watchdog (RM0433 chapter 45).
//!
//! | register | behaviour | RM0433 |
//! |---|---|---|
//! | KR | 0xcccc starts from 0xfff, once; 0xaaaa starts the counter again from RLR; 0x5555 opens PR, RLR and WINR until another key | 45.4.1 |
//! | PR, RLR | written while open; PVU, RVU until they have reached the counter's domain, five periods of the LSI | 45.4.2 to 45.4.4 |
//! | the counter | counts the LSI over 4 to 256 down to zero, which is a system reset | 45.3 |
//!
//! Left out: the window (WINR is stored), and the option byte that starts it in hardware.

use rigless::device::{Device, DeviceContext, Level, RegisterFile};
use rigless::soc::stm32h743::generated::iwdg::Register;
use rigless::soc::stm32h743::peripherals::rcc::IWDG_STARTED;
use rigless::time::{EventId, VirtualNanos};

const UNLOCK: u64 = 0x5555;
const START: u64 = 0xcccc;
const FEED: u64 = 0xaaaa;
const FULL: u64 = 0xfff;
const PVU: u64 = 1;
const RVU: u64 = 1 << 1;
/// Periods of the LSI that a value takes to the counter's domain (45.4.4).
const CROSSING: u64 = 5;

/// The watchdog.
#[derive(Debug)]
pub struct Iwdg {
    open: bool,
    started: bool,
    clock_hz: u64,
    /// Prescaler and reload value as the counter has them, and as the registers show them.
    in_force: [u64; 2],
    shown: [u64; 2],
    /// Counts left, and when.
    left: (u64, VirtualNanos),
    expiry: Option<EventId>,
    crossings: [Option<EventId>; 2],
}

impl Default for Iwdg {
    fn default() -> Self {
        Self {
            open: false,
            started: false,
            clock_hz: 0,
            in_force: [0, FULL],
            shown: [0, FULL],
            left: (FULL + 1, VirtualNanos(0)),
            expiry: None,
            crossings: [None; 2],
        }
    }
}

impl Iwdg {
    fn count_ns(&self) -> u64 {
        // 45.4.2: over 4, doubling up to 256.
        (1_000_000_000u64 * (4 << self.in_force[0].min(6))).checked_div(self.clock_hz).unwrap_or(u64::MAX).max(1)
    }

    /// Counts until now at the rate that held.
    fn settle(&mut self, now: VirtualNanos) {
        let (left, since) = self.left;
        if self.started && self.clock_hz > 0 {
            self.left = (left.saturating_sub((now.0 - since.0) / self.count_ns()), now);
        } else {
            self.left = (left, now);
        }
    }

    fn aim(&mut self, context: &mut DeviceContext<'_>) {
        self.expiry = None;
        if self.started && self.clock_hz > 0 {
            let (left, since) = self.left;
            self.expiry = Some(context.schedule(VirtualNanos(since.0 + left * self.count_ns())));
        }
    }

    fn take(&mut self, which: usize, register: Register, flag: u64, registers: &mut RegisterFile, context: &mut DeviceContext<'_>) {
        let busy = registers.get(Register::Sr) & flag != 0;
        if !self.open || busy {
            registers.set(register, self.shown[which]);
            return;
        }
        self.shown[which] = registers.get(register);
        registers.set(Register::Sr, registers.get(Register::Sr) | flag);
        self.cross(which, context);
    }

    fn cross(&mut self, which: usize, context: &mut DeviceContext<'_>) {
        if let Some(span_ns) = (1_000_000_000 * CROSSING).checked_div(self.clock_hz) {
            self.crossings[which] = Some(context.schedule(VirtualNanos(context.now().0 + span_ns)));
        }
    }
}

impl Device for Iwdg {
    type Register = Register;

    fn write(&mut self, register: Register, value: u64, registers: &mut RegisterFile, context: &mut DeviceContext<'_>) {
        match register {
            Register::Kr => {
                let key = value & 0xffff;
                self.open = key == UNLOCK;
                if key == START && !self.started {
                    self.started = true;
                    self.left = (FULL + 1, context.now());
                    context.request(IWDG_STARTED, Level::High);
                    self.aim(context);
                } else if key == FEED && self.started {
                    self.left = (self.in_force[1] + 1, context.now());
                    self.aim(context);
                }
            }
            Register::Pr => self.take(0, Register::Pr, PVU, registers, context),
            Register::Rlr => self.take(1, Register::Rlr, RVU, registers, context),
            Register::Sr | Register::Winr => {}
        }
    }

    fn on_event(&mut self, event: EventId, registers: &mut RegisterFile, context: &mut DeviceContext<'_>) {
        // Two that are due at once are one event.
        let ends = self.expiry == Some(event);
        for (which, flag) in [PVU, RVU].into_iter().enumerate() {
            if self.crossings[which] == Some(event) {
                self.crossings[which] = None;
                self.settle(context.now());
                self.in_force[which] = self.shown[which];
                registers.set(Register::Sr, registers.get(Register::Sr) & !flag);
                self.aim(context);
            }
        }
        if ends {
            context.request_reset();
        }
    }

    fn on_clock(&mut self, hz: u64, registers: &mut RegisterFile, context: &mut DeviceContext<'_>) {
        self.settle(context.now());
        self.clock_hz = hz;
        for (which, flag) in [PVU, RVU].into_iter().enumerate() {
            if registers.get(Register::Sr) & flag != 0 && self.crossings[which].is_none() {
                self.cross(which, context);
            }
        }
        self.aim(context);
    }

    fn reset(&mut self) {
        *self = Self::default();
    }
}
