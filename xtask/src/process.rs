//! Other programs: run them, say what is run and how long it took.

use std::ffi::OsStr;
use std::path::PathBuf;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail};

/// The folder of the whole project. Cargo tells where xtask lies when it runs it; without cargo, where it lay when it was built.
pub fn root() -> PathBuf {
    let own = std::env::var_os("CARGO_MANIFEST_DIR").map_or_else(|| PathBuf::from(env!("CARGO_MANIFEST_DIR")), PathBuf::from);
    own.parent().map_or_else(|| PathBuf::from("."), PathBuf::from)
}

/// Where cargo leaves what it builds.
pub fn target_folder() -> PathBuf {
    std::env::var_os("CARGO_TARGET_DIR").map_or_else(|| root().join("target"), |folder| root().join(folder))
}

/// A command that starts in the project's folder.
pub fn command(program: impl AsRef<OsStr>) -> Command {
    let mut command = Command::new(program);
    command.current_dir(root());
    command
}

/// The cargo that runs us.
pub fn cargo() -> Command {
    command(std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into()))
}

/// The command as a person would type it.
pub fn shown(command: &Command) -> String {
    let program = command.get_program().to_string_lossy();
    let name = program.rsplit(['/', '\\']).next().unwrap_or(&program).to_owned();
    std::iter::once(name).chain(command.get_args().map(|argument| argument.to_string_lossy().into_owned())).collect::<Vec<_>>().join(" ")
}

/// Runs `command` with its output shown, under a title.
pub fn run(title: &str, command: &mut Command) -> Result<()> {
    let shown = shown(command);
    eprintln!("\n==> {title}: {shown}");
    let start = Instant::now();
    let status = command.status().with_context(|| format!("cannot start `{shown}`"))?;
    if !status.success() {
        bail!("{title} failed: `{shown}` ended with {status}");
    }
    eprintln!("==> {title}: done in {:.1} s", start.elapsed().as_secs_f64());
    Ok(())
}

/// Runs `command` and gives back its standard output; `None` when it cannot be started or fails.
pub fn answer(command: &mut Command) -> Option<String> {
    let output = command.stdin(Stdio::null()).output().ok()?;
    output.status.success().then(|| String::from_utf8_lossy(&output.stdout).into_owned())
}

/// Whether `program` can be started at all.
pub fn exists(program: &str) -> bool {
    Command::new(program).arg("--version").stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null()).status().is_ok()
}

/// Runs `command` and ends it after `limit`; gives back its standard output.
pub fn answer_within(limit: Duration, command: &mut Command) -> Result<String> {
    let shown = shown(command);
    let mut child = command.stdin(Stdio::null()).stdout(Stdio::piped()).spawn().with_context(|| format!("cannot start `{shown}`"))?;
    let output = child.stdout.take().context("the standard output of a child process")?;
    // Read beside the wait: a child that fills the pipe would never end.
    let reader = std::thread::spawn(move || std::io::read_to_string(output));
    let start = Instant::now();
    let status = loop {
        if let Some(status) = child.try_wait()? {
            break status;
        }
        if start.elapsed() > limit {
            child.kill()?;
            child.wait()?;
            bail!("`{shown}` did not end within {} s", limit.as_secs());
        }
        std::thread::sleep(Duration::from_millis(20));
    };
    let text = reader.join().map_err(|_| anyhow::anyhow!("reading the output of `{shown}` failed"))??;
    if !status.success() {
        bail!("`{shown}` ended with {status} and said:\n{text}");
    }
    Ok(text)
}
