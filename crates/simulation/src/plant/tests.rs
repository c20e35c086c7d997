use super::*;
use crate::excitation::sets::{SetConfig, paper_training};

/// Eqs. (2) and (3) as printed, without any of the plant's code.
fn equations_2_and_3(pressure: &[f64]) -> Vec<f64> {
    let (r, w) = ([0.0, 0.15, 0.30, 0.45, 0.60], [0.35, 0.25, 0.20, 0.12, 0.08]);
    let mut h = [0.0_f64; 5];
    pressure
        .iter()
        .map(|&p| {
            let mut d = 0.0;
            for i in 0..5 {
                h[i] = f64::max(p - r[i], f64::min(p + r[i], h[i]));
                d += w[i] * h[i];
            }
            d
        })
        .collect()
}

fn paper_pressure() -> Vec<f64> {
    paper_training(&SetConfig { seed: 11, ..SetConfig::default() })[8].excitation.sample().expect("samples").pressure_bar
}

fn with(change: impl FnOnce(&mut PlantConfig)) -> Vec<f64> {
    let mut config = PlantConfig::default();
    change(&mut config);
    Plant::new(config).expect("valid").simulate(&paper_pressure(), 0.02, 3)
}

/// Simulates a plant of one pure play operator (the identity), so that an effect stands alone.
fn identity_with(change: impl FnOnce(&mut PlantConfig), pressure: &[f64], period_s: f64) -> Vec<f64> {
    let mut config = PlantConfig { thresholds_bar: vec![0.0], weights_mm_per_bar: vec![1.0], ..PlantConfig::default() };
    change(&mut config);
    Plant::new(config).expect("valid").simulate(pressure, period_s, 3)
}

#[test]
fn the_default_plant_is_exactly_equations_2_and_3() {
    assert_eq!(with(|_| ()), equations_2_and_3(&paper_pressure()));
}

#[test]
fn effects_of_zero_size_change_nothing() {
    let exact = equations_2_and_3(&paper_pressure());
    let still = with(|config| {
        config.dead_time = Some(DeadTime { dead_time_s: 0.0 });
        config.rate_dependence = Some(RateDependence { threshold_gain_s: 0.0 });
        config.creep = Some(Creep { time_constants_s: vec![1.0], gains: vec![0.0] });
        config.stick_slip = Some(StickSlip { band_mm: 0.0 });
        config.measurement_noise = Some(MeasurementNoise { standard_deviation_mm: 0.0 });
    });
    for (still, exact) in still.iter().zip(&exact) {
        assert!((still - exact).abs() < 1e-15);
    }
}

#[test]
fn each_effect_alone_and_all_together_change_the_displacement() {
    let exact = equations_2_and_3(&paper_pressure());
    let all = PlantConfig::all_effects();
    let alone: [(&str, Vec<f64>); 7] = [
        ("dead time", with(|config| config.dead_time = all.dead_time)),
        ("lag", with(|config| config.lag = all.lag)),
        ("rate dependence", with(|config| config.rate_dependence = all.rate_dependence)),
        ("creep", with(|config| config.creep.clone_from(&all.creep))),
        ("dead zone", with(|config| config.dead_zone_and_saturation = all.dead_zone_and_saturation)),
        ("stick-slip", with(|config| config.stick_slip = all.stick_slip)),
        ("all", with(|config| *config = all.clone())),
    ];
    for (name, simulated) in &alone {
        let rms = (simulated.iter().zip(&exact).map(|(a, b)| (a - b).powi(2)).sum::<f64>() / exact.len() as f64).sqrt();
        assert!(rms > 2e-3 && rms < 0.5, "{name}: {rms}");
    }
}

#[test]
fn dead_time_delays_by_whole_and_fractional_samples() {
    let pressure: Vec<f64> = (0..200).map(|k| (f64::from(k) * 0.1).sin() + 1.0).collect();
    let delayed = identity_with(|config| config.dead_time = Some(DeadTime { dead_time_s: 0.06 }), &pressure, 0.02);
    for k in 3..200 {
        assert!((delayed[k] - pressure[k - 3]).abs() < 1e-12, "sample {k}");
    }
    assert!(delayed[..3].iter().all(|&value| value == pressure[0]));
    let half = identity_with(|config| config.dead_time = Some(DeadTime { dead_time_s: 0.03 }), &pressure, 0.02);
    for k in 2..200 {
        assert!((half[k] - 0.5 * (pressure[k - 1] + pressure[k - 2])).abs() < 1e-12, "sample {k}");
    }
}

