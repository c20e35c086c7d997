//! The firmware as ARM code in QEMU: netduinoplus2 is the machine with the rig's chip.

use std::process::Command;
use std::time::Duration;

use anyhow::Result;

use crate::process::{answer_within, cargo, command, run, target_folder};
use crate::setup::{EMULATOR, TARGET};

/// The image boots in the emulator and ends well.
pub fn boots() -> Result<()> {
    eprintln!("\n==> emulator: the firmware boots as ARM code");
    let image = target_folder().join(TARGET).join("release/emulated");
    let text = answer_within(
        Duration::from_secs(60),
        command(EMULATOR)
            .args(["-M", "netduinoplus2", "-nographic", "-monitor", "none", "-serial", "none"])
            .args(["-semihosting-config", "enable=on,target=native", "-kernel"])
            .arg(image),
    )?;
    eprint!("{text}");
    Ok(())
}

/// The tests of parity and counts; plain `cargo test` leaves them out, as it does those below. Of the whole workspace, here and in the other
/// stages: with `-p` the features of dependencies are others, and cargo would build a second time what the tests before have built.
pub fn tests() -> Result<()> {
    run("emulator", cargo().args(["test", "--workspace", "--test", "emulator", "--", "--ignored"]))
}

/// The flashable image boots in the emulator, finds no HSE and says so.
pub fn flashable_image() -> Result<()> {
    run(
        "emulator: the flashable image",
        cargo()
            .args(["test", "--workspace", "--test", "flashable_image", "--", "--ignored", "--nocapture"])
            .env("FLASHABLE_IMAGE", crate::firmware::image()),
    )
}

/// Names the image with the whole device for whoever starts it.
pub fn environment(command: &mut Command) -> Result<&mut Command> {
    Ok(command.env("CATHETER_PIL_IMAGE", std::path::absolute(target_folder().join(TARGET).join("release/pil"))?))
}

/// The whole device as ARM code against the same device on the desktop, and what becomes of it when something breaks.
pub fn processor_in_the_loop() -> Result<()> {
    let mut tests = cargo();
    run("processor in the loop", environment(&mut tests)?.args(["test", "--workspace", "--test", "processor_in_the_loop"]))
}
