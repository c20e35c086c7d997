//! How far the tip goes: what a reference may ask for.
//!
//! It is measured whenever the rig runs and vents without a fault. Before that a simulated rig asks its plant, and a board its settings.

use anyhow::{Result, ensure};
use dashboard::{Phase, Sample};
use serde::Serialize;
use serde_json::{Value, json};
use simulation::plant::Plant;

/// The tip comes to rest within this after the rig stopped, device time, ms.
const VENTS_MS: u64 = 1000;
/// A pressure counts as higher than another one from this difference on, bar: the sensor's noise is below it.
const HIGHER_BAR: f64 = 0.02;
/// A stroke that was measured up to this share of the ceiling is the whole one.
const WHOLE_SHARE: f64 = 0.95;
/// Up to less than this share it says little: play hides much of a small stroke.
const TELLING_SHARE: f64 = 0.5;
/// So far beyond its reach, as a share of it, a tip may be asked to go: the ends of a measured reach are no sharper.
const BORNE_SHARE: f64 = 0.02;
/// What is left to either side by the reference that is offered first, as a share of the reach.
const SPARED_SHARE: f64 = 0.1;
/// The ramp from no pressure to the ceiling that a simulated plant is asked with, s; slow beside every effect but creep.
const RAMP_S: f64 = 10.0;
const STEP_S: f64 = 0.02;

/// Who says so.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Source {
    Measured,
    Simulated,
    Settings,
}

/// Displacements between which the tip goes, mm, up to a pressure.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reach {
    pub source: Source,
    pub low_mm: f64,
    pub high_mm: f64,
    /// Highest pressure for which that is known, bar.
    pub up_to_bar: f64,
    /// The rig's ceiling, bar.
    pub ceiling_bar: f64,
}

impl Reach {
    /// What the plant of a simulated rig does between no pressure and a ceiling; `rest_mm` is where its tip rests.
    pub fn of_plant(plant: &Plant, ceiling_bar: f64, rest_mm: f64) -> Self {
        let count = (RAMP_S / STEP_S) as usize;
        let up = (0..count).map(|point| ceiling_bar * point as f64 / count as f64);
        let pressure_bar: Vec<f64> = up.clone().chain([ceiling_bar]).chain(up.rev()).chain(std::iter::repeat_n(0.0, count / 10)).collect();
        let displacement_mm = plant.simulate(&pressure_bar, STEP_S, 1);
        let (low_mm, high_mm) = displacement_mm[count..].iter().fold((f64::MAX, f64::MIN), |(low, high), mm| (low.min(*mm), high.max(*mm)));
        Self { source: Source::Simulated, low_mm: rest_mm + low_mm, high_mm: rest_mm + high_mm, up_to_bar: ceiling_bar, ceiling_bar }
    }

    /// What the straight line of the settings says.
    pub fn of_line(offset_mm: f64, mm_per_bar: f64, ceiling_bar: f64) -> Self {
        Self { source: Source::Settings, low_mm: offset_mm, high_mm: offset_mm + mm_per_bar * ceiling_bar, up_to_bar: 0.0, ceiling_bar }
    }

    /// Whether it is known up to the ceiling.
    pub fn is_whole(&self) -> bool {
        self.up_to_bar >= WHOLE_SHARE * self.ceiling_bar
    }

    /// The best of what is known: measured up to the ceiling, or simulated, or measured far enough, or what the settings say.
    pub fn best(measured: Option<Self>, simulated: Option<Self>, line: Self) -> Self {
        let far_enough = |reach: &Self| reach.up_to_bar >= TELLING_SHARE * reach.ceiling_bar;
        measured.filter(Self::is_whole).or(simulated).or(measured.filter(far_enough)).unwrap_or(line)
    }

    /// In a sentence.
    pub fn sentence(&self) -> String {
        let Self { low_mm, high_mm, up_to_bar, ceiling_bar, .. } = self;
        match self.source {
            Source::Simulated => {
                format!("The simulated tip goes from {low_mm:.2} to {high_mm:.2} mm below the ceiling of {ceiling_bar:.2} bar.")
            }
            Source::Measured if self.is_whole() => {
                format!(
                    "The tip went from {low_mm:.2} to {high_mm:.2} mm, measured up to {up_to_bar:.2} bar; the ceiling is {ceiling_bar:.2} bar."
                )
            }
            Source::Measured => format!(
                "The tip went from {low_mm:.2} to {high_mm:.2} mm so far, up to {up_to_bar:.2} of {ceiling_bar:.2} bar; beyond that nothing is \
                 measured."
            ),
            Source::Settings => format!(
                "The stroke is not measured yet; by control.linear_mm_per_bar the tip goes from {low_mm:.2} to {high_mm:.2} mm. Run the rig up to \
                 its ceiling once, and it is known."
            ),
        }
    }

