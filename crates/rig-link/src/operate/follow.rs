//! A reference that a controller follows: which there are, what is played, how far the tip was from it.

use anyhow::{Context, Result, ensure};
use model_export::link::message::Telemetry;
use model_export::link::state::State;
use serde::Deserialize;
use serde_json::{Value, json};

use super::offers::Offers;
use super::reach::Reach;

/// A reference as a page asks for it.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Wanted {
    name: String,
    low_mm: f64,
    high_mm: f64,
    #[serde(default = "first")]
    seed: u64,
}

fn first() -> u64 {
    1
}

/// Farthest displacement that a reference may ask for, mm: the laser's range.
const FARTHEST_MM: f64 = 50.0;

/// Points in mm of a reference.
fn points(offers: &Offers, reference: &Value) -> Result<(String, f64, Vec<f64>)> {
    let Wanted { name, low_mm, high_mm, seed } = serde_json::from_value(reference.clone()).context("this is no reference")?;
    ensure!(
        low_mm.is_finite() && high_mm.is_finite() && low_mm < high_mm && low_mm.abs() <= FARTHEST_MM && high_mm.abs() <= FARTHEST_MM,
        "a lowest displacement below the highest is wanted, both within {FARTHEST_MM} mm"
    );
    let points_mm = (offers.reference)(&name, [low_mm, high_mm], seed).with_context(|| format!("there is no reference {name}"))?;
    Ok((name, offers.reference_period_s, points_mm))
}

/// What a reference would ask for, mm, and what is to be told of it.
///
/// # Errors
/// When there is none of this kind, or the tip does not get there.
pub fn preview(offers: &Offers, reach: &Reach, reference: &Value) -> Result<Value> {
    let (_, period_s, points_mm) = points(offers, reference)?;
    let note = reach.check(&points_mm)?;
    Ok(json!({ "period_s": period_s, "points_mm": points_mm, "note": note }))
}

/// A reference that is followed.
pub struct Following {
    controller: String,
    reference: String,
    /// Where the tip shall go, mm.
    pub points_mm: Vec<f64>,
    /// Time from one point to the next, ms.
    pub period_ms: u32,
    index: u32,
    count: u32,
    squares_mm2: f64,
    worst_mm: f64,
    outputs_bar: Option<[f64; 2]>,
    complete: bool,
}

impl Following {
    /// Nothing of it is followed yet.
    pub fn new(offers: &Offers, reach: &Reach, controller: &str, reference: &Value) -> Result<Self> {
        let (reference, period_s, points_mm) = points(offers, reference)?;
        reach.check(&points_mm)?;
        Ok(Self {
            controller: controller.to_owned(),
            reference,
            points_mm,
            period_ms: (period_s * 1e3).round() as u32,
            index: 0,
            count: 0,
            squares_mm2: 0.0,
            worst_mm: 0.0,
            outputs_bar: None,
            complete: false,
        })
    }

    /// What is followed with what.
    pub fn name(&self) -> String {
        format!("{} with {}", self.reference, self.controller)
    }

    /// How far it is, 0 to 1.
    pub fn share(&self) -> f64 {
        f64::from(self.index) / self.points_mm.len() as f64
    }

    /// Takes a sample.
    pub fn see(&mut self, told: &Telemetry) {
        if told.state != State::Running || told.playback_index == 0 {
            return;
        }
        self.index = told.playback_index;
        let output_bar = f64::from(told.output_ubar) * 1e-6;
        let [low, high] = self.outputs_bar.unwrap_or([output_bar; 2]);
        self.outputs_bar = Some([low.min(output_bar), high.max(output_bar)]);
        let Some(displacement_mm) = told.displacement_mm else { return };
        let error_mm = f64::from(displacement_mm - told.set_point);
        self.count += 1;
        self.squares_mm2 += error_mm * error_mm;
        self.worst_mm = self.worst_mm.max(error_mm.abs());
    }

    /// The device stopped at the end of the points.
    pub fn has_played(&mut self) {
        self.complete = true;
    }

    /// Whether the end was reached.
    pub fn is_complete(&self) -> bool {
        self.complete
    }

    fn figures(&self) -> Value {
        let [low, high] = self.outputs_bar.unwrap_or_default();
        json!({
            "controller": self.controller, "reference": self.reference, "share": self.share().min(1.0), "samples": self.count,
            "rmse_mm": (self.count > 0).then(|| (self.squares_mm2 / f64::from(self.count)).sqrt()), "worst_mm": self.worst_mm,
            "output_span_bar": high - low, "problem": null,
        })
    }

    /// How far the laser's displacement was from the reference.
    pub fn result(&self) -> Value {
        self.figures()
    }

    /// As [`Self::result`], of one that did not reach its end.
    pub fn ended(&self, why: &str) -> Value {
        let mut figures = self.figures();
        figures["problem"] = why.into();
        figures
    }
}
