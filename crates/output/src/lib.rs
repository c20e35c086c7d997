//! What commands leave behind: files written whole or not at all, JSON results, lines on standard output, progress.

mod input;
mod lock;
mod manner;
mod piped;
mod plain;
mod progress;
pub mod provenance;
pub mod text;

use std::fmt::Arguments;
use std::io::{ErrorKind, Write};
use std::path::{Path, PathBuf};
use std::sync::Mutex;

use anyhow::{Context, Result, bail};

pub use input::{MOST_BYTES, open, read, read_text};
pub use lock::{Locked, lock};
pub use manner::{Loudness, allow_replacing, loudness, may_replace, refuse_replacing, set_loudness};
pub use plain::{brief, plain};
pub use progress::{Working, progress, stages, working};

/// Prints a line on standard output like `println!`, but a reader that left early (`catheter inspect M.blob | head`) is no error: the
/// command goes on and still leaves its files.
#[macro_export]
macro_rules! say {
    () => { $crate::print_line(format_args!("")) };
    ($($argument:tt)*) => { $crate::print_line(format_args!($($argument)*)) };
}

/// The first error of standard output other than a closed pipe, for example a full disk behind `> report.txt`.
static STANDARD_OUTPUT_ERROR: Mutex<Option<std::io::Error>> = Mutex::new(None);

/// Prints a line on standard error with `--verbose`, with the time since the command began: what is read, written, decided on the way.
#[macro_export]
macro_rules! detail {
    ($($argument:tt)*) => { $crate::print_detail(format_args!($($argument)*)) };
}

/// Prints a line on standard output; see [`say!`]. Names from files may hold what a terminal obeys: it is shown, see [`plain`].
/// With `--quiet` only warnings and failed checks are printed, on standard error.
pub fn print_line(text: Arguments<'_>) {
    let text = text.to_string();
    if loudness() == Loudness::Quiet {
        if ["warning:", "FAILED", "DIFFERENT", "CUT"].iter().any(|word| text.trim_start().starts_with(word)) {
            // Nobody who reads it is no error.
            let _ = writeln!(std::io::stderr(), "{}", plain(&text));
        }
        return;
    }
    let mut output = std::io::stdout().lock();
    let result = output.write_all(plain(&text).as_bytes()).and_then(|()| output.write_all(b"\n"));
    remember(result);
}

/// Prints a line on standard error with `--verbose`; see [`detail!`].
pub fn print_detail(text: Arguments<'_>) {
    if loudness() == Loudness::Verbose {
        let line = format!("[{:8.2} s] {text}", provenance::elapsed_s());
        let _ = writeln!(std::io::stderr(), "{}", plain(&line));
    }
}

/// Prints bytes on standard output as they are, with `--quiet`, too; see [`say!`].
pub fn print_bytes(bytes: &[u8]) {
    remember(std::io::stdout().lock().write_all(bytes));
}

fn remember(result: std::io::Result<()>) {
    if let Err(error) = result
        && error.kind() != ErrorKind::BrokenPipe
        && let Ok(mut slot) = STANDARD_OUTPUT_ERROR.lock()
    {
        slot.get_or_insert(error);
    }
}

/// Flushes standard output and tells whether everything said so far arrived.
///
/// # Errors
/// When a line could not be written for any reason but a reader that left.
pub fn finish() -> Result<()> {
    remember(std::io::stdout().lock().flush());
    match STANDARD_OUTPUT_ERROR.lock().map(|mut slot| slot.take()) {
        Ok(Some(error)) => Err(error).context("standard output cannot be written; is the disk full?"),
        _ => Ok(()),
    }
}