#[test]
fn lag_answers_a_step_with_its_exponential_at_any_sample_period() {
    for period_s in [0.005, 0.02, 0.1] {
        // Within one sample the pressure is a ramp to 1 bar; afterwards it stays.
        let pressure: Vec<f64> = (0..40).map(|k| if k == 0 { 0.0 } else { 1.0 }).collect();
        let lagged = identity_with(|config| config.lag = Some(Lag { time_constant_s: 0.2 }), &pressure, period_s);
        let after_ramp = 1.0 - 0.2 / period_s * (1.0 - (-period_s / 0.2_f64).exp());
        for (k, value) in lagged.iter().enumerate().skip(1) {
            let wanted = 1.0 - (1.0 - after_ramp) * (-(k as f64 - 1.0) * period_s / 0.2).exp();
            // The end-of-step rule is half an internal step early: 0.5 ms / 200 ms.
            assert!((value - wanted).abs() < 0.003, "{period_s} {k}: {value} {wanted}");
        }
    }
}

#[test]
fn creep_ends_at_its_gain_and_takes_its_time() {
    let pressure: Vec<f64> = (0..3000).map(|k| if k < 10 { 0.0 } else { 1.0 }).collect();
    let creeping = identity_with(|config| config.creep = Some(Creep { time_constants_s: vec![2.0], gains: vec![0.1] }), &pressure, 0.01);
    assert!((creeping[10] - 1.0).abs() < 0.001);
    assert!((creeping[10 + 200] - (1.0 + 0.1 * (1.0 - (-1.0_f64).exp()))).abs() < 5e-4);
    assert!((creeping[2999] - 1.1).abs() < 1e-6);
}

#[test]
fn rate_dependence_widens_the_loop_by_the_rate() {
    // A triangle of 1 bar/s: the loop of a play operator of threshold r is 2 (r + gain) wide.
    let pressure: Vec<f64> = (0..=400).map(|k| 2.0 - (f64::from(k) * 0.01 - 2.0).abs()).collect();
    let wide = identity_with(|config| config.rate_dependence = Some(RateDependence { threshold_gain_s: 0.1 }), &pressure, 0.01);
    assert!((pressure[150] - pressure[250]).abs() < 1e-12);
    assert!((wide[250] - wide[150] - 0.2).abs() < 1e-9, "{} {}", wide[150], wide[250]);
}

#[test]
fn dead_zone_saturates_and_stick_slip_keeps_its_band() {
    let pressure: Vec<f64> = (0..2000).map(|k| f64::from(k) * 0.01).collect();
    let shaped = identity_with(
        |config| config.dead_zone_and_saturation = Some(DeadZoneAndSaturation { dead_zone_mm: 0.5, saturation_mm: 3.0 }),
        &pressure,
        0.02,
    );
    assert!(shaped[50] == 0.0 && shaped[51] > 0.0 && shaped[1999] < 3.0 && shaped[1999] > 2.99);
    assert!((shaped[150] - 3.0 * (1.0 / 3.0_f64).tanh()).abs() < 1e-12);
    let slow: Vec<f64> = (0..2000).map(|k| f64::from(k) * 0.001).collect();
    let stuck = identity_with(|config| config.stick_slip = Some(StickSlip { band_mm: 0.0205 }), &slow, 0.02);
    let jumps: Vec<f64> = stuck.windows(2).map(|pair| pair[1] - pair[0]).filter(|&jump| jump != 0.0).collect();
    assert_eq!(jumps.len(), 1999 / 21);
    assert!(jumps.iter().all(|jump| (jump - 0.021).abs() < 1e-12));
}

#[test]
fn measurement_noise_has_its_size_and_follows_its_seed() {
    let noise = MeasurementNoise { standard_deviation_mm: 0.01 };
    let noisy = |seed| {
        let config = PlantConfig { measurement_noise: Some(noise), ..PlantConfig::default() };
        Plant::new(config).expect("valid").simulate(&paper_pressure(), 0.02, seed)
    };
    let exact = equations_2_and_3(&paper_pressure());
    let deviation = (noisy(1).iter().zip(&exact).map(|(a, b)| (a - b).powi(2)).sum::<f64>() / 1000.0).sqrt();
    // One sigma of the estimate from 1000 samples is 2.2 %.
    assert!((deviation - 0.01).abs() < 0.0011, "{deviation}");
    assert!(noisy(1) == noisy(1) && noisy(1) != noisy(2));
}

