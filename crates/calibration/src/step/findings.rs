//! What the measurements of each step come to.

use super::finding::{Curve, Finding, Quantity};
use super::kind::Kind;
use super::plan::{Sample, SensorMap};
use super::sequence::{Point, RESPONSE_PERIOD_MS, STEP_MS, STEPS, Step};
use crate::line::Line;
use crate::noise::Noise;
use crate::response::Response;
use crate::valve::{Level, ValveMap};
use crate::{CalibrationError, Estimate};

/// A sensor whose span differs by more than this from its data sheet is more likely wired or mounted wrongly.
const UNLIKELY_SPAN: f64 = 0.2;
/// A sensor that gives less of its range than this for all of its reference's does not follow it.
const LEAST_SPAN: f64 = 0.05;
/// How long before a step its window begins, ms.
const LEAD_MS: u32 = 40;
/// Largest dead band that the device compensates.
const MOST_DEAD_SHARE: f64 = 0.9;

impl Step {
    /// What came of the step.
    ///
    /// # Errors
    /// When it is not complete, or the measurements show no response.
    pub fn finding(&self) -> Result<Finding, CalibrationError> {
        match self.kind {
            Kind::Noise => self.noise(),
            Kind::Laser => self.sensor(&self.plan.laser, &LASER),
            Kind::Pressure => self.sensor(&self.plan.pressure, &PRESSURE),
            Kind::Valve => self.valve(),
            Kind::Response => self.response(),
        }
    }

    fn noise(&self) -> Result<Finding, CalibrationError> {
        let (laser, pressure) = self.codes.as_ref().ok_or(CalibrationError::TooFew { found: 0, wanted: 1 })?;
        let per_code = |map: &SensorMap| self.plan.volts_per_code * (map.high - map.low) / (map.high_v - map.low_v);
        let mut quantities = Vec::new();
        let mut warnings = Vec::new();
        for (codes, map, names, unit, what) in [
            (laser, &self.plan.laser, ["laser noise", "laser peak to peak", "laser drift"], "mm", "laser"),
            (pressure, &self.plan.pressure, ["pressure noise", "pressure peak to peak", "pressure drift"], "bar", "pressure sensor"),
        ] {
            let noise = Noise::of(codes)?;
            for (name, value) in names.into_iter().zip([noise.standard_deviation, noise.peak_to_peak, noise.drift]) {
                let estimate = Estimate { value, half_width: None }.scaled(per_code(map).abs());
                quantities.push(Quantity { name, estimate, unit });
            }
            if noise.peak_to_peak == 0.0 {
                warnings.push(format!("The {what} gives the very same code all the time: it is stuck, or not connected."));
            }
        }
        Ok(Finding { kind: self.kind, quantities, settings: Vec::new(), curves: Vec::new(), warnings })
    }

    fn sensor(&self, map: &SensorMap, words: &SensorWords) -> Result<Finding, CalibrationError> {
        let volts = |point: &Point| point.code * self.plan.volts_per_code;
        let pairs: Vec<(f64, f64)> = self.points.iter().map(|point| (point.reference, volts(point))).collect();
        let line = Line::through(&pairs)?;
        let span = line.span();
        // What the device read at a reference of zero, and per reference, with the settings in use.
        let per_volt = (map.high - map.low) / (map.high_v - map.low_v);
        if span.value <= 0.0 || (span.value * per_volt).abs() < LEAST_SPAN {
            return Err(CalibrationError::NoResponse(format!("the voltage of the {} does not rise with its reference", words.sensor)));
        }
        let zero_before = Estimate { value: map.value(line.zero().value), ..line.zero().scaled(per_volt) };
        let gain_before = span.scaled(per_volt);
        let (low, high) = (line.reference(map.low_v), line.reference(map.high_v));
        let mut warnings = Vec::new();
        if (gain_before.value - 1.0).abs() > UNLIKELY_SPAN {
            warnings.push(format!(
                "The span is off by {:.0} %: rather a wrong range, shunt or unit than a sensor that errs. Check before you save.",
                100.0 * (gain_before.value - 1.0).abs()
            ));
        }
        if span.half_width.is_none() {
            warnings.push("Two references give no interval; take three or more.".to_owned());
        }
        let fitted_ends = pairs.iter().fold((f64::MAX, f64::MIN), |(a, b), (reference, _)| (a.min(*reference), b.max(*reference)));
        Ok(Finding {
            kind: self.kind,
            quantities: vec![
                Quantity { name: words.zero, estimate: zero_before, unit: words.unit },
                Quantity { name: words.gain, estimate: gain_before, unit: "" },
                Quantity { name: words.low, estimate: low, unit: words.unit },
                Quantity { name: words.high, estimate: high, unit: words.unit },
                Quantity {
                    name: words.residual,
                    estimate: Estimate { value: line.residual().unwrap_or(0.0) / span.value, half_width: None },
                    unit: words.unit,
                },
            ],
            settings: vec![(words.low, low.value), (words.high, high.value)],
            curves: vec![Curve {
                title: words.title,
                horizontal: words.horizontal,
                vertical: "voltage at the pin / V",
                fitted: [fitted_ends.0, fitted_ends.1].map(|reference| (reference, line.reading(reference).value)).to_vec(),
                residuals: pairs.iter().map(|(reference, volts)| (*reference, volts - line.reading(*reference).value)).collect(),
                measured: pairs,
            }],
            warnings,
        })
    }

