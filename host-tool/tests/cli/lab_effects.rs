//! `discover --effects`: effects that a laboratory writes itself take part in everything, in each of the four shapes.

use std::f64::consts::{PI, TAU};
use std::fmt::Write;

use crate::support::Bench;

const PERIOD_S: f64 = 0.02;
const SAMPLES: usize = 500;
const RECORDINGS: usize = 9;

/// What a rig of these tests hides.
struct Secret {
    /// What the pressure (over its span) becomes, sample by sample.
    pressure: fn(&[f64]) -> Vec<f64>,
    /// What thresholds are multiplied by at a pressure.
    thresholds: fn(f64) -> f64,
    /// What is added to the displacement, from the pressure and the time in the recording.
    added: fn(f64, f64) -> f64,
}

const PLAIN: Secret = Secret { pressure: <[f64]>::to_vec, thresholds: |_| 1.0, added: |_, _| 0.0 };

/// Writes the recordings of a rig of twelve play operators, 2 bar and some millimetres, into `data` and two more into `kept`.
fn record(bench: &Bench, secret: &Secret) {
    // A linear congruential generator (Numerical Recipes, 7.1): the noise is a sum of twelve even deviates.
    let mut state = 7_u32;
    let mut noise = || {
        let mut sum = -6.0;
        for _ in 0..12 {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            sum += f64::from(state) / f64::from(u32::MAX);
        }
        sum
    };
    let command = |recording: usize| -> Vec<f64> {
        let rate = 0.25 + 0.13 * (recording % 5) as f64;
        let shrink = 0.02 + 0.03 * (recording % 3) as f64;
        let at = |sample: usize| {
            let time_s = (sample as f64 * PERIOD_S - 1.0).max(0.0);
            0.5 * (-shrink * time_s).exp() * (1.0 - (TAU * rate * time_s).cos())
        };
        (0..SAMPLES).map(at).collect()
    };
    // Laws are of the pressure over its span: the highest of all is 1.
    let span = (0..RECORDINGS).flat_map(command).fold(0.0, f64::max);
    for recording in 0..RECORDINGS + 2 {
        let u: Vec<f64> = command(recording).iter().map(|value| value / span).collect();
        let v = (secret.pressure)(&u);
        let mut states = [0.0_f64; 12];
        let mut text = "time_s,pressure_bar,displacement_mm,session_time_s\n".to_owned();
        for sample in 0..SAMPLES {
            let mut y = 0.0;
            for (operator, state) in (0_u32..).zip(&mut states) {
                let threshold = 0.03 * f64::from(operator) * (secret.thresholds)(v[sample]);
                *state = (v[sample] - threshold).max((v[sample] + threshold).min(*state));
                y += *state * 0.15;
            }
            let time_s = sample as f64 * PERIOD_S;
            y += (secret.added)(u[sample], time_s) + 0.003 * noise();
            writeln!(text, "{time_s:.3},{:.6},{:.6},{:.3}", 2.0 * u[sample], 4.0 * y, time_s + 15.0 * recording as f64)
                .expect("a string takes all");
        }
        let folder = if recording < RECORDINGS { "data" } else { "kept" };
        bench.write(&format!("{folder}/run{recording:02}.csv"), &text);
    }
}

/// Lets `discover` find the effect of a file, and `evaluate` reproduce its figures without that file; the effect's parameters.
fn found(bench: &Bench, secret: &Secret, effect: &str) -> serde_json::Value {
    record(bench, secret);
    bench.write("lab.toml", effect);
    bench.works("discover --data data --holdout kept --effects lab.toml --out found --json result.json");
    let result = bench.json("result.json");
    assert_eq!(result["verdict"], "named", "{result}");
    assert_eq!(result["effects"][0]["name"], "sleeve", "{result}");
    assert!(result["gap_closed"].as_f64().expect("a number") > 0.95, "{result}");
    std::fs::remove_file(bench.path("lab.toml")).expect("the file of effects can be removed");
    bench.works("evaluate --model found/model.toml --data kept --json errors.json");
    let [told, simulated] =
        [&result["rmse_after"], &bench.json("errors.json")["pooled_rmse"]].map(|value| value.as_f64().expect("a number"));
    assert!((told / simulated - 1.0).abs() < 1e-9, "{told} told, {simulated} simulated");
    result["effects"][0]["parameters"].clone()
}

fn assert_near(value: &serde_json::Value, truth: f64, share: f64) {
    let value = value.as_f64().expect("a number");
    assert!((value / truth - 1.0).abs() < share, "{value} instead of {truth}");
}

