//! The part's bus: memory, instances, reset values, clock gates.

use std::num::{NonZeroU32, NonZeroU64};

use rigless::cpu::armv7m;
use rigless::soc::stm32f427::generated::{self, gpioa};
use rigless::soc::stm32f427::peripherals::dma::Wire;
use rigless::soc::stm32f427::peripherals::tim::Counter;
use rigless::soc::stm32f427::peripherals::usart;
use rigless::soc::{self, Bus, Cpu, Endian, EraseBlocks, Error, Gate, Peripheral, Region, WriteModify};

// What the STM32F405 has where the STM32F427 has something else. RM0090 gives both families, each in sections of its own.

/// | what | STM32F427 | STM32F405 | RM0090 |
/// |---|---|---|---|
/// | flash | two banks, 2 MiB | one bank, 1 MiB, sectors 0 to 11 | table 5 |
/// | SRAM | 192 KiB | 112 + 16 KiB | section 2.3.1 |
/// | core-coupled memory | 64 KiB | 64 KiB, on the data bus only | section 2.3.1 |
/// | interrupt lines | 91 | 82 | table 62 |
/// | peripherals | | none of [`ABSENT`] | section 2.3 |
/// | reset values | | [`RESETS`] | chapter 7, section 5.4 |
/// | device number | 0x419 | 0x413 | section 38.6.1 |
pub static MEMORY: [Region; 5] = [
    Region::flash("flash", 0x0800_0000, 1 << 20).erased_in(&SECTORS).erased_to(0xff).programmed_by("FLASH"),
    Region::ram("ccm", 0x1000_0000, 64 << 10),
    Region::system("system", 0x1fff_0000, 32 << 10),
    Region::ram("sram", 0x2000_0000, 128 << 10),
    Region::ram("backup_sram", 0x4002_4000, 4 << 10),
];
static SECTORS: [EraseBlocks; 3] = [blocks(16, 4), blocks(64, 1), blocks(128, 7)];
const INTERRUPT_LINES: u16 = 82;
/// Peripherals of the STM32F427 (and of the STM32F407, for the camera and Ethernet) that the STM32F405 lacks.
const ABSENT: [&str; 18] = [
    "UART7",
    "UART8",
    "SPI4",
    "SPI5",
    "SPI6",
    "SAI1",
    "GPIOJ",
    "GPIOK",
    "DMA2D",
    "FMC",
    "DCMI",
    "CRYP",
    "HASH",
    "Ethernet_MAC",
    "Ethernet_MMC",
    "Ethernet_PTP",
    "Ethernet_DMA",
    "I2S2ext",
];
/// Reset values of the STM32F405 where the register tables have another: the sibling's, or one that the manual corrects.
const RESETS: [(&str, &str, u64); 14] = [
    ("RCC", "AHB1LPENR", 0x7e67_91ff),     // 7.3.15
    ("RCC", "APB1LPENR", 0x36fe_c9ff),     // 7.3.18
    ("RCC", "APB2LPENR", 0x0007_5f33),     // 7.3.19
    ("RCC", "PLLI2SCFGR", 0x2000_3000),    // 7.3.23
    ("PWR", "CR", 0x0000_4000),            // 5.4.1: VOS is one bit
    ("FLASH", "CR", 0x8000_0000),          // 3.9.5: locked
    ("DBG", "DBGMCU_IDCODE", 0x100f_6413), // 38.6.1, revision Y
    ("USART1", "SR", 0x0000_00c0),         // 30.6.1
    ("TIM2", "ARR", 0xffff_ffff),          // 18.4.12
    ("TIM5", "ARR", 0xffff_ffff),
    ("TIM3", "ARR", 0x0000_ffff),
    ("TIM4", "ARR", 0x0000_ffff),
    ("TIM11", "ARR", 0x0000_0000), // 19.5.9
    ("RCC", "CSR", 0x0e00_0000),   // 7.3.21
];
/// Reset values of MODER, OSPEEDR and PUPDR of ports A and B; the others' are zero (8.4.1, 8.4.3, 8.4.4).
const PORT_RESETS: [[u64; 3]; 2] = [[0xa800_0000, 0x0c00_0000, 0x6400_0000], [0x0000_0280, 0x0000_00c0, 0x0000_0100]];
/// Interrupts of the instances with a model whose list in the tables is incomplete (table 62).
const INTERRUPTS: [(&str, &[u16]); 3] = [("ADC1", &[18]), ("TIM11", &[26]), ("EXTI", &[1])];

const fn blocks(kib: u64, count: u32) -> EraseBlocks {
    match (NonZeroU64::new(kib << 10), NonZeroU32::new(count)) {
        (Some(size), Some(count)) => EraseBlocks { size, count },
        _ => panic!("a sector has bytes"),
    }
}

/// Ports.
pub const PORTS: [&str; 9] = ["GPIOA", "GPIOB", "GPIOC", "GPIOD", "GPIOE", "GPIOF", "GPIOG", "GPIOH", "GPIOI"];
/// Timers with nothing beside them.
pub const TIMERS: [(&str, Counter); 3] = [("TIM3", Counter::Narrow), ("TIM4", Counter::Narrow), ("TIM5", Counter::Wide)];

