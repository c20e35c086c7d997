//! States of the device and causes of its last reset, as the link names them.
//!
//! # Example
//! ```
//! use model_export::link::state::{ResetCause, State};
//!
//! let with_pressure: Vec<State> = State::ALL.into_iter().filter(|state| state.is_energised()).collect();
//! assert_eq!(with_pressure, [State::Armed, State::Running]);
//! assert_eq!(ResetCause::from_number(ResetCause::Watchdog.number()), ResetCause::Watchdog);
//! assert_eq!(ResetCause::from_number(99), ResetCause::Other(99));
//! ```

use serde::{Deserialize, Serialize};

/// State of the device. Only [`State::Armed`] and [`State::Running`] close the dump valve.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum State {
    /// Starting; vented.
    #[default]
    Boot,
    /// Checking itself; vented.
    SelfTest,
    /// Ready to be armed; vented.
    Idle,
    /// Dump valve closed, output zero.
    Armed,
    /// Output follows the control law through the limiter.
    Running,
    /// A fault is latched; vented.
    Fault,
}

impl State {
    /// All states, in the order of their wire numbers.
    pub const ALL: [Self; 6] = [Self::Boot, Self::SelfTest, Self::Idle, Self::Armed, Self::Running, Self::Fault];

    /// Whether the dump valve is closed, so that there can be pressure.
    pub const fn is_energised(self) -> bool {
        matches!(self, Self::Armed | Self::Running)
    }
}

/// Why the device last started.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum ResetCause {
    /// The hardware does not say.
    #[default]
    Unknown,
    /// Power came up.
    PowerOn,
    /// The reset pin was pulled, for example by a debugger.
    Pin,
    /// The firmware asked for it.
    Software,
    /// The watchdog ran out.
    Watchdog,
    /// The supply voltage fell below the limit.
    BrownOut,
    /// A number of a later version.
    Other(u8),
}

impl ResetCause {
    /// Number in the frozen Hello.
    pub const fn number(self) -> u8 {
        match self {
            Self::Unknown => 0,
            Self::PowerOn => 1,
            Self::Pin => 2,
            Self::Software => 3,
            Self::Watchdog => 4,
            Self::BrownOut => 5,
            Self::Other(number) => number,
        }
    }

    /// The cause with this number; never fails, since Hello must be readable across versions.
    pub const fn from_number(number: u8) -> Self {
        match number {
            0 => Self::Unknown,
            1 => Self::PowerOn,
            2 => Self::Pin,
            3 => Self::Software,
            4 => Self::Watchdog,
            5 => Self::BrownOut,
            other => Self::Other(other),
        }
    }
}
