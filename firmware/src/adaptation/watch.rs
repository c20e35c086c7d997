//! What happened to the ticks of a window that makes it unfit to learn from.

use model_export::link::adaptation::Adapting;

use crate::plausibility::{SensorState, Verdict};

/// The ticks of the window so far. The worst reason counts, in the order of the fields.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct WindowWatch {
    not_running: bool,
    limited: bool,
    outside_domain: bool,
    laser: bool,
}

/// What a tick knows of itself at its end.
#[derive(Clone, Copy, Debug)]
pub struct TickFacts {
    /// The control law's demand is in force.
    pub running: bool,
    /// The limiter changed the demand.
    pub limited: bool,
    /// The model sees what it was not trained on.
    pub outside_domain: bool,
    /// Ticks were lost before this one.
    pub lost: bool,
    /// What to make of the laser's sample.
    pub laser: Verdict,
}

impl WindowWatch {
    /// Takes in a tick.
    pub fn tick(&mut self, facts: &TickFacts) {
        self.not_running |= !facts.running;
        self.limited |= facts.limited;
        self.outside_domain |= facts.outside_domain;
        // A value that stands in for a rejected sample, or a gap, makes the mean one of another time.
        self.laser |= facts.lost || !matches!(facts.laser, Verdict::Good(_));
    }

    /// Ends a window of `ticks`: why it is unfit, if it is. The next one begins.
    ///
    /// A live laser is never exactly constant over a window.
    pub fn end(&mut self, ticks: u16, laser: &SensorState) -> Option<Adapting> {
        let watched = core::mem::take(self);
        if watched.not_running {
            Some(Adapting::NotRunning)
        } else if watched.limited {
            Some(Adapting::Limited)
        } else if watched.outside_domain {
            Some(Adapting::OutsideDomain)
        } else if watched.laser || laser.same_code_ticks() >= ticks {
            Some(Adapting::NoLaser)
        } else {
            None
        }
    }
}
