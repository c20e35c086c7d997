//! `catheter rig calibrate` on simulated rigs whose sensors and valve err.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde_json::Value;

use crate::support::Bench;

/// How a rig errs.
#[derive(Debug)]
struct Errors {
    laser_zero_mm: f64,
    laser_gain: f64,
    pressure_zero_bar: f64,
    pressure_gain: f64,
    dead_band_share: f64,
    hysteresis_share: f64,
    valve_gain: f64,
    regulator_ms: f64,
    falling_ms: f64,
    dead_time_ms: u32,
}

impl Errors {
    /// Zeros off by up to 0.4 mm, gains by up to 7 %; a dead band that is one, since 10 % of nothing is nothing.
    fn draw(seed: u64) -> Self {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        Self {
            laser_zero_mm: random.random_range(-0.4..0.4),
            laser_gain: random.random_range(0.93..1.07),
            pressure_zero_bar: random.random_range(-0.06..0.06),
            pressure_gain: random.random_range(0.93..1.07),
            dead_band_share: random.random_range(0.02..0.08),
            hysteresis_share: random.random_range(0.0..0.01),
            valve_gain: random.random_range(0.93..1.07),
            regulator_ms: random.random_range(10.0..25.0),
            falling_ms: random.random_range(10.0..35.0),
            dead_time_ms: random.random_range(0..20),
        }
    }

    fn hardware(&self) -> String {
        format!(
            "rest_mm = 3.0\nregulator_ms = {}\nregulator_falling_ms = {}\ndead_time_ms = {}\n\
             [laser]\nzero = {}\ngain = {}\n[pressure]\nzero = {}\ngain = {}\n\
             [valve]\ndead_band_share = {}\nhysteresis_share = {}\ngain = {}\n",
            self.regulator_ms,
            self.falling_ms,
            self.dead_time_ms,
            self.laser_zero_mm,
            self.laser_gain,
            self.pressure_zero_bar,
            self.pressure_gain,
            self.dead_band_share,
            self.hysteresis_share,
            self.valve_gain
        )
    }
}

fn quantity(result: &Value, name: &str) -> (f64, Option<f64>) {
    let all =
        result["findings"].as_array().into_iter().flatten().flat_map(|finding| finding["quantities"].as_array().into_iter().flatten());
    let found = all.into_iter().find(|quantity| quantity["name"] == name).unwrap_or_else(|| panic!("{name} is missing from {result}"));
    (found["value"].as_f64().expect("a value"), found["half_width"].as_f64())
}

/// The ceiling in force, bar.
const CEILING_BAR: f64 = 2.0;

#[test]
fn twenty_rigs_that_err_are_calibrated_from_zero_to_saved_settings() {
    for seed in 0..20 {
        let bench = Bench::new();
        let errors = Errors::draw(7100 + seed);
        bench.write("rig.toml", errors.hardware());
        bench.works(&format!("rig --flash rig.flash --hardware rig.toml settings set limits.ceiling_bar={CEILING_BAR} --save"));
        bench.works(&format!("rig --flash rig.flash --hardware rig.toml --seed {seed} calibrate --save --json found.json"));
        let found = bench.json("found.json");
        let near = |name: &str, truth: f64, tolerance: f64| {
            let (value, _) = quantity(&found, name);
            assert!((value - truth).abs() <= tolerance, "rig {seed}: {name} is {value}, and {truth} in truth; {errors:?}");
        };
        // Half a per cent of the span: 20 mm, 6 bar, and one.
        near("laser zero", errors.laser_zero_mm, 0.005 * 20.0);
        near("laser span", errors.laser_gain, 0.005 * errors.laser_gain);
        near("pressure zero", errors.pressure_zero_bar, 0.005 * 6.0);
        near("pressure span", errors.pressure_gain, 0.005 * errors.pressure_gain);
        near("valve dead band", errors.dead_band_share, 0.1 * errors.dead_band_share);
        near("valve.full_scale_bar", 5.0 * errors.valve_gain, 0.02 * 5.0);
        near("valve hysteresis", errors.hysteresis_share, 0.001);
        // A regulator of first order in steps of 1 ms.
        let exact_ms = |regulator_ms: f64| -1.0 / (1.0 - 1.0 / regulator_ms).ln();
        near("fill time constant", exact_ms(errors.regulator_ms), 2.0);
        near("vent time constant", exact_ms(errors.falling_ms), 2.0);
        near("fill dead time", f64::from(errors.dead_time_ms), 2.5);
        let peak_bar = found["simulated_peak_bar"].as_f64().expect("a peak");
        assert!(peak_bar > 0.5 * CEILING_BAR && peak_bar < CEILING_BAR, "rig {seed}: {peak_bar} bar");

        // What was saved makes the device read the truth: the rig at rest lies at 3 mm, and 0.8 bar are 0.8 bar by the hardware's own truth.
        bench.works("rig --flash rig.flash --hardware rig.toml status --json status.json");
        let reading = &bench.json("status.json")["reading"];
        let rest_mm = reading["displacement_mm"].as_f64().expect("a displacement");
        assert!((rest_mm - 3.0).abs() < 0.02, "rig {seed}: {rest_mm} mm at rest");
        bench.works("rig --flash rig.flash --hardware rig.toml hold --arm --pressure-bar 0.8 --seconds 1 --json hold.json");
        let held_bar = bench.json("hold.json")["reading"]["pressure_bar"].as_f64().expect("a pressure");
        // Half the valve's hysteresis, and the sensor's noise.
        let tolerance_bar = 5.0 * 0.5 * errors.hysteresis_share + 0.02;
        assert!((held_bar - 0.8).abs() < tolerance_bar, "rig {seed}: {held_bar} bar instead of 0.8");
    }
}

