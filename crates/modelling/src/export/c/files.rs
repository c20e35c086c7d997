//! The two C files on the disk.

use std::path::{Path, PathBuf};

use anyhow::{Result, bail};
use model_export::blob::Blob;

use super::name::Name;
use super::source::{CSource, generate};

/// Where C goes, and under which name.
#[derive(Clone, Debug)]
pub struct CFiles {
    /// The source file.
    pub source: PathBuf,
    /// The header beside it.
    pub header: PathBuf,
    name: Name,
}

impl CFiles {
    /// For a source file; its header goes beside it.
    ///
    /// # Errors
    /// When the name does not end in `.c`, no `#include` could name the header, or the header cannot be written there.
    pub fn new(source: &Path) -> Result<Self> {
        let stem = source.file_stem().and_then(|stem| stem.to_str()).filter(|_| source.extension().is_some_and(|found| found == "c"));
        let Some(name) = stem.and_then(Name::from_stem) else {
            bail!("no #include can name the header beside it; take a name of letters and digits that ends in .c");
        };
        let header = source.with_extension("h");
        output::check_file(&header).map_err(|problem| anyhow::anyhow!("{}: {problem}", header.display()))?;
        Ok(Self { source: source.to_owned(), header, name })
    }

    /// What is public in the files begins with this.
    #[must_use]
    pub fn identifier(&self) -> &str {
        self.name.identifier()
    }

    /// Writes both files.
    ///
    /// # Errors
    /// When the model does not meet its golden vectors, or a file cannot be written.
    pub fn write(&self, blob: &Blob<'_>) -> Result<()> {
        let CSource { header, source } = generate(blob, &self.name)?;
        output::write_atomic(&self.header, header.as_bytes())?;
        output::write_atomic(&self.source, source.as_bytes())
    }

    /// Source and header.
    #[must_use]
    pub fn into_paths(self) -> Vec<PathBuf> {
        vec![self.source, self.header]
    }
}
