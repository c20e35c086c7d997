//! The plant's parameters and their TOML file.

use std::path::Path;

use serde::{Deserialize, Serialize};

/// No parameter is larger than this in its unit: a kilometre, a million bar, eleven days. Products of the largest ones are still finite.
pub const LARGEST_PARAMETER: f64 = 1e6;

/// Parameters of the plant; effects that are absent are off.
///
/// ```toml
/// thresholds_bar = [0.0, 0.15, 0.30, 0.45, 0.60]
/// weights_mm_per_bar = [0.35, 0.25, 0.20, 0.12, 0.08]
///
/// [lag]
/// time_constant_s = 0.2
/// ```
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PlantConfig {
    /// Thresholds of the play operators in bar.
    pub thresholds_bar: Vec<f64>,
    /// Their weights in mm/bar.
    pub weights_mm_per_bar: Vec<f64>,
    /// Dead time between command and pressure.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub dead_time: Option<DeadTime>,
    /// First-order lag between command and pressure.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub lag: Option<Lag>,
    /// Thresholds that grow with the rate.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rate_dependence: Option<RateDependence>,
    /// Slow after-movement.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub creep: Option<Creep>,
    /// Asymmetry and saturation of the displacement.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub dead_zone_and_saturation: Option<DeadZoneAndSaturation>,
    /// A tip that sticks and then jumps.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub stick_slip: Option<StickSlip>,
    /// White noise of the laser.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub measurement_noise: Option<MeasurementNoise>,
}

/// The pressure at the muscle is the command of a while ago.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DeadTime {
    /// How long ago, in s.
    pub dead_time_s: f64,
}

/// The pressure follows the command as a first-order lag.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Lag {
    /// Time constant in s.
    pub time_constant_s: f64,
}

/// The threshold of every play operator is `r_i + gain |dv/dt|`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RateDependence {
    /// Growth of the thresholds in bar per bar/s.
    pub threshold_gain_s: f64,
}

/// A Kelvin-Voigt chain: the displacement is `s + sum_j g_j C_j`, each `C_j` following `s` with its own time constant.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Creep {
    /// Time constants in s.
    pub time_constants_s: Vec<f64>,
    /// Gains, as shares of the displacement.
    pub gains: Vec<f64>,
}

/// `saturation tanh(z / saturation)` with `z` the displacement beyond the dead zone, zero within it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DeadZoneAndSaturation {
    /// Displacement that is lost before the tip moves, in mm.
    pub dead_zone_mm: f64,
    /// Displacement that is never exceeded, in mm.
    pub saturation_mm: f64,
}

/// The tip stays until it is further than the band from where it should be, then jumps there.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StickSlip {
    /// Half width of the band in mm.
    pub band_mm: f64,
}

/// White Gaussian noise added to the displacement.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MeasurementNoise {
    /// Standard deviation in mm.
    pub standard_deviation_mm: f64,
}

/// Why a plant cannot be built.
#[derive(Debug, thiserror::Error)]
pub enum PlantError {
    /// The file cannot be read.
    #[error("{path}: cannot be read ({problem}); give a plant file, `pi` or `all-effects`")]
    Open {
        /// The file.
        path: String,
        /// What the system said.
        problem: String,
    },
    /// The file is not a valid plant.
    #[error("{path}: is no valid plant file: {problem}")]
    Syntax {
        /// The file.
        path: String,
        /// The parser's message with line and column.
        problem: String,
    },
    /// A value that makes no sense.
    #[error("plant: {field} {problem}")]
    Value {
        /// The field.
        field: &'static str,
        /// What is wrong with it.
        problem: String,
    },
}

impl Default for PlantConfig {
    /// Five play operators without effects. The paper prints neither thresholds nor weights; these are the project's, chosen to look
    /// like its loops: a total gain of 1 mm/bar and a loop about 0.2 mm wide at 2 bar.
    fn default() -> Self {
        Self {
            thresholds_bar: vec![0.0, 0.15, 0.30, 0.45, 0.60],
            weights_mm_per_bar: vec![0.35, 0.25, 0.20, 0.12, 0.08],
            dead_time: None,
            lag: None,
            rate_dependence: None,
            creep: None,
            dead_zone_and_saturation: None,
            stick_slip: None,
            measurement_noise: None,
        }
    }
}

