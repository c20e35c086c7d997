//! The flashable image: the rig on the board.
//!
//! | task | priority | does |
//! |---|---|---|
//! | `supply_falls` (supply monitor) | 5 | vents, remembers, starts again |
//! | `tick_monitor` (SysTick) | 4 | counts periods; starts a tick that the sampling did not start |
//! | `tick` (end of a sampling) | 3 | everything the rig does in a millisecond |
//! | `serial` (line) | 1 | begins the next piece of what is to be sent; on the STM32H743 it moves bytes, at priority 4 |
//! | `idle` | - | link, storage, self-test, logs |
//!
//! The HSE's failure (NMI), a panic and a hard fault vent first and start again; the next start tells.
#![cfg_attr(target_os = "none", no_std, no_main)]

#[cfg(target_os = "none")]
#[allow(unsafe_op_in_unsafe_fn, reason = "the framework's code, which the compiler takes for ours because it comes out of a macro here")]
mod image {
    use core::panic::PanicInfo;

    use cortex_m_rt::exception;
    use defmt_rtt as _;
    use firmware::board::chip::registers::ThisBoard;
    use firmware::board::contract::Board;
    use firmware::board::shared_atomics::SharedAtomics;
    use firmware::board::target::crash;
    use model_export::link::fault::Fault;

    firmware::board_entry!();

    static SHARED: SharedAtomics = SharedAtomics::new();