/// Writes `bytes` to `path` through a temporary file in the same folder, so that a reader sees the old file or the new one.
/// Folders on the way are created. A pipe or device (`/dev/stdout`) is written straight.
///
/// # Errors
/// When the folder cannot be created or written to.
pub fn write_atomic(path: &Path, bytes: &[u8]) -> Result<()> {
    if is_stream(path) {
        let mut stream =
            std::fs::OpenOptions::new().append(true).open(path).with_context(|| format!("{}: cannot be opened", path.display()))?;
        return match stream.write_all(bytes) {
            Err(error) if error.kind() != ErrorKind::BrokenPipe => {
                Err(error).with_context(|| format!("{}: cannot be written", path.display()))
            }
            _ => Ok(()),
        };
    }
    check_file(path).map_err(|problem| anyhow::anyhow!("{}: {problem}", path.display()))?;
    // A link to a file stays a link: what it points to is replaced.
    let path = &std::fs::canonicalize(path).unwrap_or_else(|_| path.to_path_buf());
    let folder = folder_of(path);
    std::fs::create_dir_all(folder).with_context(|| format!("{}: the folder cannot be created", folder.display()))?;
    let mut file = new_temporary(folder).with_context(|| format!("{}: no file can be written in this folder", folder.display()))?;
    refuse_another_kind(path, bytes)?;
    let full = || format!("{}: cannot be written; is the disk full?", path.display());
    file.write_all(bytes).with_context(full)?;
    // Before the name changes hands: after a loss of power the name must not point to a file whose bytes never arrived.
    file.as_file().sync_all().with_context(full)?;
    file.persist(path).with_context(|| format!("{}: cannot be written", path.display()))?;
    // The name itself; a file system that cannot do that has kept its old promise.
    if let Ok(folder) = std::fs::File::open(folder) {
        let _ = folder.sync_all();
    }
    detail!("wrote {}, {} bytes", path.display(), bytes.len());
    Ok(())
}

/// Keeps a result from replacing a file of another kind: a model over a recording is a slip of the finger.
fn refuse_another_kind(path: &Path, bytes: &[u8]) -> Result<()> {
    use std::io::Read as _;
    let mut there = Vec::new();
    let Ok(file) = std::fs::File::open(path) else { return Ok(()) };
    if file.take(512).read_to_end(&mut there).is_err() || there.is_empty() {
        return Ok(());
    }
    let (old, new) = (kind(&there), kind(bytes));
    if old != new && old != UNKNOWN {
        bail!("{}: is {old}, and {new} would replace it; choose another name, or remove the file first", path.display());
    }
    Ok(())
}

/// What is not recognised.
const UNKNOWN: &str = "a file of another kind";

/// What bytes are, as far as their beginning tells.
fn kind(bytes: &[u8]) -> &'static str {
    let starts = |magic: &[u8]| bytes.starts_with(magic);
    match bytes {
        _ if starts(b"CATHBLOB") => "a blob",
        _ if starts(b"CATHJRNL") => "a journal",
        _ if starts(b"\x1f\x8b") => "a compressed file",
        _ if starts(b"PK") => "an archive",
        _ if starts(b"\x89MCAP") => "an MCAP file",
        _ if starts(b"MATLAB") => "a MAT file",
        _ if starts(b"\x7fELF") => "a program",
        _ if bytes.get(8) == Some(&b'{') && bytes[..8].contains(&0) => "a network in safetensors",
        _ if bytes.contains(&0) => UNKNOWN,
        _ => text_kind(bytes),
    }
}

/// What a text is: HTML, JSON, TOML or a table.
fn text_kind(bytes: &[u8]) -> &'static str {
    let text = String::from_utf8_lossy(&bytes[..bytes.len().min(512)]).into_owned();
    let mut lines = text.lines().map(str::trim).filter(|line| !line.is_empty() && !line.starts_with('#'));
    let first = lines.next().unwrap_or_default();
    if first.get(..9).is_some_and(|begin| begin.eq_ignore_ascii_case("<!doctype")) || first.starts_with("<html") {
        return "a page in HTML";
    }
    let names = first.split(',').collect::<Vec<_>>();
    let is_header = names.len() >= 2 && names.iter().all(|name| !name.is_empty() && !name.contains(['=', '{', '[', '"', ' ']));
    if is_header && first.contains("time") {
        return "a recording";
    }
    let is_key =
        first.split_once(" = ").is_some_and(|(key, _)| key.chars().all(|letter| letter.is_ascii_alphanumeric() || "_-.".contains(letter)));
    match first.chars().next() {
        Some('{') => "a result in JSON",
        _ if is_key || (first.starts_with('[') && first.ends_with(']') && first.len() > 2 && !first.contains(',')) => "a file in TOML",
        _ => UNKNOWN,
    }
}

