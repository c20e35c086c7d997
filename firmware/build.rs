//! Link arguments of the target binaries; nothing on the desktop.

fn main() {
    println!("cargo:rerun-if-changed=build.rs");
    println!("cargo:rerun-if-changed=../memory.x");
    println!("cargo:rustc-check-cfg=cfg(planted_panic)");
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
