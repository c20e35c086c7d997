//! `catheter rig model`.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use clap::Subcommand;
use model_export::blob;
use model_export::link::fault::Fault;
use model_export::link::message::{Refusal, Reply, Request};
use model_export::link::state::State;
use serde::Serialize;

use super::Which;
use crate::backend::Rig;
use crate::cli::Outcome;
use crate::experiment;
use crate::link::{Client, LinkError, fault_in_words};
use crate::{output, say};

/// What to do with models.
#[derive(Subcommand)]
pub enum Command {
    /// Upload a blob into the slot that is not active; the device checks it whole, golden vectors included.
    Upload {
        /// The blob that `catheter export` made.
        #[arg(value_name = "FILE")]
        blob: PathBuf,
        /// Activate it at once.
        #[arg(long)]
        activate: bool,
    },
    /// Make the other whole model the active one; the device tests itself again.
    Activate,
    /// Go back to the model before.
    Rollback,
    /// Show which models are whole: the active one, and the one that could be activated.
    List,
}

#[derive(Serialize)]
struct Listed {
    active: Option<String>,
    other: Option<String>,
}

fn identity(id: [u8; 8]) -> Option<String> {
    (id != [0; 8]).then(|| id.iter().map(|byte| format!("{byte:02x}")).collect())
}

fn list(rig: &mut Client<Rig>, which: &Which) -> Result<Outcome> {
    let Reply::Models { active, other } = rig.request(&Request::Models)? else { return Err(rig.unexpected(&Request::Models).into()) };
    let listed = Listed { active: identity(active), other: identity(other) };
    say!("active   {}", listed.active.as_deref().unwrap_or("none; `model upload FILE --activate` brings one"));
    say!("other    {}", listed.other.as_deref().unwrap_or("none"));
    if listed.other.is_some() {
        say!(
            "`model activate` makes the other one the active one. A model is known by the first bytes of its content hash, as `inspect` shows it."
        );
    }
    which.write(&listed)?;
    Ok(Outcome::Success)
}

#[derive(Serialize)]
struct Written {
    uploaded_bytes: Option<usize>,
    activated: bool,
    model_id: Option<String>,
}

/// Runs the command.
pub fn run(command: &Command, rig: &mut Client<Rig>, which: &Which) -> Result<Outcome> {
    let (uploaded_bytes, activate) = match command {
        Command::Upload { blob, activate } => {
            let bytes = upload(blob, rig)?;
            (Some(bytes.len()), activate.then(|| blob::content_id(&bytes)).flatten())
        }
        Command::Activate | Command::Rollback => (None, Some(other(rig)?)),
        Command::List => return list(rig, which),
    };
    let activated = activate.is_some();
    if let Some(id) = activate {
        self::activate(id, rig)?;
    } else {
        say!("The device still runs the model before; `model activate` changes over.");
    }
    if which.forgets() {
        say!("This device ends with this command; name a file with --flash to keep its models.");
    }
    let id = rig.greet_again()?.model_id;
    let model_id = identity(id);
    which.write(&Written { uploaded_bytes, activated, model_id })?;
    Ok(Outcome::Success)
}

/// The whole model that is not active.
fn other(rig: &mut Client<Rig>) -> Result<[u8; 8]> {
    match rig.request(&Request::Models)? {
        Reply::Models { other: [0, 0, 0, 0, 0, 0, 0, 0], .. } => Err(LinkError::Refused(Refusal::NoOtherModel).into()),
        Reply::Models { other, .. } => Ok(other),
        _ => Err(rig.unexpected(&Request::Models).into()),
    }
}

/// Sends a blob piece by piece, and gives it.
pub fn upload(path: &Path, rig: &mut Client<Rig>) -> Result<Vec<u8>> {
    let bytes = output::read(path).with_context(|| format!("{}: cannot be read", path.display()))?;
    blob::decode(&bytes).map_err(|error| anyhow::anyhow!("{}: is no blob this program knows: {error}", path.display()))?;
    let bar = output::progress(bytes.len() as u64, "upload");
    experiment::upload(rig, &bytes, &mut |sent| bar.set_position(sent.into()))?;
    bar.finish_and_clear();
    say!("Uploaded {} bytes; the device checked them, and the golden vectors came out right.", bytes.len());
    Ok(bytes)
}

/// Activates a model and waits for the self-test.
pub fn activate(id: [u8; 8], rig: &mut Client<Rig>) -> Result<()> {
    rig.command(&Request::ModelActivate { id })?;
    let status = experiment::settle_after_change(rig)?;
    if let (State::Fault, Some(fault)) = (status.state, Fault::from_number(status.first_fault)) {
        bail!(
            "the device is in the fault state: {}: {} {}",
            fault_in_words(status.first_fault),
            fault.explanation().meaning,
            fault.explanation().remedy
        );
    }
    say!("Activated: the device tested it and uses it.");
    Ok(())
}
