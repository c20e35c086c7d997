//! The flashable image of a board: build it small, fill in its CRC, flash it.
//!
//! The compiler leaves a place for the checksum of the program, which only the finished image can have. `xtask` fills it in: `SEAL`, then the
//! CRC-32 over vector table, code, constants and initial data, in this order, as `board::target::memory` computes it again on the device.
//!
//! Equal sources give equal images, wherever they are built: the compiler is pinned, and no path of the machine gets into the file.
//! `cargo xtask reproducible` shows it.

use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result, bail};
use object::LittleEndian;
use object::elf::FileHeader32;
use object::read::elf::{FileHeader, SectionHeader};

use crate::process::{answer, cargo, command, exists, root, run, target_folder};
use crate::setup::{self, TARGET};

/// The compiler of the image.
const COMPILER: &str = "1.95.0";

/// A board that there is an image for. Its name is also the feature that chooses it.
#[derive(Debug)]
pub struct Board {
    /// Its name.
    pub name: &'static str,
    /// Its chip as the probe's software names it.
    chip: &'static str,
}

/// All of them; the first is built unless another is asked for.
pub const BOARDS: [Board; 3] = [
    Board { name: "custom-f405", chip: "STM32F405RGTx" },
    Board { name: "feather-f405", chip: "STM32F405RGTx" },
    Board { name: "nucleo-h743zi", chip: "STM32H743ZITx" },
];

impl Board {
    /// The board of this name.
    pub fn named(name: &str) -> Result<&'static Self, String> {
        let names = || BOARDS.iter().map(|board| board.name).collect::<Vec<_>>().join(", ");
        BOARDS.iter().find(|board| board.name == name).ok_or_else(|| format!("there are the boards {}", names()))
    }

    /// Where its image is left.
    pub fn image(&self) -> PathBuf {
        let folder = target_folder().join(TARGET).join("release");
        if self.name == BOARDS[0].name { folder.join("rig") } else { folder.join(format!("rig-{}", self.name)) }
    }
}
/// Sections the checksum covers, in its order.
const SEALED_SECTIONS: [&str; 4] = [".vector_table", ".text", ".rodata", ".data"];
const OPEN: &[u8; 4] = b"OPEN";
const MAGIC: &[u8; 4] = b"SEAL";

/// What the image is and takes.
pub struct Sealed {
    /// SHA-256 of the file.
    pub sha256: String,
    /// Code, constants and initial data, bytes.
    pub flash: u64,
    /// Statics and stack, bytes.
    pub ram: u64,
    /// The stack alone, bytes.
    pub stack: u64,
}

/// Where the first board's image is left.
pub fn image() -> PathBuf {
    BOARDS[0].image()
}

/// The compiler of the image, installed if it is not there; without rustup the one that there is, with a warning.
fn compiler() -> Result<Command> {
    if answer(command("rustc").arg("--version")).is_some_and(|version| version.starts_with(&format!("rustc {COMPILER} "))) {
        return Ok(cargo());
    }
    if !exists("rustup") {
        eprintln!(
            "warning: this is not Rust {COMPILER} and there is no rustup to install it, so the image is none that others can reproduce"
        );
        return Ok(cargo());
    }
    if answer(command("rustup").args(["run", COMPILER, "rustc", "--print", "target-libdir", "--target", TARGET]))
        .is_none_or(|folder| !Path::new(folder.trim()).is_dir())
    {
        setup::toolchain(COMPILER, &["--target", TARGET])?;
    }
    Ok(setup::cargo_of(COMPILER))
}

/// What keeps the machine's paths out of the file: the project's folder, the build folder and cargo's become names.
fn remapped_paths() -> Result<String> {
    let absolute = |path: PathBuf| std::path::absolute(&path).with_context(|| format!("no absolute path to {}", path.display()));
    let home = match (std::env::var_os("CARGO_HOME"), std::env::home_dir()) {
        (Some(folder), _) => PathBuf::from(folder),
        (None, Some(home)) => home.join(".cargo"),
        (None, None) => bail!("neither CARGO_HOME nor a home folder is known"),
    };
    // The last one that fits counts, so the build folder may lie in the project's.
    let pairs = [(absolute(home)?, "/cargo"), (absolute(root())?, "/rig"), (absolute(target_folder())?, "/target")];
    // What cargo joins with this character may hold spaces.
    Ok(pairs.map(|(path, name)| format!("--remap-path-prefix={}={name}", path.display())).join("\u{1f}"))
}

