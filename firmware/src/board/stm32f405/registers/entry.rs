//! What runs before and beneath Rust: the first instructions after a reset, and the entry of the hard fault.

/// Instantiates the two entry points in a binary.
///
/// `__pre_init` runs before RAM is initialised, so it is assembly: it makes the dump valve's pin an output at zero. A reset has made it an
/// input already, and the pull-down outside holds the valve released; this ends any doubt.
///
/// `HardFault` may have been entered because the stack is full. It takes the stack from the top, since nothing returns from here, and
/// goes on in `hard_fault_on_fresh_stack`, which the binary brings.
#[macro_export]
macro_rules! board_entry {
    () => {
        core::arch::global_asm!(
            ".section .text.__pre_init, \"ax\", %progbits",
            ".global __pre_init",
            ".type __pre_init, %function",
            ".thumb_func",
            "__pre_init:",
            "ldr r0, ={clock_register}",
            "ldr r1, [r0]",
            "orr r1, r1, #{clock_bit}",
            "str r1, [r0]",
            // The clock needs two cycles to arrive (errata ES0182, delay after an RCC peripheral clock enabling): read it back.
            "ldr r1, [r0]",
            "ldr r0, ={port}",
            "ldr r1, ={reset_bit}",
            "str r1, [r0, #0x18]", // BSRR before MODER: no pulse
            "ldr r1, [r0]",
            "bic r1, r1, #{mode_mask}",
            "orr r1, r1, #{mode_output}",
            "str r1, [r0]",
            "bx lr",
            ".ltorg",
            ".section .text.HardFault, \"ax\", %progbits",
            ".global HardFault",
            ".type HardFault, %function",
            ".thumb_func",
            "HardFault:",
            "ldr r0, =_stack_start",
            "msr msp, r0",
            "b hard_fault_on_fresh_stack",
            ".ltorg",
            clock_register = const $crate::board::stm32f405::facts::RCC_AHB1ENR,
            clock_bit = const $crate::board::stm32f405::facts::PORT_B_CLOCK,
            port = const $crate::board::stm32f405::facts::PORT_B,
            reset_bit = const 1u32 << (16 + $crate::board::stm32f405::facts::DUMP_VALVE_PIN),
            mode_mask = const 3u32 << (2 * $crate::board::stm32f405::facts::DUMP_VALVE_PIN),
            mode_output = const 1u32 << (2 * $crate::board::stm32f405::facts::DUMP_VALVE_PIN),
        );
    };
}
