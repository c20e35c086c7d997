//! Running the built command in a folder of its own, and recordings and models to run it on.

use std::collections::BTreeMap;
use std::fmt::Write;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;

use assert_cmd::Command;
use serde_json::Value;

/// A working folder that vanishes with the test.
pub struct Bench {
    folder: tempfile::TempDir,
    /// Whether commands may replace results of earlier ones, as most tests let them.
    replaces: bool,
}

/// What one run said.
pub struct Said {
    pub code: i32,
    pub stdout: String,
    pub stderr: String,
    pub line: String,
}

impl Bench {
    pub fn new() -> Self {
        Self { folder: tempfile::tempdir().expect("a temporary folder"), replaces: true }
    }

    /// A working folder in which nothing is replaced without `--force`, as for a user.
    pub fn careful() -> Self {
        Self { replaces: false, ..Self::new() }
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    pub fn write(&self, name: &str, bytes: impl AsRef<[u8]>) -> PathBuf {
        let path = self.path(name);
        std::fs::create_dir_all(path.parent().expect("a file lies in a folder")).expect("a folder for the file");
        std::fs::write(&path, bytes).expect("a file in the temporary folder");
        path
    }

    pub fn read(&self, name: &str) -> Vec<u8> {
        std::fs::read(self.path(name)).unwrap_or_else(|error| panic!("{name}: {error}"))
    }

    pub fn json(&self, name: &str) -> Value {
        serde_json::from_slice(&self.read(name)).unwrap_or_else(|error| panic!("{name}: {error}"))
    }

    /// Runs `catheter` with the words of `line`; files are named relative to the working folder, no word has a space.
    pub fn run(&self, line: &str) -> Said {
        self.run_within(line, 300)
    }

    /// The same, and it may not take longer than so many seconds.
    pub fn run_within(&self, line: &str, seconds: u64) -> Said {
        let output = Command::new(env!("CARGO_BIN_EXE_catheter"))
            .args(line.split_whitespace())
            .current_dir(self.folder.path())
            .env("CATHETER_FORCE", if self.replaces { "1" } else { "0" })
            .timeout(std::time::Duration::from_secs(seconds))
            .output()
            .expect("the built command starts");
        let said = Said {
            code: output.status.code().unwrap_or(-1),
            stdout: String::from_utf8_lossy(&output.stdout).into_owned(),
            stderr: String::from_utf8_lossy(&output.stderr).into_owned(),
            line: line.to_owned(),
        };
        assert!(!said.stderr.contains("panicked"), "`{line}` panicked: {}", said.stderr);
        said
    }

    /// Runs `catheter` and expects it to work.
    pub fn works(&self, line: &str) -> Said {
        let said = self.run(line);
        assert_eq!(said.code, 0, "`{line}` ended with {}: {}\n{}", said.code, said.stderr, said.stdout);
        said
    }

    /// Runs `catheter` and expects it to refuse: exit code 2, a message that contains every one of `words`, and no file made, changed
    /// or left behind.
    pub fn refuses(&self, line: &str, words: &[&str]) -> Said {
        let before = self.contents();
        let said = self.run(line);
        assert_eq!(said.code, 2, "`{line}` ended with {}\nstdout: {}\nstderr: {}", said.code, said.stdout, said.stderr);
        for word in words {
            assert!(said.stderr.contains(word), "`{line}` does not say `{word}`:\n{}", said.stderr);
        }
        assert!(said.stderr.starts_with("error: "), "`{line}` says more than its error:\n{}", said.stderr);
        let after = self.contents();
        let names = |contents: &BTreeMap<PathBuf, Option<Vec<u8>>>| contents.keys().cloned().collect::<Vec<_>>();
        assert_eq!(names(&before), names(&after), "`{line}` was refused and left files behind");
        assert!(before == after, "`{line}` was refused and changed a file");
        said
    }

    /// Every file with its bytes and every folder, however deep.
    fn contents(&self) -> BTreeMap<PathBuf, Option<Vec<u8>>> {
        fn visit(folder: &Path, into: &mut BTreeMap<PathBuf, Option<Vec<u8>>>) {
            for entry in std::fs::read_dir(folder).expect("a folder can be listed") {
                let path = entry.expect("an entry of a folder").path();
                if path.is_dir() {
                    visit(&path, into);
                    into.insert(path, None);
                } else {
                    let bytes = std::fs::read(&path).expect("a file can be read");
                    into.insert(path, Some(bytes));
                }
            }
        }
        let mut contents = BTreeMap::new();
        visit(self.folder.path(), &mut contents);
        contents
    }
}

/// One play operator, eq. (2) of the paper, written here once more so that the tests do not trust the code under test.
fn play(input: &[f64], threshold: f64) -> Vec<f64> {
    let mut state = 0.0_f64;
    input
        .iter()
        .map(|&value| {
            state = (value - threshold).max((value + threshold).min(state));
            state
        })
        .collect()
}

/// Thresholds and weights of the little rig behind [`recording_csv`].
pub const TRUTH: [(f64, f64); 3] = [(0.0, 0.4), (0.15, 0.35), (0.4, 0.25)];

/// A recording in our own format: 600 samples of a decaying sine, 20 ms apart, through three play operators, without noise.
pub fn recording_csv(frequency_hz: f64) -> String {
    recording(frequency_hz, |displacement| displacement)
}

/// The same with a displacement that saturates, which no sum of play operators does: something is left for a network to learn.
fn bent_recording_csv(frequency_hz: f64) -> String {
    recording(frequency_hz, |displacement| 1.2 * (displacement / 1.2).tanh())
}

fn recording(frequency_hz: f64, bend: impl Fn(f64) -> f64) -> String {
    let time_s: Vec<f64> = (0..600).map(|index| f64::from(index) * 0.02).collect();
    let pressure: Vec<f64> = time_s
        .iter()
        .map(|&time| (-0.05 * time).exp() * ((std::f64::consts::TAU * frequency_hz * time - std::f64::consts::FRAC_PI_2).sin() + 1.0))
        .collect();
    let mut displacement = vec![0.0; pressure.len()];
    for (threshold, weight) in TRUTH {
        for (sum, state) in displacement.iter_mut().zip(play(&pressure, threshold)) {
            *sum += weight * state;
        }
    }
    let mut text = "time_s,pressure_bar,displacement_mm\n".to_owned();
    for ((time, pressure), displacement) in time_s.iter().zip(&pressure).zip(&displacement) {
        writeln!(text, "{time:.2},{pressure},{}", bend(*displacement)).expect("writing to a string");
    }
    text
}

/// Models made once for all tests: `exact/` (recordings of three play operators) and `physics.toml` found in them; `data/` (the same,
/// bent) and the hybrid `model.safetensors` and `model.blob` made from them.
pub fn models() -> &'static Path {
    static MODELS: OnceLock<PathBuf> = OnceLock::new();
    MODELS.get_or_init(|| {
        let bench = Bench::new();
        for (name, frequency_hz) in [("a1", 0.3), ("a2", 0.5), ("a3", 0.7), ("a4", 0.4)] {
            bench.write(&format!("exact/{name}.csv"), recording_csv(frequency_hz));
            bench.write(&format!("data/{name}.csv"), bent_recording_csv(frequency_hz));
        }
        bench.works("identify --data exact --out physics.toml");
        bench.works("train --preset hybrid --data data --out model.safetensors --epochs 400 --threads 1");
        bench.works("export model.safetensors --calibration data --out model.blob");
        // Kept for the whole test run, in cargo's own folder for that.
        let kept = Path::new(env!("CARGO_TARGET_TMPDIR")).join("models");
        let _ = std::fs::remove_dir_all(&kept);
        copy(bench.folder.path(), &kept);
        kept
    })
}

impl Bench {
    /// As [`Self::careful`], with the files of [`models`] in it.
    pub fn careful_with_models() -> Self {
        Self { replaces: false, ..Self::with_models() }
    }

    /// A working folder with the files of [`models`] in it.
    pub fn with_models() -> Self {
        let bench = Self::new();
        copy(models(), bench.folder.path());
        bench
    }
}

fn copy(from: &Path, to: &Path) {
    std::fs::create_dir_all(to).expect("a folder can be made");
    for entry in std::fs::read_dir(from).expect("a folder can be listed") {
        let entry = entry.expect("an entry of a folder");
        let (path, target) = (entry.path(), to.join(entry.file_name()));
        if path.is_dir() {
            copy(&path, &target);
        } else {
            std::fs::copy(&path, &target).expect("a file can be copied");
        }
    }
}
