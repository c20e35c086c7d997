//! The firmware library as ARM code in QEMU (`-M netduinoplus2`): parity with the desktop, and instruction counts.
//!
//! What to do comes as a *work file* that QEMU's loader puts into flash at `machine::WORK_ADDRESS`; results go as lines of text to the
//! standard output. Without a work file the image says that it is ready and ends.
//!
//! ```text
//! offset  bytes  what, little-endian
//!      0      4  magic, "WORK"
//!      4      4  task: 1 sweep, 2 golden, 3 cost, 4 tick
//!      8      4  number of steps
//!     12      4  seed
//!     16      4  number of blobs
//!     20      .  for each blob its length, 4 bytes, and the blob, padded to a multiple of 4
//! ```
//!
//! Each task prints one line an item and then `done`; a line that begins with `error` means that the target contradicts itself.
#![cfg_attr(target_os = "none", no_std, no_main)]

#[cfg(target_os = "none")]
mod machine;
#[cfg(target_os = "none")]
mod tasks;
#[cfg(target_os = "none")]
mod tick;

#[cfg(target_os = "none")]
mod target {
    use core::panic::PanicInfo;

    use cortex_m_rt::entry;
    use cortex_m_semihosting::{debug, hprintln};
    use firmware::estimator::MAX_PACKED_WORDS;
    use firmware::parity::RandomNetwork;

    use crate::machine;
    use crate::tasks;

    #[entry]
    fn main() -> ! {
        // The attribute makes these exclusive references; as values they would pass through the stack, which is too small for them.
        static mut PACKED: [u32; MAX_PACKED_WORDS] = [0; MAX_PACKED_WORDS];
        static mut RANDOM: RandomNetwork = RandomNetwork::new();
        match machine::work().and_then(tasks::Work::read) {
            None => hprintln!("ready"),
            Some(work) => work.run(PACKED, RANDOM),
        }
        debug::exit(debug::EXIT_SUCCESS);
        loop {
            cortex_m::asm::nop();
        }
    }

    #[panic_handler]
    fn panic(information: &PanicInfo<'_>) -> ! {
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
