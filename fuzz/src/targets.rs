//! Readers that are called, each with valid files to begin from.

use std::path::{Path, PathBuf};

use recording::{ColumnMap, Recording};

use crate::readers::{self, Wrong};
use crate::{mutate, seeds};

/// A reader.
pub struct Target {
    /// Its name.
    pub name: &'static str,
    /// Makes valid files.
    pub files: fn() -> Vec<Vec<u8>>,
    /// Reads one file: the refusal, or what is wrong with what was accepted.
    pub read: fn(&[u8]) -> Result<(), Wrong>,
    /// Makes a changed file's checksums right again, so that it is not refused at the door; every second file goes through it.
    pub mend_crc: Option<fn(&mut [u8])>,
}

impl Target {
    /// The changed file number `number` of a seed, from what [`Self::files`] gave.
    #[must_use]
    pub fn input(&self, files: &[Vec<u8>], seed: u64, number: u64) -> Vec<u8> {
        let mut bytes = mutate::mutated(files, seed, number);
        if let Some(mend_crc) = self.mend_crc.filter(|_| number.is_multiple_of(2)) {
            mend_crc(&mut bytes);
        }
        bytes
    }
}

fn fixtures(names: &[&str]) -> Vec<Vec<u8>> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../crates/recording/tests/formats");
    let read = |name: &&str| std::fs::read(folder.join(name)).unwrap_or_else(|error| panic!("{name}: {error}"));
    names.iter().map(read).collect()
}

/// All readers.
#[must_use]
pub fn all() -> Vec<Target> {
    let target = |name, files, read| Target { name, files, read, mend_crc: None };
    vec![
        target("csv", || fixtures(&["reference.csv", "units.csv", "tab.tsv"]), own),
        target("foreign-csv", || fixtures(&["excel.csv"]), foreign),
        target("gzip", || fixtures(&["gzip.csv.gz"]), own),
        target("npz", || fixtures(&["savez.npz", "compressed.npz", "matrix.npz"]), own),
        target("mat", || fixtures(&["columns.mat", "compressed.mat", "structure.mat"]), own),
        target("mcap", || fixtures(&["zstd.mcap", "lz4.mcap", "nested.mcap"]), own),
        target("columns", maps, columns),
        target("physics", || vec![seeds::file("physics.toml"), seeds::file("modified.toml")], readers::physics),
        target("discovered", || vec![seeds::file("discovered.toml")], readers::model),
        target("fitted", || vec![seeds::file("fitted.toml")], readers::model),
        target("network", seeds::networks, readers::trained),
        Target { name: "blob", files: seeds::blobs, read: readers::blob, mend_crc: Some(blob_with_crc) },
        target("checkpoint", seeds::checkpoints, readers::checkpoint),
        Target { name: "journal", files: seeds::journals, read: readers::replay_log, mend_crc: Some(replay_log_with_crc) },
        target("flash", seeds::flashes, readers::flash),
        target("excitation", seeds::excitations, readers::played),
        target("plant", || vec![seeds::file("plant.toml")], readers::plant),
        target("settings", || vec![seeds::file("settings.toml")], readers::settings),
        target("hardware", || vec![seeds::file("hardware.toml")], readers::hardware),
        target("effects", || vec![seeds::file("effects.toml")], readers::effects),
        target("torch", || vec![seeds::vector("torch_single.safetensors"), seeds::vector("torch_gru_dense.safetensors")], readers::foreign),
        target("keras", || vec![seeds::vector("keras_double.safetensors"), seeds::vector("keras_relu.safetensors")], readers::foreign),
        target("onnx", || vec![seeds::vector("onnx_by_hand.onnx"), seeds::vector("onnx_torch_gru.onnx")], readers::foreign),
        target("vectors", || vec![seeds::vector("torch_single.csv")], readers::vectors),
        target("reference", || vec![b"time_s,reference_mm\n0,1\n0.02,2\n0.04,3.5\n0.06,2\n".to_vec()], readers::reference),
        target("dump", || vec![seeds::file("dump.csv")], readers::dump),
    ]
}

/// Content hash and checksum of a blob.
fn blob_with_crc(bytes: &mut [u8]) {
    use model_export::blob::{HEADER_BYTES, crc32};
    use sha2::{Digest, Sha256};
    if bytes.len() > HEADER_BYTES {
        let hash: [u8; 32] = Sha256::digest(&bytes[HEADER_BYTES..]).into();
        bytes[20..52].copy_from_slice(&hash);
        let checksum = crc32(crc32(0, &bytes[..16]), &bytes[20..]);
        bytes[16..20].copy_from_slice(&checksum.to_le_bytes());
    }
}

/// Checksum of a replay log.
fn replay_log_with_crc(bytes: &mut [u8]) {
    if bytes.len() > 16 {
        let checksum = model_export::blob::crc32(0, &bytes[16..]);
        bytes[12..16].copy_from_slice(&checksum.to_le_bytes());
    }
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_reader_accepts_a_file_to_begin_from_and_mending_its_crc_leaves_all_as_they_are() {
        for target in all() {
            let files = (target.files)();
            let refused: Vec<Wrong> = files.iter().filter_map(|file| (target.read)(file).err()).collect();
            // Some of other programs' files need words on the command line.
            assert!(refused.len() < files.len(), "{}: {refused:?}", target.name);
            assert!(refused.iter().all(|wrong| matches!(wrong, Wrong::Refused(_))), "{}: {refused:?}", target.name);
            for file in &files {
                let mut changed = file.clone();
                target.mend_crc.into_iter().for_each(|mend_crc| mend_crc(&mut changed));
                assert!(changed == *file, "{}", target.name);
            }
        }
    }
}
