//! Ladders of laws to tune on: for effects that failed on unseen laws, many laws each, as the literature has them, one for every seed.
//!
//! Softening: Mullins (1969), Simo (1987), Ogden and Roxburgh (1999), and Dorfmann and Ogden (2004) for what stays. Valves: on-off control with and without
//! hysteresis, by flow, by ramp and by pulses.

use super::draw::{Draw, STEP_S};
use super::ladders_of_time;
use super::laws::{Drawn, Turn, first_order, stage};

/// How many laws of softening there are.
const SOFTENINGS: u64 = 14;
/// First seed of further laws of softening.
const FURTHER: u64 = 8100;
/// How many of them there are.
const FURTHER_SOFTENINGS: u64 = 5;
/// First seed of laws of creep and of what swings.
const OF_TIME: u64 = 8200;
/// How many valves.
const VALVES: u64 = 8;
/// How many holds.
const HOLDS: u64 = 6;

/// Draws the law of the effect `name` that belongs to `seed`.
pub(super) fn tuning(name: &str, seed: u64, draw: &mut Draw<'_>) -> Drawn {
    match name {
        "first-cycle-softening" if seed >= FURTHER => further_softening(seed % FURTHER_SOFTENINGS, draw),
        "first-cycle-softening" => softening(seed % SOFTENINGS, draw),
        "creep" if seed >= OF_TIME => ladders_of_time::creep(seed % ladders_of_time::CREEPS, draw),
        "resonance" if seed >= OF_TIME => ladders_of_time::resonance(seed % ladders_of_time::SWINGS, draw),
        "valve-dead-band" => valve(seed % VALVES, draw),
        "hold-after-reversal" => hold(seed % HOLDS, draw),
        other => super::laws::tuning(other, draw),
    }
}

/// Laws of a muscle whose first strokes are other ones.
fn softening(law: u64, draw: &mut Draw<'_>) -> Drawn {
    let (span, range, size) = (draw.span_bar, draw.range_mm, draw.even(0.08, 0.22));
    let (few, far) = (draw.log(0.7, 3.0), range * draw.log(0.8, 4.0));
    let (mut last, mut done, mut high, mut peak) = (0.0_f64, 0.0_f64, false, 0.0_f64);
    match law {
        // Damage by the largest displacement so far, saturating, the same on both branches.
        0 => Drawn::Behind(stage(move |value: f64, moment| {
            peak = if moment.begins { value } else { peak.max(value) };
            value * (1.0 - size * (-peak / (0.4 * range)).exp())
        })),
        // By a power of the number of strokes.
        1 => Drawn::Behind(stage(move |value, moment| {
            count(&mut done, &mut high, value / range, moment.begins);
            value * (1.0 - size / (1.0 + done).powf(few))
        })),
        // By a logarithm of the number of strokes, as shakedown is often drawn.
        2 => Drawn::Behind(stage(move |value, moment| {
            count(&mut done, &mut high, value / range, moment.begins);
            value * (1.0 - size + 0.35 * size * (1.0 + done).ln())
        })),
        // What stays behind after unloading: a permanent set that the first strokes leave.
        3 => Drawn::Behind(stage(move |value: f64, moment| {
            if moment.begins {
                (done, last) = (0.0, value);
            }
            done += (value - last).abs() / far;
            last = value;
            value + size * range * (1.0 - (-done).exp())
        })),
        // The same by the largest displacement.
        4 => Drawn::Behind(stage(move |value: f64, moment| {
            peak = if moment.begins { value } else { peak.max(value) };
            value + size * peak * (1.0 - (value / range).clamp(0.0, 1.0))
        })),
        // Two structures, one that the first strokes destroy and one that takes many.
        5 => Drawn::Behind(stage(move |value: f64, moment| {
            if moment.begins {
                (done, last) = (0.0, value);
            }
            done += (value - last).abs() / far;
            last = value;
            value * (1.0 - size * (0.6 * (-done).exp() + 0.4 * (-done / 8.0).exp()))
        })),
        // By the work that the pressure has done.
        6 => Drawn::Behind(stage(move |value: f64, moment| {
            if moment.begins {
                (done, last) = (0.0, value);
            }
            done += (value - last).abs() * value.max(0.0) / (0.5 * range * far);
            last = value;
            value * (1.0 - size * (-done).exp())
        })),
        // Stiffer at large displacements only.
        7 => Drawn::Behind(stage(move |value: f64, moment| {
            if moment.begins {
                (done, last) = (0.0, value);
            }
            done += (value - last).abs() / far;
            last = value;
            value - 2.0 * size * (-done).exp() * value * (value / range).max(0.0)
        })),
        // The first strokes need more pressure, whatever the displacement.
        8 => Drawn::Before(stage(move |value: f64, moment| {
            count(&mut done, &mut high, value / span, moment.begins);
            value * (1.0 - size * (-done / few).exp())
        })),
        // They need a pressure to begin with, which the sleeve takes until it has settled.
        9 => Drawn::Before(stage(move |value: f64, moment| {
            count(&mut done, &mut high, value / span, moment.begins);
            (value - 0.7 * size * span * (-done / few).exp()).max(0.0)
        })),
        // Time under load softens it.
        10 => Drawn::Behind(stage(move |value: f64, moment| {
            if moment.begins {
                done = 0.0;
            }
            done += STEP_S * (value / range).max(0.0);
            value * (1.0 - size * (-done / (0.8 * few)).exp())
        })),
        // A pause brings back a part; the rest is for good.
        11 => {
            let back = draw.even(0.3, 0.7);
            let mut stiff = 1.0;
            Drawn::Behind(stage(move |value: f64, moment| {
                if moment.begins {
                    (stiff, last) = (stiff + back * (1.0 - stiff), value);
                }
                stiff *= (-(value - last).abs() / far).exp();
                last = value;
                value * (1.0 - size * stiff)
            }))
        }
        // Below its peak it is softer by a power of how far.
        12 => Drawn::Behind(stage(move |value: f64, moment| {
            peak = if moment.begins { value.max(1e-9) } else { peak.max(value) };
            value * (1.0 + size * (1.0 - value.max(0.0) / peak).sqrt())
        })),
        // A whole stroke at a time, and only the first one is another.
        _ => Drawn::Behind(stage(move |value, moment| {
            count(&mut done, &mut high, value / range, moment.begins);
            value * if done < 1.0 { 1.0 - size } else { 1.0 }
        })),
    }
}

