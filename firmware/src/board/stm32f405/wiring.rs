//! What a board around the STM32F405 has to say: its name, its HSE, and which pins it uses for what.
//!
//! Some functions have one pin on this chip: the analogue drive is DAC_OUT1 at PA4, the pulse width is TIM3_CH1 at PA6 (DS8626 table 9). The
//! others are the board's choice, within what the chip can do; a choice that it cannot do fails to compile. The board's model reads this file
//! too, so it says nothing of the firmware.

/// A pin of the chip.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Pin {
    /// The port: 0 is A.
    pub port: u32,
    /// The number in the port.
    pub number: u32,
}

impl Pin {
    /// A pin by port's letter and number.
    pub const fn new(port: char, number: u32) -> Self {
        Self { port: port as u32 - 'A' as u32, number }
    }

    /// Channel of the first converter at this pin (DS8626 table 9).
    pub const fn channel(self) -> Option<u8> {
        let [number, ..] = self.number.to_le_bytes();
        match (self.port, number) {
            (0, 0..=7) => Some(number),
            (1, 0..=1) => Some(8 + number),
            (2, 0..=5) => Some(10 + number),
            _ => None,
        }
    }

    /// The same, of a pin that has one.
    pub const fn channel_of(self) -> u8 {
        match self.channel() {
            Some(channel) => channel,
            None => unreachable!(),
        }
    }

    /// Address of the port's registers (RM0090 section 2.3).
    pub const fn port_address(self) -> u32 {
        0x4002_0000 + 0x400 * self.port
    }

    const fn is(self, port: char, number: u32) -> bool {
        self.port == port as u32 - 'A' as u32 && self.number == number
    }
}

/// The analogue drive's pin.
pub const DRIVE: Pin = Pin::new('A', 4);
/// The pulse width's pin.
pub const PULSE: Pin = Pin::new('A', 6);
/// The debug probe's pins.
pub const PROBE: [Pin; 2] = [Pin::new('A', 13), Pin::new('A', 14)];

/// Whether no pin is there twice.
pub const fn all_differ(pins: &[Pin]) -> bool {
    let mut rest = pins;
    while let [pin, others @ ..] = rest {
        let mut behind = others;
        while let [other, more @ ..] = behind {
            if pin.port == other.port && pin.number == other.number {
                return false;
            }
            behind = more;
        }
        rest = others;
    }
    true
}

/// A board.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Wiring {
    /// Its name, in the Hello.
    pub name: &'static str,
    /// The HSE that is fitted, Hz: any of 4 to 26 MHz (DS8626 table 38).
    /// Another one is found out before it drives anything (`board::clock`).
    pub hse_hz: u32,
    /// The laser's input.
    pub laser: Pin,
    /// The measured pressure's input.
    pub pressure: Pin,
    /// The emergency stop: an input, high is pressed.
    pub emergency_stop: Pin,
    /// The dump valve: an output, high is energised.
    pub dump_valve: Pin,
    /// USART1 TX: PA9 or PB6.
    pub transmit: Pin,
    /// USART1 RX: PA10 or PB7.
    pub receive: Pin,
}

impl Wiring {
    /// Whether the chip can do that: converter channels where they are needed, a serial port at its pins, an HSE within its range, and no
    /// pin twice.
    pub const fn is_possible(&self) -> bool {
        let serial = (self.transmit.is('A', 9) || self.transmit.is('B', 6)) && (self.receive.is('A', 10) || self.receive.is('B', 7));
        let analogue = self.laser.channel().is_some() && self.pressure.channel().is_some();
        let hse = self.hse_hz >= 4_000_000 && self.hse_hz <= 26_000_000;
        serial && analogue && hse && all_differ(&self.pins())
    }

    /// Every pin in use.
    pub const fn pins(&self) -> [Pin; 10] {
        let [clock, data] = PROBE;
        [self.laser, self.pressure, DRIVE, PULSE, self.emergency_stop, self.dump_valve, self.transmit, self.receive, clock, data]
    }
}