#[test]
fn a_page_shows_the_curves_and_without_save_nothing_stays_changed() {
    let bench = Bench::new();
    bench.write("rig.toml", Errors::draw(7200).hardware());
    let line = "rig --flash rig.flash --hardware rig.toml";
    let said = bench.works(&format!("{line} calibrate --steps noise,laser,pressure --html page.html --json found.json")).stdout;
    assert!(said.contains("step 1 of 3: noise") && said.contains("THE RIG IS PRESSURISED") && said.contains("Not saved"), "{said}");
    assert!(bench.works(&format!("{line} settings diff --defaults")).stdout.contains("No setting differs"));
    let page = String::from_utf8(bench.read("page.html")).expect("HTML is text");
    assert!(
        page.contains("<svg") && page.contains("laser.low_mm") && page.contains("\u{b1}") && page.contains("Not saved"),
        "the page lacks something"
    );
    assert!(page.contains("script-src 'sha256-") && page.matches("<script>").count() == 1, "one script runs, allowed by its hash");
    let (noise_mm, _) = quantity(&bench.json("found.json"), "laser noise");
    // Two codes to either side, equally likely: a standard deviation of 1.414 codes of 0.00336 mm.
    assert!((noise_mm - 1.414 * 0.003_358).abs() < 0.0006, "{noise_mm}");
}

#[test]
fn answers_come_from_a_file_and_wrong_ones_are_refused() {
    let bench = Bench::new();
    bench.write("answers.toml", "placed_mm = [4.0, 8.0, 16.0]\n");
    let said = bench.works("rig calibrate --steps laser --distances-mm 4,8,16 --answers answers.toml --json found.json");
    assert!(said.stdout.contains("laser.low_mm"), "{}", said.stdout);
    let (gain, half) = quantity(&bench.json("found.json"), "laser span");
    assert!((gain - 1.0).abs() < 0.001 && half.is_some_and(|half| half < 0.01), "{gain} {half:?}");
    // A gauge that shows more than the ceiling ends it.
    bench.write("high.toml", "gauge_bar = [0.0, 3.2]\n");
    bench.refuses("rig calibrate --steps pressure --answers high.toml", &["3.200 bar", "ceiling"]);
    bench.write("wrong.toml", "gauge = 1\n");
    bench.refuses("rig calibrate --answers wrong.toml", &["wrong.toml", "gauge"]);
    bench.refuses("rig calibrate --steps lazer", &["noise, laser, pressure, valve, response"]);
    bench.refuses("rig calibrate --steps laser --distances-mm 4", &["two distances"]);
    bench.refuses("rig calibrate --steps laser --distances-mm 4,4,4", &["spread"]);
    // A supply that fails is no valve.
    let said = bench.run("rig calibrate --steps valve --inject supply-fails");
    assert_eq!(said.code, 2, "{}", said.stdout);
    assert!(said.stderr.contains("step valve"), "{}", said.stderr);
}
