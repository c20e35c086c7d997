//! Why an excitation cannot be played.

/// Why an excitation cannot be played.
#[derive(Debug, thiserror::Error)]
pub enum ExcitationError {
    /// The file cannot be read.
    #[error("{path}: cannot be read ({problem}); check the path")]
    Open {
        /// The file.
        path: String,
        /// What the system said.
        problem: String,
    },
    /// The file is not a valid excitation.
    #[error("{path}: is no valid excitation file: {problem}")]
    Syntax {
        /// The file.
        path: String,
        /// The parser's message with line and column.
        problem: String,
    },
    /// A value that makes no sense.
    #[error("{place}: {problem}")]
    Value {
        /// Which segment or field.
        place: String,
        /// What is wrong and what to do.
        problem: String,
    },
    /// The pressure leaves the rig's range.
    #[error(
        "asks for {asked_bar:.3} bar at {time_s:.2} s, the rig's range is {minimum_bar} to {maximum_bar} bar; nothing was played. {remedy}"
    )]
    Pressure {
        /// The worst pressure asked for.
        asked_bar: f64,
        /// When.
        time_s: f64,
        /// Lower limit.
        minimum_bar: f64,
        /// Upper limit.
        maximum_bar: f64,
        /// What to do.
        remedy: String,
    },
    /// The pressure changes faster than the rig may.
    #[error(
        "asks for {asked_bar_per_s:.1} bar/s at {time_s:.2} s, the limit is {maximum_bar_per_s} bar/s; nothing was played. Lengthen the move (rise_s, ramp_s, a lower frequency) or lower noise_bar"
    )]
    Slew {
        /// The fastest change asked for.
        asked_bar_per_s: f64,
        /// When.
        time_s: f64,
        /// The limit.
        maximum_bar_per_s: f64,
    },
}