/// Builds a program as an image of a board is built.
fn compile(board: &Board, program: &str, link_arguments: &[&str]) -> Result<PathBuf> {
    let mut build = compiler()?;
    build
        .args(["rustc", "--locked", "--profile", "flash", "--target", TARGET, "-p", "firmware"])
        .args(["--no-default-features", "--features", board.name, "--bin", program, "--"])
        // Functions that came out alike are one.
        .args(["-C", "link-arg=--icf=all"])
        .args(link_arguments)
        // Start, states and faults: what the bring-up reads. Without a level only errors are compiled in.
        .env("DEFMT_LOG", "info")
        .env("CARGO_ENCODED_RUSTFLAGS", remapped_paths()?)
        .env(COMMIT, commit());
    run("firmware", &mut build)?;
    Ok(target_folder().join(TARGET).join("flash").join(program))
}

/// Builds the program that counts instructions in the emulator, optimised as the image is.
pub fn emulated_as_flashed() -> Result<PathBuf> {
    compile(&BOARDS[0], "emulated", &[])
}

/// Builds and seals the image of a board.
pub fn build(board: &Board) -> Result<Sealed> {
    // The budgets of `memory.x` hold for this build.
    let built = compile(board, "rig", &["-C", "link-arg=--defsym=_budgeted=1"])?;
    let mut bytes = std::fs::read(&built).with_context(|| format!("cannot read {}", built.display()))?;
    let checksum = fill_in_crc(&mut bytes).with_context(|| format!("{} cannot be given its CRC", built.display()))?;
    let sealed = describe(&bytes)?;
    let image = board.image();
    std::fs::create_dir_all(image.parent().unwrap_or(Path::new(".")))?;
    // Tests may be reading the one that is there: it stays if it is the same, and otherwise another takes its place at once. What was there may
    // be a hard link into cargo's own folder.
    if std::fs::read(&image).ok().as_ref() != Some(&bytes) {
        let fresh = image.with_extension("new");
        std::fs::write(&fresh, &bytes).with_context(|| format!("cannot write {}", fresh.display()))?;
        std::fs::rename(&fresh, &image).with_context(|| format!("cannot write {}", image.display()))?;
    }
    eprintln!(
        "{}: sealed with {checksum:08x}; {} bytes of flash, {} of RAM, of which {} are stack\nSHA-256 {}",
        image.display(),
        sealed.flash,
        sealed.ram,
        sealed.stack,
        sealed.sha256
    );
    Ok(sealed)
}

/// What the image is made of.
const SOURCES: [&str; 6] = ["Cargo.toml", "Cargo.lock", "memory.x", "hysteresis", "model-export", "firmware"];

/// The variable that tells the image its commit; an archive of the sources, which git knows nothing of, is told by it as well.
const COMMIT: &str = "FIRMWARE_COMMIT";

/// The last commit that changed the image's sources, which `Hello` tells; empty where the tree holds something else. Later commits of other
/// files build the same image.
fn commit() -> String {
    let git = |arguments: &[&str]| {
        let output = command("git").args(arguments).arg("--").args(SOURCES).current_dir(root()).output().ok()?;
        output.status.success().then(|| String::from_utf8_lossy(&output.stdout).trim().to_owned())
    };
    match (git(&["status", "--porcelain", "--untracked-files=no"]), git(&["log", "-1", "--format=%H"])) {
        (Some(changes), Some(commit)) if changes.is_empty() => commit,
        (None, None) => std::env::var(COMMIT).unwrap_or_default(),
        _ => String::new(),
    }
}

/// Builds, seals and flashes, then shows the logs until it is stopped.
pub fn flash(board: &Board) -> Result<()> {
    let sealed = build(board)?;
    if !exists("probe-rs") {
        bail!("`probe-rs` is missing; see https://probe.rs/docs/getting-started/installation, then run this again");
    }
    // What the probe's software reads is what was sealed, whoever else writes into the build folder.
    let image = board.image();
    let bytes = std::fs::read(&image).with_context(|| format!("cannot read {}", image.display()))?;
    check(&bytes, &sealed.sha256).with_context(|| format!("{} is not flashed", image.display()))?;
    // With what was written read back and compared.
    run("flash", command("probe-rs").args(["run", "--verify", "--chip", board.chip]).arg(image))
}

