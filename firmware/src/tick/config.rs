//! From the operator's settings to everything immutable that a tick needs.

use core::num::NonZeroU16;

use model_export::link::fault::AdaptationCondition;
use model_export::link::settings::Settings;

use crate::adaptation::{Adaptation, AdaptationConfig};
use crate::calibration::{Calibration, CalibrationConfig, ConverterConfig, NotAMap};
use crate::certificate::{ClosedLoop, certify};
use crate::control::{
    Controller, FeedForward, FeedbackSensor, ObserverConfig, OutsideDomain, PidConfig, PlaybackConfig, PressureSetPoint, TrackingConfig,
};
use crate::limiter::{Limiter, LimiterConfig};
use crate::number::{MicroBar, round_to_i32};
use crate::plausibility::{ResidualMonitor, ResidualMonitorConfig, Sensor, SensorConfig};
use crate::supervisor::{Supervisor, SupervisorConfig};

/// What the board knows about itself.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RigFacts {
    /// The converter of both measured channels.
    pub converter: ConverterConfig,
}

/// Which of the board's two outputs drives the valve; the other one stays at zero.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ValveOutput {
    /// A voltage.
    #[default]
    Analogue,
    /// A pulse width.
    PulseWidth,
}

/// The settings and the board's facts, before they are built.
#[derive(Clone, Debug, PartialEq)]
pub struct TickConfig<'a> {
    /// The operator's settings.
    pub settings: &'a Settings,
    /// The board.
    pub facts: RigFacts,
}

/// Settings that do not go together.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Inconsistent {
    /// The number of the first one to blame.
    Setting(u16),
    /// Adaptation has no certificate with them: the first condition that fails.
    Adaptation(AdaptationCondition),
}

/// Everything immutable that a tick needs.
#[derive(Clone, Debug, PartialEq)]
pub struct Tick {
    pub(super) laser: Sensor,
    pub(super) laser_required: bool,
    pub(super) pressure: Sensor,
    pub(super) pressure_residual: ResidualMonitor,
    pub(super) model_residual: Option<ResidualMonitor>,
    pub(super) model_sees_measured: bool,
    pub(super) controller: Controller,
    pub(super) adaptation: Option<Adaptation>,
    /// Delay of the loop that adaptation is certified for, ms; absent while no feedback listens to the adapted estimate.
    pub(super) certified_delay_ms: Option<u16>,
    pub(super) supervisor: Supervisor,
    pub(super) limiter: Limiter,
    pub(super) over_pressure_bar: f32,
    pub(super) valve_full_scale_ubar: u32,
    /// Drives between which the valve gives pressure, of 65535.
    pub(super) valve_shares: (u16, u16),
    pub(super) pulse_hz: u32,
    pub(super) valve_output: ValveOutput,
    pub(super) host_timeout_ticks: u16,
    pub(super) maximum_late_ticks: u16,
    pub(super) telemetry_period_ticks: u16,
}

