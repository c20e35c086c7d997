//! The independent watchdog's registers (RM0090 section 21).

use stm32f4::stm32f405::IWDG;

use crate::board::stm32f405::clock::wait;
use crate::board::watchdog::{Watchdog, WatchdogTimer};

const KEY_UNLOCK: u16 = 0x5555;
const KEY_FEED: u16 = 0xaaaa;
const KEY_START: u16 = 0xcccc;
/// Polls for a setting to reach the watchdog's clock domain: five periods of at least 17 kHz, 50,000 cycles of 168 MHz, four a poll.
const SETTLE_POLLS: u32 = 50_000;

/// The running watchdog.
#[derive(Debug)]
pub struct Timer(IWDG);

impl Timer {
    fn key(&self, key: u16) {
        // SAFETY: one of the three keys (RM0090 section 21.4.1).
        self.0.kr().write(|w| unsafe { w.key().bits(key) });
    }
}

impl WatchdogTimer for Timer {
    fn is_busy(&self) -> bool {
        let status = self.0.sr().read();
        status.pvu().bit_is_set() || status.rvu().bit_is_set()
    }

    fn set(&mut self, prescaler: u8, reload: u16) {
        self.key(KEY_UNLOCK);
        // SAFETY: three bits and twelve bits, checked by the regimes' tests (RM0090 sections 21.4.2 and 21.4.3).
        unsafe {
            self.0.pr().write(|w| w.bits(u16::from(prescaler & 7)));
            self.0.rlr().write(|w| w.bits(reload & 0xfff));
        }
    }

    fn feed(&mut self) {
        self.key(KEY_FEED);
    }
}

/// Starts the watchdog for vented states; `false` beside it if its oscillator does not run.
///
/// A debugger does not stop it: a breakpoint while there is pressure must end in a vented rig.
pub fn start(registers: IWDG) -> (Watchdog<Timer>, bool) {
    let timer = Timer(registers);
    timer.key(KEY_START);
    let watchdog = Watchdog::new(timer);
    let lives = wait(SETTLE_POLLS, || !watchdog.is_settling());
    (watchdog, lives)
}
