//! Sampling: TIM2 triggers four conversions of ADC1 a millisecond (RM0433 sections 25.4, 39.4); SysTick watches that it does.
//!
//! The converter collects the four in its own queue of eight, and its end of sequence is the tick. The second converter reads the drive's pin
//! back, the third the chip's reference voltage.

use cortex_m::peripheral::SYST;
use cortex_m::peripheral::syst::SystClkSource;
use stm32h7::stm32h743v::{ADC1, ADC2, ADC3, ADC3_COMMON, ADC12_COMMON, RCC, TIM2, adc3};

use super::pins;
use crate::board::clock::wait;
use crate::board::converter::{Measured, SAMPLING_SEQUENCE};
use crate::board::rates::Rates;
use crate::board::selected::WIRING;
use crate::board::stm32h743::facts::{REFERENCE_CALIBRATION, REFERENCE_CHANNEL};
use crate::board::stm32h743::wiring::{DRIVE, channel_of};
use crate::drivers::{RawSample, ReadBack, SampleSource};

/// The channels of the measured inputs and of the drive's pin.
const LASER: u8 = channel_of(WIRING.laser);
const PRESSURE: u8 = channel_of(WIRING.pressure);
const DRIVE_CHANNEL: u8 = channel_of(DRIVE);
/// Code of the trigger TIM2_TRGO (RM0433 table 210, EXTSEL), and of its rising edge.
const TRIGGER_TIM2_TRGO: u32 = 0b01011;
const RISING: u32 = 0b01;
/// Code of 12 bits (RM0433 section 25.6.4, revision V).
const TWELVE_BITS: u32 = 0b110;
/// Codes of a sampling time of 64.5 and of 810.5 cycles of 16 MHz (RM0433 section 25.6.6): 4 and 51 us; the reference needs 4.3 us (DS12110 table 117).
const SAMPLING_64_CYCLES: u32 = 0b101;
const SAMPLING_810_CYCLES: u32 = 0b111;
/// Codes of the kernel clock from the internal oscillator, over two, which the converter halves again: 16 MHz (RM0433 sections 8.7.22, 25.7.2), and
/// of the boost that goes with it (section 25.6.3).
const FROM_INTERNAL: u8 = 0b10;
const OVER_TWO: u8 = 0b0001;
const BOOST: u32 = 0b10 << 8;
/// Bits of ADC_CR (RM0433 section 25.6.3) and ADC_ISR (section 25.6.1).
const ENABLE: u32 = 1;
const START: u32 = 1 << 2;
const REGULATOR: u32 = 1 << 28;
const CALIBRATE: u32 = 1 << 31;
const READY: u32 = 1;
const END: u32 = 1 << 2;
const END_OF_SEQUENCE: u32 = 1 << 3;
const OVERRUN: u32 = 1 << 4;
const REGULATOR_READY: u32 = 1 << 12;
/// Polls for the regulator, 10 us, and for a calibration, 1.1 ms at 16 MHz with the linearity (DS12110 table 174).
const READY_POLLS: u32 = 100_000;
const CALIBRATION_POLLS: u32 = 1_000_000;
/// Words in the converter's queue.
const QUEUE: usize = 8;

fn set_sampling_time(converter: &adc3::RegisterBlock, channel: u8, code: u32) {
    let place = 3 * u32::from(channel % 10);
    let change = |bits: u32| bits & !(0b111 << place) | code << place;
    // SAFETY: a code of the manual in the channel's own three bits.
    unsafe {
        if channel < 10 {
            converter.smpr1().modify(|r, w| w.bits(change(r.bits())));
        } else {
            converter.smpr2().modify(|r, w| w.bits(change(r.bits())));
        }
    }
}

