//! Why the chip started: from the reset flags to one cause.

use model_export::link::fault::Fault;
use model_export::link::state::ResetCause;

/// The cause in the flags of RCC_RSR (RM0433 section 8.7.39); the most specific wins, as on the STM32F405.
pub const fn reset_cause(rsr: u32, crash: Option<Fault>) -> ResetCause {
    const BROWN_OUT: u32 = 1 << 21;
    const PIN: u32 = 1 << 22;
    const POWER_ON: u32 = 1 << 23;
    const SOFTWARE: u32 = 1 << 24;
    const WATCHDOG: u32 = 1 << 26;
    const WINDOW_WATCHDOG: u32 = 1 << 28;
    let waited = matches!(crash, Some(Fault::BrownOut));
    if rsr & (WATCHDOG | WINDOW_WATCHDOG) != 0 && waited {
        ResetCause::BrownOut
    } else if rsr & (WATCHDOG | WINDOW_WATCHDOG) != 0 {
        ResetCause::Watchdog
    } else if rsr & SOFTWARE != 0 {
        ResetCause::Software
    } else if rsr & POWER_ON != 0 {
        ResetCause::PowerOn
    } else if rsr & BROWN_OUT != 0 {
        ResetCause::BrownOut
    } else if rsr & PIN != 0 {
        ResetCause::Pin
    } else {
        ResetCause::Unknown
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The flags of RM0433 table 55, for the causes that this program can meet.
    #[test]
    fn the_most_specific_flag_wins() {
        for (flags, crash, cause) in [
            (0x00fe_0000, None, ResetCause::PowerOn),
            (0x0060_0000, None, ResetCause::BrownOut),
            (0x0040_0000, None, ResetCause::Pin),
            (0x0140_0000, None, ResetCause::Software),
            (0x0440_0000, None, ResetCause::Watchdog),
            (0x1040_0000, None, ResetCause::Watchdog),
            (0x0440_0000, Some(Fault::BrownOut), ResetCause::BrownOut),
            (0, None, ResetCause::Unknown),
        ] {
            assert_eq!(reset_cause(flags, crash), cause, "{flags:#010x}");
        }
    }
}