/// Further laws of it: of the tangent, of a peak that fades, of powers, and of the width of the loop.
fn further_softening(law: u64, draw: &mut Draw<'_>) -> Drawn {
    let (range, size) = (draw.range_mm, draw.even(0.08, 0.22));
    let far = range * draw.log(0.8, 4.0);
    let (mut last, mut state, mut travelled, mut peak) = (0.0_f64, 0.0_f64, 0.0_f64, 0.0_f64);
    match law {
        // The tangent is stiffer at first, not the secant: what is missing stays missing.
        0 => Drawn::Behind(stage(move |value: f64, moment| {
            if moment.begins {
                (last, state, travelled) = (value, value, 0.0);
            }
            travelled += (value - last).abs();
            state += (value - last) * (1.0 - size * (-travelled / far).exp());
            last = value;
            state
        })),
        // Softer below a peak that fades.
        1 => {
            let fades_s = draw.log(4.0, 20.0);
            Drawn::Behind(stage(move |value: f64, moment| {
                peak = if moment.begins { value } else { peak.max(value) };
                peak += (value - peak) * STEP_S / fades_s;
                value * (1.0 + size * ((peak - value) / (0.25 * range)).tanh())
            }))
        }
        // By the square of the largest load.
        2 => Drawn::Behind(stage(move |value: f64, moment| {
            peak = if moment.begins { value } else { peak.max(value) };
            value * (1.0 - size * (1.0 - (peak / range).clamp(0.0, 1.0).powi(2)))
        })),
        // Below the peak along another power of the displacement.
        3 => Drawn::Behind(stage(move |value: f64, moment| {
            peak = if moment.begins { value.max(1e-9) } else { peak.max(value) };
            if value > 0.0 { peak * (value / peak).powf(1.0 - 2.0 * size) } else { value }
        })),
        // The loop is wider at first.
        _ => Drawn::Behind(stage(move |value: f64, moment| {
            if moment.begins {
                (last, state, travelled) = (value, value, 0.0);
            }
            travelled += (value - last).abs();
            last = value;
            let width = 0.5 * size * range * (-travelled / far).exp();
            state = state.clamp(value - width, value + width);
            state
        })),
    }
}

/// Counts a stroke when the displacement, as a share of its range, is back below 0.3 after it was above 0.4.
fn count(done: &mut f64, high: &mut bool, share: f64, begins: bool) {
    if begins {
        (*done, *high) = (0.0, false);
    }
    if *high && share < 0.3 {
        (*done, *high) = (*done + 1.0, false);
    } else if share > 0.4 {
        *high = true;
    }
}