/// Whether this file is the finished one: its hash, and the CRC over the sections that it would write.
fn check(bytes: &[u8], sha256: &str) -> Result<()> {
    let found = hash(bytes);
    if found != sha256 {
        bail!("its SHA-256 is {found} and {sha256} was sealed");
    }
    let (offset, length) = section(bytes, ".seal")?;
    let checksum = checksum(bytes)?;
    if bytes[offset..offset + length] != [&MAGIC[..], &checksum.to_le_bytes()].concat() {
        bail!("its CRC does not match its contents");
    }
    Ok(())
}

/// Builds the image once more, from a copy of the sources in another folder, and compares the files. Whatever differs of a copy is refused.
pub fn reproducible(board: &Board) -> Result<()> {
    let here = build(board)?;
    let elsewhere = std::env::temp_dir().join(format!("catheter-reproducible-{}", std::process::id()));
    let result = rebuild(board, &elsewhere).and_then(|bytes| {
        if hash(&bytes) != here.sha256 {
            bail!("{} gives SHA-256 {} and {} gives {}", elsewhere.display(), hash(&bytes), root().display(), here.sha256);
        }
        // The check that `flash` rests on can fail: a flipped bit in any section that is written.
        for name in SEALED_SECTIONS {
            let (offset, length) = section(&bytes, name)?;
            let mut damaged = bytes.clone();
            damaged[offset + length / 2] ^= 1;
            let by_crc = check(&damaged, &hash(&damaged));
            if check(&damaged, &here.sha256).is_ok() || by_crc.is_ok() {
                bail!("a damaged {name} passes for the sealed image");
            }
        }
        check(&bytes, &here.sha256)
    });
    let _ = std::fs::remove_dir_all(&elsewhere);
    result?;
    eprintln!("{}: two folders, one image, SHA-256 {}", board.name, here.sha256);
    Ok(())
}

/// Copies what git knows into `folder`, builds there as here, and gives the sealed file's bytes.
fn rebuild(board: &Board, folder: &Path) -> Result<Vec<u8>> {
    let files = answer(command("git").args(["ls-files", "--cached", "--others", "--exclude-standard", "-z"]))
        .context("git does not list the sources")?;
    for file in files.split('\0').filter(|file| !file.is_empty()) {
        let (from, to) = (root().join(file), folder.join(file));
        // A link, or a file that is deleted but not yet committed, is no source.
        if from.is_file() {
            std::fs::create_dir_all(to.parent().unwrap_or(folder))?;
            std::fs::copy(&from, &to).with_context(|| format!("cannot copy {file}"))?;
        }
    }
    // The same program on the other tree: `root` and the build folder come from these variables, as when cargo starts it there.
    let mut again = command(std::env::current_exe().context("where this program lies")?);
    again.current_dir(folder).env("CARGO_MANIFEST_DIR", folder.join("xtask")).env("CARGO_TARGET_DIR", folder.join("target"));
    run("reproducible: the same sources elsewhere", again.env(COMMIT, commit()).args(["firmware", "--board", board.name]))?;
    let image = folder.join("target").join(TARGET).join("release").join(board.image().file_name().unwrap_or_default());
    std::fs::read(&image).with_context(|| format!("cannot read {}", image.display()))
}

fn hash(bytes: &[u8]) -> String {
    use sha2::{Digest, Sha256};
    Sha256::digest(bytes).iter().map(|byte| format!("{byte:02x}")).collect()
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

/// CRC-32 over the sealed sections.
fn checksum(bytes: &[u8]) -> Result<u32> {
    let mut hasher = crc32fast::Hasher::new();
    for name in SEALED_SECTIONS {
        let (offset, length) = section(bytes, name)?;
        hasher.update(&bytes[offset..offset + length]);
    }
    Ok(hasher.finalize())
}

fn fill_in_crc(bytes: &mut [u8]) -> Result<u32> {
    let checksum = checksum(bytes)?;
    let (offset, length) = section(bytes, ".seal")?;
    let place = &mut bytes[offset..offset + length];
    if length != 8 || &place[..4] != OPEN {
        bail!("its section .seal has no open place for the CRC");
    }
    place[..4].copy_from_slice(MAGIC);
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
fn describe(bytes: &[u8]) -> Result<Sealed> {
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
    Ok(Sealed { sha256: hash(bytes), flash: value("_flash_bytes")?, ram: value("_ram_bytes")?, stack: value("_stack_bytes")? })
}