#[test]
fn the_file_round_trips_and_mistakes_are_named() {
    let all = PlantConfig::all_effects();
    assert_eq!(toml::from_str::<PlantConfig>(&all.to_toml()).expect("valid"), all);
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path().join("plant.toml");
    for (text, wanted) in [
        ("thresholds_bar = [0.0]\nweights_mm_per_bar = [1.0, 2.0]\n", "weights_mm_per_bar has 2 values for 1 thresholds"),
        ("thresholds_bar = [-0.1]\nweights_mm_per_bar = [1.0]\n", "thresholds_bar is -0.1"),
        ("thresholds_bar = []\nweights_mm_per_bar = []\n", "thresholds_bar is empty"),
        ("thresholds_bar = [0.1]\nweights_mm_per_bar = [nan]\n", "weights_mm_per_bar holds NaN"),
        ("thresholds_bar = [0.1]\nweights_mm_per_bar = [1e300]\n", "weights_mm_per_bar holds 1e300"),
        (
            "thresholds_bar = [0.1]\nweights_mm_per_bar = [1.0]\n[creep]\ntime_constants_s = [1.0]\ngains = [2e6]\n",
            "creep.gains is 2000000.0",
        ),
        ("thresholds_bar = [0.1]\nweights_mm_per_bar = [1.0]\n[lag]\ntime_constant_s = 0.0\n", "lag.time_constant_s is 0"),
        ("thresholds_bar = [0.1]\nweights_mm_per_bar = [1.0]\n[lagg]\n", "lagg"),
    ] {
        std::fs::write(&path, text).expect("write");
        let message = Plant::named(&path.display().to_string()).expect_err(text).to_string();
        assert!(message.contains(wanted), "{message}");
    }
    assert!(matches!(Plant::named("nowhere.toml"), Err(PlantError::Open { .. })));
}

#[test]
fn the_largest_parameters_that_are_accepted_give_a_displacement_that_a_recording_can_hold() {
    let most = LARGEST_PARAMETER;
    let config = PlantConfig {
        thresholds_bar: vec![0.0, most],
        weights_mm_per_bar: vec![most, -most],
        rate_dependence: Some(RateDependence { threshold_gain_s: most }),
        creep: Some(Creep { time_constants_s: vec![f64::MIN_POSITIVE, most], gains: vec![most, most] }),
        measurement_noise: Some(MeasurementNoise { standard_deviation_mm: most }),
        ..PlantConfig::default()
    };
    let within = |config: PlantConfig| {
        let displacement_mm = Plant::new(config).expect("valid").simulate(&paper_pressure(), 0.02, 3);
        assert!(displacement_mm.iter().all(|value| value.abs() <= recording::LARGEST));
    };
    // The smallest ones too: a saturation and a lag of next to nothing.
    let least = f64::MIN_POSITIVE;
    within(PlantConfig {
        lag: Some(Lag { time_constant_s: least }),
        dead_zone_and_saturation: Some(DeadZoneAndSaturation { dead_zone_mm: 0.0, saturation_mm: least }),
        ..config.clone()
    });
    within(config);
}

#[test]
fn a_data_set_is_written_whole_and_reads_back() {
    use dataset::{Dataset, SetKind};
    let folder = tempfile::tempdir().expect("folder");
    let plant = Plant::named("all-effects").expect("plant");
    let config = SetConfig { seed: 21, tests_per_family: 2, ..SetConfig::default() };
    let limits = crate::excitation::Limits::default();
    let set = Dataset::simulate(SetKind::Paper, &config, &limits, &plant, folder.path()).expect("simulate");
    set.write(folder.path(), &plant).expect("write");
    let tests = recording::load(&[folder.path().join("test")], None).expect("read");
    let families: String = tests.iter().map(|recording| recording.family.as_str()).collect();
    assert_eq!(families, "aabbccdd");
    assert_eq!(recording::load(&[folder.path().join("train")], None).expect("read").len(), 24);
    // What was recorded can be made again from the files beside it, bit for bit.
    let first = &set.made[0];
    let excitation =
        crate::excitation::read(&folder.path().join(format!("excitation/train/{}.toml", first.named.name))).expect("excitation");
    let plant_again = Plant::named(&folder.path().join("plant.toml").display().to_string()).expect("plant");
    let again = dataset::play(&excitation, &limits, &plant_again, &first.recording.path).expect("play");
    assert_eq!(again, first.recording);
    // The same command again is fine, another set in the same place is not.
    set.write(folder.path(), &plant).expect("write again");
    let other = Dataset::simulate(SetKind::Rich, &config, &limits, &plant, folder.path()).expect("simulate");
    let message = other.write(folder.path(), &plant).expect_err("mixture").to_string();
    assert!(message.contains("another data set"), "{message}");
}