    /// Checks where a reference goes; gives what is to be told before it plays.
    ///
    /// # Errors
    /// When it goes where the tip does not get.
    pub fn check(&self, points_mm: &[f64]) -> Result<String> {
        let (from_mm, to_mm) = points_mm.iter().fold((f64::MAX, f64::MIN), |(low, high), mm| (low.min(*mm), high.max(*mm)));
        let borne_mm = BORNE_SHARE * (self.high_mm - self.low_mm);
        let within = from_mm >= self.low_mm - borne_mm && to_mm <= self.high_mm + borne_mm;
        let (asks, sentence) = (format!("The reference goes from {from_mm:.2} to {to_mm:.2} mm."), self.sentence());
        ensure!(within || !self.is_whole(), "{asks} {sentence}");
        Ok(if within { sentence } else { format!("{asks} {sentence} It may be out of reach.") })
    }

    /// For the page: with the range that it offers first.
    pub fn told(&self) -> Value {
        let span_mm = self.high_mm - self.low_mm;
        // Round numbers, inwards.
        let step_mm = 10_f64.powf((span_mm.max(1e-3)).log10().floor() - 1.0);
        let round = |value: f64| format!("{value:.6}").parse::<f64>().unwrap_or(value);
        let offered_mm = [
            round(((self.low_mm + SPARED_SHARE * span_mm) / step_mm).ceil() * step_mm),
            round(((self.high_mm - SPARED_SHARE * span_mm) / step_mm).floor() * step_mm),
        ];
        json!({
            "source": self.source, "low_mm": self.low_mm, "high_mm": self.high_mm, "up_to_bar": self.up_to_bar, "ceiling_bar": self.ceiling_bar,
            "offered_mm": offered_mm, "sentence": self.sentence(),
        })
    }
}

/// Displacements since the highest pressure was met, mm, and that pressure, bar.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Extremes {
    low_mm: f64,
    high_mm: f64,
    up_to_bar: f64,
}

/// The stroke of a rig, as far as it was measured.
#[derive(Debug, Default)]
pub struct Stroke {
    known: Option<Extremes>,
    /// Of the run under way, or of the vent behind it.
    run: Option<Extremes>,
    ran_ms: u64,
}

impl Stroke {
    /// What was measured does not hold any more.
    pub fn forget(&mut self) {
        *self = Self::default();
    }

    /// Takes a sample; whether more is known now. A run counts once it is vented without a fault.
    pub fn see(&mut self, sample: &Sample) -> bool {
        match sample.phase {
            Phase::Fault => self.run = None,
            Phase::Running => self.ran_ms = sample.time_ms,
            _ if self.run.is_none() => {}
            _ if sample.time_ms.saturating_sub(self.ran_ms) > VENTS_MS => return self.keep(),
            _ => {}
        }
        let runs = sample.phase == Phase::Running || self.run.is_some();
        if let (true, Some(bar), Some(mm)) = (runs, sample.pressure_bar, sample.displacement_mm) {
            let (bar, mm) = (f64::from(bar), f64::from(mm));
            let run = self.run.get_or_insert(Extremes { low_mm: mm, high_mm: mm, up_to_bar: bar });
            if bar > run.up_to_bar + HIGHER_BAR {
                *run = Extremes { low_mm: mm, high_mm: mm, up_to_bar: bar };
            }
            (run.low_mm, run.high_mm) = (run.low_mm.min(mm), run.high_mm.max(mm));
        }
        false
    }

    fn keep(&mut self) -> bool {
        let Some(run) = self.run.take() else { return false };
        let before = self.known;
        self.known = Some(match before {
            Some(known) if run.up_to_bar <= known.up_to_bar + HIGHER_BAR => {
                Extremes { low_mm: known.low_mm.min(run.low_mm), high_mm: known.high_mm.max(run.high_mm), ..known }
            }
            _ => run,
        });
        self.known != before
    }

    /// What was measured.
    pub fn reach(&self, ceiling_bar: f64) -> Option<Reach> {
        let Extremes { low_mm, high_mm, up_to_bar } = self.known?;
        Some(Reach { source: Source::Measured, low_mm, high_mm, up_to_bar, ceiling_bar })
    }
}

