//! What happened to the ticks of a window that makes it unfit to learn from.

use model_export::link::adaptation::Adapting;

use crate::plausibility::{SensorState, Verdict};

/// The ticks of the window so far. The worst reason counts, in the order of the fields.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct WindowWatch {
    ticks: u16,
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
        self.ticks = self.ticks.saturating_add(1);
        self.not_running |= !facts.running;
        self.limited |= facts.limited;
        self.outside_domain |= facts.outside_domain;
        // A value that stands in for a rejected sample, or a gap, makes the mean one of another time.
        self.laser |= facts.lost || !matches!(facts.laser, Verdict::Good(_));
    }

    /// Ends a window of `ticks`: why it is unfit, if it is. The next one begins.
    ///
    /// A live laser is never exactly constant over a window. A window that nobody watched whole, as after other settings, is none.
    pub fn end(&mut self, ticks: u16, laser: &SensorState) -> Option<Adapting> {
        let watched = core::mem::take(self);
        if watched.not_running || watched.ticks < ticks {
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

#[cfg(test)]
mod tests {
    use super::*;

    const GOOD: TickFacts = TickFacts { running: true, limited: false, outside_domain: false, lost: false, laser: Verdict::Good(5.0) };

    /// Why a window of twenty ticks is unfit, one of them with these facts.
    fn end(odd: TickFacts) -> Option<Adapting> {
        let mut watch = WindowWatch::default();
        (0..20).for_each(|tick| watch.tick(if tick == 11 { &odd } else { &GOOD }));
        watch.end(20, &SensorState::default())
    }

    #[test]
    fn one_bad_tick_spoils_its_window_and_no_other() {
        use crate::plausibility::Rejection;
        assert_eq!(end(GOOD), None);
        assert_eq!(end(TickFacts { running: false, limited: true, ..GOOD }), Some(Adapting::NotRunning));
        assert_eq!(end(TickFacts { limited: true, ..GOOD }), Some(Adapting::Limited));
        assert_eq!(end(TickFacts { outside_domain: true, ..GOOD }), Some(Adapting::OutsideDomain));
        assert_eq!(end(TickFacts { lost: true, ..GOOD }), Some(Adapting::NoLaser));
        assert_eq!(end(TickFacts { laser: Verdict::Held(5.0, Rejection::Rate), ..GOOD }), Some(Adapting::NoLaser));
        assert_eq!(end(TickFacts { laser: Verdict::Lost(Rejection::Stuck), ..GOOD }), Some(Adapting::NoLaser));
        let mut watch = WindowWatch::default();
        watch.tick(&TickFacts { limited: true, ..GOOD });
        assert_eq!(watch.end(20, &SensorState::default()), Some(Adapting::NotRunning), "a part of a window is none");
        (0..20).for_each(|_| watch.tick(&GOOD));
        assert_eq!(watch.end(20, &SensorState::default()), None);
    }
}
