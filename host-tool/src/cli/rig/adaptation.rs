//! `catheter rig adaptation`.

use anyhow::Result;
use model_export::link::adaptation::{AdaptationReport, Adapting};
use model_export::link::message::{Reply, Request};
use serde::Serialize;

use super::Which;
use crate::backend::Rig;
use crate::cli::Outcome;
use crate::link::Client;
use crate::say;

#[derive(Serialize)]
struct Written {
    adapting: &'static str,
    zero_mm: f32,
    gain: f32,
    updates: u32,
}

/// Name and sentence of what the last window did.
fn in_words(adapting: Adapting) -> (&'static str, &'static str) {
    match adapting {
        Adapting::Off => ("off", "switched off; the setting adaptation.enabled switches it on"),
        Adapting::Both => ("both", "zero and gain follow the laser"),
        Adapting::ZeroOnly => ("zero-only", "the zero follows the laser; the tip moves too little to tell a gain"),
        Adapting::NotRunning => ("not-running", "frozen: the device does not run"),
        Adapting::Limited => ("limited", "frozen: the limiter holds the output back"),
        Adapting::NoLaser => ("no-laser", "frozen: the laser is lost, rejected, saturated or stands still"),
        Adapting::NoEstimate => ("no-estimate", "frozen: there is no estimate"),
        Adapting::OutsideDomain => ("outside-domain", "frozen: the model's input is outside of what it was trained on"),
        Adapting::Implausible => ("implausible", "frozen: laser and estimate differ by more than adaptation.gate_share allows"),
    }
}

/// What adaptation learned.
pub fn run(rig: &mut Client<Rig>, which: &Which) -> Result<Outcome> {
    let request = Request::AdaptationReport;
    let Reply::AdaptationReport(report) = rig.request(&request)? else { return Err(rig.unexpected(&request).into()) };
    let AdaptationReport { adapting, zero_mm, gain, updates } = report;
    let (name, sentence) = in_words(adapting);
    say!("adaptation {sentence}");
    say!("zero       {zero_mm:+.4} mm at the pivot");
    say!("gain       {gain:.5}");
    say!("learned    {updates} windows since its reset");
    which.write(&Written { adapting: name, zero_mm, gain, updates })?;
    Ok(Outcome::Success)
}