/// Valves that leave an error alone as long as it is small. The first and the third, which never jump, are play operators before those of the muscle: more
/// of the same, which no recording tells apart.
fn valve(law: u64, draw: &mut Draw<'_>) -> Drawn {
    let drawn = draw.span_bar * draw.log(0.03, 0.1);
    let band = draw.tell("valve-dead-band.band_bar", drawn);
    let (flow_s, ramp, shuts) = (draw.log(0.01, 0.05), draw.span_bar * draw.log(3.0, 10.0) * STEP_S, draw.even(0.0, 0.4) * band);
    let (mut state, mut open, mut left) = (0.0_f64, false, 0_u32);
    let filled = draw.even(0.3, 0.8);
    match law {
        // Fills when it is too low by the band, vents when it is too high by the band, by one rate.
        0 => Drawn::Before(stage(move |value: f64, _| {
            let error = value - state;
            state += if error.abs() > band { ramp * error.signum() } else { 0.0 };
            state
        })),
        // The same with what it takes to shut.
        1 => Drawn::Before(stage(move |value: f64, _| {
            let error = value - state;
            open = error.abs() > if open { shuts.max(ramp) } else { band };
            state += if open { error.clamp(-ramp, ramp) } else { 0.0 };
            state
        })),
        // Proportional flow beyond the overlap of the spool.
        2 => Drawn::Before(first_order(move |value, state| {
            let error = value - state;
            (error - error.clamp(-band, band)) / flow_s
        })),
        // Full flow once it is open, like a volume behind a restriction.
        3 => Drawn::Before(stage(move |value: f64, _| {
            let error = value - state;
            open = error.abs() > if open { shuts.max(0.02 * band) } else { band };
            state += if open { error * STEP_S / flow_s } else { 0.0 };
            state
        })),
        // Pulses of one length, each as soon as the error is large.
        4 => Drawn::Before(stage(move |value: f64, _| {
            let error = value - state;
            if left == 0 && error.abs() > band {
                left = 25;
            }
            if left > 0 {
                left -= 1;
                state += error * STEP_S / flow_s;
            }
            state
        })),
        // One band to fill and a narrower one to vent.
        5 => Drawn::Before(stage(move |value: f64, _| {
            let error = value - state;
            let own = if error > 0.0 { band } else { filled * band };
            open = error.abs() > if open { 0.05 * band } else { own };
            state += if open { error * STEP_S / flow_s } else { 0.0 };
            state
        })),
        // A controller that looks every 20 ms and sets the pressure right where it is wrong enough.
        6 => Drawn::Before(stage(move |value: f64, _| {
            left = if left == 0 { 19 } else { left - 1 };
            if left == 0 && (value - state).abs() > band {
                state = value;
            }
            state
        })),
        // It opens at the band and lets through a share of the error before it shuts.
        _ => Drawn::Before(stage(move |value: f64, _| {
            let error = value - state;
            open = error.abs() > if open { (1.0 - filled) * band } else { band };
            state += if open { error.clamp(-ramp, ramp) } else { 0.0 };
            state
        })),
    }
}

/// What stands still after its command has turned.
fn hold(law: u64, draw: &mut Draw<'_>) -> Drawn {
    let drawn_s = draw.log(0.1, 0.4);
    let hold_s = draw.tell("hold-after-reversal.hold_s", drawn_s);
    let (flow_s, ramp) = (draw.log(0.02, 0.1), draw.span_bar * draw.log(1.5, 5.0) * STEP_S);
    let (mut turn, mut state, mut behind, mut held) = (Turn::default(), 0.0_f64, 0.0_f64, 0.0_f64);
    match law {
        // It holds and is there at once.
        0 => Drawn::Before(stage(move |value: f64, _| {
            state = if turn.holds(value, hold_s) { state } else { value };
            state
        })),
        // The valve holds, the muscle follows by its own lag all the time.
        1 => Drawn::Before(stage(move |value: f64, _| {
            held = if turn.holds(value, hold_s) { held } else { value };
            state += (held - state) * STEP_S / flow_s;
            state
        })),
        // It catches up by a ramp.
        2 => Drawn::Before(stage(move |value: f64, _| {
            state += if turn.holds(value, hold_s) { 0.0 } else { (value - state).clamp(-ramp, ramp) };
            state
        })),
        // The tip holds.
        3 => Drawn::Behind(stage(move |value: f64, _| {
            state = if turn.holds(value, hold_s) { state } else { value };
            state
        })),
        // The tip holds, and what it is behind fades.
        4 => Drawn::Behind(stage(move |value: f64, _| {
            if turn.holds(value, hold_s) {
                behind = state - value;
            } else {
                behind *= 1.0 - STEP_S / flow_s;
            }
            state = value + behind;
            state
        })),
        // It does not hold altogether: a tenth of the flow leaks through.
        _ => Drawn::Before(stage(move |value: f64, _| {
            let flow = if turn.holds(value, hold_s) { 0.1 } else { 1.0 };
            state += flow * (value - state) * STEP_S / flow_s;
            state
        })),
    }
}
