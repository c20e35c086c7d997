//! The pins' modes, and the two digital ones (RM0090 section 8.4).

use core::convert::Infallible;

use embedded_hal::digital::{ErrorType, InputPin, OutputPin};
use stm32f4::stm32f405::{RCC, gpioc};

use crate::board::selected::WIRING;
use crate::board::stm32f405::wiring::{DRIVE, PULSE, Pin};
use crate::drivers::DumpValve;

/// Code of an analogue pin, of one that a peripheral has, of an input (RM0090 section 8.4.1), and of a pull-up (section 8.4.4).
const ANALOGUE: u32 = 0b11;
const ALTERNATE: u32 = 0b10;
const INPUT: u32 = 0b00;
const PULL_UP: u32 = 0b01;
/// Alternate functions of USART1 and TIM3 (DS8626 table 9).
const AF_USART1: u32 = 7;
const AF_TIM3: u32 = 2;

/// A port's registers: those of every port lie alike.
fn port(pin: Pin) -> &'static gpioc::RegisterBlock {
    // SAFETY: registers of a port that the chip has, by `Wiring::is_possible`. They exist for ever; what is shared is written in single writes.
    unsafe { &*core::ptr::with_exposed_provenance(pin.port_address() as usize) }
}

const fn with_field(bits: u32, place: u32, width: u32, value: u32) -> u32 {
    bits & !(((1 << width) - 1) << place) | value << place
}

fn set_mode(pin: Pin, mode: u32) {
    // SAFETY: two bits of one pin; the others stay, the debug probe's among them.
    port(pin).moder().modify(|r, w| unsafe { w.bits(with_field(r.bits(), 2 * pin.number, 2, mode)) });
}

fn pull_up(pin: Pin) {
    // SAFETY: two bits of one pin.
    port(pin).pupdr().modify(|r, w| unsafe { w.bits(with_field(r.bits(), 2 * pin.number, 2, PULL_UP)) });
}

fn set_function(pin: Pin, function: u32) {
    let place = 4 * (pin.number % 8);
    // SAFETY: four bits of one pin.
    unsafe {
        if pin.number < 8 {
            port(pin).afrl().modify(|r, w| w.bits(with_field(r.bits(), place, 4, function)));
        } else {
            port(pin).afrh().modify(|r, w| w.bits(with_field(r.bits(), place, 4, function)));
        }
    }
}

/// Sets the mode of every pin in use; the dump valve's was set before there was RAM.
pub fn set_up(rcc: &RCC) -> (DumpValve<DumpPin>, StopPin) {
    enable_clock!(rcc.ahb1enr: gpioaen, gpioben, gpiocen);
    // Pull-ups first, then functions, then modes: no pin moves before it knows where to.
    pull_up(WIRING.receive);
    pull_up(WIRING.emergency_stop);
    set_function(PULSE, AF_TIM3);
    set_function(WIRING.transmit, AF_USART1);
    set_function(WIRING.receive, AF_USART1);
    for pin in [WIRING.laser, WIRING.pressure, DRIVE] {
        set_mode(pin, ANALOGUE);
    }
    for pin in [PULSE, WIRING.transmit, WIRING.receive] {
        set_mode(pin, ALTERNATE);
    }
    set_mode(WIRING.emergency_stop, INPUT);
    (DumpValve::new(DumpPin(())), StopPin(()))
}

/// The dump valve's. Only writes to the set/reset register, where each bit is its own.
#[derive(Debug)]
pub struct DumpPin(());

fn write(bits: u32) {
    // SAFETY: BSRR changes only the pins whose bits are ones, in one write (RM0090 section 8.4.7).
    port(WIRING.dump_valve).bsrr().write(|w| unsafe { w.bits(bits) });
}

/// Whether the dump valve's pin is high, as it is outside.
pub fn dump_is_high() -> bool {
    port(WIRING.dump_valve).idr().read().bits() & (1 << WIRING.dump_valve.number) != 0
}

/// Whether the pulse width's pin is high, as it is outside: the timer has it, and it is an input all the same.
pub fn pulse_is_high() -> bool {
    port(PULSE).idr().read().bits() & (1 << PULSE.number) != 0
}

/// Releases the dump valve, whoever has it. The other way there is only [`DumpValve::obey`].
pub fn release_dump_valve() {
    write(1 << (16 + WIRING.dump_valve.number));
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
        write(1 << WIRING.dump_valve.number);
        Ok(())
    }
}

/// The emergency stop's.
#[derive(Debug)]
pub struct StopPin(());

impl ErrorType for StopPin {
    type Error = Infallible;
}

impl InputPin for StopPin {
    fn is_high(&mut self) -> Result<bool, Infallible> {
        Ok(port(WIRING.emergency_stop).idr().read().bits() & (1 << WIRING.emergency_stop.number) != 0)
    }

    fn is_low(&mut self) -> Result<bool, Infallible> {
        self.is_high().map(|high| !high)
    }
}
