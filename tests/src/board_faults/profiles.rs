//! Profiles of valves and sensors on the image.

use host_tool::experiment;
use host_tool::link::{Breakage, FlashMemory, HardwareConfig, ValveError};
use model_export::link::message::Request;
use model_export::link::profiles::Profile;
use model_export::link::settings::Settings;

use super::Bench;
use crate::board_model::config;

/// How a profile of a valve or a sensor ends on the image: the safe state before anything is armed, under pressure, and after each fault.
#[derive(Clone, Debug, PartialEq)]
pub struct ProfileEnd {
    /// Its name, and what struck.
    pub name: String,
    /// Whether the drive was at zero and the dump valve without current before it was armed.
    pub rests: bool,
    /// Pressure that was held, bar.
    pub held_bar: f64,
    /// Time until the outputs were safe, ms.
    pub safe_ms: Option<u32>,
    /// Whether they stayed so, and the drive at zero.
    pub stays: bool,
    /// The fault that the device names.
    pub fault: u8,
}

/// Puts a profile's settings into the image's flash, holds 1 bar with it, and breaks something.
///
/// # Panics
/// When its settings are not taken, or the pressure is not reached.
#[must_use]
pub fn profile_ends(profile: &Profile, breakage: Breakage) -> ProfileEnd {
    const HELD_BAR: f64 = 1.0;
    /// Ten times what the outputs may take, and so long that a drive that comes back would be seen.
    const WATCHED_MS: u32 = 500;
    let mut settings = Settings { control_law: 1, ..Settings::default() };
    profile.apply(&mut settings).expect("settings of a profile");
    // The valve of the profile: no pressure at its lowest drive, its full scale at the highest.
    let (lowest, highest) = (f64::from(settings.valve_lowest_share), f64::from(settings.valve_highest_share));
    let hardware = HardwareConfig {
        valve_full_scale_bar: f64::from(settings.valve_full_scale_bar) * (1.0 - lowest) / (highest - lowest),
        valve: ValveError { dead_band_share: lowest, ..ValveError::default() },
        ..HardwareConfig::default()
    };
    let flash = FlashMemory::default().with_settings(&settings).expect("settings that fit");
    let mut bench = Bench::start_with(config(), &flash, None, hardware);
    experiment::settle(&mut bench.rig).expect("a self-test that ends");
    let rests = bench.watch.since(0).iter().all(|moment| !moment.energised && moment.valve_share == 0);
    bench.rig.command(&Request::Arm).expect("an armed rig");
    bench.rig.command(&Request::Start).expect("a started rig");
    bench.ask_for(800, |_| HELD_BAR);
    let held_bar = bench.rig.transport().hardware().pressure_bar();
    let from = bench.watch.len();
    bench.rig.transport().hardware().set_breakage(Some(breakage));
    bench.ask_for(WATCHED_MS, |_| HELD_BAR);
    let moments = bench.watch.since(from);
    let safe = moments.iter().position(|moment| !moment.energised);
    let stays = safe.is_some_and(|safe| moments[safe..].iter().all(|moment| !moment.energised && moment.valve_share == 0));
    let safe_ms = safe.and_then(|ticks| u32::try_from(ticks).ok());
    ProfileEnd { name: format!("{}, {breakage:?}", profile.name), rests, held_bar, safe_ms, stays, fault: bench.fault().0 }
}