    defmt::timestamp!("{=u32:ms}", SHARED.periods());

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
        ThisBoard::crash(Fault::HardFault)
    }

    /// The clock security system: the HSE stopped (RM0090 section 7.2.7).
    #[exception]
    unsafe fn NonMaskableInt() -> ! {
        ThisBoard::crash(Fault::ClockFailed)
    }

    /// An interrupt that nobody enabled.
    #[exception]
    unsafe fn DefaultHandler(_number: i16) -> ! {
        ThisBoard::crash(Fault::HardFault)
    }

    // The program, with the names of the chip's interrupts: the end of a sampling, the line's, the supply monitor's. The framework wants them
    // spelt out. Not formatted: within a macro the list of resources moves to the right with every run of the formatter.
    #[rustfmt::skip]
    macro_rules! program {
        ($sampled:ident, $line:ident, $supply:ident) => {
            #[rtic::app(device = firmware::board::chip::registers::pac, peripherals = true)]
            mod app {
                use core::mem::MaybeUninit;

                use embedded_io::Write as _;
                use firmware::board::background_task::{BackgroundQueues, BackgroundTask, Facts};
                use firmware::board::chip::registers::pac::Interrupt;
                use firmware::board::chip::registers::{Peripherals, ThisBoard};
                use firmware::board::clock::Source;
                use firmware::board::contract::{Board, TickIoOf, LineInterrupt, Started, SupplyMonitor};
                use firmware::board::converter::FACTS;
                use firmware::board::shared_atomics::{AnswerQueue, CommandQueue, TelemetryQueue, TraceQueue};
                use firmware::board::log;
                use firmware::board::pulse_drive::PulseMonitor;
                use firmware::board::target::crash;
                use firmware::board::target::memory;
                use firmware::board::target::models::{BoardModel, ModelSlot, LoadedModel};
                use firmware::board::tick_task::{TickQueues, TickTask};
                use firmware::estimator::EstimatorState;
                use firmware::link::{Identity, Link, LinkBuffers, LinkConfig};
                use firmware::tick::{BootReport, TickConfig};
                use model_export::link::fault::Fault;
                use model_export::link::hello::Build;
                use model_export::link::state::State;
                use model_export::schema::Model;

                use super::SHARED;

                /// Rounds of the background between two looks at the stack.
                const ROUNDS_PER_STACK_LOOK: u32 = 1024;

                type BoardFlash = <ThisBoard as Board>::Flash;
                type BoardTask = TickTask<'static, TickIoOf<ThisBoard>>;
                type BoardBackground = BackgroundTask<'static, BoardFlash, BoardFlash, &'static mut LinkBuffers>;

                #[shared]
                struct Shared {
                    loaded: LoadedModel,
                }

                #[local]
                struct Local {
                    task: &'static mut BoardTask,
                    background: &'static mut BoardBackground,
                    line: <ThisBoard as Board>::Line,
                    line_interrupt: <ThisBoard as Board>::LineInterrupt,
                    place: Option<&'static mut BoardModel>,
                    cycles_per_tick: u32,
                    supply: <ThisBoard as Board>::Supply,
                    ticks_seen: u32,
                }

                #[init(local = [
                    commands: CommandQueue = CommandQueue::new(),
                    answers: AnswerQueue = AnswerQueue::new(),
                    telemetry: TelemetryQueue = TelemetryQueue::new(),
                    trace: TraceQueue = TraceQueue::new(),
                    line_memory: <ThisBoard as Board>::LineMemory = <ThisBoard as Board>::LineMemory::new(),
                    model_home: MaybeUninit<BoardModel> = MaybeUninit::uninit(),
                    model_state: EstimatorState = EstimatorState::new(),
                    model_contents: MaybeUninit<Model<'static>> = MaybeUninit::uninit(),
                    program: [&'static [u8]; 4] = [&[]; 4],
                    task_home: MaybeUninit<BoardTask> = MaybeUninit::uninit(),
                    background_home: MaybeUninit<BoardBackground> = MaybeUninit::uninit(),
                    link_buffers: LinkBuffers = LinkBuffers::new(),
                ])]
                fn init(context: init::Context) -> (Shared, Local) {
                    let peripherals = Peripherals { device: context.device, core: context.core };
                    let board = ThisBoard::start(peripherals, context.local.line_memory, &SHARED);
                    let Started { reset_cause, crash_record, clock, mut standing, io, .. } = board;
                    let mut boot_faults = clock.faults.union(crash_record.map(|crash_record| crash_record.faults()).unwrap_or_default());
                    boot_faults = boot_faults.union(board.found).union(standing);
                    let program_crc32 = match memory::image_crc() {
                        Some(crc32) => {
                            *context.local.program = memory::program();
                            crc32
                        }
                        // An image straight from the compiler has no CRC. It is for work at the debug probe and nowhere else.
                        None => {
                            standing.insert_if(!memory::is_debugged(), Fault::FlashCorrupt);
                            0
                        }
                    };
                    let facts =
                        Facts { program: context.local.program, program_crc32, clock: clock.check, faults: standing, chip: board.thermometer };
                    // A damaged program is told at once, not only by the self-test that an acknowledgement leads to.
                    boot_faults = boot_faults.union(facts.examine());
                    let (commands_in, commands_out) = context.local.commands.split();
                    let (answers_in, answers_out) = context.local.answers.split();
                    let (telemetry_in, telemetry_out) = context.local.telemetry.split();
                    let (trace_in, trace_out) = context.local.trace.split();
                    let queues =
                        BackgroundQueues { commands: commands_in, answers: answers_out, telemetry: telemetry_out, trace: trace_out };
                    let background = in_place(context.local.background_home, || {
                        let link = Link::with_buffers(
                            LinkConfig {
                                firmware: firmware::VERSION,
                                board: heapless::String::try_from(ThisBoard::NAME).unwrap_or_default(),
                                reset_cause,
                                previous_record: crash_record.map(|crash_record| crash_record.record).filter(|record| record.first != 0),
                                facts: FACTS,
                            },
                            board.settings,
                            board.models,
                            context.local.link_buffers,
                        );
                        BackgroundTask::new(link, facts, queues, &SHARED)
                    });
                    let build = Build { source: source_hash(option_env!("FIRMWARE_COMMIT")), ..board.build };
                    background.link_mut().identify(Identity { build, has_bootloader: ThisBoard::HAS_BOOTLOADER, has_history: true });
                    let boot = BootReport { reset_cause, faults: boot_faults.union(background.link().boot_faults()) };
                    let queues = TickQueues { commands: commands_out, answers: answers_in, telemetry: telemetry_in, trace: trace_in };
                    let contents = in_place(context.local.model_contents, Model::default);
                    let place = in_place(context.local.model_home, || BoardModel::over(context.local.model_state, contents));
                    let settings = background.link().settings();
                    let rates = clock.rates;
                    let task = in_place(context.local.task_home, || {
                        // The link's settings go together, and so do the defaults; a test holds the latter.
                        let Ok(tick) = (TickConfig { settings, facts: FACTS }).build() else { ThisBoard::crash(Fault::Panicked) };
                        TickTask::new(tick, boot, io, queues, &SHARED, rates.cycles_per_tick(), board.reference_calibration)
                    });

                    log::start(ThisBoard::NAME, &build, reset_cause, rates.core_hz, program_crc32);
                    log_clock(clock.source, rates.core_hz);
                    log::standing(boot.faults);
                    if let Some(crash_record) = crash_record.filter(|crash_record| crash_record.record.first != 0) {
                        log::before(&crash_record.record);
                    }
                    ThisBoard::begin(board.beginning, &mut task.io_mut().source);
                    (
                        Shared { loaded: LoadedModel::none() },
                        Local {
                            task,
                            background,
                            line: board.line,
                            line_interrupt: board.line_interrupt,
                            place: Some(place),
                            cycles_per_tick: rates.cycles_per_tick(),
                            supply: board.supply,
                            ticks_seen: 0,
                        },
                    )
                }

                #[idle(local = [background, line, place, cycles_per_tick], shared = [loaded])]
                fn idle(context: idle::Context) -> ! {
                    let idle::LocalResources { background, line, place, cycles_per_tick, .. } = context.local;
                    // SAFETY: the only one; the background holds the slot of a model while it is in use.
                    let mut slot = unsafe { ModelSlot::new(context.shared.loaded, place.take(), *cycles_per_tick) };
                    let mut state = SHARED.state();
                    let mut fault_is_new = false;
                    let mut stack_unused_bytes = memory::stack_unused_bytes();
                    let mut round = 0u32;
                    let mut pulse = PulseMonitor::default();
                    loop {
                        round = round.wrapping_add(1);
                        let (expected, reading) = ThisBoard::read_pulse(&SHARED.pulse);
                        SHARED.report_pulse(pulse.step(&expected, &reading));
                        background.link_mut().serve_history(&crash::LastTicks);
                        if background.link_mut().wants_bootloader() {
                            defmt::warn!("starting the chip's bootloader");
                            let _ = line.flush();
                            ThisBoard::enter_bootloader();
                        }
                        background.step(line, &mut slot, stack_unused_bytes, cortex_m::peripheral::DWT::cycle_count());
                        if round.is_multiple_of(ROUNDS_PER_STACK_LOOK) {
                            stack_unused_bytes = memory::stack_unused_bytes();
                        }
                        if let Some((token, refusal)) = background.link_mut().take_refusal() {
                            log::refusal(token, refusal);
                        }
                        if SHARED.state() != state {
                            state = SHARED.state();
                            log::state(state);
                            fault_is_new |= state == State::Fault;
                        }
                        // Later, where the tick is just writing it.
                        if fault_is_new && let Some(crash_record) = crash::peek() {
                            fault_is_new = false;
                            log::fault(&crash_record.record);
                        }
                    }
                }

                #[task(binds = $sampled, priority = 3, local = [task], shared = [loaded])]
                fn tick(mut context: tick::Context) {
                    let task = context.local.task;
                    context.shared.loaded.lock(|loaded| task.run(loaded));
                }

                #[task(binds = SysTick, priority = 4, local = [ticks_seen])]
                fn tick_monitor(context: tick_monitor::Context) {
                    SHARED.add_periods(1);
                    let ticks = SHARED.ticks();
                    if ticks == *context.local.ticks_seen {
                        // The sampling did not start a tick: this one finds no sample.
                        rtic::pend(Interrupt::$sampled);
                    }
                    *context.local.ticks_seen = ticks;
                }

                #[task(binds = $line, priority = 1, local = [line_interrupt])]
                fn serial(context: serial::Context) {
                    context.local.line_interrupt.interrupt();
                }

                #[task(binds = $supply, priority = 5, local = [supply])]
                fn supply_falls(context: supply_falls::Context) {
                    context.local.supply.fell();
                }

                /// Makes something long where it will stay; a function of its own, so that its copies are off the stack when the next one begins.
                #[inline(never)]
                fn in_place<T>(home: &'static mut MaybeUninit<T>, make: impl FnOnce() -> T) -> &'static mut T {
                    home.write(make())
                }

                /// The first bytes of a hash in hexadecimal digits; zeros without one.
                const fn source_hash(digits: Option<&str>) -> [u8; 8] {
                    let mut hash = [0; 8];
                    let Some(digits) = digits else { return hash };
                    let digits = digits.as_bytes();
                    let mut index = 0;
                    while index < 16 && index < digits.len() {
                        let digit = match digits[index] {
                            digit @ b'0'..=b'9' => digit - b'0',
                            digit @ b'a'..=b'f' => digit - b'a' + 10,
                            _ => return [0; 8],
                        };
                        hash[index / 2] = (hash[index / 2] << 4) | digit;
                        index += 1;
                    }
                    hash
                }

                fn log_clock(source: Source, core_hz: u32) {
                    let mhz = core_hz / 1_000_000;
                    match source {
                        Source::Hse => defmt::info!("{=u32} MHz from the HSE", mhz),
                        Source::InternalFast => defmt::warn!("{=u32} MHz from the internal oscillator", mhz),
                        Source::Internal => defmt::warn!("{=u32} MHz from the internal oscillator", mhz),
                    }
                }
            }
        };
    }

    #[cfg(chip = "stm32f405")]
    program!(ADC, DMA2_STREAM7, PVD);
    #[cfg(chip = "stm32h743")]
    program!(ADC1_2, DMA_STR1, PVD_PVM);
}

#[cfg(not(target_os = "none"))]
fn main() {
    eprintln!("this program runs on the microcontroller: `cargo xtask firmware` builds it, `cargo xtask flash` flashes it");
}
