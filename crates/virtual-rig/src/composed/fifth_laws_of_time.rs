//! Textbook laws of the tip, the sensor and the session; see `fifth_laws`.

use std::f64::consts::TAU;

use rand::RngExt;

use super::draw::{Draw, STEP_S};
use super::laws::{Drawn, stage};
use crate::noise::normal;

/// A Kelvin-Voigt element in series with the muscle: the standard linear solid. Second: the same with an Eyring dashpot, whose rate grows as the
/// hyperbolic sine of the stress, so that creep follows the logarithm of time.
pub(super) fn creep(second: bool, draw: &mut Draw<'_>) -> Drawn {
    let size = draw.even(0.08, 0.22);
    let mut strain_mm = 0.0;
    if second {
        let (time_s, activation_mm) = (draw.log(10.0, 40.0), draw.even(0.15, 0.3) * size * draw.range_mm);
        return Drawn::Behind(stage(move |value, _| {
            let stress: f64 = (size * value - strain_mm) / activation_mm;
            strain_mm += STEP_S * activation_mm / time_s * stress.sinh();
            value + strain_mm
        }));
    }
    let time_s = draw.log(1.0, 8.0);
    Drawn::Behind(stage(move |value, _| {
        strain_mm += STEP_S * (size * value - strain_mm) / time_s;
        value + strain_mm
    }))
}

/// The Mullins effect: rubber is softer below the largest stroke since the recording began. Second: loading damages the fresh rubber, which is stiff at
/// first and softens with the stroke that it has loaded.
pub(super) fn first_cycle_softening(second: bool, draw: &mut Draw<'_>) -> Drawn {
    let (size, range) = (draw.even(0.08, 0.22), draw.range_mm);
    if second {
        let stroke_mm = range * draw.log(0.6, 2.5);
        let (mut damage, mut last_mm) = (0.0, 0.0_f64);
        return Drawn::Behind(stage(move |value, moment| {
            if moment.begins {
                damage = 0.0;
            }
            damage += (1.0 - damage) * (value - last_mm).max(0.0) / stroke_mm;
            last_mm = value;
            value * (1.0 - size * (1.0 - damage))
        }));
    }
    let (width_mm, mut largest_mm) = (range * draw.even(0.1, 0.3), 0.0_f64);
    Drawn::Behind(stage(move |value, moment| {
        largest_mm = if moment.begins { value } else { largest_mm.max(value) };
        value * (1.0 + size * ((largest_mm - value) / width_mm).tanh())
    }))
}

/// A mass on a spring under Stribeck friction. Second: the tip stays until the drive is a threshold ahead, then snaps to it.
pub(super) fn stick_slip(second: bool, draw: &mut Draw<'_>) -> Drawn {
    const PARTS: u32 = 10;
    let hold_mm = draw.range_mm * draw.log(0.025, 0.08);
    let mut tip_mm = 0.0;
    if second {
        return Drawn::Behind(stage(move |value: f64, _| {
            if (value - tip_mm).abs() > hold_mm {
                tip_mm = value;
            }
            tip_mm
        }));
    }
    let (omega_per_s, damping, kinetic) = (TAU * draw.log(8.0, 20.0), draw.even(0.2, 0.6), draw.even(0.3, 0.7));
    let (stribeck_mm_per_s, part_s) = (0.2 * hold_mm * omega_per_s, STEP_S / f64::from(PARTS));
    let (mut speed_mm_per_s, mut slides) = (0.0_f64, false);
    Drawn::Behind(stage(move |value, _| {
        for _ in 0..PARTS {
            let stretch_mm: f64 = value - tip_mm;
            if !slides && stretch_mm.abs() <= hold_mm {
                break;
            }
            let direction = if slides { speed_mm_per_s.signum() } else { stretch_mm.signum() };
            let friction_mm = hold_mm * (kinetic + (1.0 - kinetic) * (-(speed_mm_per_s / stribeck_mm_per_s).powi(2)).exp());
            let drive_mm = stretch_mm - direction * friction_mm - 2.0 * damping * speed_mm_per_s / omega_per_s;
            speed_mm_per_s += part_s * omega_per_s * omega_per_s * drive_mm;
            slides = speed_mm_per_s * direction > 0.0;
            if !slides {
                speed_mm_per_s = 0.0;
            }
            tip_mm += part_s * speed_mm_per_s;
        }
        tip_mm
    }))
}

