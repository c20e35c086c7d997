//! What can be broken and changed on a simulated rig, by name.

use anyhow::{Context, Result};
use dashboard::Entry;

use crate::link::Breakage;
use simulation::plant::{Plant, PlantConfig};

/// Code of 3.75 mA through 150 ohm at two summed conversions of 12 bits: a sensor's own fault signal.
const FAULT_CODE: u16 = 1396;

/// Name, title, and what breaks.
const FAULTS: &[(&str, &str, Breakage)] = &[
    ("laser-wire", "Laser: broken wire, 3.75 mA", Breakage::LaserCode(FAULT_CODE)),
    ("laser-frozen", "Laser: code stands still", Breakage::LaserFrozen),
    ("laser-jump", "Laser: jumps by 3 mm", Breakage::LaserOffsetMm(3.0)),
    ("pressure-wire", "Pressure sensor: broken wire", Breakage::PressureCode(FAULT_CODE)),
    ("pressure-frozen", "Pressure sensor: code stands still", Breakage::PressureFrozen),
    ("pressure-offset", "Pressure sensor: 0.5 bar too high", Breakage::PressureOffsetBar(0.5)),
    ("emergency-stop", "Emergency stop pressed", Breakage::EmergencyStop),
    ("late-ticks", "Every tick takes too long", Breakage::EveryTickLate),
    ("muscle-bursts", "The muscle bursts", Breakage::MuscleBursts),
    ("supply-fails", "The air supply fails", Breakage::SupplyFails),
    ("valve-open", "The valve sticks fully open", Breakage::ValveFullyOpen),
    ("dump-valve-stuck", "The dump valve sticks closed", Breakage::DumpValveStuckClosed),
];

/// Name, title, and what of the paper's rig with all effects stays.
type Chosen = (&'static str, &'static str, fn(PlantConfig) -> PlantConfig);

const PLANTS: &[Chosen] = &[
    ("pi", "Play operators alone", |_| PlantConfig::default()),
    ("dead-time", "Hidden: a dead time of 60 ms", |all| PlantConfig { dead_time: all.dead_time, ..PlantConfig::default() }),
    ("lag", "Hidden: a lag of 0.2 s", |all| PlantConfig { lag: all.lag, ..PlantConfig::default() }),
    ("rate-dependence", "Hidden: loops that grow with speed", |all| PlantConfig {
        rate_dependence: all.rate_dependence,
        ..PlantConfig::default()
    }),
    ("creep", "Hidden: creep", |all| PlantConfig { creep: all.creep, ..PlantConfig::default() }),
    ("saturation", "Hidden: dead zone and saturation", |all| PlantConfig {
        dead_zone_and_saturation: all.dead_zone_and_saturation,
        ..PlantConfig::default()
    }),
    ("stick-slip", "Hidden: stick-slip", |all| PlantConfig { stick_slip: all.stick_slip, ..PlantConfig::default() }),
    ("all-effects", "All effects at once", |all| all),
];

fn entry(name: &str, title: &str) -> Entry {
    Entry { name: name.to_owned(), title: title.to_owned() }
}

/// What can be broken.
pub fn faults() -> Vec<Entry> {
    FAULTS.iter().map(|(name, title, _)| entry(name, title)).collect()
}

/// The breakage of a name.
pub fn breakage(name: &str) -> Result<Breakage> {
    let found = FAULTS.iter().find(|(known, _, _)| *known == name);
    found.map(|(_, _, breakage)| *breakage).with_context(|| format!("there is no fault {name} to inject"))
}

/// What can move the tip; `given` is what the command line chose.
pub fn plants(given: &str) -> Vec<Entry> {
    let known = PLANTS.iter().map(|(name, title, _)| entry(name, title));
    let file = (!PLANTS.iter().any(|(name, _, _)| *name == given)).then(|| entry(given, given));
    known.chain(file).collect()
}

/// The plant of a name; `given` is what the command line chose, which may be a file. No other file can be named.
pub fn plant(name: &str, given: &str) -> Result<Plant> {
    if let Some((_, _, make)) = PLANTS.iter().find(|(known, _, _)| *known == name) {
        return Ok(Plant::new(make(PlantConfig::all_effects()))?);
    }
    anyhow::ensure!(name == given, "there is no plant {name}");
    Ok(Plant::named(given)?)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_name_that_is_shown_can_be_chosen() {
        faults().iter().for_each(|entry| assert!(breakage(&entry.name).is_ok(), "{}", entry.name));
        let shown = plants("pi");
        assert_eq!(shown.len(), PLANTS.len());
        shown.iter().for_each(|entry| assert!(plant(&entry.name, "pi").is_ok(), "{}", entry.name));
        assert!(breakage("nothing").is_err());
        assert!(plant("/etc/hostname", "pi").is_err(), "a page names no files");
    }
}
