//! Faults, blockers and notices: what the device can say about itself, with what to do about each.
//!
//! A **fault** vents and latches; the first one is kept with time and context. A **blocker** is a reason why arming is refused now; it
//! goes away when its cause does. A **notice** says that something is limited or degraded at this moment and never vents.
//!
//! Numbers are on the wire and in lab notebooks: none is ever reused or renumbered. They stay below 64 so that a set fits one word.
//!
//! # Example
//! ```
//! use model_export::link::fault::{Blocker, BlockerSet, Explanation, Fault, FaultSet, explain};
//!
//! let Explanation { name, remedy, .. } = explain("E017").expect("a fault of this version");
//! assert_eq!(name, "laser-stuck");
//! assert!(!remedy.is_empty());
//! assert_eq!(Fault::from_number(17).map(Fault::number), Some(17));
//! assert_eq!(Fault::LaserStuck.explanation(), explain("e17").unwrap());
//! assert!(Fault::ALL.contains(&Fault::LaserStuck));
//!
//! let mut faults = FaultSet::EMPTY;
//! faults.insert(Fault::LaserStuck);
//! faults.insert_if(true, Fault::LaserRange);
//! assert!(faults.contains(Fault::LaserRange) && !faults.is_empty());
//! assert_eq!(faults.first(), Some(Fault::LaserRange));
//! faults.remove(Fault::LaserRange);
//! assert_eq!(faults.union(FaultSet::EMPTY).iter().count(), 1);
//!
//! let blockers: BlockerSet = [Blocker::EmergencyStopPressed].into_iter().collect();
//! assert_eq!(blockers.first().map(|blocker| blocker.explanation().name), Some("emergency-stop-pressed"));
//! ```

/// One entry of a table a person can look up.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Explanation {
    /// Stable number, unique within its table.
    pub number: u8,
    /// Name in kebab case, as logs and JSON show it.
    pub name: &'static str,
    /// What happened.
    pub meaning: &'static str,
    /// What to do.
    pub remedy: &'static str,
}

