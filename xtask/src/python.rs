//! The Python package: built into an environment of its own, its tests and its notebook run there.
//!
//! Python is no part of what the project needs. Where there is none, or its packages cannot be had, the stage says so and is left out; what
//! fails once the environment stands is an error.

use std::path::{Path, PathBuf};

use anyhow::Result;

use crate::process::{answer, cargo, command, root, run, target_folder};

/// Asks a Python whether it is new enough and can make environments.
const PROBE: &str = "import sys, venv, ensurepip; sys.exit(sys.version_info < (3, 9))";

/// The package's tests, with the command built by the demo beside it.
pub fn tests() -> Result<()> {
    let Some(python) = ["python3", "python"].into_iter().find(|python| answer(command(python).args(["-c", PROBE])).is_some()) else {
        return left_out("there is no Python 3.9 or later with venv and pip (on Debian: `apt-get install python3-venv`)");
    };
    let environment = target_folder().join("python");
    if run("environment", command(python).args(["-m", "venv"]).arg(&environment)).is_err() {
        return left_out(&format!("`{python} -m venv` makes no environment"));
    }
    let inside = program(&environment, "python");
    let pip = |arguments: &[&str]| {
        let mut pip = command(&inside);
        pip.args(["-m", "pip", "install", "--quiet", "--disable-pip-version-check"]).args(arguments);
        pip
    };
    if run("packages", &mut pip(&["--requirement", "python/tests/requirements.txt"])).is_err() {
        return left_out("pip cannot install python/tests/requirements.txt; is its registry reachable?");
    }
    let own = target_folder();
    // In the build folder of the workspace and its release profile: the demo has built everything but the binding.
    let mut package = pip(&["--no-build-isolation", "--no-deps", "--force-reinstall", "./python"]);
    // pip looks for maturin on the path.
    let path = std::env::var_os("PATH").unwrap_or_default();
    let path = std::env::join_paths(inside.parent().map(Path::to_path_buf).into_iter().chain(std::env::split_paths(&path)))?;
    run("package", package.env("CARGO_TARGET_DIR", &own).env("PATH", path))?;
    run("command", cargo().args(["build", "--release", "--bin", "catheter"]))?;
    let mut tests = command(&inside);
    tests.current_dir(root().join("python")).env("CATHETER", own.join("release").join(executable("catheter")));
    run("tests of the package", tests.args(["-m", "pytest", "--quiet", "-p", "no:cacheprovider"]))
}

fn left_out(reason: &str) -> Result<()> {
    eprintln!("\n==> Python package: LEFT OUT, {reason}");
    Ok(())
}

fn program(environment: &Path, name: &str) -> PathBuf {
    environment.join(if cfg!(windows) { "Scripts" } else { "bin" }).join(executable(name))
}

fn executable(name: &str) -> String {
    format!("{name}{}", std::env::consts::EXE_SUFFIX)
}
