//! The flashable image: the rig on the board.
//!
//! | task | priority | does |
//! |---|---|---|
//! | `supply_falls` (PVD) | 5 | vents, remembers, starts again |
//! | `serial` (USART1) | 4 | moves bytes between line and queues |
//! | `guard` (SysTick) | 4 | counts periods; starts a tick that the sampling did not start |
//! | `tick` (ADC) | 3 | everything the rig does in a millisecond |
//! | `idle` | - | link, storage, self-test, logs |
//!
//! The crystal's failure (NMI), a panic and a hard fault vent first and start again; the next start tells.
#![cfg_attr(target_os = "none", no_std, no_main)]

#[cfg(target_os = "none")]
mod image {
    use core::panic::PanicInfo;

    use cortex_m_rt::exception;
    use defmt_rtt as _;
    use firmware::board::chip::crash;
    use firmware::board::exchange::Exchange;
    use model_export::link::fault::Fault;

    firmware::board_entry!();

    static EXCHANGE: Exchange = Exchange::new();

    defmt::timestamp!("{=u32:ms}", EXCHANGE.periods());

    #[panic_handler]
    fn panic(information: &PanicInfo<'_>) -> ! {
        crash::vent_and_remember(Fault::Panicked);
        if let Some(location) = information.location() {
            defmt::error!("panicked at {=str}:{=u32}", location.file(), location.line());
        }
        cortex_m::peripheral::SCB::sys_reset()
    }

    /// Goes on from the hard fault's entry, on a fresh stack.
    #[unsafe(no_mangle)]
    extern "C" fn hard_fault_on_fresh_stack() -> ! {
        crash::crash(Fault::HardFault)
    }

    /// The clock security system: the crystal stopped (RM0090 section 7.2.7).
    #[exception]
    unsafe fn NonMaskableInt() -> ! {
        crash::crash(Fault::ClockFailed)
    }

    /// An interrupt that nobody enabled.
    #[exception]
    unsafe fn DefaultHandler(_number: i16) -> ! {
        crash::crash(Fault::HardFault)
    }

    #[rtic::app(device = firmware::board::chip::pac, peripherals = true)]
    mod app {
        use core::mem::MaybeUninit;

        use firmware::board::background_task::{BackgroundQueues, BackgroundTask, Facts};
        use firmware::board::brown_out;
        use firmware::board::chip::drives::{AnalogueDrive, PulseDrive};
        use firmware::board::chip::flash::Controller;
        use firmware::board::chip::models::{BoardModel, Room, Tenant};
        use firmware::board::chip::pac::{Interrupt, PWR};
        use firmware::board::chip::sampling::{Cycles, Milliseconds, Sampler};
        use firmware::board::chip::serial::{Port, ReceiveQueue, SerialLine, TransmitQueue};
        use firmware::board::chip::{BoardTask, clock, crash, memory, pins, protection, sampling, serial as uart, supply, watchdog};
        use firmware::board::clock::Source;
        use firmware::board::exchange::{AnswerQueue, CommandQueue, TelemetryQueue, TraceQueue};
        use firmware::board::flash::InternalFlash;
        use firmware::board::hardware::{BOARD_NAME, CRYSTAL_HZ, FACTS, MODEL_SECTORS, Pll, SETTINGS_SECTORS};
        use firmware::board::tick_task::{Hands, TickQueues, TickTask};
        use firmware::estimator::EstimatorState;
        use firmware::link::{Link, LinkBuffers, LinkConfig};
        use firmware::tick::{BootReport, Rig, TickConfig};
        use model_export::link::fault::{Fault, FaultSet};
        use model_export::schema::Model;

        use super::EXCHANGE;

        /// Rounds of the background between two looks at the stack.
        const ROUNDS_PER_STACK_LOOK: u32 = 1024;

        type BoardFlash = InternalFlash<Controller>;
        type BoardBackground = BackgroundTask<'static, BoardFlash, BoardFlash, &'static mut LinkBuffers>;

        #[shared]
        struct Shared {
            tenant: Tenant,
        }

        #[local]
        struct Local {
            task: &'static mut BoardTask,
            background: &'static mut BoardBackground,
            line: SerialLine,
            port: Port,
            place: Option<&'static mut BoardModel>,
            cycles_per_tick: u32,
            power: PWR,
            ticks_seen: u32,
        }

