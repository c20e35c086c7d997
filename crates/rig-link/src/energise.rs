//! A rig under pressure: armed, started, kept alive by its host, and vented at the end however it comes.
//!
//! While it runs, a device wants a word from its host within `limits.host_timeout_ms`, or it vents. So whoever runs a rig repeats the set-point every
//! 50 ms, from this loop alone: when the process hangs or ends, the words end too.

use std::time::Duration;

use anyhow::{Context, Result, bail, ensure};
use model_export::link::fault::Blocker;
use model_export::link::message::{FaultRecord, Quantity, Reply, Request, Status, Telemetry};
use model_export::link::state::State;

use crate::experiment::{self, blocked_for_long, settle, status};
use crate::interrupt;
use crate::link::{Client, LinkError, Transport, fault_in_words, state_name};

/// How often the set-point is repeated: a fifth of the default host timeout.
pub const HEARTBEAT: Duration = Duration::from_millis(50);
/// How long an idle device may take until nothing that passes by itself speaks against arming.
const READY_WITHIN: Duration = Duration::from_secs(5);
/// Pressure must be gone within 1 s; the rest is for the way there and back.
pub const VENTED_WITHIN: Duration = Duration::from_millis(1500);

/// What to do next while the rig runs.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Next {
    /// Have this set-point, in the quantity's unit.
    Hold(f32),
    /// Come to the end.
    End,
}

/// How a run ended.
#[derive(Clone, Debug, PartialEq)]
pub enum Ended {
    /// As its caller wanted.
    AsAsked,
    /// Somebody pressed Ctrl-C.
    Interrupted,
    /// A fault vented the rig.
    Fault(Box<FaultRecord>),
    /// The device left the running state without a fault.
    Left(State),
}

/// Waits until nothing that passes by itself speaks against arming.
///
/// # Errors
/// When the device is gone.
pub fn wait_for_readiness(rig: &mut Client<impl Transport>) -> Result<Status> {
    settle(rig)?;
    let until = rig.elapsed() + READY_WITHIN;
    loop {
        let status = status(rig)?;
        if status.blockers.is_empty() || blocked_for_long(&status) || rig.elapsed() >= until || interrupt::is_requested() {
            return Ok(status);
        }
        rig.listen_for(Duration::from_millis(20))?;
    }
}

/// Arms an idle device, once what passes by itself has passed.
///
/// # Errors
/// With every blocker and its remedy, when the device refuses.
pub fn arm(rig: &mut Client<impl Transport>) -> Result<()> {
    let ready = wait_for_readiness(rig)?;
    if ready.state == State::Fault {
        let fault = fault_in_words(ready.first_fault);
        bail!("the rig is in the state `fault` ({fault}); `catheter explain` with that number says what to do");
    }
    rig.command(&Request::Arm).context("the rig does not arm")?;
    Ok(())
}

/// Vents and waits until the pressure is seen to be gone; whether it was.
///
/// # Errors
/// When the device is gone.
pub fn vent(rig: &mut Client<impl Transport>) -> Result<(bool, Status), LinkError> {
    rig.command(&Request::Vent)?;
    let until = rig.elapsed() + VENTED_WITHIN;
    loop {
        rig.listen(Duration::from_millis(20))?;
        let status = status(rig)?;
        let low = !status.blockers.contains(Blocker::VentNotVerified);
        if low || rig.elapsed() >= until {
            return Ok((low, status));
        }
    }
}

/// Starts an armed device and keeps it running: `each` sees every sample of telemetry and says what comes next. The rig runs when this returns
/// [`Ended::AsAsked`] or [`Ended::Interrupted`], for the time of `limits.host_timeout_ms`: the caller stops or vents it.
///
/// # Errors
/// When the device refuses, or is gone.
pub fn run<T: Transport>(
    rig: &mut Client<T>,
    quantity: Quantity,
    first: f32,
    each: &mut dyn FnMut(&mut T, &Telemetry) -> Result<Next>,
) -> Result<Ended> {
    rig.command(&Request::Start).context("the rig does not start")?;
    rig.begin_account();
    let mut value = first;
    let mut waiting: Option<u32> = None;
    let mut sent: Option<Duration> = None;
    let mut ran = false;
    // What is on its way from before the start is older than this.
    let begun = rig.elapsed();
    loop {
        if interrupt::is_requested() {
            return Ok(Ended::Interrupted);
        }
        if let Some(token) = waiting
            && let Some(reply) = rig.take_reply(token)
        {
            if let Reply::Refused(refusal) = reply {
                return Err(LinkError::Refused(refusal)).context("the set-point was refused");
            }
            waiting = None;
        }
        if sent.is_none_or(|sent| rig.elapsed() >= sent + HEARTBEAT) {
            waiting = Some(rig.send(&Request::SetPoint { quantity, value })?);
            sent = Some(rig.elapsed());
        }
        rig.listen(Duration::from_millis(5))?;
        while let Some(sample) = rig.take_telemetry() {
            match sample.state {
                State::Running => ran = true,
                State::Fault => {
                    let record = experiment::fault_record(rig)?.context("the device is in the fault state and keeps no record of it")?;
                    return Ok(Ended::Fault(Box::new(record)));
                }
                state if ran => return Ok(Ended::Left(state)),
                _ => continue,
            }
            match each(rig.transport(), &sample)? {
                Next::End => return Ok(Ended::AsAsked),
                Next::Hold(wanted) if wanted != value => {
                    ensure!(wanted.is_finite(), "the set-point {wanted} is no number");
                    value = wanted;
                    waiting = Some(rig.send(&Request::SetPoint { quantity, value })?);
                    sent = Some(rig.elapsed());
                }
                Next::Hold(_) => {}
            }
        }
        if !ran && rig.elapsed() > begun + READY_WITHIN {
            let status = status(rig)?;
            bail!("no telemetry of a running rig comes (state `{}`)", state_name(status.state));
        }
    }
}