/// A pump's ripple on the pressure. Second: a beating heart moves the tip, with a second harmonic.
pub(super) fn periodic_disturbance(second: bool, draw: &mut Draw<'_>) -> Drawn {
    let phase = draw.even(0.0, TAU);
    if second {
        let (frequency_hz, size_mm) = (draw.log(0.8, 2.5), draw.range_mm * draw.log(0.012, 0.04));
        let (share, lead) = (draw.even(0.2, 0.6), draw.even(0.0, TAU));
        draw.tell("periodic-disturbance.frequency_hz", frequency_hz);
        return Drawn::Behind(stage(move |value, moment| {
            let turn = TAU * frequency_hz * moment.session_s + phase;
            value + size_mm * (turn.sin() + share * (2.0 * turn + lead).sin())
        }));
    }
    let (frequency_hz, size_bar) = (draw.log(1.0, 6.0), draw.span_bar * draw.log(0.025, 0.07));
    draw.tell("periodic-disturbance.frequency_hz", frequency_hz);
    Drawn::Before(stage(move |value, moment| value + size_bar * (TAU * frequency_hz * moment.session_s + phase).sin()))
}

/// The sensor's zero walks at random over the session. Second: it warms up and nears its final value exponentially.
pub(super) fn offset_drift(second: bool, draw: &mut Draw<'_>) -> Drawn {
    let size_mm = draw.range_mm * draw.log(0.04, 0.14) * draw.sign();
    if second {
        let time_s = draw.session_s * draw.even(0.15, 0.4);
        return Drawn::Behind(stage(move |value, moment| value + size_mm * warmth(moment.session_s, time_s)));
    }
    let knot_s = 10.0;
    let count = (1.3 * draw.session_s / knot_s) as usize + 2;
    let mut walk = vec![0.0_f64];
    for knot in 1..count {
        walk.push(walk[knot - 1] + normal(draw.generator));
    }
    let widest = walk.iter().fold(0.0, |widest: f64, place| widest.max(place.abs()));
    Drawn::Behind(stage(move |value, moment| {
        let place = (moment.session_s.max(0.0) / knot_s).min((count - 1) as f64);
        let below = (place as usize).min(count - 2);
        let between = walk[below] + (place - below as f64) * (walk[below + 1] - walk[below]);
        value + size_mm * between / widest
    }))
}

/// How warm a device is some time after it was switched on, from zero to one.
fn warmth(session_s: f64, time_s: f64) -> f64 {
    1.0 - (-session_s.max(0.0) / time_s).exp()
}

/// The stroke grows or shrinks while the rig warms up. Second: it follows the slow swing of the room's temperature.
pub(super) fn gain_drift(second: bool, draw: &mut Draw<'_>) -> Drawn {
    let size = draw.even(0.07, 0.22) * draw.sign();
    if second {
        let (period_s, phase) = (draw.session_s * draw.even(0.6, 1.5), draw.even(0.0, TAU));
        return Drawn::Behind(stage(move |value, moment| value * (1.0 + 0.5 * size * (TAU * moment.session_s / period_s + phase).sin())));
    }
    let time_s = draw.session_s * draw.even(0.2, 0.5);
    Drawn::Behind(stage(move |value, moment| value * (1.0 + size * warmth(moment.session_s, time_s))))
}

/// From one recording on, the sensor sits elsewhere at another angle: offset and gain both change. Second: its place changes twice.
pub(super) fn setup_change(second: bool, draw: &mut Draw<'_>) -> Drawn {
    let at = draw.generator.random_range(5..14);
    let shift_mm = draw.range_mm * draw.even(0.03, 0.1) * draw.sign();
    if second {
        let (again, next_mm) = (at + draw.generator.random_range(2..6), draw.range_mm * draw.even(0.03, 0.1) * draw.sign());
        return Drawn::Behind(stage(move |value, moment| {
            let first_mm = if moment.recording >= at { shift_mm } else { 0.0 };
            value + first_mm + if moment.recording >= again { next_mm } else { 0.0 }
        }));
    }
    let gain = 1.0 + draw.even(0.03, 0.1) * draw.sign();
    Drawn::Behind(stage(move |value, moment| if moment.recording >= at { gain * value + shift_mm } else { value }))
}

/// The controller's output is held between the ticks of a clock that runs through the session. Second: the camera that sees the tip is slow.
pub(super) fn sample_and_hold(second: bool, draw: &mut Draw<'_>) -> Drawn {
    let period_s = draw.log(0.08, 0.45);
    draw.tell("sample-and-hold.period_s", period_s);
    let (mut held, mut last_tick) = (0.0, None);
    let law = stage(move |value, moment| {
        let tick = Some((moment.session_s / period_s).floor() as i64);
        if tick != last_tick {
            (held, last_tick) = (value, tick);
        }
        held
    });
    if second { Drawn::Behind(law) } else { Drawn::Before(law) }
}
