//! Runs the firmware's image `emulated` in QEMU: a work file in, lines of text out.

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

/// The microcontroller's target.
const TARGET: &str = "thumbv7em-none-eabihf";
/// Where the image looks for its work file.
const WORK_ADDRESS: &str = "0x08080000";

/// The variable that names another `emulated` than the release build.
const EMULATED_IMAGE: &str = "CATHETER_EMULATED_IMAGE";

/// What the image can do; the numbers stand in the image's documentation.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Task {
    /// Networks of every shape.
    Sweep = 1,
    /// Golden vectors and random steps of each blob.
    Golden = 2,
    /// Instructions per step of each blob.
    Cost = 3,
    /// Instructions per tick with each blob as the model.
    Tick = 4,
}

/// A work file before it is written.
#[derive(Clone, Debug)]
pub struct Work<'a> {
    /// What to do.
    pub task: Task,
    /// Steps of each item.
    pub steps: u32,
    /// Seed of the random work.
    pub seed: u32,
    /// The blobs.
    pub blobs: &'a [Vec<u8>],
}

impl Work<'_> {
    fn bytes(&self) -> Vec<u8> {
        let length = |count: usize| u32::try_from(count).expect("fewer than 2^32");
        let mut bytes = b"WORK".to_vec();
        for number in [self.task as u32, self.steps, self.seed, length(self.blobs.len())] {
            bytes.extend(number.to_le_bytes());
        }
        for blob in self.blobs {
            bytes.extend(length(blob.len()).to_le_bytes());
            bytes.extend(blob);
            bytes.resize(bytes.len().next_multiple_of(4), 0);
        }
        bytes
    }

    /// Runs the image and gives back its lines, without the last, `done`.
    ///
    /// Instructions are counted, one a nanosecond of emulated time, so that results do not depend on the host.
    ///
    /// # Panics
    /// When the image is missing or QEMU cannot be started, with the command to type; when the image reports an error or does not finish.
    #[must_use]
    pub fn run(&self) -> Vec<String> {
        let image = std::env::var_os(EMULATED_IMAGE).map_or_else(|| image("emulated"), PathBuf::from);
        let folder = tempfile::tempdir().expect("a temporary folder");
        let path = folder.path().join("work.bin");
        std::fs::write(&path, self.bytes()).expect("a work file");
        let mut qemu = Command::new("qemu-system-arm");
        qemu.args(["-M", "netduinoplus2", "-nographic", "-monitor", "none", "-serial", "none", "-icount", "shift=0,sleep=off"])
            .args(["-semihosting-config", "enable=on,target=native", "-kernel"])
            .arg(&image)
            .arg("-device")
            .arg(format!("loader,file={},addr={WORK_ADDRESS},force-raw=on", path.display()));
        let text = output_within(Duration::from_secs(300), &mut qemu);
        let mut lines: Vec<String> = text.lines().map(str::to_owned).collect();
        assert!(!text.contains("error") && !text.contains("panic"), "the image reports:\n{text}");
        assert_eq!(lines.pop().as_deref(), Some("done"), "the image did not finish:\n{text}");
        lines
    }
}

/// A built image of the firmware.
///
/// # Panics
/// When it is not there, with the command to type.
#[must_use]
pub fn image(name: &str) -> PathBuf {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    let target = std::env::var_os("CARGO_TARGET_DIR").map_or_else(|| root.join("target"), |folder| root.join(folder));
    let path = target.join(TARGET).join("release").join(name);
    let hint = "build it with `cargo build --release --target thumbv7em-none-eabihf -p firmware`, or run `cargo xtask test`";
    assert!(path.is_file(), "the image {} is missing; {hint}", path.display());
    path
}

fn output_within(limit: Duration, command: &mut Command) -> String {
    let mut child = command
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .spawn()
        .expect("qemu-system-arm cannot be started; install it with `cargo xtask setup`");
    let output = child.stdout.take().expect("the standard output of a child");
    // Read beside the wait: a child that fills the pipe would never end.
    let reader = std::thread::spawn(move || std::io::read_to_string(output));
    let start = Instant::now();
    while child.try_wait().expect("the state of a child").is_none() {
        if start.elapsed() > limit {
            let _ = child.kill();
            let _ = child.wait();
            panic!("the image did not end within {} s", limit.as_secs());
        }
        std::thread::sleep(Duration::from_millis(5));
    }
    reader.join().expect("a reader that does not panic").expect("text from the image")
}
