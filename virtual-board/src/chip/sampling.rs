//! TIM2's trigger output to ADC1's injected group (RM0090 sections 13.6, 18.3.15).
//!
//! | register | what this adds to the crate's models | RM0090 |
//! |---|---|---|
//! | TIM2 CR2.MMS | each pulse of TRGO reaches the other peripherals | 18.4.2 |
//! | ADC1 CR2.JEXTSEL = 0011, JEXTEN | TRGO starts the injected group on the rising edge, the falling one, or both | 13.13.3, table 69 |
//! | ADC1 JDR1 to 4 | hold the codes that the caller put on the pins for this group, exactly | 13.13.13 |
//!
//! A trigger that comes while the group is converting is lost, as in section 13.3.9. The other sources of table 69 are not wired.

use rigless::device::{Device, DeviceContext, Level, RegisterFile, RequestChange};
use rigless::soc::stm32f427::generated::adc1::{Register as AdcRegister, cr2, jsqr};
use rigless::soc::stm32f427::peripherals::adc::Adc;
use rigless::soc::stm32f427::peripherals::tim::{General, Tim};

use super::beside::Beside;

/// Request output on which TIM2 gives its trigger; the timer's own are numbered 0 to 6.
pub const TRGO_REQUEST: usize = 16;
/// JEXTSEL of TIM2_TRGO (RM0090 section 13.13.3).
const JEXTSEL_TIM2_TRGO: u64 = 0b0011;
/// Channels with codes of their own, PA0 and PA1.
pub const CHANNELS: usize = 2;
/// Conversions of one channel in a group, at most.
pub const PER_CHANNEL: usize = 2;
const RESULTS: [AdcRegister; 4] = [AdcRegister::Jdr1, AdcRegister::Jdr2, AdcRegister::Jdr3, AdcRegister::Jdr4];

/// Sends TIM2's trigger on.
#[derive(Debug, Default)]
pub struct TriggerOutput {
    level: Level,
    pulses: u64,
}

impl Beside<Tim<General>> for TriggerOutput {
    fn after(&mut self, model: &mut Tim<General>, _registers: &mut RegisterFile, context: &mut DeviceContext<'_>) {
        let (level, pulses) = model.trigger_output();
        if pulses != self.pulses {
            context.request(TRGO_REQUEST, Level::High);
            context.request(TRGO_REQUEST, Level::Low);
        } else if level != self.level {
            context.request(TRGO_REQUEST, level);
        }
        (self.level, self.pulses) = (level, pulses);
    }

    fn reset(&mut self) {
        *self = Self::default();
    }
}

/// What is on the converter's pins, and its trigger.
#[derive(Debug, Default)]
pub struct InjectedGroup {
    /// Codes of the channels, for the first and the second conversion of a group.
    pub codes: [[u16; PER_CHANNEL]; CHANNELS],
    /// Groups that ran to their end.
    pub groups: u64,
    started: bool,
    rank: usize,
    taken: [usize; CHANNELS],
}

impl InjectedGroup {
    /// The channel of a rank: the last JL + 1 entries of JSQR, in order (RM0090 section 13.13.12).
    fn channel(registers: &RegisterFile, rank: usize) -> Option<usize> {
        let sequence = registers.get(AdcRegister::Jsqr);
        let length = usize::try_from(jsqr::JL.get(sequence)).ok()? + 1;
        let field = [jsqr::JSQ1, jsqr::JSQ2, jsqr::JSQ3, jsqr::JSQ4].into_iter().nth(4 - length + rank)?;
        usize::try_from(field.get(sequence)).ok()
    }
}

impl Beside<Adc> for InjectedGroup {
    fn request(&mut self, change: RequestChange, model: &mut Adc, registers: &mut RegisterFile, context: &mut DeviceContext<'_>) {
        if change.instance != "TIM2" || change.request != TRGO_REQUEST {
            return;
        }
        let control = registers.get(AdcRegister::Cr2);
        let edge = match change.level {
            Level::High => 0b01,
            Level::Low => 0b10,
        };
        let wanted = cr2::JEXTSEL.get(control) == JEXTSEL_TIM2_TRGO && cr2::JEXTEN.get(control) & edge != 0;
        if wanted && cr2::ADON.is_set(control) && !self.started {
            (self.started, self.rank, self.taken) = (true, 0, [0; CHANNELS]);
            // The hardware's trigger does what the software's does (RM0090 section 13.3.9).
            let start = cr2::JSWSTART.set(control, 1);
            registers.set(AdcRegister::Cr2, start);
            model.write(AdcRegister::Cr2, start, registers, context);
        }
    }

    fn event(&mut self, _model: &mut Adc, registers: &mut RegisterFile) {
        if !self.started {
            return;
        }
        if let Some(channel) = Self::channel(registers, self.rank)
            && let Some(codes) = self.codes.get(channel)
            && let Some(result) = RESULTS.get(self.rank)
        {
            let index = self.taken[channel].min(PER_CHANNEL - 1);
            registers.set(*result, u64::from(codes[index]));
            self.taken[channel] += 1;
        }
        self.rank += 1;
        let length = usize::try_from(jsqr::JL.get(registers.get(AdcRegister::Jsqr))).unwrap_or(3) + 1;
        if self.rank >= length {
            self.started = false;
            self.groups += 1;
        }
    }

    fn after(&mut self, _model: &mut Adc, registers: &mut RegisterFile, _context: &mut DeviceContext<'_>) {
        // Powered down in the middle of a group: the group is gone (RM0090 section 13.3.1).
        if !cr2::ADON.is_set(registers.get(AdcRegister::Cr2)) {
            self.started = false;
        }
    }

    fn reset(&mut self) {
        *self = Self { codes: self.codes, groups: self.groups, ..Self::default() };
    }
}
