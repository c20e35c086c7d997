//! One command at a time on a file that is read, changed and written back, such as the flash memory of a simulated rig.

use std::fs::{File, TryLockError};
use std::path::Path;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail};

use crate::place::folder_of;

/// A file that nobody else changes while this lives.
#[derive(Debug)]
pub struct Locked(#[expect(dead_code, reason = "closing it ends the lock")] File);

/// Waits until no other command holds the file, for `patience` at most. Where there is no such file yet its folder is held, or
/// the nearest one above that exists.
///
/// # Errors
/// When another command holds it for longer.
pub fn lock(path: &Path, patience: Duration) -> Result<Locked> {
    let begin = Instant::now();
    loop {
        // Opening a pipe would wait for somebody at its other end.
        let (file, is_there) = match crate::input::open(path) {
            Ok(file) => (file, true),
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => {
                let named = folder_of(path).ancestors().find(|folder| folder.is_dir());
                let folder = named.unwrap_or(Path::new("."));
                (File::open(folder).with_context(|| format!("{}: cannot be read", folder.display()))?, false)
            }
            Err(error) => return Err(error).with_context(|| format!("{}: cannot be read", path.display())),
        };
        match file.try_lock() {
            // While it was waited for, the name may have been given to a new file.
            Ok(()) if is_there && !is_same(&file, path) => {}
            Ok(()) if !is_there && path.exists() => {}
            // A file system without locks.
            Ok(()) | Err(TryLockError::Error(_)) => return Ok(Locked(file)),
            Err(TryLockError::WouldBlock) => {
                if begin.elapsed() > patience {
                    bail!("{}: another command is using it; wait for its end, or name another file", path.display());
                }
                std::thread::sleep(Duration::from_millis(20));
            }
        }
    }
}

/// Whether the name still stands for this file.
#[cfg(unix)]
fn is_same(file: &File, path: &Path) -> bool {
    use std::os::unix::fs::MetadataExt;
    let (Ok(held), Ok(named)) = (file.metadata(), std::fs::metadata(path)) else { return false };
    (held.dev(), held.ino()) == (named.dev(), named.ino())
}

#[cfg(not(unix))]
fn is_same(_file: &File, _path: &Path) -> bool {
    true
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nobody_loses_an_update_although_every_write_makes_a_new_file() -> Result<()> {
        let folder = tempfile::tempdir()?;
        let path = folder.path().join("count");
        let add = || -> Result<()> {
            for _ in 0..20 {
                let _locked = lock(&path, Duration::from_secs(60))?;
                let count: u32 = std::fs::read_to_string(&path).map_or(Ok(0), |text| text.parse())?;
                std::thread::sleep(Duration::from_millis(1));
                crate::write_atomic(&path, (count + 1).to_string().as_bytes())?;
            }
            Ok(())
        };
        std::thread::scope(|scope| {
            let threads: Vec<_> = (0..4).map(|_| scope.spawn(add)).collect();
            threads.into_iter().try_for_each(|thread| thread.join().expect("a thread"))
        })?;
        assert_eq!(std::fs::read_to_string(&path)?, "80");
        let _held = lock(&path, Duration::ZERO)?;
        assert!(lock(&path, Duration::from_millis(50)).is_err_and(|error| error.to_string().contains("another command")));
        Ok(())
    }
}