#[test]
fn a_curve_of_the_pressure_that_a_lab_wrote_is_named_with_its_parameter() {
    let bench = Bench::new();
    let secret = Secret { pressure: |u| u.iter().map(|u| u + 0.06 * (3.0 * PI * u).sin()).collect(), ..PLAIN };
    let effect = r#"
        [[effect]]
        name = "sleeve"
        shape = "static-map"
        law = "u + depth * sin(3 * PI * u)"
        parameters.depth = { low = 0.005, high = 0.3 }
    "#;
    assert_near(&found(&bench, &secret, effect)["depth"], 0.06, 0.1);
}

#[test]
fn a_differential_equation_that_a_lab_wrote_is_named_with_its_parameter() {
    let bench = Bench::new();
    // Fills through a sleeve that opens with the pressure; a hundred steps a sample.
    let pressure = |u: &[f64]| {
        let mut x = 0.0;
        (0..u.len())
            .map(|sample| {
                let before = u[sample.saturating_sub(1)];
                for step in 0..100 {
                    let now = before + (u[sample] - before) * f64::from(step) / 100.0;
                    x += PERIOD_S / 100.0 * (now - x) * (0.25 + x) / 0.06;
                }
                x
            })
            .collect()
    };
    let effect = r#"
        [[effect]]
        name = "sleeve"
        shape = "first-order"
        law = "(u - x) * (0.25 + x) / tau"
        parameters.tau = { low = 0.005, high = 1.0, unit = "s" }
    "#;
    assert_near(&found(&bench, &Secret { pressure, ..PLAIN }, effect)["tau_s"], 0.06, 0.1);
}

#[test]
fn a_law_of_the_thresholds_that_a_lab_wrote_is_named_with_its_parameter() {
    let bench = Bench::new();
    let secret = Secret { thresholds: |v| 1.0 + 0.6 * (TAU * v).cos(), ..PLAIN };
    let effect = r#"
        [[effect]]
        name = "sleeve"
        shape = "threshold"
        law = "1 + depth * cos(TAU * u)"
        parameters.depth = { low = 0.05, high = 0.95 }
    "#;
    assert_near(&found(&bench, &secret, effect)["depth"], 0.6, 0.15);
}

#[test]
fn a_column_that_a_lab_wrote_is_named_with_its_parameter() {
    let bench = Bench::new();
    let secret = Secret { added: |u, time_s| 0.08 * u * (TAU * time_s / 1.7).sin(), ..PLAIN };
    let effect = r#"
        [[effect]]
        name = "sleeve"
        shape = "column"
        law = "u * sin(TAU * t / period)"
        parameters.period = { low = 1.2, high = 2.4, unit = "s" }
    "#;
    assert_near(&found(&bench, &secret, effect)["period_s"], 1.7, 0.02);
}

#[test]
fn a_law_without_a_value_in_a_part_of_the_range_explains_nothing() {
    let bench = Bench::new();
    record(&bench, &PLAIN);
    for shape in ["static-map", "threshold", "column"] {
        let law = "law = \"u + depth * ln(u - 0.3)\"\nparameters.depth = { low = 0.01, high = 0.3 }";
        bench.write("lab.toml", format!("[[effect]]\nname = \"sleeve\"\nshape = \"{shape}\"\n{law}\n"));
        bench.works("discover --data data --holdout kept --effects lab.toml --out found --json result.json");
        let result = bench.json("result.json");
        assert_eq!(result["verdict"], "none", "{shape}: {result}");
    }
}

#[test]
fn a_law_that_makes_no_sense_is_refused_with_what_would() {
    let bench = Bench::new();
    record(&bench, &PLAIN);
    for (law, words) in [
        ("law = \"u + depth * v\"\nparameters.depth = { low = 0, high = 1 }", "none of u, depth"),
        ("law = \"u + * 2\"", "the law"),
        ("law = \"u\"\nparameters.depth = { low = 0, high = 1 }", "depth is not in the law"),
        ("law = \"u * depth\"\nparameters.depth = { low = 2, high = 1 }", "low must be less than high"),
        ("law = \"ln(-u)\"", "no finite value"),
    ] {
        bench.write("lab.toml", format!("[[effect]]\nname = \"sleeve\"\nshape = \"static-map\"\n{law}\n"));
        bench.refuses("discover --data data --effects lab.toml --out found", &["sleeve", words]);
    }
}