/// Writes `value` as indented JSON, atomically.
///
/// # Errors
/// As [`write_atomic`].
pub fn write_json(path: &Path, value: &impl serde::Serialize) -> Result<()> {
    let mut bytes = serde_json::to_vec_pretty(value).context("cannot encode the JSON result")?;
    bytes.push(b'\n');
    write_atomic(path, &bytes)
}

/// Writes the result of a command as indented JSON, atomically; an object gets a last field `provenance`: command, version, seed, and the
/// hashes of the recordings.
///
/// # Errors
/// As [`write_atomic`].
pub fn write_result(path: &Path, value: &impl serde::Serialize) -> Result<()> {
    let mut text = serde_json::to_string_pretty(value).context("cannot encode the JSON result")?;
    // Spliced in as text: the fields keep the order that the result has.
    if let (Some(provenance), Some(fields)) = (provenance::json(), text.strip_suffix("\n}")) {
        let provenance = serde_json::to_string_pretty(&provenance).context("cannot encode the JSON result")?.replace('\n', "\n  ");
        text = format!("{fields},\n  \"provenance\": {provenance}\n}}");
    }
    text.push('\n');
    write_atomic(path, text.as_bytes())
}

/// Checks, before any work is done, that a file can be written at `path`: it is no folder, and the nearest folder that exists takes
/// files. Creates nothing.
///
/// # Errors
/// What is in the way and what to do; the message does not repeat the path.
pub fn check_file(path: &Path) -> Result<(), String> {
    if is_stream(path) {
        return Ok(());
    }
    if path.is_dir() || path.file_name().is_none() {
        return Err("is a folder, a file name is wanted; add one".to_owned());
    }
    check_writable(folder_of(path))
}

/// Checks, before any work is done, that files can be written into the folder `path`, which need not exist yet. Creates nothing.
///
/// # Errors
/// As [`check_file`].
pub fn check_folder(path: &Path) -> Result<(), String> {
    check_writable(path)
}

/// The folder itself while it is absent or empty, else the first free one of `name-2`, `name-3` and so on: a report's folder, so that a
/// command can be typed twice. With `--force` the folder itself.
#[must_use]
pub fn free_folder(path: &Path) -> PathBuf {
    if may_replace() { path.to_path_buf() } else { numbered(path) }
}

fn numbered(path: &Path) -> PathBuf {
    let is_free = |path: &Path| match std::fs::read_dir(path) {
        Ok(mut entries) => entries.next().is_none(),
        Err(_) => !path.exists(),
    };
    if path.is_file() || is_free(path) {
        return path.to_path_buf();
    }
    let name = path.file_name().map_or_else(|| "out".to_owned(), |name| name.to_string_lossy().into_owned());
    (2_u64..).map(|number| path.with_file_name(format!("{name}-{number}"))).find(|path| is_free(path)).unwrap_or_else(|| path.to_path_buf())
}

/// Checks the nearest folder that exists at or above `folder`.
fn check_writable(folder: &Path) -> Result<(), String> {
    let here = if folder.as_os_str().is_empty() { Path::new(".") } else { folder };
    let Some(existing) =
        here.ancestors().map(|path| if path.as_os_str().is_empty() { Path::new(".") } else { path }).find(|path| path.exists())
    else {
        return Err("cannot be reached; check the path".to_owned());
    };
    if !existing.is_dir() {
        return Err(format!("{} is a file, a folder is wanted there; choose another place", existing.display()));
    }
    match new_temporary(existing) {
        Ok(_) => Ok(()),
        Err(error) => Err(format!("the folder {} takes no files ({}); choose another place", existing.display(), reason(&error))),
    }
}

/// What the system says, without the name of the temporary file.
fn reason(error: &std::io::Error) -> String {
    error.raw_os_error().map_or_else(|| error.kind().to_string(), |code| std::io::Error::from_raw_os_error(code).to_string())
}

fn folder_of(path: &Path) -> &Path {
    match path.parent() {
        Some(folder) if !folder.as_os_str().is_empty() => folder,
        _ => Path::new("."),
    }
}

