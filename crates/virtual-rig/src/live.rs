//! The realistic rig, live: every effect of the discovery catalogue at once, at a strength that a real bench may have, for a controller
//! to work against one millisecond at a time.
//!
//! ```text
//! valve pressure ─► tube ─► on-off spool ─► orifices ─► volume ─► choked flow ─► supply ─► leak ─► bladder ─► sliders
//!   ─► bending geometry ─► creep ─► softening ─► stick-slip ─► swinging tip ─► heartbeat ─► THE TIP
//!   ─► warm-up of zero and gain, remounted sensor, wrong samples ─► what the laser sees
//! ```
//!
//! [`super::hide`] exaggerates one effect so that it can be found; here each one has the size that data sheets and the literature on
//! pneumatic muscles make likely, and every parameter lies within 15 % of the table below, drawn from the seed.

use std::f64::consts::PI;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::muscle::{Muscle, ThresholdLaw};
use super::stages::{
    Bladder, ChokedFlow, Geometry, Heart, KelvinVoigt, LuGreTip, Moment, OnOffValve, Orifices, Pendulum, Remount, Rubber, STEP_S, Stage,
    Supply, Tube, Volume, WarmUp,
};

/// Integration steps in a millisecond.
const STEPS_PER_MS: usize = 10;
/// Where the laser sees the straight tip, mm: the zero lies inside its range, so that a swing below it is no fault code.
pub const REST_MM: f64 = 2.0;
/// Displacement over the usable pressures, mm, for shares of the stroke.
pub const STROKE_MM: f64 = 10.0;

/// How large the effects are. One value each; the seed moves all of them by up to 15 %.
mod strength {
    /// Two metres of tube (6 ms at the speed of sound) and the valve's electronics.
    pub const TRANSIT_S: f64 = 0.02;
    /// Proportional valves in on-off operation, share of the range below one per cent.
    pub const SPOOL_OPEN_BAR: f64 = 0.02;
    /// The band closes again well inside.
    pub const SPOOL_CLOSE_BAR: f64 = 0.004;
    /// Filling through a small orifice; venting to the room takes longer.
    pub const FILL_S: f64 = 0.025;
    /// See above.
    pub const VENT_S: f64 = 0.04;
    /// The muscle's volume behind two metres of tube.
    pub const VOLUME_S: f64 = 0.05;
    /// Fastest change that the valve's flow allows.
    pub const FASTEST_BAR_PER_S: f64 = 15.0;
    /// The supply regulator.
    pub const SUPPLY_BAR: f64 = 3.0;
    /// Share of the pressure that a leak takes away while the valve refills.
    pub const LEAK_SHARE: f64 = 0.01;
    /// Pressure at which the bladder touches the sleeve.
    pub const TOUCH_BAR: f64 = 0.2;
    /// Angle of the bent tip at full stroke: a sine bends by 6 %.
    pub const ANGLE_RAD: f64 = 0.6;
    /// Friction grows with the pressure.
    pub const FRICTION_PER_BAR: f64 = 0.12;
    /// Loops grow slightly with speed.
    pub const OVERSTRESS_BAR: f64 = 0.01;
    /// Creep of rubber: some per cent.
    pub const CREEP: [f64; 3] = [0.02, 0.015, 0.015];
    /// Its times.
    pub const CREEP_S: [f64; 3] = [1.0, 5.0, 25.0];
    /// The first strokes after a pause are shorter (Mullins effect).
    pub const SOFTENING: f64 = 0.015;
    /// Travel that softens.
    pub const SOFTENING_MM: f64 = 30.0;
    /// The tip sticks in its sheath.
    pub const STICTION_MM: f64 = 0.05;
    /// Swing of the tip.
    pub const SWING_HZ: f64 = 8.0;
    /// Damping of the swing.
    pub const SWING_DAMPING: f64 = 0.4;
    /// A heart that beats against the tip.
    pub const HEART_HZ: f64 = 1.15;
    /// Half a per cent of the stroke.
    pub const HEART_MM: f64 = 0.05;
    /// The laser's zero warms up.
    pub const ZERO_DRIFT_MM: f64 = 0.04;
    /// Its gain too.
    pub const GAIN_DRIFT: f64 = 0.003;
    /// In this time.
    pub const WARM_UP_S: f64 = 900.0;
    /// Somebody touches the laser's mount between identification and use.
    pub const REMOUNT_MM: f64 = 0.02;
    /// Another gain for the same reason.
    pub const REMOUNT_GAIN: f64 = 0.002;
    /// The rig's clock against the controller's.
    pub const CLOCK_SKEW: f64 = 2e-4;
    /// Wrong samples of the laser.
    pub const WRONG_SHARE: f64 = 1e-3;
}

/// What happened at the tip, for whoever judges the controller; the controller cannot see it.
#[derive(Clone, Debug, Default)]
pub struct Probe(Arc<AtomicU64>);

