//! Excitation files on disk.

use std::path::Path;

use super::config::ExcitationConfig;
use super::error::ExcitationError;

/// Reads an excitation file.
///
/// # Errors
/// When it cannot be read or is not a valid excitation; the message has line and column.
pub fn read(path: &Path) -> Result<ExcitationConfig, ExcitationError> {
    let name = path.display().to_string();
    let text = output::read_text(path).map_err(|error| ExcitationError::Open { path: name.clone(), problem: error.to_string() })?;
    toml::from_str(&text).map_err(|error| ExcitationError::Syntax { path: name, problem: error.to_string() })
}

/// The text of an excitation file.
///
/// # Panics
/// Never: every excitation is representable, seeds above `i64::MAX` excepted, which [`super::sets`] does not make.
#[must_use]
pub fn to_toml(excitation: &ExcitationConfig) -> String {
    toml::to_string(excitation).expect("an excitation is representable in TOML")
}
