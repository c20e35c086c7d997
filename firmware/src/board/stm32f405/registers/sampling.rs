//! Sampling: TIM2 triggers four injected conversions of ADC1 a millisecond (RM0090 sections 13.13, 18.4); SysTick watches that it does.

use cortex_m::peripheral::SYST;
use cortex_m::peripheral::syst::SystClkSource;
use stm32f4::stm32f405::{ADC_COMMON, ADC1, RCC, TIM2, TIM5};

use super::pins;
use crate::board::clock::wait;
use crate::board::converter::{Measured, SAMPLING_SEQUENCE};
use crate::board::rates::Rates;
use crate::board::read_back::ChipThermometer;
use crate::board::selected::WIRING;
use crate::board::stm32f405::facts::{CHIP_CALIBRATION, CHIP_CHANNEL, READ_BACK_CHANNELS, REFERENCE_CALIBRATION};
use crate::drivers::{RawSample, ReadBack, SampleSource};

/// Code of the trigger TIM2_TRGO (RM0090 section 13.13.3, JEXTSEL).
const TRIGGER_TIM2_TRGO: u8 = 0b0011;
/// Code of a sampling time of 480 ADC cycles (RM0090 section 13.13.4): 23 us.
const SAMPLING_480_CYCLES: u8 = 0b111;
/// Code of a sampling time of 84 ADC cycles (RM0090 section 13.13.5).
const SAMPLING_84_CYCLES: u8 = 0b100;

/// The channels of the measured inputs.
const LASER: u8 = WIRING.laser.channel_of();
const PRESSURE: u8 = WIRING.pressure.channel_of();

/// Sets a channel's sampling time (RM0090 sections 13.13.4 and 13.13.5): three bits each, channels 0 to 9 in the second register.
fn set_sampling_time(converter: &ADC1, channel: u8, code: u8) {
    let place = 3 * u32::from(channel % 10);
    let change = |bits: u32| bits & !(0b111 << place) | u32::from(code) << place;
    // SAFETY: a code of the manual in the channel's own three bits.
    unsafe {
        if channel < 10 {
            converter.smpr2().modify(|r, w| w.bits(change(r.bits())));
        } else {
            converter.smpr1().modify(|r, w| w.bits(change(r.bits())));
        }
    }
}

/// The converter.
pub struct Sampler {
    converter: ADC1,
    timer: TIM2,
    /// Which conversion is under way; the first of 256 is that of the temperature.
    reads: u8,
}

impl Sampler {
    /// Sets up converter and timer; sampling begins with [`Self::begin`].
    pub fn new(rcc: &RCC, converter: ADC1, common: &ADC_COMMON, timer: TIM2, rates: Rates) -> Self {
        enable_clock!(rcc.apb2enr: adc1en);
        enable_clock!(rcc.apb1enr: tim2en);
        common.ccr().modify(|_, w| w.adcpre().div4().tsvrefe().set_bit());
        let [first, second, third, fourth] = SAMPLING_SEQUENCE.map(|measured| match measured {
            Measured::Laser => LASER,
            Measured::Pressure => PRESSURE,
        });
        // The reference and the temperature need 10 us (DS8626 tables 73 and 76), the drive's pin as long as the others.
        let [reference, drive] = READ_BACK_CHANNELS;
        set_sampling_time(&converter, reference, SAMPLING_480_CYCLES);
        set_sampling_time(&converter, CHIP_CHANNEL, SAMPLING_480_CYCLES);
        for channel in [drive, LASER, PRESSURE] {
            set_sampling_time(&converter, channel, SAMPLING_84_CYCLES);
        }
        // SAFETY: channel numbers, in fields of their width.
        unsafe {
            converter.sqr1().write(|w| w.l().bits(0));
            // Four conversions (JL = 3), so JSQ1 is the first (RM0090 section 13.13.12).
            converter.jsqr().write(|w| w.jl().bits(3).jsq1().bits(first).jsq2().bits(second).jsq3().bits(third).jsq4().bits(fourth));
        }
        converter.cr1().modify(|_, w| w.res().twelve_bit().scan().set_bit().jeocie().set_bit());
        // SAFETY: the trigger's code above.
        converter
            .cr2()
            .modify(|_, w| unsafe { w.align().right().jextsel().bits(TRIGGER_TIM2_TRGO).jexten().rising_edge().adon().set_bit() });
        timer.cr1().modify(|_, w| w.cen().clear_bit());
        timer.psc().reset();
        // SAFETY: every value counts.
        #[allow(unused_unsafe, reason = "safe in some versions of the register definitions")]
        timer.arr().write(|w| unsafe { w.bits(rates.timer_counts_per_tick() - 1) });
        timer.cr2().modify(|_, w| w.mms().update());
        Self { converter, timer, reads: 1 }
    }

