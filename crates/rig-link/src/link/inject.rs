//! Faults that a simulated rig is asked to have, by name and in their time: `laser-unplugged`, `emergency-stop@1.5`, `line-cut@1..1.4`.

use std::str::FromStr;

use super::breakage::Breakage;

/// Code of a current through the shunt: 150 ohm, 3.3 V, two conversions of 12 bits summed.
fn code(current_ma: f64) -> u16 {
    (current_ma * 1e-3 * 150.0 / 3.3 * 8190.0).round().clamp(0.0, 8190.0) as u16
}

/// Something that breaks at a time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Injection {
    /// What breaks.
    pub breakage: Breakage,
    /// From when on, ms after the rig was switched on.
    pub from_ms: u64,
    /// Until when, ms; for ever when absent.
    pub until_ms: Option<u64>,
}

impl Injection {
    /// Whether it is broken at this time.
    #[must_use]
    pub fn holds_at(&self, time_ms: u64) -> bool {
        time_ms >= self.from_ms && self.until_ms.is_none_or(|until| time_ms < until)
    }
}

/// The names, what each takes behind `=`, and what it means.
pub const INJECTIONS: &[(&str, &str, &str)] = &[
    ("laser-unplugged", "", "the laser's channel reads nothing"),
    ("laser-current", "mA", "the laser gives this current"),
    ("laser-frozen", "", "the laser's channel keeps its code"),
    ("laser-offset", "mm", "the laser reads this much more"),
    ("pressure-unplugged", "", "the pressure sensor's channel reads nothing"),
    ("pressure-current", "mA", "the pressure sensor gives this current"),
    ("pressure-frozen", "", "the pressure sensor's channel keeps its code"),
    ("pressure-offset", "bar", "the pressure sensor reads this much more"),
    ("pressure-gain", "factor", "the pressure sensor reads this many times the pressure"),
    ("emergency-stop", "", "the emergency stop is pressed, or its wire is off"),
    ("ticks-late", "", "every tick takes too long"),
    ("muscle-bursts", "", "the muscle loses its pressure"),
    ("supply-fails", "", "no air comes"),
    ("supply", "bar", "the supply regulator is at this pressure"),
    ("line-leaks", "share", "this share of the pressure is lost in the line"),
    ("line-blocked", "", "no air enters or leaves the muscle"),
    ("valve-open", "", "the valve sticks fully open"),
    ("dump-valve-closed", "", "the dump valve sticks closed"),
    ("line-cut", "", "nothing passes between device and host"),
];

fn breakage(name: &str, value: Option<f64>) -> Option<Breakage> {
    Some(match (name, value) {
        ("laser-unplugged", None) => Breakage::LaserCode(0),
        ("laser-current", Some(current_ma)) => Breakage::LaserCode(code(current_ma)),
        ("laser-frozen", None) => Breakage::LaserFrozen,
        ("laser-offset", Some(offset_mm)) => Breakage::LaserOffsetMm(offset_mm),
        ("pressure-unplugged", None) => Breakage::PressureCode(0),
        ("pressure-current", Some(current_ma)) => Breakage::PressureCode(code(current_ma)),
        ("pressure-frozen", None) => Breakage::PressureFrozen,
        ("pressure-offset", Some(offset_bar)) => Breakage::PressureOffsetBar(offset_bar),
        ("pressure-gain", Some(factor)) => Breakage::PressureGain(factor),
        ("emergency-stop", None) => Breakage::EmergencyStop,
        ("ticks-late", None) => Breakage::EveryTickLate,
        ("muscle-bursts", None) => Breakage::MuscleBursts,
        ("supply-fails", None) => Breakage::SupplyFails,
        ("supply", Some(bar)) => Breakage::SupplyBar(bar.max(0.0)),
        ("line-leaks", Some(share)) => Breakage::LineLeaks(share.clamp(0.0, 1.0)),
        ("line-blocked", None) => Breakage::LineBlocked,
        ("valve-open", None) => Breakage::ValveFullyOpen,
        ("dump-valve-closed", None) => Breakage::DumpValveStuckClosed,
        ("line-cut", None) => Breakage::LineCut,
        _ => return None,
    })
}

impl FromStr for Injection {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let wanted = || {
            let names: Vec<String> = INJECTIONS
                .iter()
                .map(|(name, unit, _)| if unit.is_empty() { (*name).to_owned() } else { format!("{name}={unit}") })
                .collect();
            format!("{text}: NAME[=VALUE][@SECONDS[..SECONDS]] is wanted; names are {}", names.join(", "))
        };
        let seconds = |text: &str| text.parse::<f64>().ok().filter(|seconds| (0.0..=1e6).contains(seconds)).ok_or_else(wanted);
        let milliseconds = |text: &str| seconds(text).map(|seconds| (seconds * 1e3).round() as u64);
        let (what, when) = text.split_once('@').map_or((text, None), |(what, when)| (what, Some(when)));
        let (name, value) = what.split_once('=').map_or((what, None), |(name, value)| (name, Some(value)));
        let value = value.map(|value| value.parse::<f64>().ok().filter(|value| value.is_finite()).ok_or_else(wanted)).transpose()?;
        let breakage = breakage(name, value).ok_or_else(wanted)?;
        let (from_ms, until_ms) = match when.map(|when| when.split_once("..").map_or((when, None), |(from, until)| (from, Some(until)))) {
            None => (0, None),
            Some((from, until)) => (milliseconds(from)?, until.map(milliseconds).transpose()?),
        };
        Ok(Self { breakage, from_ms, until_ms })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn faults_are_named_with_value_and_time() {
        let wanted = Injection { breakage: Breakage::LaserCode(1396), from_ms: 0, until_ms: None };
        assert_eq!("laser-current=3.75".parse(), Ok(wanted));
        let wanted = Injection { breakage: Breakage::LineCut, from_ms: 1000, until_ms: Some(1400) };
        assert_eq!("line-cut@1..1.4".parse(), Ok(wanted));
        assert!(wanted.holds_at(1000) && wanted.holds_at(1399) && !wanted.holds_at(999) && !wanted.holds_at(1400));
        for wrong in ["", "laser", "laser-current", "laser-current=x", "emergency-stop=1", "line-cut@", "line-cut@-1", "line-cut@1..x"] {
            let refused = wrong.parse::<Injection>();
            assert!(refused.is_err_and(|problem| problem.contains("emergency-stop")), "{wrong}");
        }
    }

    #[test]
    fn every_name_of_the_list_is_understood() {
        for (name, unit, _) in INJECTIONS {
            let text = if unit.is_empty() { (*name).to_owned() } else { format!("{name}=4") };
            assert!(text.parse::<Injection>().is_ok(), "{text}");
        }
    }
}