impl TickConfig<'_> {
    /// The laser's calibration, by the settings.
    ///
    /// # Errors
    /// [`NotAMap`] if its points do not make one.
    pub fn laser_calibration(&self) -> Result<Calibration, NotAMap> {
        let settings = self.settings;
        CalibrationConfig {
            low_v: settings.laser_low_v,
            low_value: settings.laser_low_mm,
            high_v: settings.laser_high_v,
            high_value: settings.laser_high_mm,
            fault_below_v: settings.laser_fault_below_v,
            fault_above_v: settings.laser_fault_above_v,
        }
        .build(&self.facts.converter)
    }

    /// The measured pressure's.
    ///
    /// # Errors
    /// As [`Self::laser_calibration`].
    pub fn pressure_calibration(&self) -> Result<Calibration, NotAMap> {
        let settings = self.settings;
        CalibrationConfig {
            low_v: settings.pressure_low_v,
            low_value: settings.pressure_low_bar,
            high_v: settings.pressure_high_v,
            high_value: settings.pressure_high_bar,
            fault_below_v: settings.pressure_fault_below_v,
            fault_above_v: settings.pressure_fault_above_v,
        }
        .build(&self.facts.converter)
    }

    /// Builds the tick.
    ///
    /// # Errors
    /// [`Inconsistent`] names the first setting that contradicts another, or the condition of adaptation's certificate that fails.
    pub fn build(&self) -> Result<Tick, Inconsistent> {
        let settings = self.settings;
        let stuck_command = MicroBar::from_bar(settings.stuck_command_bar).ok_or(Inconsistent::Setting(32))?;
        let sensor = |calibration, maximum_rate_per_s| {
            SensorConfig {
                maximum_rate_per_s,
                rejected_ms: narrow(settings.rejected_ms),
                stuck_ms: narrow(settings.stuck_ms),
                stuck_command,
                still_command_bar: settings.still_command_bar,
                still_response_ms: settings.still_response_ms,
                calibration,
            }
            .build()
        };
        let laser = self.laser_calibration().map_err(|_| Inconsistent::Setting(10))?;
        let pressure = self.pressure_calibration().map_err(|_| Inconsistent::Setting(20))?;
        let limiter = LimiterConfig {
            ceiling_bar: settings.ceiling_bar,
            slew_up_bar_per_s: settings.slew_up_bar_per_s,
            slew_down_bar_per_s: settings.slew_down_bar_per_s,
            output_time_to_live_ms: narrow(settings.output_time_to_live_ms),
        }
        .build()
        .map_err(|_| Inconsistent::Setting(1))?;
        // A pressure that the sensor cannot show must not be asked for: over-pressure could not be seen.
        let over_pressure_bar = settings.ceiling_bar + settings.over_pressure_margin_bar;
        if pressure.highest_value() <= over_pressure_bar {
            return Err(Inconsistent::Setting(23));
        }
        let full_scale = MicroBar::from_bar(settings.valve_full_scale_bar).ok_or(Inconsistent::Setting(50))?;
        let period = |milliseconds: u32, number| NonZeroU16::new(narrow(milliseconds)).ok_or(Inconsistent::Setting(number));
        let controller = match settings.control_law {
            0 => Controller::Playback(PlaybackConfig { period_ms: period(settings.playback_period_ms, 61)? }.build()),
            1 => Controller::PressureSetPoint(PressureSetPoint),
            2 => Controller::Tracking(tracking(settings, period(settings.playback_period_ms, 61)?)?.build()),
            _ => return Err(Inconsistent::Setting(60)),
        };
        let closed = if settings.control_law == 2 { closed_loop(settings) } else { None };
        let adaptation = if settings.adaptation {
            let config = adaptation(settings);
            certify(&config, closed.as_ref()).map_err(Inconsistent::Adaptation)?;
            Some(config.build())
        } else {
            None
        };
        let model_residual = ResidualMonitorConfig {
            response_steps: 0.0,
            tolerance: settings.mismatch_displacement_mm,
            steps: narrow(settings.mismatch_displacement_steps),
        };
        Ok(Tick {
            laser: sensor(laser, settings.laser_maximum_rate_mm_per_s),
            laser_required: settings.laser_required,
            pressure: sensor(pressure, settings.pressure_maximum_rate_bar_per_s),
            pressure_residual: ResidualMonitorConfig {
                response_steps: settings.pressure_response_ms,
                tolerance: settings.mismatch_pressure_bar,
                steps: narrow(settings.mismatch_pressure_ms),
            }
            .build(),
            model_residual: (settings.mismatch_displacement_mm > 0.0).then(|| model_residual.build()),
            model_sees_measured: settings.estimator_input_measured,
            controller,
            adaptation,
            certified_delay_ms: closed.filter(|_| settings.adaptation).map(|closed| closed.delay_ms),
            supervisor: SupervisorConfig { arming_timeout_s: narrow(settings.arming_timeout_s) }.build(),
            limiter,
            over_pressure_bar,
            valve_full_scale_ubar: u32::try_from(full_scale.0).map_err(|_| Inconsistent::Setting(50))?,
            valve_shares: valve_shares(settings)?,
            pulse_hz: settings.pulse_hz,
            valve_output: if settings.valve_drive == 0 { ValveOutput::Analogue } else { ValveOutput::PulseWidth },
            host_timeout_ticks: narrow(settings.host_timeout_ms),
            maximum_late_ticks: narrow(settings.maximum_late_ticks),
            telemetry_period_ticks: period(settings.telemetry_period_ms, 80)?.get(),
        })
    }
}

/// The settings of a control law that tracks.
fn tracking(settings: &Settings, period_ms: NonZeroU16) -> Result<TrackingConfig, Inconsistent> {
    Ok(TrackingConfig {
        period_ms,
        feed_forward: FeedForward::from_number(settings.feed_forward).ok_or(Inconsistent::Setting(62))?,
        sensor: FeedbackSensor::from_number(settings.feedback_sensor).ok_or(Inconsistent::Setting(63))?,
        linear_mm_per_bar: settings.linear_mm_per_bar,
        linear_offset_mm: settings.linear_offset_mm,
        learned_look_ahead_ms: narrow(settings.learned_look_ahead_ms),
        pid: pid(settings),
        observer: ObserverConfig {
            time_constant_s: settings.observer_time_constant_s,
            estimate_bound_mm: settings.observer_estimate_bound_mm,
            widening_mm_per_s: settings.observer_widening_mm_per_s,
        },
        transfer_s: settings.transfer_s,
        outside_domain: OutsideDomain::from_number(settings.outside_domain).ok_or(Inconsistent::Setting(68))?,
        estimate_by_physics: settings.estimate_by_physics,
    })
}

