//! The steps against rigs in closed form: what goes in comes out, and no pressure comes above the ceiling on the way.

use calibration::CalibrationError;
use calibration::step::{Finding, Instruction, Kind, Measurement, Plan, Sample, SensorMap, Step};
use proptest::prelude::*;

const VOLTS_PER_CODE: f64 = 3.3 / 8190.0;
const LASER: SensorMap = SensorMap { low_v: 0.6, low: 0.0, high_v: 3.0, high: 20.0 };
const PRESSURE: SensorMap = SensorMap { low_v: 0.6, low: 0.0, high_v: 3.0, high: 6.0 };

fn plan() -> Plan {
    Plan {
        volts_per_code: VOLTS_PER_CODE,
        laser: LASER,
        pressure: PRESSURE,
        lowest_share: 0.0,
        highest_drive_share: 1.0,
        full_scale_bar: 5.0,
        ceiling_bar: 2.0,
        highest_share: 0.85,
        highest_command_bar: None,
        distances_mm: vec![2.0, 10.0, 18.0],
        pressure_levels: 6,
        staircase_levels: 24,
    }
}

/// A rig without inertia; readings are `gain` times the truth plus `zero`.
#[derive(Clone, Copy, Debug)]
struct Rig {
    laser: (f64, f64),
    pressure: (f64, f64),
    dead_share: f64,
    valve_gain: f64,
    time_constant_s: f64,
}

fn code(map: SensorMap, (zero, gain): (f64, f64), truth: f64) -> u16 {
    let reading = zero + gain * truth;
    let volts = map.low_v + (reading - map.low) / (map.high - map.low) * (map.high_v - map.low_v);
    (volts / VOLTS_PER_CODE).round() as u16
}

impl Rig {
    fn settled_bar(&self, command_bar: f64) -> f64 {
        let share = plan().drive_share(command_bar);
        5.0 * self.valve_gain * ((share - self.dead_share) / (1.0 - self.dead_share)).max(0.0)
    }

    /// Carries an instruction out; the highest true pressure goes to `peak_bar`. The gauge has three digits.
    fn carry_out(&self, instruction: &Instruction, peak_bar: &mut f64) -> Measurement {
        let codes = |reference: Option<f64>, distance_mm: f64, bar: f64| Measurement::Codes {
            reference,
            laser: vec![code(LASER, self.laser, distance_mm); 50],
            pressure: vec![code(PRESSURE, self.pressure, bar); 50],
        };
        match instruction {
            Instruction::Listen { .. } => codes(None, 5.0, 0.0),
            Instruction::PlaceTarget { distance_mm, .. } => codes(Some(*distance_mm), *distance_mm, 0.0),
            Instruction::HoldPressure { command_bar, .. } => {
                let bar = self.settled_bar(*command_bar);
                *peak_bar = peak_bar.max(bar);
                codes(Some((bar * 1e3).round() * 1e-3), 5.0, bar)
            }
            Instruction::Play { period_ms, commands_bar } => {
                let period_s = f64::from(*period_ms) * 1e-3;
                let decay = (-period_s / self.time_constant_s).exp();
                let mut bar = 0.0;
                let sample = |(index, command_bar): (usize, &f64)| {
                    let sample = Sample {
                        time_s: period_s * index as f64,
                        command_bar: *command_bar,
                        laser_code: code(LASER, self.laser, 3.0 + 2.0 * bar),
                        pressure_code: code(PRESSURE, self.pressure, bar),
                    };
                    bar = self.settled_bar(*command_bar) * (1.0 - decay) + bar * decay;
                    *peak_bar = peak_bar.max(bar);
                    sample
                };
                Measurement::Course(commands_bar.iter().enumerate().map(sample).collect())
            }
        }
    }

    fn walk(&self, kind: Kind, plan: &Plan, peak_bar: &mut f64) -> Result<(Step, Finding), CalibrationError> {
        let mut step = Step::new(kind, plan);
        while let Some(instruction) = step.next() {
            step.take(self.carry_out(&instruction, peak_bar))?;
        }
        let finding = step.finding()?;
        Ok((step, finding))
    }
}

fn value(finding: &Finding, name: &str) -> f64 {
    finding.quantity(name).unwrap_or_else(|| panic!("{name} is missing")).estimate.value
}