/// Wakes a converter up, calibrates it and switches it on, every wait bounded: a converter that does not come up gives no samples, which the tick
/// takes for lost sensors.
fn switch_on(converter: &adc3::RegisterBlock, channels: &[(u8, u32)], sequence: [u32; 2], configuration: u32) {
    // SAFETY: values of the manual, in the order of RM0433 sections 25.4.6 to 25.4.9.
    unsafe {
        converter.cr().write(|w| w.bits(0));
        converter.cr().write(|w| w.bits(REGULATOR | BOOST));
        let _ = wait(READY_POLLS, || converter.isr().read().bits() & REGULATOR_READY != 0);
        converter.cr().write(|w| w.bits(REGULATOR | BOOST | CALIBRATE));
        let _ = wait(CALIBRATION_POLLS, || converter.cr().read().bits() & CALIBRATE == 0);
        converter.isr().write(|w| w.bits(READY));
        converter.cr().modify(|r, w| w.bits(r.bits() | ENABLE));
        let _ = wait(READY_POLLS, || converter.isr().read().bits() & READY != 0);
        let selected = channels.iter().fold(0, |bits, (channel, _)| bits | 1 << channel);
        converter.pcsel().write(|w| w.bits(selected));
        for (channel, time) in channels {
            set_sampling_time(converter, *channel, *time);
        }
        let [first, second] = sequence;
        converter.sqr1().write(|w| w.bits(first));
        converter.sqr2().write(|w| w.bits(second));
        // The queue of injected conversions stays off, as after a reset (JQDIS).
        converter.cfgr().write(|w| w.bits(1 << 31 | TWELVE_BITS << 2 | configuration));
    }
}

/// The converters.
pub struct Sampler {
    converter: ADC1,
    drive: ADC2,
    reference: ADC3,
    timer: TIM2,
}

/// What the sampler is made of.
pub struct Parts<'a> {
    /// Samples.
    pub converter: ADC1,
    /// Reads the drive's pin.
    pub drive: ADC2,
    /// Reads the reference.
    pub reference: ADC3,
    /// Common block of the first two.
    pub common: &'a ADC12_COMMON,
    /// Common block of the third.
    pub reference_common: &'a ADC3_COMMON,
    /// Triggers.
    pub timer: TIM2,
}

impl Sampler {
    /// Sets up converters and timer; sampling begins with [`Self::begin`].
    pub fn new(rcc: &RCC, parts: Parts<'_>, rates: Rates) -> Self {
        let Parts { converter, drive, reference, common, reference_common, timer } = parts;
        // SAFETY: a source the field has.
        rcc.d3ccipr().modify(|_, w| unsafe { w.adcsel().bits(FROM_INTERNAL) });
        enable_clock!(rcc.ahb1enr: adc12en);
        enable_clock!(rcc.ahb4enr: adc3en);
        enable_clock!(rcc.apb1lenr: tim2en);
        // SAFETY: a divider of the manual; the reference voltage of the third converter on.
        unsafe {
            common.ccr().modify(|_, w| w.presc().bits(OVER_TWO));
            reference_common.ccr().modify(|_, w| w.presc().bits(OVER_TWO).vrefen().set_bit());
        }
        let [first, second, third, fourth] = SAMPLING_SEQUENCE.map(|measured| match measured {
            Measured::Laser => u32::from(LASER),
            Measured::Pressure => u32::from(PRESSURE),
        });
        // Four conversions (L = 3).
        let sequence = 3 | first << 6 | second << 12 | third << 18 | fourth << 24;
        let trigger = TRIGGER_TIM2_TRGO << 5 | RISING << 10;
        switch_on(&converter, &[(LASER, SAMPLING_64_CYCLES), (PRESSURE, SAMPLING_64_CYCLES)], [sequence, 0], trigger);
        switch_on(&drive, &[(DRIVE_CHANNEL, SAMPLING_64_CYCLES)], [u32::from(DRIVE_CHANNEL) << 6, 0], 0);
        switch_on(&reference, &[(REFERENCE_CHANNEL, SAMPLING_810_CYCLES)], [u32::from(REFERENCE_CHANNEL) << 6, 0], 0);
        // SAFETY: the interrupt at the end of a sequence.
        converter.ier().write(|w| unsafe { w.bits(END_OF_SEQUENCE) });
        timer.cr1().modify(|_, w| w.cen().clear_bit());
        timer.psc().reset();
        // SAFETY: every value counts; MMS = 010 is the update event.
        #[allow(unused_unsafe, reason = "safe in some versions of the register definitions")]
        unsafe {
            timer.arr().write(|w| w.bits(rates.timer_counts_per_tick() - 1));
            timer.cr2().modify(|r, w| w.bits(r.bits() & !(0b111 << 4) | 0b010 << 4));
        }
        Self { converter, drive, reference, timer }
    }