fn pid(settings: &Settings) -> PidConfig {
    PidConfig {
        proportional: settings.pid_proportional,
        integral_per_s: settings.pid_integral_per_s,
        derivative_s: settings.pid_derivative_s,
        derivative_filter_s: settings.pid_derivative_filter_s,
        limit_mm: settings.pid_limit_mm,
    }
}

/// The settings of adaptation.
fn adaptation(settings: &Settings) -> AdaptationConfig {
    let (one_mm, other_mm) = (settings.laser_low_mm, settings.laser_high_mm);
    AdaptationConfig {
        pivot_mm: settings.adaptation_pivot_mm,
        span_mm: settings.adaptation_span_mm,
        zero_limit: settings.adaptation_zero_limit_share,
        gain_minimum: settings.adaptation_gain_minimum,
        gain_maximum: settings.adaptation_gain_maximum,
        time_constant_s: settings.adaptation_time_constant_s,
        gate: settings.adaptation_gate_share,
        excitation: settings.adaptation_excitation_share,
        laser_mm: if one_mm < other_mm { [one_mm, other_mm] } else { [other_mm, one_mm] },
    }
}

/// The feedback of a law that tracks, if it listens to the estimate.
fn closed_loop(settings: &Settings) -> Option<ClosedLoop> {
    let sensor = FeedbackSensor::from_number(settings.feedback_sensor)?;
    matches!(sensor, FeedbackSensor::Estimate | FeedbackSensor::Observer).then(|| ClosedLoop {
        pid: pid(settings),
        delay_ms: narrow(settings.adaptation_loop_delay_ms),
        blends: sensor == FeedbackSensor::Observer,
        lags_inverted: FeedForward::from_number(settings.feed_forward) == Some(FeedForward::Physics),
    })
}

/// The setting's bounds lie within 16 bits; saturating is for settings that bypassed them.
fn narrow(value: u32) -> u16 {
    u16::try_from(value).unwrap_or(u16::MAX)
}

impl Tick {
    /// Whether what adaptation learned with `self` still means the same with `other`: the same filter, laser and estimate.
    pub(super) fn adapts_alike(&self, other: &Self) -> bool {
        let estimate = |tick: &Self| match &tick.controller {
            Controller::Tracking(law) => law.estimates_by_physics(),
            _ => false,
        };
        self.adaptation == other.adaptation
            && self.laser.calibration() == other.laser.calibration()
            && self.model_sees_measured == other.model_sees_measured
            && estimate(self) == estimate(other)
    }

    /// The limits in force.
    pub fn limiter(&self) -> &Limiter {
        &self.limiter
    }

    /// The laser's checks.
    pub fn laser(&self) -> &Sensor {
        &self.laser
    }

    /// The pressure sensor's checks.
    pub fn pressure(&self) -> &Sensor {
        &self.pressure
    }

    /// Frequency of the pulse width, Hz.
    pub fn pulse_hz(&self) -> u32 {
        self.pulse_hz
    }

    /// What drives the valve.
    pub fn valve_output(&self) -> ValveOutput {
        self.valve_output
    }

    pub(super) fn valve_share(&self, output: MicroBar) -> u16 {
        // Rounded down: the valve never gets more than the output.
        let output_ubar = u64::from(u32::try_from(output.0).unwrap_or(0));
        if output_ubar == 0 {
            return 0;
        }
        let (lowest, highest) = self.valve_shares;
        let span = u64::from(highest.saturating_sub(lowest));
        let share = (output_ubar * span).checked_div(u64::from(self.valve_full_scale_ubar)).unwrap_or(0).min(span);
        lowest.saturating_add(u16::try_from(share).unwrap_or(0))
    }
}

/// The drives between which the valve gives pressure.
fn valve_shares(settings: &Settings) -> Result<(u16, u16), Inconsistent> {
    let share = |share: f32| round_to_i32(share * f32::from(u16::MAX)).and_then(|share| u16::try_from(share).ok());
    match (share(settings.valve_lowest_share), share(settings.valve_highest_share)) {
        (Some(lowest), Some(highest)) if lowest < highest => Ok((lowest, highest)),
        _ => Err(Inconsistent::Setting(53)),
    }
}