prop_compose! {
    fn rigs()(
        laser in (-0.4..0.4_f64, 0.93..1.07_f64), pressure in (-0.06..0.06_f64, 0.93..1.07_f64),
        dead_share in 0.0..0.1_f64, valve_gain in 0.8..1.3_f64, time_constant_s in 0.01..0.06_f64,
    ) -> Rig {
        Rig { laser, pressure, dead_share, valve_gain, time_constant_s }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    #[test]
    fn what_a_rig_errs_by_is_found_and_no_pressure_comes_near_the_ceiling(rig in rigs()) {
        let mut peak_bar = 0.0;
        let mut plan = plan();
        let (_, laser) = rig.walk(Kind::Laser, &plan, &mut peak_bar).unwrap();
        prop_assert_eq!(peak_bar, 0.0);
        // Half a code is 0.0017 mm.
        prop_assert!((value(&laser, "laser zero") - rig.laser.0).abs() < 0.005, "{laser:?}");
        prop_assert!((value(&laser, "laser span") - rig.laser.1).abs() < 0.0005, "{laser:?}");

        let (step, pressure) = rig.walk(Kind::Pressure, &plan, &mut peak_bar).unwrap();
        prop_assert!((value(&pressure, "pressure zero") - rig.pressure.0).abs() < 0.002, "{pressure:?}");
        prop_assert!((value(&pressure, "pressure span") - rig.pressure.1).abs() < 0.003, "{pressure:?}");
        plan.highest_command_bar = step.highest_command_bar();
        for (name, found) in &pressure.settings {
            match *name {
                "pressure.low_bar" => plan.pressure.low = *found,
                "pressure.high_bar" => plan.pressure.high = *found,
                other => prop_assert!(false, "{other}"),
            }
        }

        let (_, valve) = rig.walk(Kind::Valve, &plan, &mut peak_bar).unwrap();
        prop_assert!((value(&valve, "valve dead band") - rig.dead_share).abs() < 0.002, "{valve:?}");
        prop_assert!((value(&valve, "valve.full_scale_bar") / (5.0 * rig.valve_gain) - 1.0).abs() < 0.01, "{valve:?}");

        let (_, response) = rig.walk(Kind::Response, &plan, &mut peak_bar).unwrap();
        for name in ["fill time constant", "vent time constant", "laser time constant, rising"] {
            prop_assert!((value(&response, name) / (1e3 * rig.time_constant_s) - 1.0).abs() < 0.03, "{name}: {response:?}");
        }
        // The gauge's last digit, and what half a step of the staircase may be off.
        prop_assert!(peak_bar < plan.highest_share * plan.ceiling_bar + 0.05, "{peak_bar}");
        prop_assert!(peak_bar > 0.5 * plan.ceiling_bar, "so low that it says little: {peak_bar}");
    }
}

#[test]
fn a_valve_that_gives_far_more_than_its_data_sheet_says_is_approached_carefully() {
    // Almost twice the pressure that it is asked for, which nobody knows beforehand.
    let rig = Rig { laser: (0.0, 1.0), pressure: (0.0, 1.0), dead_share: 0.0, valve_gain: 1.9, time_constant_s: 0.02 };
    let mut peak_bar = 0.0;
    rig.walk(Kind::Pressure, &plan(), &mut peak_bar).unwrap();
    assert!(peak_bar < 2.0 && peak_bar > 1.0, "{peak_bar}");
}

#[test]
fn a_gauge_above_the_ceiling_a_number_that_is_none_and_the_wrong_kind_are_refused() {
    let mut step = Step::new(Kind::Pressure, &plan());
    let read = |reference: f64| Measurement::Codes { reference: Some(reference), laser: vec![1489; 50], pressure: vec![1489; 50] };
    assert_eq!(step.take(read(2.1)), Err(CalibrationError::AboveCeiling { gauge_bar: 2.1, ceiling_bar: 2.0 }));
    assert!(matches!(step.take(read(f64::NAN)), Err(CalibrationError::NotFinite(_))));
    assert_eq!(step.take(Measurement::Course(Vec::new())), Err(CalibrationError::WrongKind));
    assert_eq!(
        step.take(Measurement::Codes { reference: None, laser: vec![1; 50], pressure: vec![1; 50] }),
        Err(CalibrationError::WrongKind)
    );
    assert!(matches!(
        step.take(Measurement::Codes { reference: Some(0.0), laser: Vec::new(), pressure: Vec::new() }),
        Err(CalibrationError::TooFew { .. })
    ));
    // None of them counts.
    assert!(matches!(step.next(), Some(Instruction::HoldPressure { command_bar, .. }) if command_bar == 0.0));
    step.take(read(0.0)).unwrap();
    assert!(matches!(step.next(), Some(Instruction::HoldPressure { command_bar, .. }) if command_bar > 0.1));
    step.repeat();
    assert!(matches!(step.next(), Some(Instruction::HoldPressure { command_bar, .. }) if command_bar == 0.0));
}

#[test]
fn a_channel_that_stands_still_is_no_sensor() {
    let mut step = Step::new(Kind::Laser, &plan());
    while let Some(Instruction::PlaceTarget { distance_mm, .. }) = step.next() {
        step.take(Measurement::Codes { reference: Some(distance_mm), laser: vec![3000; 50], pressure: vec![1489; 50] }).unwrap();
    }
    assert!(matches!(step.finding(), Err(CalibrationError::NoResponse(_))));
    let mut noise = Step::new(Kind::Noise, &plan());
    noise.take(Measurement::Codes { reference: None, laser: vec![3000; 50], pressure: vec![1489; 50] }).unwrap();
    assert_eq!(noise.finding().unwrap().warnings.len(), 2, "a code that never moves is no quiet sensor");
}

#[test]
fn every_step_says_before_it_begins_whether_there_will_be_pressure() {
    for kind in Kind::ALL {
        let said = Step::new(kind, &plan()).explanation();
        let moves = matches!(kind, Kind::Pressure | Kind::Valve | Kind::Response);
        assert_eq!(said.contains("PRESSURISED") || said.contains("JUMPS"), moves, "{said}");
        assert!(said.contains("bar") == moves && (moves || said.contains("vented")), "{said}");
    }
}
