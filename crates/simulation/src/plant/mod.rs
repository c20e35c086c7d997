//! The simulated plant: the paper's Prandtl-Ishlinskii model, and effects of real rigs that can be switched on one by one.
//!
//! Signal path, with `p` the commanded pressure and every stage optional but the play operators:
//!
//! ```text
//! p -> dead time -> first-order lag -> v -> play operators, thresholds r_i + rate_gain |dv/dt| -> s = sum w_i H_i
//!   -> s + sum g_j C_j (creep) -> dead zone and saturation -> stick-slip -> measurement noise -> d
//! ```
//!
//! Without effects a sample is exactly eqs. (2) and (3). With dead time, lag, rate dependence or creep the path up to the creep runs at
//! [`INTERNAL_STEP_S`] or finer, the pressure taken as straight lines between samples; lag and creep advance by their exact exponential
//! for the value at the end of the step. Dead zone, saturation and stick-slip act once a sample, on the sampled displacement.
//! Every state starts at the equilibrium of the first sample, the play operators by the second line of eq. (2) (from zero).

mod config;
pub mod dataset;
mod effects;
mod simulate;

pub use config::{
    Creep, DeadTime, DeadZoneAndSaturation, LARGEST_PARAMETER, Lag, MeasurementNoise, PlantConfig, PlantError, RateDependence, StickSlip,
};
pub use simulate::{INTERNAL_STEP_S, Plant, RunningPlant};

#[cfg(test)]
mod tests;
