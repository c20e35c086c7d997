//! Limits of the device that a session needs at hand.

use anyhow::{Result, bail};
use model_export::link::settings::SettingValue;

use super::pace::Paced;
use crate::device_settings;
use crate::link::Client;

/// Settings that the session needs at hand.
#[derive(Clone, Copy)]
pub struct KnownLimits {
    pub ceiling_bar: f32,
    pub slew_bar_per_s: f32,
    pub host_timeout_ms: u32,
    pub estimate_bound_mm: f32,
    pub linear_mm_per_bar: f32,
    pub linear_offset_mm: f32,
}

impl KnownLimits {
    pub fn read(rig: &mut Client<Paced>) -> Result<Self> {
        let float = |rig: &mut Client<Paced>, name: &str| match device_settings::setting(rig, name)? {
            SettingValue::Float(value) => Ok(value),
            _ => bail!("{name} is no number"),
        };
        let SettingValue::Integer(host_timeout_ms) = device_settings::setting(rig, "limits.host_timeout_ms")? else {
            bail!("limits.host_timeout_ms is no time");
        };
        Ok(Self {
            ceiling_bar: float(rig, "limits.ceiling_bar")?,
            slew_bar_per_s: float(rig, "limits.slew_up_bar_per_s")?.min(float(rig, "limits.slew_down_bar_per_s")?),
            host_timeout_ms,
            estimate_bound_mm: float(rig, "observer.estimate_bound_mm")?,
            linear_mm_per_bar: float(rig, "control.linear_mm_per_bar")?,
            linear_offset_mm: float(rig, "control.linear_offset_mm")?,
        })
    }
}
