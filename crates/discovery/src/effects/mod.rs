//! The effects that discovery knows, one file each; [`catalogue::forms`] registers them. `sticking` and `session_curve` are
//! forms that two of them share.

pub mod activation_threshold;
pub mod asymmetric_hysteresis;
pub mod catalogue;
pub mod clock_skew;
pub mod creep;
pub mod dead_time;
pub mod earlier;
pub mod fill_vent_asymmetry;
pub mod first_cycle_softening;
pub mod gain_drift;
pub mod hold_after_reversal;
pub mod leakage;
pub mod of_a_file;
pub mod offset_drift;
pub mod other_input;
pub mod periodic_disturbance;
pub mod pneumatic_lag;
pub mod rate_dependent_hysteresis;
pub mod resonance;
pub mod sample_and_hold;
pub mod session_curve;
pub mod setup_change;
pub mod slew_limit;
pub mod smooth_hysteresis;
pub mod softening_of_pressure;
pub mod static_nonlinearity;
pub mod stick_slip;
pub(crate) mod sticking;
pub mod supply_saturation;
pub mod valve_dead_band;