impl PlantConfig {
    /// The default plant with every effect but noise on.
    #[must_use]
    pub fn all_effects() -> Self {
        Self {
            dead_time: Some(DeadTime { dead_time_s: 0.06 }),
            lag: Some(Lag { time_constant_s: 0.2 }),
            rate_dependence: Some(RateDependence { threshold_gain_s: 0.02 }),
            creep: Some(Creep { time_constants_s: vec![1.0, 8.0], gains: vec![0.03, 0.03] }),
            dead_zone_and_saturation: Some(DeadZoneAndSaturation { dead_zone_mm: 0.05, saturation_mm: 2.5 }),
            stick_slip: Some(StickSlip { band_mm: 0.02 }),
            ..Self::default()
        }
    }

    /// Whether an effect is on that runs at the internal step.
    #[must_use]
    pub fn is_continuous(&self) -> bool {
        self.dead_time.is_some() || self.lag.is_some() || self.rate_dependence.is_some() || self.creep.is_some()
    }

    /// The text of the plant file.
    ///
    /// # Panics
    /// Never: every plant is representable.
    #[must_use]
    pub fn to_toml(&self) -> String {
        toml::to_string(self).expect("a plant is representable in TOML")
    }

    /// Checks that the parameters make sense.
    ///
    /// # Errors
    /// Naming the first field that does not.
    pub fn validate(&self) -> Result<(), PlantError> {
        let bad = |field, problem: String| Err(PlantError::Value { field, problem });
        let positive = |field, value: f64| match value > 0.0 && value <= LARGEST_PARAMETER {
            true => Ok(()),
            false => bad(field, format!("is {value:?}, a positive number of at most {LARGEST_PARAMETER} is wanted")),
        };
        let not_negative = |field, value: f64| match (0.0..=LARGEST_PARAMETER).contains(&value) {
            true => Ok(()),
            false => bad(field, format!("is {value:?}, a number from 0 to {LARGEST_PARAMETER} is wanted")),
        };
        if self.thresholds_bar.is_empty() {
            return bad("thresholds_bar", "is empty; give at least one play operator".to_owned());
        }
        if self.thresholds_bar.len() != self.weights_mm_per_bar.len() {
            let (thresholds, weights) = (self.thresholds_bar.len(), self.weights_mm_per_bar.len());
            return bad("weights_mm_per_bar", format!("has {weights} values for {thresholds} thresholds; give one weight a threshold"));
        }
        self.thresholds_bar.iter().try_for_each(|&threshold| not_negative("thresholds_bar", threshold))?;
        if let Some(weight) = self.weights_mm_per_bar.iter().find(|weight| !(-LARGEST_PARAMETER..=LARGEST_PARAMETER).contains(*weight)) {
            return bad("weights_mm_per_bar", format!("holds {weight:?}, numbers of at most {LARGEST_PARAMETER} are wanted"));
        }
        if let Some(dead_time) = &self.dead_time {
            not_negative("dead_time.dead_time_s", dead_time.dead_time_s)?;
            if dead_time.dead_time_s > 60.0 {
                return bad("dead_time.dead_time_s", format!("is {}, at most 60 s make sense", dead_time.dead_time_s));
            }
        }
        if let Some(lag) = &self.lag {
            positive("lag.time_constant_s", lag.time_constant_s)?;
        }
        if let Some(rate) = &self.rate_dependence {
            not_negative("rate_dependence.threshold_gain_s", rate.threshold_gain_s)?;
        }
        if let Some(creep) = &self.creep {
            creep.time_constants_s.iter().try_for_each(|&value| positive("creep.time_constants_s", value))?;
            creep.gains.iter().try_for_each(|&value| not_negative("creep.gains", value))?;
            if creep.gains.len() != creep.time_constants_s.len() {
                let (gains, constants) = (creep.gains.len(), creep.time_constants_s.len());
                return bad("creep.gains", format!("has {gains} values for {constants} time constants; give one gain each"));
            }
        }
        if let Some(shape) = &self.dead_zone_and_saturation {
            not_negative("dead_zone_and_saturation.dead_zone_mm", shape.dead_zone_mm)?;
            positive("dead_zone_and_saturation.saturation_mm", shape.saturation_mm)?;
        }
        if let Some(stick) = &self.stick_slip {
            not_negative("stick_slip.band_mm", stick.band_mm)?;
        }
        if let Some(noise) = &self.measurement_noise {
            not_negative("measurement_noise.standard_deviation_mm", noise.standard_deviation_mm)?;
        }
        Ok(())
    }
}

/// Reads a plant file.
pub(super) fn read(path: &Path) -> Result<PlantConfig, PlantError> {
    let name = path.display().to_string();
    let text = output::read_text(path).map_err(|error| PlantError::Open { path: name.clone(), problem: error.to_string() })?;
    toml::from_str(&text).map_err(|error| PlantError::Syntax { path: name, problem: error.to_string() })
}
