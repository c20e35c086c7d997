//! A serial port for one process alone: two hosts on a line would take each other's replies, and neither would know why the rig moved.
//!
//! An advisory lock (`flock`) keeps out other processes of this program, exclusive mode (`TIOCEXCL`) those of others. Both end with the process,
//! however it ends. Who is kept out is told who is in.

use super::LinkError;

#[cfg(unix)]
mod system {
    use std::fs::{File, TryLockError};
    use std::io;
    use std::path::Path;

    use rustix::fs::{Mode, OFlags};
    use rustix::io::Errno;

    use super::LinkError;

    /// The lock, as long as it lives.
    #[derive(Default)]
    pub struct Reserved(Option<File>);

    impl Drop for Reserved {
        fn drop(&mut self) {
            // A pseudo-terminal may stay open at its other end, and its mode with it.
            let _ = self.0.as_ref().map(rustix::termios::ioctl_tiocnxcl);
        }
    }

    /// Keeps a port for this process.
    pub fn reserve(port: &str) -> Result<io::Result<Reserved>, LinkError> {
        let taken = || LinkError::InUse { place: port.to_owned(), by: holder(port) };
        // Without waiting for a carrier, and not as the terminal that controls this process.
        let file = match rustix::fs::open(port, OFlags::RDWR | OFlags::NOCTTY | OFlags::NONBLOCK | OFlags::CLOEXEC, Mode::empty()) {
            Ok(descriptor) => File::from(descriptor),
            Err(Errno::BUSY) => return Err(taken()),
            Err(error) => return Ok(Err(error.into())),
        };
        match file.try_lock() {
            Ok(()) => {}
            Err(TryLockError::WouldBlock) => return Err(taken()),
            Err(TryLockError::Error(error)) => return Ok(Err(error)),
        }
        // What is no terminal has no such mode; opening it as a port says so.
        let _ = rustix::termios::ioctl_tiocexcl(&file);
        Ok(Ok(Reserved(Some(file))))
    }

    /// Which process has the port, where the system tells: the one with the lock, or else one that has it open.
    fn holder(port: &str) -> String {
        let number = locker(port).or_else(|| opener(port));
        number.map_or_else(
            || "another process".to_owned(),
            |number| format!("process {number} (`{}`)", command_line(&Path::new("/proc").join(number.to_string()))),
        )
    }

    /// The process that has the lock on a file, by Linux' list of locks: `1: FLOCK  ADVISORY  WRITE 4711 00:1c:5 0 EOF`.
    fn locker(port: &str) -> Option<u32> {
        use std::os::unix::fs::MetadataExt as _;
        let inode = std::fs::metadata(port).ok()?.ino().to_string();
        let locks = std::fs::read_to_string("/proc/locks").ok()?;
        let of = |line: &str| {
            let words: Vec<&str> = line.split_whitespace().collect();
            let is_it = words.get(1) == Some(&"FLOCK") && words.get(5)?.rsplit(':').next() == Some(inode.as_str());
            words.get(4).filter(|_| is_it)?.parse().ok()
        };
        locks.lines().find_map(of).filter(|number| *number != std::process::id())
    }

    /// A process that has a file open.
    fn opener(port: &str) -> Option<u32> {
        let wanted = std::fs::canonicalize(port).unwrap_or_else(|_| port.into());
        let has_it = |process: &Path| {
            let files = std::fs::read_dir(process.join("fd")).into_iter().flatten().flatten();
            files.into_iter().any(|file| std::fs::read_link(file.path()).is_ok_and(|target| target == wanted))
        };
        let processes = std::fs::read_dir("/proc").ok()?.flatten();
        let numbered = processes.filter_map(|process| Some((process.file_name().to_str()?.parse::<u32>().ok()?, process.path())));
        let mut others = numbered.filter(|(number, _)| *number != std::process::id());
        others.find(|(_, path)| has_it(path)).map(|(number, _)| number)
    }

    /// The words of a process' command line, without what a terminal would obey.
    fn command_line(process: &Path) -> String {
        let bytes = std::fs::read(process.join("cmdline")).unwrap_or_default();
        let words: Vec<String> =
            bytes.split(|byte| *byte == 0).filter(|word| !word.is_empty()).map(|word| String::from_utf8_lossy(word).into_owned()).collect();
        words.join(" ").chars().filter(|letter| !letter.is_control()).take(200).collect()
    }
}

#[cfg(not(unix))]
mod system {
    use super::LinkError;

    /// Elsewhere a port is opened by one process alone anyway.
    #[derive(Default)]
    pub struct Reserved;

    /// Nothing is to be done.
    pub fn reserve(_port: &str) -> Result<std::io::Result<Reserved>, LinkError> {
        Ok(Ok(Reserved))
    }
}

pub use system::{Reserved, reserve};