    /// Begins: the first tick comes a period later, when the converter has been on for long enough (3 us, DS8626 table 67).
    pub fn begin(&mut self) {
        self.timer.cnt().reset();
        self.timer.cr1().modify(|_, w| w.cen().set_bit());
    }
}

fn read_in_turn(turn: u8) -> u8 {
    let [reference, drive] = READ_BACK_CHANNELS;
    match turn {
        0 => CHIP_CHANNEL,
        turn if turn % 2 == 0 => reference,
        _ => drive,
    }
}

impl SampleSource for Sampler {
    fn sample(&mut self) -> RawSample {
        // The tick may also have been started by the tick monitor, because no conversion came.
        if self.converter.sr().read().jeoc().bit_is_clear() {
            return RawSample::MISSING;
        }
        self.converter.sr().modify(|_, w| w.jeoc().clear_bit());
        let [first, second, third, fourth] = [
            self.converter.jdr1().read().bits(),
            self.converter.jdr2().read().bits(),
            self.converter.jdr3().read().bits(),
            self.converter.jdr4().read().bits(),
        ];
        // Twelve bits each; the sum fits 16.
        let sum = |a: u32, b: u32| u16::try_from((a & 0xfff) + (b & 0xfff)).unwrap_or(u16::MAX);
        RawSample { laser_code: sum(first, fourth), pressure_code: sum(second, third) }
    }

    fn read_back(&mut self) -> Option<ReadBack> {
        // The conversion that the last tick started is over long ago. Reading the data clears its flag.
        let converted = self.converter.sr().read().eoc().bit_is_set();
        let code = converted.then(|| self.converter.dr().read().data().bits() & 0xfff);
        let [reference, drive] = READ_BACK_CHANNELS;
        let of = |channel: u8| code.filter(|_| read_in_turn(self.reads) == channel);
        let (reference_code, drive_code, chip_code) = (of(reference), of(drive), of(CHIP_CHANNEL));
        self.reads = self.reads.wrapping_add(1);
        // SAFETY: a channel's number.
        self.converter.sqr3().write(|w| unsafe { w.sq1().bits(read_in_turn(self.reads)) });
        self.converter.cr2().modify(|_, w| w.swstart().set_bit());
        Some(ReadBack { reference_code, drive_code, chip_code, dump_is_high: pins::dump_is_high() })
    }
}

/// The factory's code of the reference voltage.
///
/// # Safety
/// On the chip itself: elsewhere there may be nothing at its address.
pub unsafe fn reference_calibration() -> u16 {
    // SAFETY: system memory of the chip, readable for ever.
    unsafe { core::ptr::with_exposed_provenance::<u16>(REFERENCE_CALIBRATION).read_volatile() }
}

/// The factory's two points of the chip's temperature sensor, if they are there.
///
/// # Safety
/// As [`reference_calibration`].
pub unsafe fn chip_calibration() -> Option<ChipThermometer> {
    // SAFETY: system memory of the chip, readable for ever.
    let [code_30, code_110] = CHIP_CALIBRATION.map(|place| unsafe { core::ptr::with_exposed_provenance::<u16>(place).read_volatile() });
    ChipThermometer::new(code_30, code_110)
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

/// Free-running milliseconds by TIM5, also while the processor stands still.
#[derive(Clone, Copy, Debug)]
pub struct Milliseconds(());

/// Counts of the timer: the slowest that its 16-bit prescaler gives.
const COUNTS_PER_MS: u32 = 2;

impl Milliseconds {
    /// Starts the timer.
    pub fn start(rcc: &RCC, timer: TIM5, rates: Rates) -> Self {
        enable_clock!(rcc.apb1enr: tim5en);
        let prescaler = u16::try_from(rates.timer_counts_per_tick() / COUNTS_PER_MS - 1).unwrap_or(u16::MAX);
        // SAFETY: every value divides.
        #[allow(unused_unsafe, reason = "safe in some versions of the register definitions")]
        timer.psc().write(|w| unsafe { w.psc().bits(prescaler) });
        // SAFETY: counts through all 32 bits.
        #[allow(unused_unsafe, reason = "safe in some versions of the register definitions")]
        timer.arr().write(|w| unsafe { w.bits(u32::MAX) });
        // Only an update takes the prescaler over.
        timer.egr().write(|w| w.ug().set_bit());
        timer.cr1().modify(|_, w| w.cen().set_bit());
        Self(())
    }

    /// Milliseconds so far; wraps after 24 days.
    pub fn now(self) -> u32 {
        // SAFETY: reading the counter has no effect.
        let counts = unsafe { (*TIM5::ptr()).cnt().read().bits() };
        counts / COUNTS_PER_MS
    }
}
