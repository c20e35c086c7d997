//! A pressure path through given points, the common form of all signals that are not a formula.

/// How to get from one point to the next.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Shape {
    /// At constant rate.
    Straight,
    /// Starting and ending at rest: 10 s^3 - 15 s^4 + 6 s^5, the least jerk.
    Smooth,
}

/// Points in order of time; before the first and after the last the pressure stays.
pub(super) struct Path {
    shape: Shape,
    points: Vec<(f64, f64)>,
}

impl Path {
    pub(super) fn new(shape: Shape, start_bar: f64) -> Self {
        Self { shape, points: vec![(0.0, start_bar)] }
    }

    /// Where the path ends: time in s and pressure in bar.
    pub(super) fn end(&self) -> (f64, f64) {
        self.points[self.points.len() - 1]
    }

    /// Goes to a pressure within a time.
    pub(super) fn go(&mut self, pressure_bar: f64, within_s: f64) {
        self.points.push((self.end().0 + within_s, pressure_bar));
    }

    /// Stays for a time.
    pub(super) fn hold(&mut self, time_s: f64) {
        self.go(self.end().1, time_s);
    }

    /// The pressures at ascending times.
    pub(super) fn at(&self, times: &[f64]) -> Vec<f64> {
        let mut next = 0;
        let mut pressures = Vec::with_capacity(times.len());
        for &time in times {
            while next < self.points.len() && self.points[next].0 <= time {
                next += 1;
            }
            pressures.push(match (next.checked_sub(1).map(|before| self.points[before]), self.points.get(next)) {
                (Some((_, pressure)), None) => pressure,
                (None, Some(&(_, pressure))) => pressure,
                (Some((start_s, start_bar)), Some(&(end_s, end_bar))) => {
                    let s = (time - start_s) / (end_s - start_s);
                    let way = match self.shape {
                        Shape::Straight => s,
                        Shape::Smooth => s * s * s * (10.0 + s * (6.0 * s - 15.0)),
                    };
                    start_bar + way * (end_bar - start_bar)
                }
                (None, None) => f64::NAN,
            });
        }
        pressures
    }
}
