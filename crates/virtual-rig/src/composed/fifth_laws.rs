//! Laws to tune on from textbooks of pneumatics and of hysteresis, two for every effect: this file holds those of the pressure side and of the muscle,
//! `fifth_laws_of_time` those of the tip, the sensor and the session.

use super::draw::{Draw, STEP_S, ThresholdLaw};
use super::fifth_laws_of_time as of_time;
use super::laws::{self, Drawn, Turn, first_order, map, stage, swing};

/// Atmosphere, bar absolute.
const ATMOSPHERE_BAR: f64 = 1.0;
/// Critical pressure ratio of a small valve by ISO 6358.
const CRITICAL_RATIO: f64 = 0.3;

/// Draws a law of the effect `name`: the first for `which` zero, else the second.
pub(super) fn tuning(name: &str, which: u64, draw: &mut Draw<'_>) -> Drawn {
    let second = which == 1;
    match name {
        "pneumatic-lag" => pneumatic_lag(second, draw),
        "fill-vent-asymmetry" => fill_vent_asymmetry(second, draw),
        "slew-limit" => slew_limit(second, draw),
        "valve-dead-band" => valve_dead_band(second, draw),
        "supply-saturation" => supply_saturation(second, draw),
        "activation-threshold" => activation_threshold(second, draw),
        "static-nonlinearity" => static_nonlinearity(second, draw),
        "asymmetric-hysteresis" => asymmetric_hysteresis(second, draw),
        "rate-dependent-hysteresis" => rate_dependent_hysteresis(second, draw),
        "resonance" => resonance(second, draw),
        "leakage" => leakage(second, draw),
        "hold-after-reversal" => hold_after_reversal(second, draw),
        "creep" => of_time::creep(second, draw),
        "first-cycle-softening" => of_time::first_cycle_softening(second, draw),
        "stick-slip" => of_time::stick_slip(second, draw),
        "periodic-disturbance" => of_time::periodic_disturbance(second, draw),
        "offset-drift" => of_time::offset_drift(second, draw),
        "gain-drift" => of_time::gain_drift(second, draw),
        "setup-change" => of_time::setup_change(second, draw),
        "sample-and-hold" => of_time::sample_and_hold(second, draw),
        other => laws::tuning(other, draw),
    }
}

/// A linear lag of first order. Second: the line and the muscle are two volumes in series, the line the smaller one.
fn pneumatic_lag(second: bool, draw: &mut Draw<'_>) -> Drawn {
    let time_s = draw.log(0.05, 0.35);
    if second {
        let line_s = time_s * draw.even(0.2, 0.6);
        let mut line_bar = 0.0;
        return Drawn::Before(first_order(move |value, state| {
            line_bar += STEP_S * (value - line_bar) / line_s;
            (line_bar - state) / time_s
        }));
    }
    draw.tell("pneumatic-lag.time_constant_s", time_s);
    Drawn::Before(first_order(move |value, state| (value - state) / time_s))
}

/// A share of the choked mass flow by ISO 6358, from the higher pressure to the lower one, both absolute.
pub(super) fn flow_share(critical_ratio: f64, upstream_bar: f64, downstream_bar: f64) -> f64 {
    let beyond = ((downstream_bar / upstream_bar - critical_ratio) / (1.0 - critical_ratio)).clamp(0.0, 1.0);
    (1.0 - beyond * beyond).sqrt()
}

/// A proportional valve fills from the supply and vents to the atmosphere, both through one orifice by ISO 6358. Second: one time constant to fill and
/// another to vent, either of them the longer.
fn fill_vent_asymmetry(second: bool, draw: &mut Draw<'_>) -> Drawn {
    if second {
        let (short_s, ratio) = (draw.log(0.04, 0.15), draw.log(2.0, 5.0));
        let (fill_s, vent_s) = if draw.sign() > 0.0 { (short_s, ratio * short_s) } else { (ratio * short_s, short_s) };
        return Drawn::Before(first_order(move |value, state| (value - state) / if value > state { fill_s } else { vent_s }));
    }
    let span = draw.span_bar;
    let (supply_bar, volume_s, full_error_bar) = (draw.even(5.0, 7.0), draw.log(0.5, 2.0), draw.even(0.1, 0.3) * span);
    Drawn::Before(first_order(move |value, state| {
        let muscle_bar = state.max(0.0) + ATMOSPHERE_BAR;
        let opening = ((value - state) / full_error_bar).clamp(-1.0, 1.0);
        if opening > 0.0 {
            opening * supply_bar * flow_share(CRITICAL_RATIO, supply_bar, muscle_bar) / volume_s
        } else {
            opening * muscle_bar * flow_share(CRITICAL_RATIO, muscle_bar, ATMOSPHERE_BAR) / volume_s
        }
    }))
}

