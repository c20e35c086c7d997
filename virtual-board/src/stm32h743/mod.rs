//! The STM32H743: the crate's models on the crate's bus, and what those models lack for the rig's image.
//!
//! | peripheral | model | RM0433 |
//! |---|---|---|
//! | RCC, PWR, FLASH, EXTI, SYSCFG, DBGMCU, GPIO A to K, USART3 | the crate's | chapters 8, 6, 4, 20, 12, 60, 11, 48 |
//! | ADC1 to ADC3 and their common blocks, TIM2 | the crate's, with the trigger between TIM2 and ADC1 beside them ([`sampling`]) | chapters 25, 39 |
//! | TIM3, TIM5 | the crate's | chapter 39 |
//! | DAC | [`dac`] | chapter 26 |
//! | TIM17 | [`crate::chip::capture`] | section 41.6 |
//! | IWDG | [`watchdog`] | chapter 45 |
//!
//! Flash changes while the processor runs on, since models and settings lie in the other bank. Not wired: the supply monitor's line to EXTI, the
//! clock security system's NMI, and faults but those of the emergency stop, the reset pin, memory and the core.

pub mod dac;
pub mod part;
pub mod sampling;
pub mod watchdog;