macro_rules! explained {
    ($(#[$meta:meta])* $kind:ident, $set:ident, $(#[$set_meta:meta])*
     { $($number:literal $variant:ident $name:literal $meaning:literal $remedy:literal)* }) => {
        $(#[$meta])*
        #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
        #[cfg_attr(feature = "defmt", derive(defmt::Format))]
        #[repr(u8)]
        pub enum $kind {
            $(#[doc = $meaning] $variant = $number,)*
        }

        impl $kind {
            /// All of them, by number.
            pub const ALL: &'static [Self] = &[$(Self::$variant,)*];

            /// The stable number.
            pub const fn number(self) -> u8 {
                match self { $(Self::$variant => $number,)* }
            }

            /// The one with this number, if this version knows it.
            pub const fn from_number(number: u8) -> Option<Self> {
                match number { $($number => Some(Self::$variant),)* _ => None }
            }

            /// Name, meaning and remedy.
            pub const fn explanation(self) -> Explanation {
                match self {
                    $(Self::$variant => Explanation { number: $number, name: $name, meaning: $meaning, remedy: $remedy },)*
                }
            }
        }

        $(#[$set_meta])*
        #[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
        #[cfg_attr(feature = "defmt", derive(defmt::Format))]
        pub struct $set(pub u64);

        impl $set {
            /// The empty set.
            pub const EMPTY: Self = Self(0);

            /// Whether nothing is in it.
            pub const fn is_empty(self) -> bool {
                self.0 == 0
            }

            /// Whether `item` is in it.
            pub const fn contains(self, item: $kind) -> bool {
                self.0 & (1 << item.number()) != 0
            }

            /// Adds `item`.
            pub const fn insert(&mut self, item: $kind) {
                self.0 |= 1 << item.number();
            }

            /// Adds `item` when `present`.
            pub const fn insert_if(&mut self, present: bool, item: $kind) {
                if present {
                    self.insert(item);
                }
            }

            /// Takes `item` out.
            pub const fn remove(&mut self, item: $kind) {
                self.0 &= !(1 << item.number());
            }

            /// Everything in either.
            pub const fn union(self, other: Self) -> Self {
                Self(self.0 | other.0)
            }

            /// What is in it, by ascending number; numbers unknown to this version are left out.
            pub fn iter(self) -> impl Iterator<Item = $kind> {
                $kind::ALL.iter().copied().filter(move |item| self.contains(*item))
            }

            /// The member with the lowest number.
            pub fn first(self) -> Option<$kind> {
                self.iter().next()
            }
        }

        impl FromIterator<$kind> for $set {
            fn from_iter<I: IntoIterator<Item = $kind>>(items: I) -> Self {
                let mut set = Self::EMPTY;
                for item in items {
                    set.insert(item);
                }
                set
            }
        }
    };
}

explained! {
    /// Why the device vented. Within one tick the lowest number counts as first: causes come before their consequences.
    Fault, FaultSet,
    /// A set of faults, bit = number.
    {
        1 FlashCorrupt "flash-corrupt"
            "The checksum of the program in flash is wrong."
            "Flash the firmware again; if it comes back, replace the board."
        2 ClockFailed "clock-failed"
            "The crystal oscillator did not start, or stopped; the device runs on its internal oscillator."
            "Check the crystal and its two capacitors, then power-cycle. Nothing can be armed without the crystal, since every rate limit hangs on it."
        3 ClockInaccurate "clock-inaccurate"
            "Two oscillators disagree about the length of a second by more than the tolerance."
            "Check that the crystal has the frequency the firmware was built for, then power-cycle."
        4 SelfTestTimeout "self-test-timeout"
            "The self-test did not report within its time."
            "Power-cycle; if it comes back, flash the firmware and upload the model again."
        5 ModelCorrupt "model-corrupt"
            "The checksum of the active model is wrong."
            "Upload the model again, or roll back to the other one."
        6 ModelUnsupported "model-unsupported"
            "The active model has a schema version, a size or a sample period that this firmware cannot run."
            "Export the model with the host tool of the firmware's version, or update the firmware."
        7 GoldenMismatch "golden-mismatch"
            "The model's golden vectors, replayed on this device, did not give the recorded outputs."
            "Upload the model again; if it comes back, report it with the model: the arithmetic differs from the exporter's reference."
        8 SelfTestBlind "self-test-blind"
            "A golden vector that was corrupted on purpose passed, so the self-test cannot be trusted."
            "Flash the firmware again; if it comes back, report it with the model."
        9 SettingsInvalid "settings-invalid"
            "The stored settings are damaged, contradict each other or lie outside their bounds; those in use are older ones or the defaults."
            "Check every limit with `catheter rig settings diff`, correct them, save, and acknowledge: nothing arms before they are saved again."
        10 StorageFailed "storage-failed"
            "The flash memory could not be erased or written."
            "Repeat the save; if it comes back, the flash is worn out and the board needs replacing."
        11 EmergencyStop "emergency-stop"
            "The emergency stop is pressed or its wire is broken."
            "Make the rig safe, release the button, check the wire, then acknowledge."
        12 WatchdogReset "watchdog-reset"
            "The watchdog restarted the device because the loop or the background hung."
            "Read the fault record for what ran last, report it, and acknowledge."
        13 Panicked "panicked"
            "The program stopped itself at a condition that must not occur."
            "Read the fault record, report it, and acknowledge."
        14 HardFault "hard-fault"
            "The processor stopped at an illegal access or instruction; a full stack ends here too."
            "Read the fault record, report it, and acknowledge."
        15 BrownOut "brown-out"
            "The supply voltage fell below the limit."
            "Check the supply and its wiring under load, then acknowledge."
        16 LaserRange "laser-range"
            "The laser's signal is outside the range of measured values: a broken wire, no target, or the sensor's own fault code such as 3.75 mA."
            "Check the laser's wiring, supply and target; the settings laser.fault_below_v and laser.fault_above_v set the limits."
        17 LaserStuck "laser-stuck"
            "The laser's code did not change at all while the pressure command moved."
            "Check the laser and its hold input; raise plausibility.stuck_ms if the signal is free of noise."
        18 LaserRate "laser-rate"
            "The laser's signal moved faster than the tip can."
            "Check the laser's mounting and wiring for interference; the setting laser.maximum_rate_mm_per_s sets the limit."
        19 PressureRange "pressure-range"
            "The pressure sensor's signal is outside the range of measured values: a broken wire or the sensor's own fault code."
            "Check the pressure sensor's wiring and supply; the settings pressure.fault_below_v and pressure.fault_above_v set the limits."
        20 PressureStuck "pressure-stuck"
            "The pressure sensor's code did not change at all while the pressure command moved."
            "Check the sensor; raise plausibility.stuck_ms if the signal is free of noise."
        21 PressureRate "pressure-rate"
            "The pressure sensor's signal moved faster than the pneumatics can."
            "Check the sensor's wiring for interference; the setting pressure.maximum_rate_bar_per_s sets the limit."
        22 OverPressure "over-pressure"
            "The measured pressure exceeded the ceiling and its margin."
            "Check the supply pressure and the valve; look at the recording for what asked for it."
        23 PressureMismatch "pressure-mismatch"
            "The measured pressure does not follow the commanded one: a leak, a closed supply, a stuck valve or a burst muscle."
            "Check supply, tubes and muscle; the settings mismatch.* hold the expected response and its tolerance."
        24 ModelMismatch "model-mismatch"
            "The laser and the model disagree by more than the tolerance."
            "Check that the model belongs to this catheter and set-up; the setting mismatch.displacement_mm sets the tolerance."
        25 EstimatorNotFinite "estimator-not-finite"
            "The model's output was not a number."
            "Check the model with `catheter inspect`; upload another one."
        26 ControlNotFinite "control-not-finite"
            "The control law asked for a pressure that is not a number."
            "Check the control settings and the set-points."
        27 ControlExpired "control-expired"
            "The control law did not renew its output within its time-to-live."
            "Check the control settings; the setting limits.output_time_to_live_ms sets the time."
        28 HostLost "host-lost"
            "No set-point came from the host within the timeout while running."
            "Check the cable and the host's load; the setting limits.host_timeout_ms sets the time."
        29 DeadlineMissed "deadline-missed"
            "Too many ticks in a row came late or were lost."
            "Report it with the model and settings in use; a smaller model takes less time."
        30 BackgroundStalled "background-stalled"
            "The background tasks (link, storage) stopped while the rig was energised."
            "Read the fault record, report it, and acknowledge."
        31 VentNotVerified "vent-not-verified"
            "The pressure was not below 0.1 bar within 1 s of venting."
            "Keep away from the catheter, close the supply by hand, and check the dump valve and its exhaust."
        32 VentUnverifiable "vent-unverifiable"
            "The device vented, but the pressure sensor cannot be trusted to confirm it."
            "Close the supply by hand, then repair the pressure sensor."
        33 PressureWhileVented "pressure-while-vented"
            "Pressure came back although the dump valve is open."
            "Close the supply by hand, and check the dump valve and the regulator."
        34 InternalInconsistent "internal-inconsistent"
            "The limiter's state was damaged in memory."
            "Power-cycle and report it."
        35 ModelTooSlow "model-too-slow"
            "A step of the active model takes more than 60 % of a millisecond on this processor."
            "Train a smaller model, or one that streams instead of running a window; `catheter inspect` tells the instructions of a step."
        36 ReferenceVoltage "reference-voltage"
            "The analogue supply, on which every measured and every given voltage hangs, is more than 3 % off 3.3 V."
            "Check the board's 3.3 V regulator and its load, then acknowledge."
        37 OutputMismatch "output-mismatch"
            "The voltage at the valve's drive or the level at the dump valve's pin is not what the device put out."
            "Close the supply by hand, and look for a short circuit or a broken driver at PA4 and PB1."
        38 ModelInputs "model-inputs"
            "The active model takes several inputs, and this firmware measures one pressure."
            "Upload a model of one input; one of several runs on a computer, or as the C of `catheter export --c` in other firmware."
    }
}

explained! {
    /// Why arming or starting is refused.
    Blocker, BlockerSet,
    /// A set of blockers, bit = number.
    {
        1 WrongState "wrong-state"
            "The device is not in the state this command starts from."
            "Ask for the status: arming starts from idle, starting from armed."
        2 FaultLatched "fault-latched"
            "A fault is latched."
            "Read it, remove its cause, then acknowledge it."
        3 EmergencyStopPressed "emergency-stop-pressed"
            "The emergency stop is pressed."
            "Make the rig safe and release it."
        4 LaserNotPlausible "laser-not-plausible"
            "The laser's signal is not plausible now."
            "Check the laser's supply, wiring and target, or set laser.required to false for work without it."
        5 PressureNotPlausible "pressure-not-plausible"
            "The pressure sensor's signal is not plausible now."
            "Check the pressure sensor's supply and wiring."
        6 VentNotVerified "vent-not-verified"
            "The pressure has not been seen below 0.1 bar since the last vent."
            "Wait a second; if it stays, open the exhaust and check the dump valve."
        7 ModelMissing "model-missing"
            "The chosen control law or check needs a model, and none is active."
            "Upload and activate a model, or choose another control law."
        8 LoopLate "loop-late"
            "The last tick came late."
            "Try again; if it stays, report it."
        9 BackgroundSilent "background-silent"
            "The background tasks do not show life."
            "Power-cycle; if it stays, report it."
        10 PlaybackEmpty "playback-empty"
            "There is nothing to play back."
            "Send set-points before starting."
        11 FaultCausePresent "fault-cause-present"
            "The cause of the latched fault is still there."
            "Remove it first; `catheter explain` tells how."
        12 AdaptationUncertified "adaptation-uncertified"
            "Adaptation is on, and the active model is slower or has another period than its certificate was computed for."
            "Raise adaptation.loop_delay_ms to the model's dead time and 38 ms, use a model with a period of 20 ms, or switch adaptation off."
    }
}

explained! {
    /// What is limited or degraded at this moment.
    Notice, NoticeSet,
    /// A set of notices, bit = number.
    {
        1 Ceiling "ceiling"
            "The demand is above the pressure ceiling and is held there."
            "Lower the demand, or raise limits.ceiling_bar if the catheter allows it."
        2 Floor "floor"
            "The demand is below zero and is held at zero."
            "Nothing, unless it lasts: then the control law or its model is off."
        3 Slew "slew"
            "The demand moves faster than the slew limit allows."
            "Nothing, unless the experiment needs the speed."
        4 LaserHeld "laser-held"
            "A laser sample was rejected and the last good one is in use."
            "Nothing, unless it lasts."
        5 PressureHeld "pressure-held"
            "A pressure sample was rejected and the last good one is in use."
            "Nothing, unless it lasts."
        6 LaserLost "laser-lost"
            "The laser is not plausible; the settings allow to go on without it."
            "Check the laser when the experiment needs it."
        7 PlaybackStarved "playback-starved"
            "The playback buffer ran empty before the end; the last point is held."
            "Send set-points earlier."
        8 TickLate "tick-late"
            "This tick came late or ticks before it were lost."
            "Nothing, unless it lasts."
        9 DemandHeld "demand-held"
            "The control law gave no new demand; the last one is held."
            "Nothing, unless it lasts."
        10 EstimateMissing "estimate-missing"
            "There is no model, or its input is not available."
            "Nothing, unless the experiment needs the estimate."
        11 ArmExpired "arm-expired"
            "The device disarmed itself because nothing was started in time."
            "Arm again when ready; arming.timeout_s sets the time."
        12 FeedbackMissing "feedback-missing"
            "The feedback's sensor gives nothing; the correction stays as it is."
            "Check the laser, or choose the observer with control.sensor."
        13 FeedForwardFallback "feed-forward-fallback"
            "The chosen feed-forward cannot work now; a simpler one stands in."
            "Activate a model with a compensation part, or stay within what it was trained on."
        14 OutsideDomain "outside-domain"
            "The model's input is outside of what it was trained on."
            "Slow down or stay within the trained pressures, or train on more."
        15 AdaptationFrozen "adaptation-frozen"
            "The last window taught adaptation nothing while running: the laser, the estimate or the limiter forbids it."
            "Nothing, unless it lasts: `catheter rig ... adaptation` tells the reason."
        16 AdaptationLimited "adaptation-limited"
            "Zero or gain of the estimate are at a limit of adaptation."
            "Identify the actuator again; it is no longer the one that the model was made for."
    }
}

explained! {
    /// What must hold for adaptation to be switched on.
    AdaptationCondition, AdaptationConditionSet,
    /// A set of conditions, bit = number.
    {
        1 SpanWithinLaser "span-within-laser"
            "The span around the pivot must lie within the laser's calibrated range."
            "Correct adaptation.pivot_mm and adaptation.span_mm, or the laser's calibration."
        2 NearTheRaw "near-the-raw"
            "At their limits zero and gain must not move the estimate by more than 30 % of the span within the span."
            "Lower adaptation.zero_limit_share, or bring adaptation.gain_minimum and adaptation.gain_maximum closer to one."
        3 LagsInverted "lags-inverted"
            "Feedback that listens to the estimate must stand beside the inverse of the physics, for which the loop is known."
            "Set control.feed_forward to 3, or let control.sensor be 0 or 1."
        4 LoopContracts "loop-contracts"
            "The feedback loop without adaptation must be proven stable."
            "Lower the gains pid.*, or correct adaptation.loop_delay_ms."
        5 LoopMargin "loop-margin"
            "The feedback loop must stay stable for every sequence of gains within the limits, with a margin."
            "Lower the gains pid.*, or bring adaptation.gain_minimum and adaptation.gain_maximum closer to one."
        6 SlowerThanLoop "slower-than-loop"
            "Adaptation must take ten times as long as the feedback loop takes to settle."
            "Raise adaptation.time_constant_s, or use faster feedback."
    }
}

const _: () = {
    let tables = [Fault::ALL.len(), Blocker::ALL.len(), Notice::ALL.len()];
    assert!(tables[0] < 64 && tables[1] < 64 && tables[2] < 64 && AdaptationCondition::ALL.len() < 64);
};

/// What an identifier such as `E017` (fault), `B03` (blocker), `N2` (notice) or `C5` (condition of adaptation) means; case and leading zeros do not matter.
pub fn explain(identifier: &str) -> Option<Explanation> {
    let identifier = identifier.trim();
    let mut characters = identifier.chars();
    let table = characters.next()?;
    let number: u8 = characters.as_str().parse().ok()?;
    match table.to_ascii_uppercase() {
        'E' => Fault::from_number(number).map(Fault::explanation),
        'B' => Blocker::from_number(number).map(Blocker::explanation),
        'N' => Notice::from_number(number).map(Notice::explanation),
        'C' => AdaptationCondition::from_number(number).map(AdaptationCondition::explanation),
        _ => None,
    }
}
