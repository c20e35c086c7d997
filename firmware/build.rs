//! Which board this build is for, and link arguments of the target binaries.

/// The boards, each a feature of the package with its chip's folder. The last one that is on is meant, so that every combination builds:
/// `--all-features` is one of them.
const BOARDS: [(&str, &str); 3] = [("custom-f405", "stm32f405"), ("feather-f405", "stm32f405"), ("nucleo-h743zi", "stm32h743")];

fn main() {
    println!("cargo:rerun-if-changed=build.rs");
    println!("cargo:rerun-if-changed=../memory.x");
    println!("cargo:rustc-check-cfg=cfg(planted_panic)");
    let is_on = |name: &str| std::env::var_os(format!("CARGO_FEATURE_{}", name.to_uppercase().replace('-', "_"))).is_some();
    let (board, chip) = BOARDS.into_iter().rev().find(|(name, _)| is_on(name)).unwrap_or(BOARDS[0]);
    println!("cargo:rustc-cfg=board=\"{board}\"");
    println!("cargo:rustc-cfg=chip=\"{chip}\"");
    let list = |names: [&str; BOARDS.len()]| names.map(|name| format!("\"{name}\"")).join(", ");
    println!("cargo:rustc-check-cfg=cfg(board, values({}))", list(BOARDS.map(|(board, _)| board)));
    println!("cargo:rustc-check-cfg=cfg(chip, values({}))", list(BOARDS.map(|(_, chip)| chip)));
    let own_memory = format!("src/board/{}/memory.x", board.replace('-', "_"));
    // The folder, because most boards have no such file, and cargo would take a missing one as changed and build all over again each time.
    println!("cargo:rerun-if-changed=src/board/{}", board.replace('-', "_"));
    // The macro of embedded-test asks for it.
    println!("cargo:rustc-check-cfg=cfg(rust_analyzer)");
    if std::env::var("CARGO_CFG_TARGET_OS").as_deref() == Ok("none") {
        let root = std::path::Path::new(&std::env::var("CARGO_MANIFEST_DIR").unwrap_or_default()).join("..");
        println!("cargo:rustc-link-search={}", root.display());
        println!("cargo:rustc-link-arg-bins=--nmagic");
        println!("cargo:rustc-link-arg-bins=-T{}", link_script(&own_memory));
        println!("cargo:rustc-link-arg-tests=--nmagic");
        for script in ["link.x", "defmt.x", "embedded-test.x"] {
            println!("cargo:rustc-link-arg-tests=-T{script}");
        }
        // The flashable image: its logs, and the budgets of `memory.x`.
        println!("cargo:rustc-link-arg-bin=rig=-Tdefmt.x");
        println!("cargo:rustc-link-arg-bin=rig=--defsym=_flashable=1");
    }
}

/// The link script: cortex-m-rt's `link.x`, which takes the `memory.x` at the top of the project. The linker looks in the folder it runs in before any
/// other, so a board with a memory map of its own gets a copy that names its file.
fn link_script(own_memory: &str) -> String {
    let folder = std::env::var("CARGO_MANIFEST_DIR").expect("cargo sets it");
    let memory = std::path::Path::new(&folder).join(own_memory);
    if !memory.exists() {
        return "link.x".to_owned();
    }
    // cortex-m-rt's build script has run before this one, as `links` in its manifest makes sure, and left its script beside ours.
    let out = std::path::PathBuf::from(std::env::var_os("OUT_DIR").expect("cargo sets it"));
    let builds = out.ancestors().nth(2).expect("the folder of all build scripts");
    let scripts = std::fs::read_dir(builds).expect("it can be read").filter_map(|entry| {
        let entry = entry.ok()?;
        let script = entry.path().join("out/link.x");
        let is_its = entry.file_name().to_string_lossy().starts_with("cortex-m-rt-");
        Some((script.metadata().ok()?.modified().ok()?, script)).filter(|_| is_its)
    });
    let (_, script) = scripts.max().expect("cortex-m-rt leaves link.x");
    let text = std::fs::read_to_string(&script).expect("it can be read");
    let include = "INCLUDE memory.x";
    assert_eq!(text.matches(include).count(), 1, "{}", script.display());
    let own = out.join("link-board.x");
    std::fs::write(&own, text.replace(include, &std::fs::read_to_string(&memory).expect("it can be read"))).expect("it can be written");
    own.display().to_string()
}
