//! The law of a valve with a dead band: it opens when the error between command and pressure passes the band, lets the pressure follow, and closes when
//! little error is left.

use crate::data::session::Run;

/// See the module; in units of the command.
#[derive(Clone, Copy, Debug)]
pub struct Valve {
    /// Error at which it opens.
    pub band: f64,
    /// Error at which it closes.
    pub closing: f64,
    /// Time constant with which the pressure follows through it, s.
    pub flow_s: f64,
    /// What passes through it at most, per s.
    pub most_flow: f64,
}

/// Recordings before one that are gone through for the pressure at which it begins.
const BACK: usize = 3;

impl Valve {
    /// Lets the pressure follow a command that goes on a straight line from `from` to `to` within `left_s`, until the valve closes: at the most flow as
    /// long as the error is large, then on an exponential. The pressure then, whether the valve is open still, and the share that is left of an error of
    /// the pressure before.
    #[must_use]
    pub fn pass(&self, mut pressure: f64, mut from: f64, to: f64, mut left_s: f64) -> (f64, bool, f64) {
        let rate = if left_s > 0.0 { (to - from) / left_s } else { 0.0 };
        let (direction, large) = ((from - pressure).signum(), (self.most_flow * self.flow_s).max(self.closing));
        let mut keeps = 1.0;
        if (from - pressure).abs() > large {
            let nearer = self.most_flow - rate * direction;
            let spent_s = if nearer > 0.0 { (((from - pressure).abs() - large) / nearer).min(left_s) } else { left_s };
            (pressure, from, left_s) = (pressure + direction * self.most_flow * spent_s, from + rate * spent_s, left_s - spent_s);
        }
        let error = from - pressure;
        if error.abs() <= self.closing * (1.0 + 1e-9) {
            return (pressure, false, 0.0);
        }
        if left_s > 0.0 {
            let drag = rate * self.flow_s;
            keeps = (-left_s / self.flow_s).exp();
            let after = drag + (error - drag) * keeps;
            if after * direction < self.closing.max(1e-6) {
                // It closed when that much error was left.
                let aim = self.closing * direction;
                let spent_s = (self.flow_s * ((error - drag) / (aim - drag)).max(1.0).ln()).min(left_s);
                return (from + rate * spent_s - aim, false, 0.0);
            }
            pressure = to - after;
        }
        (pressure, true, keeps)
    }

    /// The share of a sample after which the error passes the band, on a straight line between the samples.
    #[must_use]
    pub fn share_until_it_opens(&self, error_before: f64, error: f64) -> f64 {
        let direction = error.signum();
        let rise = error.abs() - error_before * direction;
        if rise > 1e-9 { ((self.band - error_before * direction) / rise).clamp(0.0, 1.0) } else { 0.0 }
    }

    /// The pressure behind it in the place of the command, from this one on, the valve closed at first.
    pub fn lead(&self, path: &mut [f64], mut pressure: f64, period_s: f64) {
        let Some(&(mut before)) = path.first() else { return };
        let mut open = false;
        for value in path {
            let command = *value;
            if open || (command - pressure).abs() > self.band {
                let share = if open { 0.0 } else { self.share_until_it_opens(before - pressure, command - pressure) };
                (pressure, open, _) = self.pass(pressure, before + (command - before) * share, command, (1.0 - share) * period_s);
            }
            (before, *value) = (command, pressure);
        }
    }

    /// Where the pressure stands when the command has been at `command` for long.
    #[must_use]
    pub fn settled(&self, pressure: f64, command: f64) -> f64 {
        let error = command - pressure;
        if error.abs() > self.band { command - self.closing.copysign(error) } else { pressure }
    }

