//! Why something cannot be calibrated.

/// Why something cannot be calibrated; each message says what to do.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum CalibrationError {
    /// Fewer measurements than unknowns.
    #[error("{found} measurements, and {wanted} are wanted at least")]
    TooFew {
        /// How many there are.
        found: usize,
        /// How many are needed.
        wanted: usize,
    },
    /// The unknowns cannot be told apart.
    #[error("the measurements do not differ enough to tell {0} from them; spread the references further apart")]
    Degenerate(&'static str),
    /// A number that is none.
    #[error("{0} is not a finite number; enter the reading as a plain number")]
    NotFinite(&'static str),
    /// The channel does not follow its reference.
    #[error("{0}; check wiring and mounting, and repeat the step")]
    NoResponse(String),
    /// What was brought is not what was asked for.
    #[error("a measurement of another kind was brought than the step asked for")]
    WrongKind,
    /// A level that would go too high.
    #[error("the gauge reads {gauge_bar:.3} bar, above the ceiling of {ceiling_bar:.3} bar: vent, and check regulator and valve")]
    AboveCeiling {
        /// What the gauge reads, bar.
        gauge_bar: f64,
        /// The ceiling, bar.
        ceiling_bar: f64,
    },
}