    fn valve(&self) -> Result<Finding, CalibrationError> {
        let course = self.course.as_ref().ok_or(CalibrationError::TooFew { found: 0, wanted: 1 })?;
        let levels = self.levels(course);
        let map = ValveMap::of(&levels)?;
        let begin = map.begin_share();
        let full_bar = map.pressure_bar(self.plan.highest_drive_share);
        let mut warnings = Vec::new();
        if map.saturates {
            warnings.push("The upper levels gave no more pressure: the supply ends there. They were left out.".to_owned());
        }
        // A dead band that is none within its interval is no dead band.
        let is_real = begin.value > 0.0 && begin.half_width.is_none_or(|half| begin.value > half);
        let lowest_share = if is_real { begin.value.min(MOST_DEAD_SHARE) } else { 0.0 };
        let measured: Vec<(f64, f64)> = levels.iter().map(|level| (level.share, level.pressure_bar)).collect();
        let highest_share = measured.iter().map(|(share, _)| *share).fold(0.0, f64::max);
        let half = 0.5 * map.hysteresis_share().value;
        let on_line = |level: &Level| {
            let shifted = if level.rising { level.share - half } else { level.share + half };
            map.pressure_bar(shifted).value.max(0.0)
        };
        Ok(Finding {
            kind: self.kind,
            quantities: vec![
                Quantity { name: "valve dead band", estimate: begin, unit: "of full drive" },
                Quantity { name: "pressure begins rising at", estimate: map.begin_rising_share(), unit: "of full drive" },
                Quantity { name: "valve hysteresis", estimate: map.hysteresis_share(), unit: "of full drive" },
                Quantity { name: "valve.full_scale_bar", estimate: full_bar, unit: "bar" },
                Quantity {
                    name: "scatter of the valve's map",
                    estimate: Estimate { value: map.residual_bar().unwrap_or(0.0), half_width: None },
                    unit: "bar",
                },
            ],
            settings: vec![("valve.lowest_share", lowest_share), ("valve.full_scale_bar", full_bar.value)],
            curves: vec![Curve {
                title: "Valve",
                horizontal: "drive / share of full",
                vertical: "pressure / bar",
                fitted: vec![(0.0, 0.0), (begin.value.max(0.0), 0.0), (highest_share, map.pressure_bar(highest_share).value)],
                residuals: levels.iter().map(|level| (level.share, level.pressure_bar - on_line(level))).collect(),
                measured,
            }],
            warnings,
        })
    }

