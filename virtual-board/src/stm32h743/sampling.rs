//! TIM2's trigger output to ADC1's regular group (RM0433 sections 25.4.19 and 39.3.15).
//!
//! | register | what this adds to the crate's models | RM0433 |
//! |---|---|---|
//! | ADC1 CR.ADSTART with CFGR.EXTEN | waits for the trigger and stays set | 25.4.19, 25.6.3 |
//! | ADC1 CFGR.EXTSEL = 01011 | TRGO of TIM2 starts the group on the rising edge, the falling one, or both | 25.4.19, table 210 |
//! | ADC1 DR | the codes that the caller put on the pins for this group, exactly | 25.6.15 |
//!
//! A trigger that comes while the group is converting is lost. The other sources of table 210 are not wired.

use rigless::device::{Device, DeviceContext, Level, RegisterFile, RequestChange};
use rigless::soc::stm32h743::generated::adc3::{Register, cfgr, cr, sqr1};
use rigless::soc::stm32h743::peripherals::adc::{Adc, Channel};

use crate::chip::beside::Beside;
use crate::chip::sampling::{CHANNELS, PER_CHANNEL, TRGO_REQUEST};

/// EXTSEL of TIM2_TRGO (RM0433 table 210).
const EXTSEL_TIM2_TRGO: u64 = 0b01011;
/// Input that stands for a code of one; [`FULL_INPUT`] is the reference.
const UNIT: u32 = 1000;
/// The reference in units of the input: its share of it is the code, exactly.
pub const FULL_INPUT: u32 = 4095 * UNIT;

/// What is on the converter's pins, and its trigger.
#[derive(Debug, Default)]
pub struct TriggeredGroup {
    numbers: [Option<u8>; CHANNELS],
    /// Whether their pins are analogue ones; a pin in another mode reads zero.
    pub connected: [bool; CHANNELS],
    /// Codes of the channels, for the first and the second conversion of a group.
    pub codes: [[u16; PER_CHANNEL]; CHANNELS],
    /// Groups that ran to their end.
    pub groups: u64,
    armed: bool,
    /// The configuration while a group runs: for the model the trigger is one of software's, which it has.
    running: Option<u64>,
    rank: usize,
    taken: [usize; CHANNELS],
}

impl TriggeredGroup {
    /// With laser and pressure on these channels.
    pub fn on(numbers: [Option<u8>; CHANNELS]) -> Self {
        Self { numbers, ..Self::default() }
    }

    /// Puts the codes of the next conversion of each channel on the pins.
    fn present(&self, model: &mut Adc) {
        for (channel, number) in self.numbers.iter().enumerate() {
            let code = self.codes[channel][self.taken[channel].min(PER_CHANNEL - 1)];
            let code = if self.connected[channel] { u32::from(code) } else { 0 };
            if let Some(channel) = number.and_then(Channel::new) {
                model.set_input(channel, code * UNIT + UNIT / 2);
            }
        }
        model.set_reference(FULL_INPUT);
    }

    fn number(registers: &RegisterFile, rank: usize) -> Option<u8> {
        // Four places in the first of the registers (25.6.11); more conversions are not wired.
        u8::try_from(registers.get(Register::Sqr1) >> (6 * (rank + 1)) & 0b1_1111).ok()
    }
}

impl Beside<Adc> for TriggeredGroup {
    fn before(&mut self, register: Register, registers: &mut RegisterFile) {
        let control = registers.get(Register::Cr);
        let external = cfgr::EXTEN.get(registers.get(Register::Cfgr)) != 0;
        if register == Register::Cr && cr::ADSTART.is_set(control) && external {
            // The model starts at once; the trigger is what starts.
            self.armed = cr::ADEN.is_set(control);
            registers.set(Register::Cr, cr::ADSTART.set(control, 0));
        }
    }

    fn answer(&self, register: Register, value: u64) -> u64 {
        match (register, self.running) {
            (Register::Cr, _) if self.armed => cr::ADSTART.set(value, 1),
            (Register::Cfgr, Some(configuration)) => configuration,
            _ => value,
        }
    }

    fn request(&mut self, change: RequestChange, model: &mut Adc, registers: &mut RegisterFile, context: &mut DeviceContext<'_>) {
        if change.instance != "TIM2" || change.request != TRGO_REQUEST {
            return;
        }
        let configuration = registers.get(Register::Cfgr);
        let edge = match change.level {
            Level::High => 0b01,
            Level::Low => 0b10,
        };
        let wanted = cfgr::EXTSEL.get(configuration) == EXTSEL_TIM2_TRGO && cfgr::EXTEN.get(configuration) & edge != 0;
        if wanted && self.armed && self.running.is_none() {
            (self.running, self.rank, self.taken) = (Some(configuration), 0, [0; CHANNELS]);
            self.present(model);
            registers.set(Register::Cfgr, cfgr::EXTEN.set(configuration, 0));
            let start = cr::ADSTART.set(registers.get(Register::Cr), 1);
            registers.set(Register::Cr, start);
            model.write(Register::Cr, start, registers, context);
        }
    }

    fn event(&mut self, model: &mut Adc, registers: &mut RegisterFile) {
        let Some(configuration) = self.running else { return };
        if let Some(number) = Self::number(registers, self.rank)
            && let Some(channel) = self.numbers.iter().position(|own| *own == Some(number))
        {
            self.taken[channel] += 1;
            self.present(model);
        }
        self.rank += 1;
        if self.rank > usize::try_from(sqr1::L3.get(registers.get(Register::Sqr1))).unwrap_or(3) {
            self.running = None;
            self.groups += 1;
            registers.set(Register::Cfgr, configuration);
        }
    }

    fn reset(&mut self) {
        *self = Self { numbers: self.numbers, connected: self.connected, codes: self.codes, groups: self.groups, ..Self::default() };
    }
}