/// Whether something other than a file or folder is there: a terminal, a pipe, a device. The standard streams count by their names,
/// because behind `> log.txt` they are files that must be added to, not replaced.
fn is_stream(path: &Path) -> bool {
    ["/dev/stdout", "/dev/stderr", "/dev/fd"].iter().any(|stream| path.starts_with(stream))
        || std::fs::metadata(path).is_ok_and(|metadata| !metadata.is_file() && !metadata.is_dir())
}

/// A temporary file that, once renamed, has the rights of any newly made file instead of the owner's alone.
fn new_temporary(folder: &Path) -> std::io::Result<tempfile::NamedTempFile> {
    let mut builder = tempfile::Builder::new();
    builder.prefix(".catheter-").suffix(".tmp");
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        builder.permissions(std::fs::Permissions::from_mode(0o666));
    }
    builder.tempfile_in(folder)
}

/// A file the user asks for, checked while the command line is read: with the right ending (`toml`, or `.toml`; any when empty), where
/// a file can be written and, without `--force`, none is that holds something.
pub fn file_argument(ending: &'static str) -> impl clap::builder::TypedValueParser<Value = PathBuf> {
    use clap::builder::{PathBufValueParser, TypedValueParser};
    let ending = ending.trim_start_matches('.');
    PathBufValueParser::new().try_map(move |path: PathBuf| {
        if !ending.is_empty() && !is_stream(&path) && path.extension().is_none_or(|found| found != ending) {
            return Err(format!("the name must end in .{ending}"));
        }
        check_file(&path)?;
        refuse_replacing(&path)?;
        Ok(path)
    })
}

/// A folder the user asks for, checked while the command line is read; it need not exist yet.
pub fn folder_argument() -> impl clap::builder::TypedValueParser<Value = PathBuf> {
    use clap::builder::{PathBufValueParser, TypedValueParser};
    PathBufValueParser::new().try_map(|path: PathBuf| {
        check_folder(&path)?;
        Ok::<_, String>(path)
    })
}

