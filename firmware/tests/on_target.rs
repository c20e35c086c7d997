//! Tests that need the real chip: `cargo test --release --target thumbv7em-none-eabihf -p firmware --test on_target` with a debug probe.
//!
//! They drive nothing: no test touches the valve's outputs or the dump valve, which the entry code keeps released. The results that matter
//! (cycles) go to the log, since no bound on them has ever been measured on silicon.
#![cfg_attr(target_os = "none", no_std, no_main)]

#[cfg(target_os = "none")]
mod image {
    use defmt_rtt as _;

    firmware::board_entry!();

    /// The tests' own hard fault: the probe sees the abort.
    #[unsafe(no_mangle)]
    extern "C" fn hard_fault_on_fresh_stack() -> ! {
        panic!("hard fault")
    }
}

#[cfg(target_os = "none")]
#[embedded_test::tests]
mod tests {
    use firmware::board::SELECTED;
    use firmware::board::chip::registers::clock;
    use firmware::board::chip::registers::pac::{CorePeripherals, Peripherals};
    use firmware::board::chip::registers::sampling::{Milliseconds, Sampler};
    use firmware::board::clock::{ClockReport, Source};
    use firmware::board::stm32f405::facts::{CORE_HZ, plan};
    use firmware::board::target::cycles::Cycles;
    use firmware::board::target::memory;
    use firmware::board::tick_task::CycleCounter;
    use firmware::drivers::{RawSample, SampleSource};
    use firmware::estimator::{KernelSource, MAX_PACKED_WORDS, Network, Portable};
    use firmware::parity::{Layers, RandomNetwork, network_digest};
    use model_export::schema::Cell;

    struct Board {
        clock: ClockReport,
        device: Peripherals,
        cycles: Cycles,
    }

    #[init]
    fn init() -> Board {
        let device = Peripherals::take().expect("the first to ask");
        let mut core = CorePeripherals::take().expect("the first to ask");
        let mut registers = clock::Registers { rcc: &device.RCC, flash: &device.FLASH, timer: &device.TIM11 };
        let clock = firmware::board::clock::start(&mut registers, &plan(SELECTED.hse_hz));
        let cycles = Cycles::start(&mut core.DCB, core.DWT);
        Board { clock, device, cycles }
    }

    #[test]
    fn the_hse_starts_and_has_its_frequency(board: Board) {
        assert_eq!(board.clock.source, Source::Hse);
        let check = board.clock.check.expect("an HSE that runs is counted");
        defmt::info!("HSE counted {=u32}, expected {=u32}", check.counted, check.expected);
        assert!(check.agrees());
    }

    #[test]
    fn a_second_has_as_many_cycles_as_the_clock_says(board: Board) {
        let clock = Milliseconds::start(&board.device.RCC, board.device.TIM5, board.clock.rates);
        let wait_for_edge = || {
            let now = clock.now();
            while clock.now() == now {}
            board.cycles.cycles()
        };
        let began = wait_for_edge();
        let end_ms = clock.now() + 100;
        while clock.now() < end_ms {}
        let cycles = board.cycles.cycles().wrapping_sub(began);
        // Both count the same clock: only the loop's length may differ.
        assert!(cycles.abs_diff(CORE_HZ / 10) < 200, "{cycles} cycles in 100 ms");
    }

    #[test]
    fn the_timer_starts_a_conversion_every_millisecond(board: Board) {
        let rates = board.clock.rates;
        let mut sampler = Sampler::new(&board.device.RCC, board.device.ADC1, &board.device.ADC_COMMON, board.device.TIM2, rates);
        sampler.begin();
        let mut next = || {
            loop {
                let sample = sampler.sample();
                if sample != RawSample::MISSING {
                    return (sample, board.cycles.cycles());
                }
            }
        };
        let (_, first) = next();
        let (mut sample, mut last) = next();
        for _ in 0..99 {
            (sample, last) = next();
        }
        defmt::info!("laser {=u16}, pressure {=u16}", sample.laser_code, sample.pressure_code);
        let cycles = last.wrapping_sub(first);
        assert!(cycles.abs_diff(100 * rates.cycles_per_tick()) < 200, "{cycles} cycles for 100 samples");
        assert!(sample.laser_code <= 8190 && sample.pressure_code <= 8190);
    }

    #[test]
    fn the_fast_kernel_gives_the_portable_ones_bits_and_this_many_cycles(board: Board) {
        static mut NETWORK: RandomNetwork = RandomNetwork::new();
        #[unsafe(link_section = ".ccm")]
        static mut WEIGHTS: [u32; MAX_PACKED_WORDS] = [0; MAX_PACKED_WORDS];
        // SAFETY: each test runs alone, in a program of its own.
        let (random, weights) = unsafe { (&mut *(&raw mut NETWORK), &mut *(&raw mut WEIGHTS)) };
        const STEPS: usize = 100;
        random.fill_pool(9_001);
        for (inputs, units) in [(1, &[32][..]), (1, &[64, 64]), (13, &[16, 48])] {
            let layers: Layers = units.iter().map(|units| (Cell::Lstm, *units)).collect();
            random.draw(9_002, inputs, &layers);
            let wire = random.wire();
            let network = Network::new(&wire, inputs).expect("a sound network");
            let kernel = weights.kernel(&network).expect("it fits");
            let began = board.cycles.cycles();
            let fast = network_digest(&network, &kernel, 9_003, STEPS);
            let cycles = board.cycles.cycles().wrapping_sub(began) / u32::try_from(STEPS).unwrap_or(1);
            defmt::info!("{=usize} inputs, {=[?]} units: {=u32} cycles a step, digest included", inputs, units, cycles);
            assert_eq!(fast, network_digest(&network, &Portable, 9_003, STEPS));
        }
    }

    #[test]
    fn the_stack_is_painted_and_most_of_it_unused(_board: Board) {
        let unused = memory::stack_unused_bytes();
        defmt::info!("{=u32} bytes of stack unused", unused);
        assert!(unused > 0);
    }
}

#[cfg(not(target_os = "none"))]
fn main() {}
