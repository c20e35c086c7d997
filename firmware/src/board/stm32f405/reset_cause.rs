//! Why the chip started: from the reset flags to one cause.

use model_export::link::fault::Fault;
use model_export::link::state::ResetCause;

/// The cause in the flags of RCC_CSR (RM0090 section 7.3.21).
///
/// Several flags may be set: a reset from inside pulls the reset pin too, and power coming up looks like a brown-out as well. The most
/// specific cause wins. A low-power reset, which this firmware cannot cause, counts as unknown.
///
/// `crash` is what memory kept. The wait for a supply that fell ends with it back, or by the watchdog: then too the supply is the cause.
pub const fn reset_cause(csr: u32, crash: Option<Fault>) -> ResetCause {
    const BROWN_OUT: u32 = 1 << 25;
    const PIN: u32 = 1 << 26;
    const POWER_ON: u32 = 1 << 27;
    const SOFTWARE: u32 = 1 << 28;
    const WATCHDOG: u32 = 1 << 29;
    const WINDOW_WATCHDOG: u32 = 1 << 30;
    let waited = matches!(crash, Some(Fault::BrownOut));
    if csr & (WATCHDOG | WINDOW_WATCHDOG) != 0 && waited {
        ResetCause::BrownOut
    } else if csr & (WATCHDOG | WINDOW_WATCHDOG) != 0 {
        ResetCause::Watchdog
    } else if csr & SOFTWARE != 0 {
        ResetCause::Software
    } else if csr & POWER_ON != 0 {
        ResetCause::PowerOn
    } else if csr & BROWN_OUT != 0 {
        ResetCause::BrownOut
    } else if csr & PIN != 0 {
        ResetCause::Pin
    } else {
        ResetCause::Unknown
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_most_specific_flag_wins() {
        for (flags, cause) in [
            (0x0e00_0000, ResetCause::PowerOn),
            (0x0600_0000, ResetCause::BrownOut),
            (0x0400_0000, ResetCause::Pin),
            (0x1400_0000, ResetCause::Software),
            (0x2400_0000, ResetCause::Watchdog),
            (0x4400_0000, ResetCause::Watchdog),
            (0x0000_0003, ResetCause::Unknown),
        ] {
            assert_eq!(reset_cause(flags, None), cause, "{flags:#010x}");
        }
    }

    #[test]
    fn a_watchdog_that_ends_the_wait_for_the_supply_is_not_the_cause() {
        assert_eq!(reset_cause(0x2400_0000, Some(Fault::BrownOut)), ResetCause::BrownOut);
        assert_eq!(reset_cause(0x2400_0000, Some(Fault::Panicked)), ResetCause::Watchdog);
        assert_eq!(reset_cause(0x1400_0000, Some(Fault::BrownOut)), ResetCause::Software);
    }
}