    /// Where the pressure stood when the recordings before this one were over: at the command in the first of all. It is known where the command of one has begun far from where
    /// that of the one before has ended; from there on, or from a few recordings before, the valve is led through them.
    #[must_use]
    pub fn stands(&self, run: &Run) -> f64 {
        if run.session.is_empty() {
            return run.earlier.as_ref().and_then(|earlier| earlier.pressure).unwrap_or(run.input[0]);
        }
        let end = |at: usize| run.session[at].input.last().copied().unwrap_or_default();
        let is_known = |at: &usize| *at == 0 || (run.session[*at].input[0] - end(*at - 1)).abs() > 2.0 * self.band;
        let least = run.index.saturating_sub(BACK);
        let first = (least..=run.index).rev().find(is_known).unwrap_or(least);
        let begin = if first == 0 { run.session[0].input[0] } else { end(first - 1) };
        run.session[first..run.index].iter().fold(begin, |pressure, earlier| {
            let mut path = earlier.input.clone();
            self.lead(&mut path, self.settled(pressure, earlier.input[0]), earlier.period_s);
            path[path.len() - 1]
        })
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use recording::{Recording, Signal};

    use super::*;
    use crate::data::session::Session;

    const VALVES: [Valve; 2] = [
        Valve { band: 0.06, closing: 0.012, flow_s: 0.02, most_flow: 1e3 },
        Valve { band: 0.06, closing: 0.012, flow_s: 1e-3, most_flow: 4.0 },
    ];

    fn command(time_s: f64) -> f64 {
        0.5 - 0.3 * (1.3 * time_s).cos() - 0.2 * (0.41 * time_s).cos()
    }

    #[test]
    fn its_pressure_is_that_of_the_law_in_fine_steps() {
        const STEP_S: f64 = 1e-5;
        for valve in VALVES {
            let mut path: Vec<f64> = (0..600).map(|sample| command(0.02 * f64::from(sample))).collect();
            valve.lead(&mut path, 0.03, 0.02);
            let (mut pressure, mut open, mut squares) = (0.03, false, 0.0);
            for step in 0..600 * 2000_u32 {
                if step % 2000 == 0 {
                    squares += (path[step as usize / 2000] - pressure).powi(2) / 600.0;
                }
                let error: f64 = command(f64::from(step) * STEP_S) - pressure;
                open = error.abs() > if open { valve.closing } else { valve.band };
                pressure += if open { STEP_S * (error / valve.flow_s).clamp(-valve.most_flow, valve.most_flow) } else { 0.0 };
            }
            // Where the command turns just beyond the band the moment of opening is hardly known.
            assert!(f64::sqrt(squares) < 0.02 * valve.band, "{} by {valve:?}", f64::sqrt(squares));
        }
    }

    #[test]
    fn a_recording_begins_where_those_before_have_left_the_pressure_and_a_far_command_leaves_it_at_the_edge() {
        let sample = |sample: usize| command(0.02 * sample as f64);
        let recording = |at: usize, from: f64| {
            let time_s: Vec<f64> = (0..200).map(|sample| 0.02 * sample as f64).collect();
            let input: Vec<f64> = (0..200).map(|step| from + sample(200 * at + step)).collect();
            let path = format!("{at}.csv");
            Recording::new(Path::new(&path), Signal::pressure_bar(), Signal::displacement_mm(), time_s, input.clone(), input)
                .expect("a recording")
        };
        for valve in VALVES {
            let whole: Vec<Recording> = (0..3).map(|at| recording(at, 0.0)).collect();
            let session = Session::new(&whole, &[]).expect("a session");
            let mut path: Vec<f64> = session.runs.iter().flat_map(|run| run.input.clone()).collect();
            valve.lead(&mut path, session.runs[0].input[0], 0.02);
            for run in &session.runs[1..] {
                let (own, wanted) = (valve.settled(valve.stands(run), run.input[0]), path[200 * run.index]);
                // The valve may be open from one to the next.
                assert!((own - wanted).abs() < 0.2 * valve.band, "{}: {own} and {wanted} by {valve:?}", run.name);
            }
            // The second begins far above: what the first left makes no difference.
            let apart = Session::new(&[recording(0, 0.0), recording(1, 0.4)], &[]).expect("a session");
            let run = &apart.runs[1];
            let edge = run.input[0] - valve.settled(valve.stands(run), run.input[0]);
            assert!((edge - valve.closing).abs() < 1e-12, "{edge} by {valve:?}");
        }
    }
}