    fn response(&self) -> Result<Finding, CalibrationError> {
        let course = self.course.as_ref().ok_or(CalibrationError::TooFew { found: 0, wanted: 1 })?;
        let volts = self.plan.volts_per_code;
        let pressure = |sample: &Sample| self.plan.pressure.value(f64::from(sample.pressure_code) * volts);
        let laser = |sample: &Sample| self.plan.laser.value(f64::from(sample.laser_code) * volts);
        let length = (STEP_MS / RESPONSE_PERIOD_MS) as usize;
        let lead = (LEAD_MS / RESPONSE_PERIOD_MS) as usize;
        if course.len() < length * (2 * STEPS as usize + 1) - 2 * lead {
            return Err(CalibrationError::TooFew { found: course.len(), wanted: length * (2 * STEPS as usize + 1) });
        }
        // All steps of a direction one over the other, each from a moment before the command moves.
        let folded = |up: bool, value: &dyn Fn(&Sample) -> f64| -> Vec<f64> {
            let windows: Vec<&[Sample]> = (0..2 * STEPS as usize)
                .filter(|index| (index % 2 == 0) == up)
                .filter_map(|index| course.get(length * (index + 1) - lead..length * (index + 2) - 2 * lead))
                .collect();
            let mean = |at: usize| windows.iter().map(|window| value(&window[at])).sum::<f64>() / windows.len().max(1) as f64;
            (0..length - lead).map(mean).collect()
        };
        let mut quantities = Vec::new();
        let mut curves = Vec::new();
        let mut add = |up: bool, names: [&'static str; 2], title, vertical, value: &dyn Fn(&Sample) -> f64| {
            let (commands, values) = (folded(up, &|sample| sample.command_bar), folded(up, value));
            let response = Response::of(f64::from(RESPONSE_PERIOD_MS) * 1e-3, &commands, &values)?;
            let milli = |estimate: Estimate| estimate.scaled(1e3);
            quantities.push(Quantity { name: names[0], estimate: milli(response.dead_time_s), unit: "ms" });
            quantities.push(Quantity { name: names[1], estimate: milli(response.time_constant_s), unit: "ms" });
            let at = |index: usize| (index as f64 - lead as f64) * f64::from(RESPONSE_PERIOD_MS) * 1e-3;
            let over_time = |values: &[f64]| values.iter().enumerate().map(|(index, value)| (at(index), *value)).collect::<Vec<_>>();
            let residuals: Vec<f64> = values.iter().zip(&response.fitted).map(|(value, fitted)| value - fitted).collect();
            curves.push(Curve {
                title,
                horizontal: "time / s",
                vertical,
                fitted: over_time(&response.fitted),
                residuals: over_time(&residuals),
                measured: over_time(&values),
            });
            Ok::<_, CalibrationError>(response)
        };
        let fill = add(true, ["fill dead time", "fill time constant"], "Filling", "pressure / bar", &pressure)?;
        let vent = add(false, ["vent dead time", "vent time constant"], "Venting", "pressure / bar", &pressure)?;
        add(true, ["laser delay, rising", "laser time constant, rising"], "Tip, rising", "displacement / mm", &laser)?;
        add(false, ["laser delay, falling", "laser time constant, falling"], "Tip, falling", "displacement / mm", &laser)?;
        let total_ms = |response: &Response| 1e3 * (response.dead_time_s.value + response.time_constant_s.value);
        // The device compares the measured pressure with a first-order response of this time constant.
        let expected_ms = 0.5 * (total_ms(&fill) + total_ms(&vent));
        let warnings = if fill.dead_time_s.value > 0.05 {
            vec!["The pressure answers after more than 50 ms: a long or narrow tube, or a slow valve.".to_owned()]
        } else {
            Vec::new()
        };
        Ok(Finding { kind: self.kind, quantities, settings: vec![("mismatch.pressure_response_ms", expected_ms)], curves, warnings })
    }
}

/// How a sensor's figures are called.
struct SensorWords {
    sensor: &'static str,
    zero: &'static str,
    gain: &'static str,
    low: &'static str,
    high: &'static str,
    residual: &'static str,
    title: &'static str,
    horizontal: &'static str,
    unit: &'static str,
}

const LASER: SensorWords = SensorWords {
    sensor: "laser",
    zero: "laser zero",
    gain: "laser span",
    low: "laser.low_mm",
    high: "laser.high_mm",
    residual: "laser scatter",
    title: "Laser",
    horizontal: "distance / mm",
    unit: "mm",
};
const PRESSURE: SensorWords = SensorWords {
    sensor: "pressure sensor",
    zero: "pressure zero",
    gain: "pressure span",
    low: "pressure.low_bar",
    high: "pressure.high_bar",
    residual: "pressure scatter",
    title: "Pressure sensor",
    horizontal: "gauge / bar",
    unit: "bar",
};
