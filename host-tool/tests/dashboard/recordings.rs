//! Recordings of a rig that every computation can make something of.

use std::fmt::Write;

/// A plain actuator at 50 Hz: 3 mm/bar behind 40 ms of dead time and a lag of 100 ms, driven by a sine that grows faster.
pub fn actuator(seconds: u32, hertz_per_s: f64) -> String {
    let samples = 50 * seconds;
    let pressure = |sample: u32| {
        let time = f64::from(sample) * 0.02;
        (1.3 - 1.2 * (std::f64::consts::TAU * (0.2 + hertz_per_s * time) * time).cos()).clamp(0.0, 2.6)
    };
    let mut text = "time_s,pressure_bar,displacement_mm\n".to_owned();
    let mut level = 0.0;
    for sample in 0..samples {
        let mut sum = 0.0;
        for tick in 20 * sample..20 * (sample + 1) {
            level += (pressure(tick.saturating_sub(40) / 20) - level) * 0.01;
            sum += level;
        }
        writeln!(text, "{:.2},{:.6},{:.6}", f64::from(sample) * 0.02, pressure(sample), 2.0 + 3.0 * sum / 20.0).expect("a line");
    }
    text
}
