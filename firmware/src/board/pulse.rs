//! The pulse width's timing: a frequency as a prescaler and a period of the timer (RM0090 sections 18.3.1 and 18.3.9).

/// What the timer is set to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PulseTiming {
    /// The prescaler register: the timer counts every this many and one of its clock.
    pub prescaler: u16,
    /// Counts of a period, which are the steps of the duty cycle.
    pub period_counts: u16,
}

impl PulseTiming {
    /// The finest steps at this frequency, which is met to within one of them. Frequencies of 2 Hz to a hundredth of the timer's are possible; others
    /// come as near as they can.
    pub const fn new(timer_hz: u32, pulse_hz: u32) -> Self {
        let pulse_hz = if pulse_hz == 0 { 1 } else { pulse_hz };
        let clocks = timer_hz / pulse_hz;
        // The smallest divider that leaves a period of 16 bits.
        let divider = clocks / u16::MAX as u32 + 1;
        let divider = if divider > u16::MAX as u32 { u16::MAX as u32 } else { divider };
        let ([p0, p1, ..], [c0, c1, ..]) = ((divider - 1).to_le_bytes(), (clocks / divider).to_le_bytes());
        let period_counts = u16::from_le_bytes([c0, c1]);
        Self { prescaler: u16::from_le_bytes([p0, p1]), period_counts: if period_counts < 2 { 2 } else { period_counts } }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::board::hardware::Rates;

    #[test]
    fn every_frequency_of_the_setting_is_met_with_fine_steps() {
        for rates in [Rates::FAST, Rates::INTERNAL] {
            for pulse_hz in [20, 50, 100, 200, 333, 500, 1_000, 4_999, 20_000] {
                let timing = PulseTiming::new(rates.timer_hz, pulse_hz);
                let counts = (u32::from(timing.prescaler) + 1) * u32::from(timing.period_counts);
                let met_hz = f64::from(rates.timer_hz) / f64::from(counts);
                let step = 1.0 / f64::from(timing.period_counts);
                assert!((met_hz / f64::from(pulse_hz) - 1.0).abs() <= 1.5 * step, "{pulse_hz} Hz: {met_hz} Hz");
                assert!(timing.period_counts >= 800, "{pulse_hz} Hz: {} steps", timing.period_counts);
            }
        }
        assert_eq!(PulseTiming::new(84_000_000, 20_000), PulseTiming { prescaler: 0, period_counts: 4200 });
        assert!(PulseTiming::new(84_000_000, 0).period_counts >= 2);
    }
}