    /// Begins: the first tick comes a period later.
    pub fn begin(&mut self) {
        // SAFETY: waits for the trigger from now on.
        self.converter.cr().modify(|r, w| unsafe { w.bits(r.bits() | START) });
        self.timer.cnt().reset();
        self.timer.cr1().modify(|_, w| w.cen().set_bit());
    }
}

/// The result of the conversion that the last tick started, and the start of the next one.
fn next(converter: &adc3::RegisterBlock) -> Option<u16> {
    // Reading the data clears the flag.
    let converted = converter.isr().read().bits() & END != 0;
    let code = converted.then(|| u16::try_from(converter.dr().read().bits() & 0xfff).unwrap_or(u16::MAX));
    // SAFETY: one conversion by software.
    converter.cr().modify(|r, w| unsafe { w.bits(r.bits() | START) });
    code
}

impl SampleSource for Sampler {
    fn sample(&mut self) -> RawSample {
        // The tick may also have been started by the tick monitor, because no conversion came.
        if self.converter.isr().read().bits() & END_OF_SEQUENCE == 0 {
            return RawSample::MISSING;
        }
        let [first, second, third, fourth] = core::array::from_fn(|_| self.converter.dr().read().bits() & 0xfff);
        let overran = self.converter.isr().read().bits() & OVERRUN != 0;
        // SAFETY: flags are cleared by writing ones.
        self.converter.isr().write(|w| unsafe { w.bits(END | END_OF_SEQUENCE | OVERRUN) });
        if overran {
            // A tick that never ran left its words in the queue: these four are of two instants. Empty it, so that the next four are of one.
            for _ in 0..QUEUE {
                let _ = self.converter.dr().read().bits();
            }
            return RawSample::MISSING;
        }
        // Twelve bits each; the sum fits 16.
        let sum = |a: u32, b: u32| u16::try_from(a + b).unwrap_or(u16::MAX);
        RawSample { laser_code: sum(first, fourth), pressure_code: sum(second, third) }
    }

    fn read_back(&mut self) -> Option<ReadBack> {
        Some(ReadBack {
            reference_code: next(&self.reference),
            drive_code: next(&self.drive),
            chip_code: None,
            dump_is_high: pins::dump_is_high(),
        })
    }
}

/// The factory's code of the reference voltage, of twelve bits.
///
/// # Safety
/// On the chip itself: elsewhere there may be nothing at its address.
pub unsafe fn reference_calibration() -> u16 {
    // SAFETY: system memory of the chip, readable for ever. The factory's code has 16 bits.
    unsafe { core::ptr::with_exposed_provenance::<u16>(REFERENCE_CALIBRATION).read_volatile() >> 4 }
}

/// Starts the tick monitor: an interrupt each period, half a period away from the sampling's. Both count the same clock, so the distance stays.
///
/// The sampling's own timer tells when half of its period is over. The bound is for one that stands still: then there is no phase to keep.
pub fn start_tick_monitor(syst: &mut SYST, sampler: &Sampler, rates: Rates) {
    syst.set_clock_source(SystClkSource::Core);
    syst.set_reload(rates.cycles_per_tick() - 1);
    let period = rates.timer_counts_per_tick();
    // Within an eighth of a period behind the middle, whenever this begins; a poll takes some cycles, so two periods at least.
    let middle = period / 2..period / 2 + period / 8;
    let _ = wait(2 * rates.cycles_per_tick(), || middle.contains(&sampler.timer.cnt().read().bits()));
    syst.clear_current();
    syst.enable_interrupt();
    syst.enable_counter();
}
