//! The link's line: the chip's first serial port. Register layout: RM0090 section 30.6.

use core::ptr;

use cortex_m::peripheral::NVIC;

const ADDRESS: usize = 0x4001_1000;
const STATUS: usize = 0;
const DATA: usize = 1;
const CONTROL_1: usize = 3;
const RECEIVED: u32 = 1 << 5;
const TRANSMIT_EMPTY: u32 = 1 << 7;
/// USART, transmitter and receiver enabled, interrupt when a byte has come.
const ENABLED: u32 = (1 << 13) | (1 << 5) | (1 << 3) | (1 << 2);

/// The port's place in the vector table (RM0090 table 62).
#[derive(Clone, Copy)]
struct Usart1;

// SAFETY: 37 is the number of an interrupt of this chip.
unsafe impl cortex_m::interrupt::InterruptNumber for Usart1 {
    fn number(self) -> u16 {
        37
    }
}

/// The serial port.
pub struct Uart(*mut u32);

impl Uart {
    /// The port, enabled.
    ///
    /// Its interrupt never runs: interrupts stay off, and a pending one ends `wfi`, so that the emulator sleeps instead of spinning.
    pub fn usart1() -> Self {
        cortex_m::interrupt::disable();
        let uart = Self(ADDRESS as *mut u32);
        uart.set(CONTROL_1, ENABLED);
        // SAFETY: with interrupts off no handler runs that could break anything.
        unsafe { NVIC::unmask(Usart1) };
        uart
    }

    /// Waits for a byte.
    pub fn read_byte(&mut self) -> u8 {
        while self.get(STATUS) & RECEIVED == 0 {
            cortex_m::asm::wfi();
        }
        let byte = self.get(DATA).to_le_bytes()[0];
        NVIC::unpend(Usart1);
        byte
    }

    /// Sends bytes.
    pub fn write(&mut self, bytes: &[u8]) {
        for byte in bytes {
            while self.get(STATUS) & TRANSMIT_EMPTY == 0 {}
            self.set(DATA, u32::from(*byte));
        }
    }

    fn get(&self, register: usize) -> u32 {
        // SAFETY: the address is that of a USART of this chip, the registers are 32 bits wide and within it.
        unsafe { ptr::read_volatile(self.0.add(register)) }
    }

    fn set(&self, register: usize, value: u32) {
        // SAFETY: as in `get`; writing these registers has no effect on memory.
        unsafe { ptr::write_volatile(self.0.add(register), value) }
    }
}
