//! The device's status, and waiting for a state.

use std::time::Duration;

use anyhow::{Result, ensure};
use model_export::link::message::{Reply, Request, Status};
use model_export::link::state::State;

use crate::link::{Client, LinkError, Transport, state_name};

/// How long to wait for the way from one state to the next: boot and self-test.
pub(crate) const PATIENCE: Duration = Duration::from_secs(12);

/// Asks for the status.
///
/// # Errors
/// See [`LinkError`].
pub fn status(rig: &mut Client<impl Transport>) -> Result<Status, LinkError> {
    match rig.request(&Request::Status)? {
        Reply::Status(status) => Ok(status),
        _ => Err(rig.unexpected(&Request::Status)),
    }
}

/// Waits until boot and self-test are over.
///
/// # Errors
/// When they do not end.
pub fn settle(rig: &mut Client<impl Transport>) -> Result<Status> {
    wait(rig, "the end of its self-test", |status| !matches!(status.state, State::Boot | State::SelfTest))
}

/// Waits for a status.
pub(crate) fn wait(rig: &mut Client<impl Transport>, what: &str, reached: impl Fn(&Status) -> bool) -> Result<Status> {
    let until = rig.elapsed() + PATIENCE;
    loop {
        let status = status(rig)?;
        if reached(&status) {
            return Ok(status);
        }
        ensure!(rig.elapsed() < until, "the device waits in the state `{}` and does not reach {what}", state_name(status.state));
        rig.listen_for(Duration::from_millis(20))?;
    }
}

/// Waits for the self-test that begins with the next tick.
///
/// # Errors
/// When it does not end.
pub fn settle_after_change(rig: &mut Client<impl Transport>) -> Result<Status> {
    rig.listen(Duration::from_millis(5))?;
    settle(rig)
}
