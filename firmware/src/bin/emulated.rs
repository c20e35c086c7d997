//! The firmware library as ARM code in QEMU (`-M netduinoplus2`): instruction counts and parity with the desktop.
#![cfg_attr(target_os = "none", no_std, no_main)]

#[cfg(target_os = "none")]
mod target {
    use core::panic::PanicInfo;

    use cortex_m_rt::entry;
    use cortex_m_semihosting::{debug, hprintln};

    #[entry]
    fn main() -> ! {
        hprintln!("ready");
        debug::exit(debug::EXIT_SUCCESS);
        loop {
            cortex_m::asm::nop();
        }
    }

    #[panic_handler]
    fn panic(information: &PanicInfo) -> ! {
        hprintln!("panic: {}", information);
        debug::exit(debug::EXIT_FAILURE);
        loop {
            cortex_m::asm::nop();
        }
    }
}

#[cfg(not(target_os = "none"))]
fn main() {
    eprintln!("this program runs on the microcontroller; build it with --target thumbv7em-none-eabihf");
}
