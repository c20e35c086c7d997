//! The STM32F405: the crate's models of its sibling, the STM32F427, on a bus of its own, and what those models lack for the rig's image.
//!
//! | peripheral | model | RM0090 |
//! |---|---|---|
//! | RCC | the crate's, with [`oscillators`] beside it | chapter 7 |
//! | PWR | the crate's, with the supply monitor's line beside it ([`lines`]) | section 5.4 |
//! | EXTI line 16 | [`lines`] | chapter 12 |
//! | FLASH | [`flash`] | sections 3.6, 3.9 |
//! | GPIO A to I, USART1, IWDG, DBGMCU | the crate's | chapters 8, 30, 21, 38 |
//! | ADC1, its common block, TIM2 | the crate's, with the trigger between them beside them ([`sampling`]) | chapters 13, 18 |
//! | TIM3, TIM4, TIM5 | the crate's | chapter 18 |
//! | DAC | [`dac`] | chapter 14 |
//! | TIM11 | [`capture`] | section 19.5 |
//! | DWT.CYCCNT | the crate's: virtual time at the core's clock, so it counts the emulator's instructions and not the chip's cycles | Armv7-M C1.8 |
//!
//! Every other peripheral has its registers and no model; a run lists those that the image touches.

pub mod beside;
pub mod bus;
pub mod capture;
pub mod dac;
pub mod flash;
pub mod held;
pub mod lines;
pub mod oscillators;
pub mod part;
pub mod pins;
pub mod sampling;
