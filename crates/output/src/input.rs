//! Reading files that a user names: whole, of a bounded size, and never waiting for a writer that does not come.

use std::fs::File;
use std::io::{Error, ErrorKind, Read, Result};
use std::path::Path;

/// Nothing that is read whole is longer than this.
pub const MOST_BYTES: u64 = 256 << 20;

/// Opens a file for reading. A named pipe or a device is refused: without a writer the command would wait for ever, and a device may never
/// end. The streams that the shell hands over (`/dev/stdin`, `/dev/fd/63`) have a writer and are taken.
///
/// # Errors
/// When there is no such file, or it is a folder, a pipe or a device.
pub fn open(path: &Path) -> Result<File> {
    let handed_over = ["/dev/stdin", "/dev/fd", "/proc/self/fd"].iter().any(|stream| path.starts_with(stream));
    let metadata = std::fs::metadata(path)?;
    if metadata.is_dir() {
        return Err(ErrorKind::IsADirectory.into());
    }
    if !metadata.is_file() && !handed_over {
        return Err(Error::new(ErrorKind::InvalidInput, "it is a pipe or a device, a file is wanted"));
    }
    File::open(path)
}

/// The bytes of a file.
///
/// # Errors
/// As [`open`], and when it is longer than [`MOST_BYTES`].
pub fn read(path: &Path) -> Result<Vec<u8>> {
    let mut bytes = Vec::new();
    open(path)?.take(MOST_BYTES + 1).read_to_end(&mut bytes)?;
    if bytes.len() as u64 > MOST_BYTES {
        return Err(Error::new(
            ErrorKind::FileTooLarge,
            format!("it is longer than the {} MB that such a file may have", MOST_BYTES >> 20),
        ));
    }
    Ok(bytes)
}

/// The text of a file.
///
/// # Errors
/// As [`read`], and when it is not UTF-8.
pub fn read_text(path: &Path) -> Result<String> {
    String::from_utf8(read(path)?).map_err(|_| Error::new(ErrorKind::InvalidData, "it is no UTF-8 text"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    #[cfg(unix)]
    fn a_pipe_that_nobody_writes_to_and_a_device_without_end_are_refused() {
        let folder = tempfile::tempdir().expect("a folder");
        let pipe = folder.path().join("run.csv");
        assert!(std::process::Command::new("mkfifo").arg(&pipe).status().expect("mkfifo").success());
        for path in [pipe.as_path(), Path::new("/dev/zero")] {
            let error = read(path).expect_err("no file");
            assert!(error.to_string().contains("a pipe or a device"), "{error}");
        }
        assert!(read(folder.path()).is_err());
        std::fs::write(folder.path().join("text"), "a µ").expect("a file");
        assert_eq!(read_text(&folder.path().join("text")).expect("text"), "a µ");
    }
}
