//! Tuning: what controllers need, from recordings. Nothing is sent to a device from here: the results are files.
//!
//! ```text
//! recordings ─► fit: the actuator with intervals ─► gains: the best in simulation that keep their margins ─► settings, blob
//! ```

mod excitation;
pub mod fit;
pub mod gains;
pub mod margins;
pub mod simulate;

use firmware::control::FeedForward;
use model_export::link::settings::SettingValue;

pub use excitation::excitation;
pub use fit::{FitError, Fitted};
pub use gains::Gains;

use crate::control::{Controller, Reach, SettingValues, setting};
use crate::export::{self, ExportError};
use crate::identify::{self, Choice, Family, FitConfig, IdentifyError, Thresholds};
use crate::recording::Recording;
use simulate::Limits;

/// Shares of the recorded range that references keep away from its ends: below, the actuator does not answer, above it saturates.
const MARGIN_SHARES: (f64, f64) = (0.05, 0.1);
/// Operators of the estimator that goes into the blob when no model is given.
const ESTIMATOR_OPERATORS: usize = 16;

/// Why tuning failed.
#[derive(Debug, thiserror::Error)]
pub enum TuneError {
    /// The actuator cannot be identified.
    #[error(transparent)]
    Fit(#[from] FitError),
    /// The estimator cannot be identified.
    #[error(transparent)]
    Identify(#[from] IdentifyError),
    /// The estimator has no blob.
    #[error(transparent)]
    Export(#[from] ExportError),
    /// The physics has no front end.
    #[error(transparent)]
    Physics(#[from] identify::ModelError),
}

/// Everything that tuning found.
#[derive(Clone, Debug)]
pub struct Tuned {
    /// The identified actuator.
    pub fitted: Fitted,
    /// Where references should lie.
    pub reach: Reach,
    /// Gains of the feedback alone.
    pub alone: Gains,
    /// Gains beside a feed-forward that inverts the lags too.
    pub beside: Gains,
    /// A model with the actuator in it.
    pub blob: Vec<u8>,
}

/// What tuning does now.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Progress {
    /// Fits the actuator: steps of the descent that are done, and how many there are at most.
    Actuator {
        /// Done.
        done: usize,
        /// At most.
        most: usize,
    },
    /// Looks for gains: sets of them that are simulated, and how many there are.
    Gains {
        /// Whether beside a feed-forward.
        beside: bool,
        /// Done.
        done: usize,
        /// In all.
        of: usize,
    },
    /// Identifies the estimator and quantises it.
    Estimator,
}

/// Tunes controllers to recordings of commanded pressure and displacement; gains are found on references made from `seed`. `watch` hears how far
/// it is.
///
/// # Errors
/// When the recordings do not show what is needed.
pub fn tune(recordings: &[Recording], limits: Limits, seed: u64, watch: &dyn Fn(Progress)) -> Result<Tuned, TuneError> {
    let fitted = fit::fit(recordings, &|done, most| watch(Progress::Actuator { done, most }))?;
    let (low, high) = fitted.range_mm;
    let reach = Reach { low_mm: low + MARGIN_SHARES.0 * (high - low), high_mm: high - MARGIN_SHARES.1 * (high - low) };
    let bench = gains::Bench { fitted: &fitted, reach, limits };
    let alone = bench.gains(FeedForward::None, seed, &|done, of| watch(Progress::Gains { beside: false, done, of }))?;
    let beside = bench.gains(FeedForward::Physics, seed, &|done, of| watch(Progress::Gains { beside: true, done, of }))?;
    watch(Progress::Estimator);
    let config = FitConfig {
        thresholds: Thresholds::Grid(ESTIMATOR_OPERATORS),
        family: Some(Family::Play),
        dead_time_s: Choice::Auto,
        lag_time_constant_s: Choice::Auto,
        ..FitConfig::default()
    };
    let estimator = export::from_physics(&identify::fit(recordings, &config)?.model)?;
    let blob = export::export_with(&estimator, recordings, Some(fitted.compensation.clone()))?.bytes;
    Ok(Tuned { fitted, reach, alone, beside, blob })
}

impl Tuned {
    /// What adaptation must know of actuator and loop; it stays switched off.
    fn adaptation(&self) -> SettingValues {
        let float = |name: &str, value: f64| setting(name, SettingValue::Float(value as f32));
        let (low_mm, high_mm) = self.fitted.range_mm;
        // The setting's bounds; beyond them the loop has no certificate, and arming is refused with adaptation.
        let delay_ms = (gains::longest_delay_s(&self.fitted) * 1e3).ceil().clamp(20.0, 600.0);
        vec![
            float("adaptation.pivot_mm", 0.5 * (low_mm + high_mm)),
            // Within the bounds of the setting.
            float("adaptation.span_mm", (high_mm - low_mm).clamp(0.1, 1000.0)),
            setting("adaptation.loop_delay_ms", SettingValue::Integer(delay_ms as u32)),
        ]
    }

    /// The settings of one controller.
    #[must_use]
    pub fn settings(&self, controller: Controller) -> SettingValues {
        let gains = if controller.feed_forward == 0 { &self.alone } else { &self.beside };
        let float = |name: &str, value: f64| setting(name, SettingValue::Float(value as f32));
        let bound_mm = 2.0 * f64::from(self.fitted.compensation.error_mm);
        let mut settings = controller.settings();
        settings.extend([
            float("control.linear_mm_per_bar", self.fitted.line.0),
            float("control.linear_offset_mm", self.fitted.line.1),
            float("pid.proportional", gains.proportional),
            float("pid.integral_per_s", gains.integral_per_s),
            float("pid.derivative_s", gains.derivative_s),
            float("pid.derivative_filter_s", gains.derivative_filter_s),
            float("pid.limit_mm", gains.limit_mm),
            float("observer.estimate_bound_mm", bound_mm),
            // The recordings' length tells how slowly the model goes astray: its bound is reached in a minute.
            float("observer.widening_mm_per_s", bound_mm / 60.0),
        ]);
        settings.extend(self.adaptation());
        settings
    }
}