/// The pressure follows its command exactly up to a greatest rate. Second: rising and falling pressure have limits of their own.
fn slew_limit(second: bool, draw: &mut Draw<'_>) -> Drawn {
    let most_bar_per_s = draw.span_bar * draw.log(0.6, 2.2);
    let (rise_bar_per_s, fall_bar_per_s) = if second {
        let ratio = draw.even(0.5, 0.85);
        if draw.sign() > 0.0 { (most_bar_per_s, ratio * most_bar_per_s) } else { (ratio * most_bar_per_s, most_bar_per_s) }
    } else {
        draw.tell("slew-limit.limit_bar_per_s", most_bar_per_s);
        (most_bar_per_s, most_bar_per_s)
    };
    Drawn::Before(first_order(move |value, state| ((value - state) / STEP_S).clamp(-fall_bar_per_s, rise_bar_per_s)))
}

/// An overlapped spool: the flow grows with the error beyond the band. Second: switching valves, fully open outside the band and shut inside.
fn valve_dead_band(second: bool, draw: &mut Draw<'_>) -> Drawn {
    let band_bar = draw.span_bar * draw.log(0.03, 0.11);
    draw.tell("valve-dead-band.band_bar", band_bar);
    if second {
        let flow_bar_per_s = draw.span_bar * draw.even(5.0, 12.0);
        return Drawn::Before(first_order(move |value, state| {
            let error_bar: f64 = value - state;
            if error_bar.abs() > band_bar { flow_bar_per_s * error_bar.signum() } else { 0.0 }
        }));
    }
    let flow_s = draw.log(0.015, 0.05);
    Drawn::Before(first_order(move |value, state| {
        let error_bar = value - state;
        (error_bar - error_bar.clamp(-band_bar, band_bar)) / flow_s
    }))
}

/// The pressure nears that of the supply along a smooth knee. Second: the supply is a small tank that every filling empties a little and a compressor
/// fills again.
fn supply_saturation(second: bool, draw: &mut Draw<'_>) -> Drawn {
    let limit_bar = draw.even(0.6, 0.88) * draw.span_bar;
    if second {
        let (volume_ratio, recovery_s) = (draw.even(0.05, 0.15), draw.log(0.5, 3.0));
        let (mut tank_bar, mut muscle_bar) = (limit_bar, 0.0);
        return Drawn::Before(stage(move |value: f64, _| {
            let next_bar = value.min(tank_bar);
            let filled_bar = (next_bar - muscle_bar).max(0.0);
            tank_bar += STEP_S * (limit_bar - tank_bar) / recovery_s - volume_ratio * filled_bar;
            muscle_bar = next_bar;
            muscle_bar
        }));
    }
    draw.tell("supply-saturation.limit_bar", limit_bar);
    let sharpness = draw.log(8.0, 20.0);
    Drawn::Before(map(move |value| value / (1.0 + (value.max(0.0) / limit_bar).powf(sharpness)).powf(1.0 / sharpness)))
}

/// Nothing moves below the threshold, and the rest of the range is stretched to the whole stroke. Second: the muscle wakes along a soft knee.
fn activation_threshold(second: bool, draw: &mut Draw<'_>) -> Drawn {
    let span = draw.span_bar;
    let threshold_bar = draw.even(0.08, 0.27) * span;
    draw.tell("activation-threshold.threshold_bar", threshold_bar);
    if second {
        let knee_bar = draw.even(0.08, 0.2) * threshold_bar;
        let soft = move |value_bar: f64| knee_bar * ((value_bar - threshold_bar) / knee_bar).exp().ln_1p();
        let rest_bar = soft(0.0);
        return Drawn::Before(map(move |value| soft(value) - rest_bar));
    }
    let stretch = span / (span - threshold_bar);
    Drawn::Before(map(move |value| stretch * (value - threshold_bar).max(0.0)))
}

/// The stroke saturates like a hyperbolic tangent. Second: it follows the S-shaped logistic curve of a braided muscle under load.
fn static_nonlinearity(second: bool, draw: &mut Draw<'_>) -> Drawn {
    let range = draw.range_mm;
    if second {
        let (steepness, middle) = (draw.even(4.0, 7.0), draw.even(0.35, 0.6));
        let logistic = move |share: f64| 1.0 / (1.0 + (-steepness * (share - middle)).exp());
        let (low, high) = (logistic(0.0), logistic(1.0));
        return Drawn::Behind(map(move |value| range * (logistic(value / range) - low) / (high - low)));
    }
    let bend = draw.even(0.8, 1.8);
    Drawn::Behind(map(move |value| range * (bend * value / range).tanh() / bend.tanh()))
}