impl Probe {
    /// Where the tip really is, mm, in the laser's frame.
    #[must_use]
    pub fn tip_mm(&self) -> f64 {
        f64::from_bits(self.0.load(Ordering::Relaxed))
    }
}

/// A regulator that feeds a leak: the pressure sags a little behind the restriction.
struct FedLeak {
    share: f64,
    refill_s: f64,
    sag: f64,
}

impl Stage for FedLeak {
    fn step(&mut self, input: f64, _: &Moment) -> f64 {
        // Turbulent loss, as in the hidden rig's leak.
        let aim = self.share * input.max(0.0).powf(0.85);
        self.sag += STEP_S / self.refill_s * (aim - self.sag);
        input - self.sag
    }
}

/// The rig behind the valve.
pub struct RealisticRig {
    before: Vec<Box<dyn Stage>>,
    muscle: Muscle,
    tip: Vec<Box<dyn Stage>>,
    sensor: Vec<Box<dyn Stage>>,
    generator: ChaCha8Rng,
    probe: Probe,
    last_bar: f64,
    steps: f64,
    clock: f64,
    session: usize,
}

impl RealisticRig {
    /// A rig at rest. `session` 0 is the one that recordings for identification come from; in later ones the laser was remounted.
    #[must_use]
    pub fn new(seed: u64, session: usize) -> Self {
        let mut draws = ChaCha8Rng::seed_from_u64(seed);
        let mut about = |value: f64| value * draws.random_range(0.85..1.15);
        let count = 20;
        let widest_bar = about(0.45);
        let slack_bar: Vec<f64> = (0..count).map(|index| widest_bar * (f64::from(index) / f64::from(count - 1)).powf(1.5)).collect();
        let gain_mm_per_bar = about(3.9);
        let elastic = about(0.45);
        let shares: Vec<f64> = slack_bar.iter().skip(1).map(|slack| about((-1.2 * slack / widest_bar).exp())).collect();
        let total: f64 = shares.iter().sum();
        let mut weights = vec![gain_mm_per_bar * elastic];
        weights.extend(shares.iter().map(|share| gain_mm_per_bar * (1.0 - elastic) * share / total));
        let law = ThresholdLaw {
            friction_per_bar: about(strength::FRICTION_PER_BAR),
            branch_bend_per_bar: 0.0,
            overstress_bar: about(strength::OVERSTRESS_BAR),
            creep_bar_per_s: about(0.5),
        };
        let vent_s = about(strength::VENT_S);
        let before: Vec<Box<dyn Stage>> = vec![
            Box::new(Tube::new(about(strength::TRANSIT_S))),
            Box::new(OnOffValve {
                open_bar: about(strength::SPOOL_OPEN_BAR),
                close_bar: about(strength::SPOOL_CLOSE_BAR),
                flow_s: 0.01,
                open: false,
                level: 0.0,
            }),
            Box::new(Orifices { fill_s: about(strength::FILL_S), vent_s, choke_bar: about(4.0), level: 0.0 }),
            Box::new(Volume { slow_s: about(strength::VOLUME_S), fast_s: 0.003, spool: 0.0, level: 0.0 }),
            Box::new(ChokedFlow { fastest_bar_per_s: about(strength::FASTEST_BAR_PER_S), fast_s: 0.01, level: 0.0 }),
            Box::new(Supply { limit_bar: strength::SUPPLY_BAR, sharpness: 30.0 }),
            Box::new(FedLeak { share: about(strength::LEAK_SHARE), refill_s: 0.5, sag: 0.0 }),
            Box::new(Bladder { touch_bar: about(strength::TOUCH_BAR), width_bar: about(0.015) }),
        ];
        let stiction_mm = about(strength::STICTION_MM);
        let tip: Vec<Box<dyn Stage>> = vec![
            Box::new(Geometry { reach: STROKE_MM / about(strength::ANGLE_RAD), bend: 1.0 }),
            Box::new(KelvinVoigt { compliance: strength::CREEP.map(&mut about), time_s: strength::CREEP_S, strain: [0.0; 3] }),
            Box::new(Rubber { missing: about(strength::SOFTENING), distance: about(strength::SOFTENING_MM), bonds: 1.0, last: 0.0 }),
            Box::new(LuGreTip {
                static_mm: stiction_mm,
                sliding_mm: 0.6 * stiction_mm,
                stribeck_mm_per_s: 2.0,
                viscous_s: 0.002,
                inertia_s2: 2e-5,
                // Softer than the hidden rig's: behind so small a friction stiff bristles would yield within a step at 50 mm/s.
                bristle: 3.0,
                deflection_mm: 0.0,
                speed_mm_per_s: 0.0,
                position_mm: 0.0,
            }),
            Box::new(Pendulum { frequency_hz: about(strength::SWING_HZ), damping: strength::SWING_DAMPING, position: 0.0, speed: 0.0 }),
            Box::new(Heart {
                frequency_hz: about(strength::HEART_HZ),
                size_mm: about(strength::HEART_MM),
                overtones: [0.3, 0.15],
                phase: about(PI),
            }),
        ];
        let sensor: Vec<Box<dyn Stage>> = vec![
            Box::new(WarmUp { size: about(strength::ZERO_DRIFT_MM), time_s: strength::WARM_UP_S, gain: false }),
            Box::new(WarmUp { size: about(strength::GAIN_DRIFT), time_s: strength::WARM_UP_S, gain: true }),
            Box::new(Remount { from: 1, shift_mm: about(strength::REMOUNT_MM), gain: 1.0 + about(strength::REMOUNT_GAIN) }),
        ];
        let mut generator = draws;
        generator.set_stream(1 + session as u64);
        let mut rig = Self {
            before,
            muscle: Muscle::new(slack_bar, weights, law),
            tip,
            sensor,
            generator,
            probe: Probe::default(),
            last_bar: 0.0,
            steps: 0.0,
            clock: 0.0,
            session,
        };
        // The bench stood at rest for a while.
        for _ in 0..500 {
            let _ = rig.advance_ms(0.0);
        }
        rig
    }

