//! Files of models: what they are, and their readers.

use std::path::Path;

use super::blob::BlobModel;
use super::discovered::DiscoveredPredictor;
use super::error::ModelError;
use super::fitted::FittedPredictor;
use super::physics::PhysicsPredictor;
use super::predictor::Predictor;
use super::trained::NetworkModel;

/// What a model file is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// An identified physics model, TOML.
    Physics,
    /// A model that discovery wrote, TOML.
    Discovered,
    /// A model of `catheter fit`, TOML.
    Fitted,
    /// A trained network, safetensors.
    Network,
    /// A blob.
    Blob,
}

/// What a file is, by how it begins and what it says; its name does not matter.
///
/// # Errors
/// When it is a folder, cannot be read, or is none of these.
pub fn format(path: &Path) -> Result<Format, ModelError> {
    match std::fs::metadata(path) {
        Ok(metadata) if metadata.is_dir() => return Err(ModelError::Folder { path: path.into() }),
        Ok(_) => {}
        Err(error) => return Err(ModelError::Open { path: path.into(), problem: error.to_string() }),
    }
    let bytes = output::read(path).map_err(|error| ModelError::Open { path: path.into(), problem: error.to_string() })?;
    if bytes.starts_with(&model_export::blob::MAGIC) {
        return Ok(Format::Blob);
    }
    // safetensors: eight bytes of length, then a JSON object.
    if bytes.get(8) == Some(&b'{') && bytes[..8].contains(&0) {
        return Ok(Format::Network);
    }
    #[derive(serde::Deserialize)]
    struct Head {
        kind: String,
    }
    let head = std::str::from_utf8(&bytes).ok().and_then(|text| toml::from_str::<Head>(text).ok());
    match head {
        Some(head) if head.kind == crate::physics::fitted::KIND => Ok(Format::Fitted),
        Some(head) if head.kind == discovery::file::KIND => Ok(Format::Discovered),
        Some(_) => Ok(Format::Physics),
        None => by_ending(path),
    }
}

/// What a file that cannot be recognised claims to be: its reader says best what is wrong with it.
fn by_ending(path: &Path) -> Result<Format, ModelError> {
    let ending = path.extension().map(|ending| ending.to_string_lossy().to_ascii_lowercase()).unwrap_or_default();
    match ending.as_str() {
        "toml" => Ok(Format::Physics),
        "safetensors" => Ok(Format::Network),
        "blob" => Ok(Format::Blob),
        _ => Err(ModelError::Ending { path: path.into() }),
    }
}

/// Reads a model of any kind.
///
/// # Errors
/// When the file is no model, or cannot be read, is damaged, of another schema, or makes no sense. The message names the file and what
/// to do.
pub fn load(path: &Path) -> Result<Box<dyn Predictor>, ModelError> {
    Ok(match format(path)? {
        Format::Network => Box::new(NetworkModel::load(path)?),
        Format::Blob => Box::new(BlobModel::load(path)?),
        Format::Discovered => Box::new(DiscoveredPredictor::load(path)?),
        Format::Fitted => Box::new(FittedPredictor::load(path)?),
        Format::Physics => Box::new(PhysicsPredictor::load(path)?),
    })
}
