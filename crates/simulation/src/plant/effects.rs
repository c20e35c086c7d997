//! The plant's state and how one internal step changes it.

use std::collections::VecDeque;

use hysteresis::play;

use super::PlantConfig;

/// Everything that the plant remembers.
pub(super) struct State {
    /// Pressures on their way through the dead time, with their age in s, newest first.
    delayed: VecDeque<(f64, f64)>,
    /// Pressure behind dead time and lag, in bar.
    pressure_bar: f64,
    /// Play operators in bar.
    plays_bar: Vec<f64>,
    /// Their weighted sum in mm.
    sum_mm: f64,
    /// Creep elements in mm.
    creeps_mm: Vec<f64>,
    /// Where the tip sticks, in mm.
    stuck_mm: Option<f64>,
}

impl State {
    /// The equilibrium at the first sample.
    pub(super) fn new(config: &PlantConfig, pressure_bar: f64) -> Self {
        let plays_bar: Vec<f64> = config.thresholds_bar.iter().map(|&threshold| play::step(threshold, pressure_bar, 0.0)).collect();
        let sum_mm = weighted(config, &plays_bar);
        let creeps_mm = vec![sum_mm; config.creep.as_ref().map_or(0, |creep| creep.gains.len())];
        Self { delayed: VecDeque::from([(0.0, pressure_bar)]), pressure_bar, plays_bar, sum_mm, creeps_mm, stuck_mm: None }
    }

    /// One internal step that ends with this commanded pressure.
    pub(super) fn advance(&mut self, config: &PlantConfig, command_bar: f64, step_s: f64) {
        let delayed_bar = match &config.dead_time {
            Some(dead_time) => self.delay(command_bar, step_s, dead_time.dead_time_s),
            None => command_bar,
        };
        let before_bar = self.pressure_bar;
        match &config.lag {
            Some(lag) => self.pressure_bar += (1.0 - (-step_s / lag.time_constant_s).exp()) * (delayed_bar - self.pressure_bar),
            None => self.pressure_bar = delayed_bar,
        }
        let widening_bar = match &config.rate_dependence {
            Some(rate) => rate.threshold_gain_s * ((self.pressure_bar - before_bar) / step_s).abs(),
            None => 0.0,
        };
        for (memory, threshold) in self.plays_bar.iter_mut().zip(&config.thresholds_bar) {
            *memory = play::step(threshold + widening_bar, self.pressure_bar, *memory);
        }
        self.sum_mm = weighted(config, &self.plays_bar);
        if let Some(creep) = &config.creep {
            for (element, time_constant_s) in self.creeps_mm.iter_mut().zip(&creep.time_constants_s) {
                *element += (1.0 - (-step_s / time_constant_s).exp()) * (self.sum_mm - *element);
            }
        }
    }

    /// The pressure of a dead time ago, by straight lines between steps.
    fn delay(&mut self, command_bar: f64, step_s: f64, dead_time_s: f64) -> f64 {
        self.delayed.iter_mut().for_each(|(age_s, _)| *age_s += step_s);
        self.delayed.push_front((0.0, command_bar));
        // Keep one entry that is older than the dead time.
        while self.delayed.len() >= 2 && self.delayed[self.delayed.len() - 2].0 >= dead_time_s {
            self.delayed.pop_back();
        }
        let last = self.delayed.len() - 1;
        let (old_age_s, old_bar) = self.delayed[last];
        if old_age_s <= dead_time_s || last == 0 {
            // Nothing that old was commanded: the pressure before the first sample was that of the first sample.
            return old_bar;
        }
        let (young_age_s, young_bar) = self.delayed[last - 1];
        young_bar + (old_bar - young_bar) * (dead_time_s - young_age_s) / (old_age_s - young_age_s)
    }

    /// The displacement at a sample; call once a sample.
    pub(super) fn displacement_mm(&mut self, config: &PlantConfig) -> f64 {
        let mut displacement_mm = self.sum_mm;
        if let Some(creep) = &config.creep {
            displacement_mm += creep.gains.iter().zip(&self.creeps_mm).map(|(gain, element)| gain * element).sum::<f64>();
        }
        if let Some(shape) = &config.dead_zone_and_saturation {
            let beyond_mm = displacement_mm.signum() * (displacement_mm.abs() - shape.dead_zone_mm).max(0.0);
            displacement_mm = shape.saturation_mm * (beyond_mm / shape.saturation_mm).tanh();
        }
        if let Some(stick) = &config.stick_slip {
            let stuck_mm = self.stuck_mm.unwrap_or(displacement_mm);
            let tip_mm = if (displacement_mm - stuck_mm).abs() > stick.band_mm { displacement_mm } else { stuck_mm };
            self.stuck_mm = Some(tip_mm);
            displacement_mm = tip_mm;
        }
        displacement_mm
    }
}

/// The weighted sum, eq. (3).
fn weighted(config: &PlantConfig, plays_bar: &[f64]) -> f64 {
    config.weights_mm_per_bar.iter().zip(plays_bar).map(|(weight, play)| weight * play).sum()
}
