//! The muscle of the virtual rig: sliders behind springs, integrated with the rate of the pressure.
//!
//! Each slider has a dead travel: it moves only while the pressure pushes against one of its stops. That is where the hysteresis comes
//! from. The stops may lie wider at high pressure (friction grows with the normal force), the two branches may bend apart, and a slider
//! may lag behind its stop by an overstress (Eyring's law) that makes the loops grow with speed.

use super::stages::STEP_S;

/// How the sliders deviate from plain ones.
#[derive(Clone, Copy, Debug, Default)]
pub struct ThresholdLaw {
    /// Relative growth of the dead travel per bar.
    pub friction_per_bar: f64,
    /// Bend of the loading branch against the unloading branch, 1/bar.
    pub branch_bend_per_bar: f64,
    /// Overstress that makes a slider `sinh(1)` times as fast as `creep_bar_per_s`, bar; zero for none.
    pub overstress_bar: f64,
    /// Speed scale of Eyring's law, bar/s.
    pub creep_bar_per_s: f64,
}

/// All sliders.
#[derive(Clone, Debug)]
pub struct Muscle {
    /// Half the dead travel of each slider, bar.
    pub slack_bar: Vec<f64>,
    /// Displacement of each slider per bar, mm.
    pub pull_mm_per_bar: Vec<f64>,
    /// Deviations.
    pub law: ThresholdLaw,
    position_bar: Vec<f64>,
}

impl Muscle {
    /// Sliders at rest at zero pressure.
    #[must_use]
    pub fn new(slack_bar: Vec<f64>, pull_mm_per_bar: Vec<f64>, law: ThresholdLaw) -> Self {
        let position_bar = vec![0.0; slack_bar.len()];
        Self { slack_bar, pull_mm_per_bar, law, position_bar }
    }

    /// Every slider back to where a new muscle has it.
    pub fn relax(&mut self) {
        self.position_bar.fill(0.0);
    }

    /// Displacement in mm one integration step after the pressure became `pressure_bar`.
    pub fn step(&mut self, pressure_bar: f64) -> f64 {
        let law = &self.law;
        let wider = 1.0 + law.friction_per_bar * pressure_bar.max(0.0);
        let bend = law.branch_bend_per_bar * pressure_bar * (3.0 - pressure_bar).max(0.0);
        let mut sum = 0.0;
        for ((slack, weights), position) in self.slack_bar.iter().zip(&self.pull_mm_per_bar).zip(&mut self.position_bar) {
            let gap = slack * wider;
            let push_up = pressure_bar + bend - gap - *position;
            let push_down = pressure_bar - bend + gap - *position;
            let push = if push_up > 0.0 {
                push_up
            } else if push_down < 0.0 {
                push_down
            } else {
                0.0
            };
            if law.overstress_bar > 0.0 {
                let speed = if push == 0.0 { 0.0 } else { law.creep_bar_per_s * (push.abs() / law.overstress_bar).min(20.0).sinh() };
                // A stiff law near the stop: never farther than the stop itself.
                *position += push.signum() * (speed * STEP_S).min(push.abs());
            } else {
                *position += push;
            }
            sum += weights * *position;
        }
        sum
    }
}
