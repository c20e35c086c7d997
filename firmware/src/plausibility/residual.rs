//! Residual monitor: two quantities that should agree, one of them after a first-order response.
//!
//! The residual is what is measured less what the leader and the response make one expect. Beyond its tolerance for too long, it is a mismatch.

/// Two quantities that should agree, one of them after a first-order response.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ResidualMonitorConfig {
    /// Time constant of the response in steps; 0 is none.
    pub response_steps: f32,
    /// Tolerated difference.
    pub tolerance: f32,
    /// Steps in a row beyond the tolerance that make a mismatch.
    pub steps: u16,
}

/// The comparison, ready to run.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ResidualMonitor {
    coefficient: f32,
    tolerance: f32,
    steps: u16,
}

/// The comparison so far.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ResidualState {
    expected: Option<f32>,
    beyond: u16,
}

impl ResidualMonitorConfig {
    /// Builds the comparison.
    pub fn build(&self) -> ResidualMonitor {
        // Backward Euler of a first-order lag: stable for every time constant.
        ResidualMonitor { coefficient: 1.0 / (1.0 + self.response_steps), tolerance: self.tolerance, steps: self.steps }
    }
}

impl ResidualMonitor {
    /// Whether `measured` has failed to follow `leader` for too long. The response starts where `measured` is.
    pub fn step(&self, state: &mut ResidualState, leader: f32, measured: f32) -> bool {
        let before = state.expected.unwrap_or(measured);
        let expected = before + self.coefficient * (leader - before);
        state.expected = Some(expected);
        // Not `>`: a difference that is no number is beyond every tolerance.
        let within = distance(measured, expected) <= self.tolerance;
        state.beyond = if within { 0 } else { state.beyond.saturating_add(1) };
        state.beyond >= self.steps
    }
}

fn distance(a: f32, b: f32) -> f32 {
    let difference = a - b;
    if difference < 0.0 { -difference } else { difference }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_monitor_tolerates_its_response_and_nothing_slower() {
        let monitor = ResidualMonitorConfig { response_steps: 20.0, tolerance: 0.3, steps: 30 }.build();
        let mut state = ResidualState::default();
        let mut measured = 0.0;
        for _ in 0..500 {
            measured += (2.0 - measured) / 25.0;
            assert!(!monitor.step(&mut state, 2.0, measured));
        }
        let mut state = ResidualState::default();
        let mismatch = (1..500).find(|_| monitor.step(&mut state, 2.0, 0.0));
        // The expected pressure passes 0.3 bar in the fourth step.
        assert_eq!(mismatch, Some(33));
        assert!(monitor.step(&mut ResidualState { expected: Some(0.0), beyond: 29 }, f32::NAN, 0.0));
    }
}
