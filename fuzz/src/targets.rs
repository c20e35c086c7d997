//! Readers that are called, each with valid files to begin from.

use std::path::{Path, PathBuf};

use recording::{ColumnMap, Recording};

/// A reader.
pub struct Target {
    /// Its name.
    pub name: &'static str,
    /// Valid files.
    pub files: Vec<Vec<u8>>,
    /// Reads one file: the refusal, or what is wrong with what was accepted.
    pub read: fn(&[u8]) -> Result<(), Wrong>,
}

/// How an input ended other than in a sound result.
#[derive(Debug)]
pub enum Wrong {
    /// Refused, with a message: as it should be.
    Refused(String),
    /// Accepted although it is garbage.
    Garbage(String),
}

fn fixtures(names: &[&str]) -> Vec<Vec<u8>> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../crates/recording/tests/formats");
    let read = |name: &&str| std::fs::read(folder.join(name)).unwrap_or_else(|error| panic!("{name}: {error}"));
    names.iter().map(read).collect()
}

/// All readers.
#[must_use]
pub fn all() -> Vec<Target> {
    let target = |name, files: &[&str]| Target { name, files: fixtures(files), read: own };
    vec![
        target("csv", &["reference.csv", "units.csv", "tab.tsv"]),
        Target { name: "foreign-csv", files: fixtures(&["excel.csv"]), read: foreign },
        target("gzip", &["gzip.csv.gz"]),
        target("npz", &["savez.npz", "compressed.npz", "matrix.npz"]),
        target("mat", &["columns.mat", "compressed.mat", "structure.mat"]),
        target("mcap", &["zstd.mcap", "lz4.mcap", "nested.mcap"]),
        Target { name: "columns", files: maps(), read: columns },
    ]
}

fn maps() -> Vec<Vec<u8>> {
    let maps = [
        "time=t_s,input=voltage_V,output=displacement_um",
        "time=t:ms,input=P:kPa,input2=q:psi,output=laser:mA@4..20=0..50mm,group=load,recording=run,measured=m:bar,session=s_min",
    ];
    maps.iter().map(|map| map.as_bytes().to_vec()).collect()
}

fn own(bytes: &[u8]) -> Result<(), Wrong> {
    judged(recording::parse(&PathBuf::from("input"), bytes, &ColumnMap::own()))
}

fn foreign(bytes: &[u8]) -> Result<(), Wrong> {
    let map = ColumnMap::parse("time=Zeit (s),input=Druck (bar),output=Weg (mm)").map_err(|error| Wrong::Garbage(error.to_string()))?;
    judged(recording::parse(&PathBuf::from("input"), bytes, &map))
}

fn columns(bytes: &[u8]) -> Result<(), Wrong> {
    let text = String::from_utf8_lossy(bytes);
    let map = ColumnMap::parse(&text).map_err(|error| Wrong::Refused(error.to_string()))?;
    let data = b"t_s,voltage_V,displacement_um\n0,1,2\n1,2,3\n2,3,4\n";
    judged(recording::parse(&PathBuf::from("input"), data, &map))
}

/// What a command would do with a recording next: look at it, and write it.
fn judged(read: Result<Recording, recording::RecordingError>) -> Result<(), Wrong> {
    let recording = match read {
        Ok(recording) => recording,
        Err(error) => {
            let message = error.to_string();
            if message.len() > 4000 {
                return Err(Wrong::Garbage(format!("a refusal of {} bytes", message.len())));
            }
            return Err(Wrong::Refused(message));
        }
    };
    let garbage = |problem: &str| Err(Wrong::Garbage(problem.to_owned()));
    let columns = recording.inputs().into_iter().chain([&recording.output[..], &recording.time_s]);
    let sound = |values: &[f64]| values.len() == recording.len() && values.iter().all(|value| value.abs() <= 1e30);
    if !columns.chain(recording.extra.iter().map(|column| &column.values[..])).all(sound) {
        return garbage("values that are not finite, or columns of different lengths");
    }
    if recording.len() < 2
        || recording.time_s.windows(2).any(|pair| pair[1] <= pair[0])
        || recording.gaps.iter().any(|&gap| gap >= recording.len())
    {
        return garbage("a clock that does not run forwards");
    }
    let check = recording::check::check(std::slice::from_ref(&recording));
    let text = serde_json::to_string(&check).map_err(|error| Wrong::Garbage(error.to_string()))?;
    if text.len() > 1 << 20 {
        return garbage("a check of more than 1 MB");
    }
    if recording::resample::check(&recording, check.common_period_s).is_ok() {
        let even = recording::resample::uniform(&recording, check.common_period_s);
        if even.output.iter().any(|value| !value.is_finite()) {
            return garbage("an even clock with values that are not finite");
        }
    }
    Ok(())
}
