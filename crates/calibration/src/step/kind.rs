//! What can be calibrated.

use serde::Serialize;

/// What is calibrated.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Kind {
    /// The noise of both channels while nothing moves.
    Noise,
    /// Zero and span of the laser, from targets at known distances.
    Laser,
    /// Zero and span of the pressure sensor, against a gauge.
    Pressure,
    /// Dead band, hysteresis and full scale of the valve.
    Valve,
    /// Fill and vent times, and the delay from command to laser.
    Response,
}

impl Kind {
    /// All kinds, in the order in which they build on each other.
    pub const ALL: [Self; 5] = [Self::Noise, Self::Laser, Self::Pressure, Self::Valve, Self::Response];

    /// Its name.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Noise => "noise",
            Self::Laser => "laser",
            Self::Pressure => "pressure",
            Self::Valve => "valve",
            Self::Response => "response",
        }
    }
}
