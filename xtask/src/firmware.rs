//! The flashable image: build it small, seal it, flash it.
//!
//! The compiler leaves a place for the checksum of the program, which only the finished image can have. Sealing fills it in: `SEAL`, then the
//! CRC-32 over vector table, code, constants and initial data, in this order, as `board::chip::memory` computes it again on the device.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use object::LittleEndian;
use object::elf::FileHeader32;
use object::read::elf::{FileHeader, SectionHeader};

use crate::process::{cargo, command, exists, run, target_folder};
use crate::setup::TARGET;

/// Chip as the probe's software names it.
const CHIP: &str = "STM32F405RGTx";
/// Sections the checksum covers, in its order.
const SEALED_SECTIONS: [&str; 4] = [".vector_table", ".text", ".rodata", ".data"];
const OPEN: &[u8; 4] = b"OPEN";
const SEAL: &[u8; 4] = b"SEAL";

/// What the image takes, in bytes.
pub struct Sizes {
    /// Code, constants and initial data.
    pub flash: u64,
    /// Statics and stack.
    pub ram: u64,
    /// The stack alone.
    pub stack: u64,
}

/// Where the image is left.
pub fn image() -> PathBuf {
    target_folder().join(TARGET).join("release/rig")
}

/// Builds and seals the image.
pub fn build() -> Result<Sizes> {
    // Code that occurs more than once becomes a function: a fifth of the program. The budgets of `memory.x` hold for this build.
    run(
        "firmware",
        cargo()
            .args(["rustc", "--profile", "flash", "--target", TARGET, "-p", "firmware", "--bin", "rig", "--"])
            .args([
                "-C",
                "llvm-args=-enable-machine-outliner=always",
                // Functions that came out alike are one.
                "-C",
                "link-arg=--icf=all",
                "-C",
                "link-arg=--defsym=_budgeted=1",
            ])
            // Start, states and faults: what the bring-up reads. Without a level only errors are compiled in.
            .env("DEFMT_LOG", "info"),
    )?;
    let built = target_folder().join(TARGET).join("flash/rig");
    let mut bytes = std::fs::read(&built).with_context(|| format!("cannot read {}", built.display()))?;
    let checksum = seal(&mut bytes).with_context(|| format!("{} cannot be sealed", built.display()))?;
    let sizes = sizes(&bytes)?;
    let image = image();
    std::fs::create_dir_all(image.parent().unwrap_or(Path::new(".")))?;
    // A fresh file: the old one may be a hard link into cargo's own folder.
    if image.exists() {
        std::fs::remove_file(&image)?;
    }
    std::fs::write(&image, &bytes).with_context(|| format!("cannot write {}", image.display()))?;
    eprintln!(
        "{}: sealed with {checksum:08x}; {} bytes of flash, {} of RAM, of which {} are stack",
        image.display(),
        sizes.flash,
        sizes.ram,
        sizes.stack
    );
    Ok(sizes)
}

/// Builds, seals and flashes, then shows the logs until it is stopped.
pub fn flash() -> Result<()> {
    build()?;
    if !exists("probe-rs") {
        bail!("`probe-rs` is missing; see https://probe.rs/docs/getting-started/installation, then run this again");
    }
    run("flash", command("probe-rs").args(["run", "--chip", CHIP]).arg(image()))
}

/// Links the image that only links when no panic is reachable from the tick, and sees that it does not link with one planted.
pub fn panic_free() -> Result<()> {
    let link = |extra: &[&str]| {
        let mut proof = cargo();
        proof.args(["rustc", "--profile", "proof", "--target", TARGET, "-p", "firmware"]);
        proof.args(["--features", "panic-free-proof", "--bin", "panic_free", "--"]).args(extra);
        proof
    };
    run("panic-free", &mut link(&[]))?;
    let planted = ["--cfg", "planted_panic"];
    eprintln!("\n==> panic-free: with a planted panic, which must not link");
    let output = link(&planted).output().context("cannot start cargo")?;
    let said = String::from_utf8_lossy(&output.stderr);
    if output.status.success() || !said.contains("a_panic_is_reachable_from_the_tick") {
        bail!("the proof proves nothing: with a planted panic it ended with {} and said\n{said}", output.status);
    }
    Ok(())
}

fn seal(bytes: &mut [u8]) -> Result<u32> {
    let mut hasher = crc32fast::Hasher::new();
    for name in SEALED_SECTIONS {
        let (offset, length) = section(bytes, name)?;
        hasher.update(&bytes[offset..offset + length]);
    }
    let checksum = hasher.finalize();
    let (offset, length) = section(bytes, ".seal")?;
    let place = &mut bytes[offset..offset + length];
    if length != 8 || &place[..4] != OPEN {
        bail!("its section .seal is not an open seal");
    }
    place[..4].copy_from_slice(SEAL);
    place[4..].copy_from_slice(&checksum.to_le_bytes());
    Ok(checksum)
}

fn header(bytes: &[u8]) -> Result<&FileHeader32<LittleEndian>> {
    FileHeader32::parse(bytes).context("not an ELF file of the microcontroller")
}

/// Place and length of a section in the file.
fn section(bytes: &[u8], name: &str) -> Result<(usize, usize)> {
    let header = header(bytes)?;
    let sections = header.sections(LittleEndian, bytes)?;
    let (_, section) = sections.section_by_name(LittleEndian, name.as_bytes()).with_context(|| format!("it has no section {name}"))?;
    let (offset, length) = section.file_range(LittleEndian).with_context(|| format!("its section {name} is empty"))?;
    Ok((usize::try_from(offset)?, usize::try_from(length)?))
}

/// The sums that `memory.x` makes, by its own symbols.
fn sizes(bytes: &[u8]) -> Result<Sizes> {
    let header = header(bytes)?;
    let sections = header.sections(LittleEndian, bytes)?;
    let symbols = sections.symbols(LittleEndian, bytes, object::elf::SHT_SYMTAB)?;
    let value = |name: &str| {
        use object::read::elf::Sym;
        symbols
            .iter()
            .find(|symbol| symbol.name(LittleEndian, symbols.strings()).is_ok_and(|found| found == name.as_bytes()))
            .map(|symbol| u64::from(symbol.st_value(LittleEndian)))
            .with_context(|| format!("it has no symbol {name}"))
    };
    Ok(Sizes { flash: value("_flash_bytes")?, ram: value("_ram_bytes")?, stack: value("_stack_bytes")? })
}
