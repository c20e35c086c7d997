//! The proof that no panic is reachable from the tick: this image links only then.
//!
//! It is never run. It holds the code of every interrupt of the flashable image, on objects that the compiler knows nothing about, since they
//! lie wherever a register says. Its panic handler calls a function that exists nowhere: if the optimiser cannot show that it is never reached,
//! the linker reports `a_panic_is_reachable_from_the_tick`. What it shows holds for the source, so for the smaller flashable image as well.
//!
//! `cargo xtask panic-free` links it, and then once more with `--cfg planted_panic`, which must fail.
#![cfg_attr(target_os = "none", no_std, no_main)]

#[cfg(target_os = "none")]
mod image {
    use core::panic::PanicInfo;

    use firmware::board::chip::registers::ThisBoard;
    use firmware::board::chip::registers::pac::WWDG;
    use firmware::board::contract::{Board, LineInterrupt, SupplyMonitor, TickIoOf};
    use firmware::board::target::models::LoadedModel;
    use firmware::board::tick_task::TickTask;
    use model_export::link::fault::Fault;

    #[panic_handler]
    fn panic(_information: &PanicInfo<'_>) -> ! {
        unsafe extern "C" {
            fn a_panic_is_reachable_from_the_tick() -> !;
        }
        // SAFETY: it does not exist, so nothing links that calls it.
        unsafe { a_panic_is_reachable_from_the_tick() }
    }

    /// Something that lies where a register says.
    fn anything<T>() -> &'static mut T {
        // SAFETY: never executed. For the compiler this is an object it can know nothing about.
        unsafe { &mut *core::ptr::with_exposed_provenance_mut::<T>((*WWDG::ptr()).cfr().read().bits() as usize) }
    }

    #[cortex_m_rt::entry]
    fn main() -> ! {
        let (task, model, port) = (
            anything::<TickTask<'static, TickIoOf<ThisBoard>>>(),
            anything::<LoadedModel>(),
            anything::<<ThisBoard as Board>::LineInterrupt>(),
        );
        loop {
            task.run(model);
            port.interrupt();
            #[cfg(planted_panic)]
            {
                let table = anything::<[u32; 8]>();
                table[0] = table[table[0] as usize];
            }
            if *anything::<bool>() {
                anything::<<ThisBoard as Board>::Supply>().fell();
            }
            if *anything::<bool>() {
                ThisBoard::crash(Fault::HardFault);
            }
        }
    }
}

#[cfg(not(target_os = "none"))]
fn main() {
    eprintln!("this image is linked, not run: `cargo xtask panic-free`");
}