#[cfg(test)]
mod tests {
    use simulation::plant::PlantConfig;

    use super::*;

    fn plant() -> Plant {
        Plant::new(PlantConfig::default()).unwrap()
    }

    /// A run up to a pressure and down to nothing, and a second of venting, of the default plant, 20 ms apart.
    fn run(stroke: &mut Stroke, up_to_bar: f64, end: Phase) -> bool {
        let up = (0..=50).map(|point| up_to_bar * f64::from(point) / 50.0);
        let pressure_bar: Vec<f64> = up.clone().chain(up.rev()).chain(std::iter::repeat_n(0.0, 60)).collect();
        let displacement_mm = plant().simulate(&pressure_bar, STEP_S, 1);
        let samples = pressure_bar.iter().zip(displacement_mm).enumerate().map(|(index, (bar, mm))| Sample {
            time_ms: 20 * index as u64,
            phase: if index < 102 { Phase::Running } else { end },
            pressure_bar: Some(*bar as f32),
            displacement_mm: Some(mm as f32),
            ..Sample::default()
        });
        // All of them are seen.
        samples.filter(|sample| stroke.see(sample)).count() > 0
    }

    #[test]
    fn a_plant_reaches_what_its_operators_sum_up_to() {
        // Eq. (2) by hand: w (3 - r) at the ceiling, w r behind it.
        let held: f64 =
            PlantConfig::default().thresholds_bar.iter().zip(PlantConfig::default().weights_mm_per_bar).map(|(r, w)| r * w).sum();
        let reach = Reach::of_plant(&plant(), 3.0, 5.0);
        assert!((reach.low_mm - 5.0 - held).abs() < 1e-9 && (reach.high_mm - 8.0 + held).abs() < 1e-9, "{reach:?}");
        let told = Reach::of_plant(&plant(), 3.0, 0.0).told();
        assert_eq!(told["offered_mm"], json!([0.5, 2.5]), "{told}");
    }

    #[test]
    fn a_run_is_measured_once_it_is_vented_and_a_fault_measures_nothing() {
        let mut stroke = Stroke::default();
        assert!(!run(&mut stroke, 3.0, Phase::Fault));
        assert_eq!(stroke.reach(3.0), None);
        assert!(run(&mut stroke, 1.0, Phase::Idle));
        let (part, line) = (stroke.reach(3.0).unwrap(), Reach::of_line(0.0, 4.0, 3.0));
        assert_eq!(Reach::best(Some(part), None, line), line, "a third of the ceiling says little");
        assert!(!part.is_whole() && part.check(&[0.5, 2.5]).unwrap().contains("may be out of reach"), "{part:?}");
        assert!(run(&mut stroke, 3.0, Phase::Idle));
        assert!(!run(&mut stroke, 2.0, Phase::Idle), "less tells nothing new");
        assert_eq!(Reach::best(stroke.reach(4.0), None, line), stroke.reach(4.0).unwrap());
        let (whole, truth) = (stroke.reach(3.0).unwrap(), Reach::of_plant(&plant(), 3.0, 0.0));
        assert!(whole.is_whole(), "{whole:?}");
        // The last step before the highest pressure is 0.06 bar.
        assert!((whole.low_mm - truth.low_mm).abs() < 1e-6 && (whole.high_mm - truth.high_mm).abs() < 1e-6, "{whole:?}, {truth:?}");
        stroke.forget();
        assert_eq!(stroke.reach(3.0), None);
    }

    #[test]
    fn a_reference_out_of_reach_is_refused_where_the_reach_is_known_and_told_where_it_is_not() {
        let reach = Reach::of_plant(&plant(), 3.0, 0.0);
        assert!(reach.check(&[0.5, 2.5]).is_ok() && reach.check(&[0.2, 2.8]).is_ok());
        let refused = reach.check(&[1.0, 5.0]).unwrap_err().to_string();
        assert!(refused.contains("1.00 to 5.00 mm") && refused.contains("0.20 to 2.80 mm"), "{refused}");
        assert!(reach.check(&[-0.5, 2.0]).is_err());
        let line = Reach::of_line(0.0, 4.0, 3.0);
        assert!(line.check(&[1.0, 5.0]).unwrap().contains("not measured yet"));
        assert!(line.check(&[1.0, 13.0]).unwrap().contains("may be out of reach"));
    }
}
