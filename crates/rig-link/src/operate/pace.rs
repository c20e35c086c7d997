//! Simulated time at the pace of the clock on the wall, for a rig that people look at.

use std::thread;
use std::time::{Duration, Instant};

use crate::backend::Rig;
use crate::link::{Hardware, InProcess, LinkError, Lockstep, Transport};

/// A tick.
const TICK: Duration = Duration::from_millis(1);
/// A simulation that is farther behind than this lets the time go: it is slower than the rig, or the computer slept.
const FARTHEST_BEHIND: Duration = Duration::from_millis(200);
/// The speed is measured over so long.
const SPEED_OVER: Duration = Duration::from_secs(1);

/// Where the link leads.
pub enum Line {
    /// A rig in this process that keeps no replay log: a session may last for days.
    Virtual(Box<Lockstep<InProcess>>),
    /// Any other.
    Other(Rig),
}

impl Line {
    /// Whether its time is simulated.
    pub fn is_simulated(&self) -> bool {
        match self {
            Self::Virtual(_) => true,
            Self::Other(rig) => rig.is_simulated(),
        }
    }

    /// The simulated hardware.
    pub fn hardware(&mut self) -> Option<&mut Hardware> {
        match self {
            Self::Virtual(rig) => Some(rig.hardware()),
            Self::Other(rig) => rig.hardware(),
        }
    }

    fn transport(&mut self) -> &mut dyn Transport {
        match self {
            Self::Virtual(rig) => rig.as_mut(),
            Self::Other(rig) => rig,
        }
    }
}

/// A line whose simulated time passes as fast as real time, or as fast as it can.
pub struct Paced {
    line: Line,
    /// Real and simulated time that belong together.
    begin: (Instant, Duration),
    measured: (Instant, Duration),
    speed: f32,
}

impl Paced {
    /// Begins with what time the rig has now.
    pub fn new(mut line: Line) -> Self {
        let now = (Instant::now(), line.transport().elapsed());
        Self { line, begin: now, measured: now, speed: 1.0 }
    }

    /// The line.
    pub fn line(&mut self) -> &mut Line {
        &mut self.line
    }

    /// How fast simulated time passes, 1 for real time.
    pub fn speed(&mut self) -> Option<f32> {
        if !self.line.is_simulated() {
            return None;
        }
        let (at, then) = self.measured;
        let (real, simulated) = (at.elapsed(), self.line.transport().elapsed().saturating_sub(then));
        if real >= SPEED_OVER {
            self.speed = simulated.as_secs_f32() / real.as_secs_f32();
            self.measured = (Instant::now(), self.line.transport().elapsed());
        }
        Some(self.speed)
    }

    /// Lets time begin anew: what passed since does not count.
    pub fn forget_the_past(&mut self) {
        self.begin = (Instant::now(), self.line.transport().elapsed());
    }

    fn behind(&mut self) -> Duration {
        let (real, simulated) = self.begin;
        let passed = self.line.transport().elapsed().saturating_sub(simulated);
        real.elapsed().saturating_sub(passed)
    }
}

impl Transport for Paced {
    fn send(&mut self, bytes: &[u8]) -> Result<(), LinkError> {
        self.line.transport().send(bytes)
    }

    fn receive(&mut self, limit: Duration, into: &mut Vec<u8>) -> Result<(), LinkError> {
        if !self.line.is_simulated() {
            return self.line.transport().receive(limit, into);
        }
        let (until, before) = (Instant::now() + limit, into.len());
        loop {
            if self.behind() > FARTHEST_BEHIND {
                self.forget_the_past();
            }
            let begun = Instant::now();
            // Who waits for an answer goes on with it: a slow simulation would go on catching up instead. Without a limit all is caught up.
            while self.behind() >= TICK && begun.elapsed() < FARTHEST_BEHIND && (limit.is_zero() || into.len() == before) {
                self.line.transport().receive(TICK, into)?;
            }
            let now = Instant::now();
            if into.len() > before || now >= until {
                return Ok(());
            }
            thread::sleep((until - now).min(TICK));
        }
    }

    fn elapsed(&self) -> Duration {
        match &self.line {
            Line::Virtual(rig) => rig.elapsed(),
            Line::Other(rig) => rig.elapsed(),
        }
    }

    fn place(&self) -> &str {
        match &self.line {
            Line::Virtual(rig) => rig.place(),
            Line::Other(rig) => rig.place(),
        }
    }
}
