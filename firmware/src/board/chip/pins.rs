//! The pins' modes, and the two digital ones (RM0090 section 8.4).

use core::convert::Infallible;

use embedded_hal::digital::{ErrorType, InputPin, OutputPin};
use stm32f4::stm32f405::{GPIOA, GPIOB, RCC};

use crate::board::hardware::{DUMP_VALVE_PIN, EMERGENCY_STOP_PIN};
use crate::seam::DumpValve;

/// Sets the mode of every pin in use; the dump valve's was set before there was RAM.
///
/// Each write keeps what it does not mean: the debug probe's pins are on port A too.
pub fn set_up(rcc: &RCC, port_a: &GPIOA, port_b: GPIOB) -> (DumpValve<DumpPin>, StopPin) {
    enable_clock!(rcc.ahb1enr: gpioaen, gpioben);
    // Pull-ups first, then functions, then modes: no pin moves before it knows where to.
    port_a.pupdr().modify(|_, w| w.pupdr10().pull_up());
    port_a.afrl().modify(|_, w| w.afrl6().af2());
    port_a.afrh().modify(|_, w| w.afrh9().af7().afrh10().af7());
    port_a.moder().modify(|_, w| {
        w.moder0().analog().moder1().analog().moder4().analog().moder6().alternate().moder9().alternate().moder10().alternate()
    });
    port_b.pupdr().modify(|_, w| w.pupdr0().pull_up());
    port_b.moder().modify(|_, w| w.moder0().input());
    (DumpValve::new(DumpPin(())), StopPin(port_b))
}

/// PB1. Only writes to the set/reset register, where each bit is its own.
#[derive(Debug)]
pub struct DumpPin(());

fn write(bits: u32) {
    // SAFETY: BSRR changes only the pins whose bits are ones, in one write (RM0090 section 8.4.7).
    unsafe { (*GPIOB::ptr()).bsrr().write(|w| w.bits(bits)) };
}

/// Whether the dump valve's pin is high, as it is outside.
pub fn dump_is_high() -> bool {
    // SAFETY: reading the input register has no effect (RM0090 section 8.4.5).
    unsafe { (*GPIOB::ptr()).idr().read().bits() & (1 << DUMP_VALVE_PIN) != 0 }
}

/// Releases the dump valve, whoever has it. The other way there is only [`DumpValve::obey`].
pub fn release_dump_valve() {
    write(1 << (16 + DUMP_VALVE_PIN));
}

impl ErrorType for DumpPin {
    type Error = Infallible;
}

impl OutputPin for DumpPin {
    fn set_low(&mut self) -> Result<(), Infallible> {
        release_dump_valve();
        Ok(())
    }

    fn set_high(&mut self) -> Result<(), Infallible> {
        write(1 << DUMP_VALVE_PIN);
        Ok(())
    }
}

/// PB0.
pub struct StopPin(GPIOB);

impl ErrorType for StopPin {
    type Error = Infallible;
}

impl InputPin for StopPin {
    fn is_high(&mut self) -> Result<bool, Infallible> {
        Ok(self.0.idr().read().bits() & (1 << EMERGENCY_STOP_PIN) != 0)
    }

    fn is_low(&mut self) -> Result<bool, Infallible> {
        self.is_high().map(|high| !high)
    }
}
