//! The law of a valve with a dead band: it opens when the error between command and pressure passes the band, lets the pressure follow, and closes when
//! little error is left.

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
}

#[cfg(test)]
mod tests {
    use super::*;

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
}