/// The generalised Prandtl-Ishlinskii model: loading and unloading have hyperbolic-tangent envelopes of different bend. Second: a Bouc-Wen element
/// ahead of the muscle, with one width for rising pressure and another for falling.
fn asymmetric_hysteresis(second: bool, draw: &mut Draw<'_>) -> Drawn {
    if second {
        let (rise_bar, ratio) = (draw.span_bar * draw.even(0.03, 0.07), draw.even(2.0, 4.0));
        let (mut slip_bar, mut last_bar) = (0.0, 0.0);
        return Drawn::Before(stage(move |value: f64, _| {
            let change_bar: f64 = value - last_bar;
            last_bar = value;
            let width_bar = if change_bar > 0.0 { rise_bar } else { ratio * rise_bar };
            // The slip nears its bound exponentially over the travel; this form holds for steps of any size.
            let aim_bar = width_bar * change_bar.signum();
            slip_bar = aim_bar + (slip_bar - aim_bar) * (-change_bar.abs() / width_bar).exp();
            value - slip_bar
        }));
    }
    let loading = draw.even(0.3, 0.8);
    let unloading = loading + draw.even(0.6, 1.2);
    Drawn::Muscle(ThresholdLaw { saturations: Some([loading, unloading]), ..ThresholdLaw::default() })
}

/// Thresholds that grow in proportion to the rate of the pressure. Second: every loaded operator yields with a viscous time constant.
fn rate_dependent_hysteresis(second: bool, draw: &mut Draw<'_>) -> Drawn {
    Drawn::Muscle(if second {
        ThresholdLaw { sliding_s: draw.log(0.04, 0.15), ..ThresholdLaw::default() }
    } else {
        ThresholdLaw { linear_rate: draw.log(0.2, 0.6), ..ThresholdLaw::default() }
    })
}

/// The air column in the line is an inertance before the volume of the muscle. Second: a bending mode carries a share of the tip's stroke, the rest
/// follows at once.
fn resonance(second: bool, draw: &mut Draw<'_>) -> Drawn {
    let (frequency_hz, damping) = (draw.log(1.5, 5.0), draw.log(0.06, 0.3));
    draw.tell("resonance.frequency_hz", frequency_hz);
    draw.tell("resonance.damping_ratio", damping);
    if second {
        let share = draw.even(0.4, 0.8);
        let mut mode = swing(frequency_hz, damping, 0.0, draw.range_mm);
        return Drawn::Behind(stage(move |value, moment| (1.0 - share) * value + share * mode(value, moment)));
    }
    Drawn::Before(swing(frequency_hz, damping, 0.0, draw.span_bar))
}

/// An enclosed volume loses air through a turbulent orifice, as the root of its pressure. Second: air flows in through a restriction from the regulator
/// and out through a laminar leak all the time.
fn leakage(second: bool, draw: &mut Draw<'_>) -> Drawn {
    let span = draw.span_bar;
    if second {
        let (fill_s, leak_s) = (draw.log(0.1, 0.4), draw.log(1.0, 5.0));
        return Drawn::Before(first_order(move |value, state| (value - state) / fill_s - state / leak_s));
    }
    let time_s = draw.log(6.0, 35.0);
    let (mut muscle_bar, mut last_bar) = (0.0_f64, 0.0);
    Drawn::Before(stage(move |value, _| {
        let lost_bar_per_s = (muscle_bar * span).sqrt() / time_s;
        muscle_bar = (muscle_bar + value - last_bar - STEP_S * lost_bar_per_s).max(0.0);
        last_bar = value;
        muscle_bar
    }))
}

/// The pressure freezes for a time when its command turns, then follows it again at once. Second: the tip does so when its stroke turns, and catches
/// up at a limited rate.
fn hold_after_reversal(second: bool, draw: &mut Draw<'_>) -> Drawn {
    let hold_s = draw.log(0.14, 0.45);
    draw.tell("hold-after-reversal.hold_s", hold_s);
    let mut turn = Turn::default();
    if second {
        let most_mm_per_s = draw.range_mm * draw.even(8.0, 20.0);
        let mut tip_mm = 0.0;
        return Drawn::Behind(stage(move |value: f64, _| {
            if !turn.holds(value, hold_s) {
                tip_mm += (value - tip_mm).clamp(-STEP_S * most_mm_per_s, STEP_S * most_mm_per_s);
            }
            tip_mm
        }));
    }
    let mut held_bar = 0.0;
    Drawn::Before(stage(move |value, _| {
        if !turn.holds(value, hold_s) {
            held_bar = value;
        }
        held_bar
    }))
}