    /// Where the tip really is.
    #[must_use]
    pub fn probe(&self) -> Probe {
        self.probe.clone()
    }

    /// A millisecond in which the valve's pressure went straight to `pressure_bar`; gives what the laser sees, mm.
    pub fn advance_ms(&mut self, pressure_bar: f64) -> f64 {
        // The rig's own clock gains a step now and then.
        self.clock += STEPS_PER_MS as f64 * (1.0 + strength::CLOCK_SKEW);
        let steps = self.clock.floor().max(1.0);
        self.clock -= steps;
        let mut tip_mm = 0.0;
        let moment = |rig: &Self| Moment { session_s: rig.steps * STEP_S, recording: rig.session };
        for step in 1..=steps as usize {
            self.steps += 1.0;
            let moment = moment(self);
            let share = step as f64 / steps;
            let mut value = self.last_bar + share * (pressure_bar - self.last_bar);
            for stage in &mut self.before {
                value = stage.step(value, &moment);
            }
            tip_mm = self.muscle.step(value);
            for stage in &mut self.tip {
                tip_mm = stage.step(tip_mm, &moment);
            }
        }
        self.last_bar = pressure_bar;
        self.probe.0.store((REST_MM + tip_mm).to_bits(), Ordering::Relaxed);
        let moment = moment(self);
        let mut seen_mm = tip_mm;
        for stage in &mut self.sensor {
            seen_mm = stage.step(seen_mm, &moment);
        }
        if self.generator.random_bool(strength::WRONG_SHARE) {
            let size = STROKE_MM * self.generator.random_range(0.1..0.6);
            seen_mm += if self.generator.random_bool(0.5) { size } else { -size };
        }
        REST_MM + seen_mm
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Where the tip is after a while at a pressure, mm.
    fn hold(rig: &mut RealisticRig, pressure_bar: f64, seconds: u32) -> f64 {
        for _ in 0..seconds * 1000 {
            rig.advance_ms(pressure_bar);
        }
        rig.probe().tip_mm()
    }

    #[test]
    fn one_pressure_has_two_displacements() {
        let mut rig = RealisticRig::new(3, 0);
        hold(&mut rig, 0.1, 1);
        let up_mm = hold(&mut rig, 1.2, 3);
        hold(&mut rig, 2.6, 3);
        let down_mm = hold(&mut rig, 1.2, 3);
        assert!(down_mm - up_mm > 0.5, "up {up_mm} mm, down {down_mm} mm");
        assert!(up_mm > REST_MM + 2.0 && down_mm < REST_MM + STROKE_MM, "up {up_mm} mm, down {down_mm} mm");
    }

    #[test]
    fn the_same_seed_is_the_same_rig_and_another_one_is_not() {
        let path = |seed| {
            let mut rig = RealisticRig::new(seed, 0);
            (0..200).map(|tick| rig.advance_ms(f64::from(tick) * 0.01)).collect::<Vec<f64>>()
        };
        assert_eq!(path(5), path(5));
        assert_ne!(path(5), path(6));
    }

    #[test]
    fn the_laser_is_wrong_now_and_then_and_the_tip_is_not() {
        let mut rig = RealisticRig::new(8, 1);
        let wrong = (0..20_000).filter(|_| (rig.advance_ms(1.0) - rig.probe().tip_mm()).abs() > 0.5).count();
        // 20 are expected; the bounds are four deviations away.
        assert!((2..=38).contains(&wrong), "{wrong}");
    }
}