        #[init(local = [
            commands: CommandQueue = CommandQueue::new(),
            answers: AnswerQueue = AnswerQueue::new(),
            telemetry: TelemetryQueue = TelemetryQueue::new(),
            trace: TraceQueue = TraceQueue::new(),
            receive: ReceiveQueue = ReceiveQueue::new(),
            transmit: TransmitQueue = TransmitQueue::new(),
            model_home: MaybeUninit<BoardModel> = MaybeUninit::uninit(),
            model_state: EstimatorState = EstimatorState::new(),
            model_contents: MaybeUninit<Model<'static>> = MaybeUninit::uninit(),
            program: [&'static [u8]; 4] = [&[]; 4],
            task_home: MaybeUninit<BoardTask> = MaybeUninit::uninit(),
            background_home: MaybeUninit<BoardBackground> = MaybeUninit::uninit(),
            link_buffers: LinkBuffers = LinkBuffers::new(),
        ])]
        fn init(context: init::Context) -> (Shared, Local) {
            let device = context.device;
            let mut core = context.core;
            let rcc = &device.RCC;

            // Why are we here, and in what time.
            let reset_cause = firmware::board::reset_cause(rcc.csr().read().bits());
            rcc.csr().modify(|_, w| w.rmvf().set_bit());
            let retained = crash::take();
            let clock = firmware::board::clock::start(
                &mut clock::Registers { rcc, flash: &device.FLASH, timer: &device.TIM11 },
                CRYSTAL_HZ,
                Pll::CRYSTAL,
            );
            let rates = clock.rates;
            let mut boot_faults = clock.faults.union(retained.map(|retained| retained.faults()).unwrap_or_default());

            let level = brown_out::ensure(&mut &device.FLASH);
            defmt::debug!("brown-out level: changed {=bool}", level == brown_out::Outcome::Programmed);
            protection::start(&core.MPU);

            // Hands, all of them at rest.
            let (dump_valve, emergency_stop) = pins::set_up(rcc, &device.GPIOA, device.GPIOB);
            let analogue = AnalogueDrive::new(rcc, device.DAC);
            let pulse = PulseDrive::new(rcc, device.TIM3, rates);
            let (watchdog, watchdog_lives) = watchdog::start(device.IWDG);
            boot_faults.insert_if(!watchdog_lives, Fault::ClockInaccurate);
            boot_faults.insert_if(supply::start(rcc, &device.PWR, &device.EXTI), Fault::BrownOut);
            let sampler = Sampler::new(rcc, device.ADC1, &device.ADC_COMMON, device.TIM2, rates);
            let milliseconds = Milliseconds::start(rcc, device.TIM5, rates);
            let (port, line) = uart::start(rcc, device.USART1, rates, context.local.receive, context.local.transmit);

            // SAFETY: both controllers go into the link, which runs in the background alone.
            let controller = || unsafe { Controller::new(milliseconds, &EXCHANGE) };
            let mut standing = clock.faults;
            standing.insert_if(!watchdog_lives, Fault::ClockInaccurate);
            let program_crc32 = match memory::seal() {
                Some(crc32) => {
                    *context.local.program = memory::program();
                    crc32
                }
                // An image straight from the compiler has no seal. It is for work at the debug probe and nowhere else.
                None => {
                    standing.insert_if(!memory::is_debugged(), Fault::FlashCorrupt);
                    0
                }
            };
            let facts = Facts { program: context.local.program, program_crc32, clock: clock.check, faults: standing };
            // A damaged program is told at once, not only by the self-test that an acknowledgement leads to.
            boot_faults = boot_faults.union(facts.examine());
            let (commands_in, commands_out) = context.local.commands.split();
            let (answers_in, answers_out) = context.local.answers.split();
            let (telemetry_in, telemetry_out) = context.local.telemetry.split();
            let (trace_in, trace_out) = context.local.trace.split();
            let queues = BackgroundQueues { commands: commands_in, answers: answers_out, telemetry: telemetry_out, trace: trace_out };
            let background = in_place(context.local.background_home, || {
                let link = Link::with_buffers(
                    LinkConfig {
                        firmware: firmware::VERSION,
                        board: heapless::String::try_from(BOARD_NAME).unwrap_or_default(),
                        reset_cause,
                        previous_record: retained.map(|retained| retained.record).filter(|record| record.first != 0),
                        facts: FACTS,
                    },
                    InternalFlash::new(controller(), SETTINGS_SECTORS),
                    InternalFlash::new(controller(), MODEL_SECTORS),
                    context.local.link_buffers,
                );
                BackgroundTask::new(link, facts, queues, &EXCHANGE)
            });
            let boot = BootReport { reset_cause, faults: boot_faults.union(background.link().boot_faults()) };
            let hands = Hands {
                source: sampler,
                analogue,
                pulse,
                dump_valve,
                emergency_stop,
                watchdog,
                counter: Cycles::start(&mut core.DCB, core.DWT),
                // SAFETY: the only one.
                keeper: unsafe { crash::Keeper::new() },
            };
            let queues = TickQueues { commands: commands_out, answers: answers_in, telemetry: telemetry_in, trace: trace_in };
            let contents = in_place(context.local.model_contents, Model::default);
            let place = in_place(context.local.model_home, || BoardModel::over(context.local.model_state, contents));
            let settings = background.link().settings();
            // SAFETY: a crystal that runs is on the chip itself.
            let reference = (clock.source == Source::Crystal).then(|| unsafe { sampling::reference_calibration() });
            let task = in_place(context.local.task_home, || {
                // The link's settings go together, and so do the defaults; a test holds the latter.
                let Ok(tick) = (TickConfig { settings, facts: FACTS }).build() else { crash::crash(Fault::Panicked) };
                TickTask::new(Rig::new(tick, boot), hands, queues, &EXCHANGE, rates.cycles_per_tick(), reference)
            });

            log_start(clock.source, boot.faults);
            task.hands_mut().source.begin();
            sampling::start_guard(&mut core.SYST, &task.hands_mut().source, rates);
            (
                Shared { tenant: Tenant::none() },
                Local {
                    task,
                    background,
                    line,
                    port,
                    place: Some(place),
                    cycles_per_tick: rates.cycles_per_tick(),
                    power: device.PWR,
                    ticks_seen: 0,
                },
            )
        }

        #[idle(local = [background, line, place, cycles_per_tick], shared = [tenant])]
        fn idle(context: idle::Context) -> ! {
            let idle::LocalResources { background, line, place, cycles_per_tick, .. } = context.local;
            // SAFETY: the only room; the background holds the slot of a model while it is in use.
            let mut room = unsafe { Room::new(context.shared.tenant, place.take(), *cycles_per_tick) };
            let mut state = EXCHANGE.state();
            let mut stack_unused_bytes = memory::stack_unused_bytes();
            let mut round = 0u32;
            loop {
                round = round.wrapping_add(1);
                background.step(line, &mut room, stack_unused_bytes, cortex_m::peripheral::DWT::cycle_count());
                if round.is_multiple_of(ROUNDS_PER_STACK_LOOK) {
                    stack_unused_bytes = memory::stack_unused_bytes();
                }
                if EXCHANGE.state() != state {
                    state = EXCHANGE.state();
                    defmt::info!("state {=u8}", state_number(state));
                }
            }
        }

        #[task(binds = ADC, priority = 3, local = [task], shared = [tenant])]
        fn tick(mut context: tick::Context) {
            let task = context.local.task;
            context.shared.tenant.lock(|tenant| task.run(tenant));
        }

        #[task(binds = SysTick, priority = 4, local = [ticks_seen])]
        fn guard(context: guard::Context) {
            EXCHANGE.add_periods(1);
            let ticks = EXCHANGE.ticks();
            if ticks == *context.local.ticks_seen {
                // The sampling did not start a tick: this one finds no sample.
                rtic::pend(Interrupt::ADC);
            }
            *context.local.ticks_seen = ticks;
        }

        #[task(binds = USART1, priority = 4, local = [port])]
        fn serial(context: serial::Context) {
            context.local.port.interrupt();
        }

        #[task(binds = PVD, priority = 5, local = [power])]
        fn supply_falls(context: supply_falls::Context) {
            supply::fell(context.local.power);
        }

        /// Makes something long where it will stay; a function of its own, so that its copies are off the stack when the next one begins.
        #[inline(never)]
        fn in_place<T>(home: &'static mut MaybeUninit<T>, make: impl FnOnce() -> T) -> &'static mut T {
            home.write(make())
        }

        fn state_number(state: model_export::link::state::State) -> u8 {
            model_export::link::state::State::ALL
                .iter()
                .zip(0u8..)
                .find(|(candidate, _)| **candidate == state)
                .map_or(0, |(_, number)| number)
        }

        fn log_start(source: Source, faults: FaultSet) {
            match source {
                Source::Crystal => defmt::info!("168 MHz from the crystal"),
                Source::InternalFast => defmt::warn!("168 MHz from the internal oscillator"),
                Source::Internal => defmt::warn!("16 MHz from the internal oscillator"),
            }
            for fault in faults.iter() {
                defmt::error!("E{=u8:03}", fault.number());
            }
        }
    }
}

#[cfg(not(target_os = "none"))]
fn main() {
    eprintln!("this program runs on the microcontroller: `cargo xtask firmware` builds it, `cargo xtask flash` flashes it");
}
