//! Which board this build is for, and link arguments of the target binaries.

/// The boards, each a feature of the package with its chip's folder. The last one that is on is meant, so that every combination builds:
/// `--all-features` is one of them.
const BOARDS: [(&str, &str); 2] = [("custom-f405", "stm32f405"), ("feather-f405", "stm32f405")];

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
    // The macro of embedded-test asks for it.
    println!("cargo:rustc-check-cfg=cfg(rust_analyzer)");
    if std::env::var("CARGO_CFG_TARGET_OS").as_deref() == Ok("none") {
        let root = std::path::Path::new(&std::env::var("CARGO_MANIFEST_DIR").unwrap_or_default()).join("..");
        println!("cargo:rustc-link-search={}", root.display());
        println!("cargo:rustc-link-arg-bins=--nmagic");
        println!("cargo:rustc-link-arg-bins=-Tlink.x");
        println!("cargo:rustc-link-arg-tests=--nmagic");
        for script in ["link.x", "defmt.x", "embedded-test.x"] {
            println!("cargo:rustc-link-arg-tests=-T{script}");
        }
        // The flashable image: its logs, and the budgets of `memory.x`.
        println!("cargo:rustc-link-arg-bin=rig=-Tdefmt.x");
        println!("cargo:rustc-link-arg-bin=rig=--defsym=_flashable=1");
    }
}
