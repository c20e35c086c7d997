//! The digital-to-analogue converter (RM0090 chapter 14), as far as software-driven outputs go.
//!
//! | register | behaviour | RM0090 |
//! |---|---|---|
//! | CR | EN1, EN2 connect the output to its pin; BOFF, WAVE, MAMP, DMAEN are stored | 14.5.1 |
//! | SWTRIGR | with TEN set and TSEL = 111, holds to output | 14.5.2 |
//! | DHR12R, DHR12L, DHR8R of 1, 2 and both | the holding register, and the output at once unless TEN is set | 14.3.3, 14.5.3 to 14.5.11 |
//! | DOR1, DOR2 | what the outputs give | 14.5.12, 14.5.13 |
//! | SR | reads zero: no DMA, so no underrun | 14.5.14 |
//!
//! Left out: triggers other than software's, noise and triangle, DMA, and the three bus cycles and the settling that a code takes.

use rigless::device::{Device, DeviceContext, RegisterFile};
use rigless::soc::stm32f427::generated::dac::Register;

const TWELVE_BITS: u64 = 0xfff;

/// The converter.
#[derive(Debug, Default)]
pub struct Dac {
    held: [u64; 2],
}

impl Dac {
    /// The code at an output, 0 or 1; `None` while it is not connected to its pin.
    pub fn output(registers: &RegisterFile, channel: usize) -> Option<u16> {
        let enabled = registers.get(Register::Cr) >> (16 * channel) & 1 != 0;
        let output = registers.get(if channel == 0 { Register::Dor1 } else { Register::Dor2 });
        enabled.then(|| u16::try_from(output & TWELVE_BITS).unwrap_or_default())
    }

    fn hold(&mut self, channel: usize, code: u64, registers: &mut RegisterFile) {
        self.held[channel] = code & TWELVE_BITS;
        let triggered = registers.get(Register::Cr) >> (16 * channel + 2) & 1 != 0;
        if !triggered {
            self.convert(channel, registers);
        }
    }

    fn convert(&self, channel: usize, registers: &mut RegisterFile) {
        registers.set(if channel == 0 { Register::Dor1 } else { Register::Dor2 }, self.held[channel]);
    }
}

impl Device for Dac {
    type Register = Register;

    fn write(&mut self, register: Register, value: u64, registers: &mut RegisterFile, _context: &mut DeviceContext<'_>) {
        match register {
            Register::Dhr12r1 => self.hold(0, value, registers),
            Register::Dhr12l1 => self.hold(0, value >> 4, registers),
            Register::Dhr8r1 => self.hold(0, (value & 0xff) << 4, registers),
            Register::Dhr12r2 => self.hold(1, value, registers),
            Register::Dhr12l2 => self.hold(1, value >> 4, registers),
            Register::Dhr8r2 => self.hold(1, (value & 0xff) << 4, registers),
            Register::Dhr12rd => {
                self.hold(0, value, registers);
                self.hold(1, value >> 16, registers);
            }
            Register::Dhr12ld => {
                self.hold(0, value >> 4, registers);
                self.hold(1, value >> 20, registers);
            }
            Register::Dhr8rd => {
                self.hold(0, (value & 0xff) << 4, registers);
                self.hold(1, (value >> 8 & 0xff) << 4, registers);
            }
            Register::Swtrigr => {
                for channel in 0..2 {
                    let by_software = registers.get(Register::Cr) >> (16 * channel + 2) & 0b1111 == 0b1111;
                    if value >> channel & 1 != 0 && by_software {
                        self.convert(channel, registers);
                    }
                }
            }
            Register::Cr | Register::Dor1 | Register::Dor2 | Register::Sr => {}
        }
    }

    fn reset(&mut self) {
        *self = Self::default();
    }
}
