//! Where a path leads: its folder, or a stream.

use std::path::Path;

/// The folder of a file, `.` where none is named.
pub(crate) fn folder_of(path: &Path) -> &Path {
    match path.parent() {
        Some(folder) if !folder.as_os_str().is_empty() => folder,
        _ => Path::new("."),
    }
}

/// Whether something other than a file or folder is there: a terminal, a pipe, a device. The standard streams count by their names,
/// because behind `> log.txt` they are files that must be added to, not replaced.
pub(crate) fn is_stream(path: &Path) -> bool {
    ["/dev/stdout", "/dev/stderr", "/dev/fd"].iter().any(|stream| path.starts_with(stream))
        || std::fs::metadata(path).is_ok_and(|metadata| !metadata.is_file() && !metadata.is_dir())
}