/// Refuses to overwrite what a command reads, as `--data run.csv --json run.csv` would.
///
/// # Errors
/// When an output is one of the inputs.
pub fn refuse_overwriting(inputs: &[PathBuf], outputs: &[&Path]) -> Result<()> {
    for output in outputs {
        let Ok(canonical) = std::fs::canonicalize(output) else { continue };
        if is_stream(output) {
            continue;
        }
        for input in inputs {
            if std::fs::canonicalize(input).is_ok_and(|input| input == canonical) {
                bail!("{}: is read by this command and would be overwritten by it; choose another name for the result", output.display());
            }
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_appears_whole_with_its_folders_and_nothing_else() -> Result<()> {
        let folder = tempfile::tempdir()?;
        let path = folder.path().join("a/b/result.json");
        write_json(&path, &[1, 2])?;
        write_json(&path, &[3])?;
        assert_eq!(std::fs::read_to_string(&path)?, "[\n  3\n]\n");
        assert_eq!(std::fs::read_dir(folder.path().join("a/b"))?.count(), 1);
        Ok(())
    }

    #[test]
    fn a_result_does_not_replace_a_file_of_another_kind() -> Result<()> {
        let folder = tempfile::tempdir()?;
        let path = folder.path().join("run");
        let kinds: [(&str, &[u8]); 6] = [
            ("a recording", b"time_s,pressure_bar,displacement_mm\n0,1,2\n"),
            ("a result in JSON", b"{\n  \"rmse\": 1\n}\n"),
            ("a file in TOML", b"# a remark\nformat_version = 1\n"),
            ("a page in HTML", b"<!DOCTYPE html><html></html>"),
            ("a blob", b"CATHBLOB\x02\0\0\0"),
            ("a network in safetensors", b"\x08\0\0\0\0\0\0\0{\"a\":1}"),
        ];
        for (old_name, old) in kinds {
            for (new_name, new) in kinds {
                std::fs::write(&path, old)?;
                let written = write_atomic(&path, new);
                assert_eq!(written.is_ok(), old_name == new_name, "{new_name} over {old_name}");
                if let Err(error) = written {
                    assert!(error.to_string().contains(&format!("is {old_name}, and {new_name} would replace it")), "{error}");
                    assert_eq!(std::fs::read(&path)?, old);
                }
            }
        }
        Ok(())
    }

    #[test]
    #[cfg(target_os = "linux")]
    fn a_full_disk_leaves_the_old_file() -> Result<()> {
        // A limit on the length of files fails a write as a full disk does; it is the child's alone.
        if let Ok(path) = std::env::var("OUTPUT_TEST_FULL") {
            let error = write_atomic(Path::new(&path), &vec![b'x'; 1 << 20]).expect_err("no room");
            assert!(format!("{error:#}").contains("is the disk full?"), "{error:#}");
            return Ok(());
        }
        let folder = tempfile::tempdir()?;
        let path = folder.path().join("result");
        std::fs::write(&path, b"old")?;
        let test = std::env::current_exe()?;
        let script =
            format!("trap '' XFSZ; ulimit -f 16; exec '{}' --exact tests::a_full_disk_leaves_the_old_file --nocapture", test.display());
        let child = std::process::Command::new("bash").args(["-c", &script]).env("OUTPUT_TEST_FULL", &path).output()?;
        assert!(child.status.success(), "{}", String::from_utf8_lossy(&child.stderr));
        assert_eq!(std::fs::read(&path)?, b"old");
        assert_eq!(std::fs::read_dir(folder.path())?.count(), 1, "no half file is left");
        Ok(())
    }

    #[test]
    #[cfg(unix)]
    fn others_may_read_the_files_we_write() -> Result<()> {
        use std::os::unix::fs::PermissionsExt;
        let folder = tempfile::tempdir()?;
        let (plain, ours) = (folder.path().join("plain"), folder.path().join("ours"));
        std::fs::write(&plain, b"x")?;
        write_atomic(&ours, b"x")?;
        let rights = |path: &Path| std::fs::metadata(path).map(|metadata| metadata.permissions().mode());
        assert_eq!(rights(&ours)?, rights(&plain)?);
        Ok(())
    }

    #[test]
    #[cfg(unix)]
    fn a_link_stays_a_link_and_a_device_stays_a_device() -> Result<()> {
        let folder = tempfile::tempdir()?;
        let (target, link) = (folder.path().join("target"), folder.path().join("link"));
        std::fs::write(&target, b"old")?;
        std::os::unix::fs::symlink(&target, &link)?;
        write_atomic(&link, b"new")?;
        assert!(std::fs::symlink_metadata(&link)?.is_symlink());
        assert_eq!(std::fs::read(&target)?, b"new");
        write_atomic(Path::new("/dev/null"), b"new")?;
        assert!(is_stream(Path::new("/dev/null")));
        Ok(())
    }

    #[test]
    fn a_folder_or_a_file_in_the_way_is_found_before_the_work_and_nothing_is_created() -> Result<()> {
        let folder = tempfile::tempdir()?;
        let file = folder.path().join("file");
        std::fs::write(&file, b"kept")?;
        assert!(check_file(folder.path()).is_err_and(|problem| problem.contains("is a folder")));
        assert!(check_file(&file.join("below.toml")).is_err_and(|problem| problem.contains("is a file")));
        assert!(check_folder(&file).is_err_and(|problem| problem.contains("is a file")));
        assert!(write_atomic(&file.join("below.toml"), b"x").is_err());
        assert_eq!(check_file(&folder.path().join("new/deep/result.toml")), Ok(()));
        assert_eq!(check_file(&file), Ok(()));
        assert_eq!(std::fs::read_dir(folder.path())?.count(), 1);
        assert_eq!(std::fs::read(&file)?, b"kept");
        Ok(())
    }

    #[test]
    fn an_input_is_not_overwritten() -> Result<()> {
        let folder = tempfile::tempdir()?;
        let input = folder.path().join("run.csv");
        std::fs::write(&input, b"x")?;
        let roundabout = folder.path().join("../").join(folder.path().file_name().unwrap_or_default()).join("run.csv");
        assert!(refuse_overwriting(std::slice::from_ref(&input), &[&roundabout]).is_err());
        assert!(refuse_overwriting(&[input], &[&folder.path().join("other.toml"), Path::new("/dev/null")]).is_ok());
        Ok(())
    }
}