/// Instance, enable register and bit, reset register and bit (7.3.5 to 7.3.14).
const CLOCKED: [[&str; 5]; 22] = [
    ["PWR", "APB1ENR", "PWREN", "APB1RSTR", "PWRRST"],
    ["DAC", "APB1ENR", "DACEN", "APB1RSTR", "DACRST"],
    ["TIM2", "APB1ENR", "TIM2EN", "APB1RSTR", "TIM2RST"],
    ["TIM3", "APB1ENR", "TIM3EN", "APB1RSTR", "TIM3RST"],
    ["TIM4", "APB1ENR", "TIM4EN", "APB1RSTR", "TIM4RST"],
    ["TIM5", "APB1ENR", "TIM5EN", "APB1RSTR", "TIM5RST"],
    ["USART1", "APB2ENR", "USART1EN", "APB2RSTR", "USART1RST"],
    ["ADC1", "APB2ENR", "ADC1EN", "APB2RSTR", "ADCRST"],
    ["C_ADC", "APB2ENR", "ADC1EN", "APB2RSTR", "ADCRST"],
    ["TIM11", "APB2ENR", "TIM11EN", "APB2RSTR", "TIM11RST"],
    ["SYSCFG", "APB2ENR", "SYSCFGEN", "APB2RSTR", "SYSCFGRST"],
    ["CRC", "AHB1ENR", "CRCEN", "AHB1RSTR", "CRCRST"],
    ["DMA2", "AHB1ENR", "DMA2EN", "AHB1RSTR", "DMA2RST"],
    ["GPIOA", "AHB1ENR", "GPIOAEN", "AHB1RSTR", "GPIOARST"],
    ["GPIOB", "AHB1ENR", "GPIOBEN", "AHB1RSTR", "GPIOBRST"],
    ["GPIOC", "AHB1ENR", "GPIOCEN", "AHB1RSTR", "GPIOCRST"],
    ["GPIOD", "AHB1ENR", "GPIODEN", "AHB1RSTR", "GPIODRST"],
    ["GPIOE", "AHB1ENR", "GPIOEEN", "AHB1RSTR", "GPIOERST"],
    ["GPIOF", "AHB1ENR", "GPIOFEN", "AHB1RSTR", "GPIOFRST"],
    ["GPIOG", "AHB1ENR", "GPIOGEN", "AHB1RSTR", "GPIOGRST"],
    ["GPIOH", "AHB1ENR", "GPIOHEN", "AHB1RSTR", "GPIOHRST"],
    ["GPIOI", "AHB1ENR", "GPIOIEN", "AHB1RSTR", "GPIOIRST"],
];
/// Instances that keep time, and those that hear other instances' requests.
const TIMED: [&str; 8] = ["TIM2", "TIM3", "TIM4", "TIM5", "USART1", "IWDG", "C_ADC", "ADC1"];
const LISTENING: [&str; 5] = ["RCC", "C_ADC", "ADC1", "EXTI", "DMA2"];
/// The line's requests to the transfer controller (table 43); no other instance's reach it here.
pub static TRANSFERS: [Wire; 2] = [
    Wire { instance: "USART1", request: usart::RECEIVE_REQUEST, channel: 4, streams: &[2, 5] },
    Wire { instance: "USART1", request: usart::TRANSMIT_REQUEST, channel: 4, streams: &[7] },
];

fn cpu() -> Cpu {
    Cpu::new("CM4", true, INTERRUPT_LINES, Endian::Little)
}

fn instances() -> impl Iterator<Item = Peripheral> {
    generated::PERIPHERALS
        .iter()
        .copied()
        .filter(|peripheral| !ABSENT.contains(&peripheral.name))
        .map(|mut peripheral| {
            if let Some((_, lines)) = INTERRUPTS.iter().find(|(name, _)| *name == peripheral.name) {
                peripheral.interrupts = lines;
            }
            if PORTS.contains(&peripheral.name) {
                peripheral.registers = &gpioa::REGISTERS;
            }
            match peripheral.name {
                "TIM2" | "TIM5" => peripheral.registers = Counter::Wide.layout(),
                "TIM3" | "TIM4" => peripheral.registers = Counter::Narrow.layout(),
                _ => {}
            }
            peripheral
        })
        .chain(std::iter::once(armv7m::PERIPHERAL))
}

/// The bus, with what differs from the sibling's.
///
/// # Errors
/// When its description contradicts itself.
pub fn bus() -> Result<Bus, Error> {
    // Which output of the clock tree an instance runs on is the same in both families; the crate knows the outputs' numbers.
    let sibling = soc::stm32f427::builder().build()?;
    let mut builder = Bus::builder(cpu(), &MEMORY, instances());
    for (instance, register, value) in RESETS {
        builder = builder.reset(instance, register, value);
    }
    for (port, values) in PORTS.iter().zip(PORT_RESETS.into_iter().chain(std::iter::repeat([0; 3]))) {
        for (register, value) in ["MODER", "OSPEEDR", "PUPDR"].into_iter().zip(values) {
            builder = builder.reset(port, register, value);
        }
    }
    // Flags that a written zero clears (18.4.5, 19.5.3), and those that a written one clears (3.9.4).
    for timer in ["TIM2", "TIM3", "TIM4", "TIM5"] {
        builder = builder.write_modify(timer, "SR", WriteModify::ZeroToClear);
    }
    builder = builder.write_modify("FLASH", "SR", WriteModify::OneToClear);
    for [instance, enable_register, enable, reset_register, reset] in CLOCKED {
        builder = builder.gate(instance, Gate::by("RCC", enable_register, enable));
        builder = builder.reset_by(instance, Gate::by("RCC", reset_register, reset));
    }
    for instance in TIMED.into_iter().chain([armv7m::DWT]) {
        if let Some(clock) = sibling.clock_of(instance) {
            builder = builder.clocked_by(instance, clock);
        }
    }
    for instance in LISTENING {
        builder = builder.reads_requests(instance);
    }
    builder.build()
}
