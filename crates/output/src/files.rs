//! Files written whole or not at all, and the checks before any work is done.

use std::io::{ErrorKind, Write};
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};

use crate::kind::{UNKNOWN, kind};
use crate::manner::{may_replace, refuse_replacing};
use crate::place::{folder_of, is_stream};
use crate::provenance;

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
    // Before the rename: after a loss of power the name must not point to a file whose bytes never arrived.
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
