#![doc = include_str!("../README.md")]
#![no_std]
#![forbid(unsafe_code)]

mod error;
mod list;
mod operator;
mod real;

pub mod bouc_wen;
pub mod dead_time;
pub mod dead_zone;
pub mod kelvin_voigt;
pub mod lag;
pub mod log_creep;
pub mod modified;
pub mod play;
pub mod prandtl_ishlinskii;
pub mod rate_dependent;
pub mod stick_band;
pub mod stop;

pub use bouc_wen::{BoucWen, BoucWenConfig, BoucWenState};
pub use dead_time::{DeadTime, DeadTimeState};
pub use dead_zone::DeadZones;
pub use error::Error;
pub use kelvin_voigt::{KelvinVoigt, KelvinVoigtConfig, KelvinVoigtState};
pub use lag::{Hold, Lag, LagConfig, LagState};
pub use log_creep::{LogCreep, LogCreepConfig};
pub use modified::{InverseModifiedPrandtlIshlinskii, ModifiedPrandtlIshlinskii};
pub use operator::Operator;
pub use play::Play;
pub use prandtl_ishlinskii::{PrandtlIshlinskii, PrandtlIshlinskiiState};
pub use rate_dependent::{InverseRateDependent, RateDependent, RateDependentConfig, RateDependentState};
pub use real::Real;
pub use stick_band::StickBand;
pub use stop::Stop;
