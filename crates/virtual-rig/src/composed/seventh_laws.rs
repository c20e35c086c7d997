//! Laws to tune on as the literature has them, several for every effect and one for every seed: this file holds those of the pressure side, of the loop
//! and of the tip's friction, `seventh_laws_of_time` those of rubber and of what swings.

use std::collections::VecDeque;
use std::f64::consts::{PI, TAU};

use super::draw::{Draw, STEP_S};
use super::laws::{self, Drawn, Turn, first_order, stage};
use super::motion::{Speed, Stroke, nears};
use super::seventh_laws_of_time as of_time;

/// How many laws each effect has, here and in `eighth_laws`.
pub(super) const COUNTS: [(&str, u64); 11] = [
    ("first-cycle-softening", 6),
    ("resonance", 6),
    ("creep", 5),
    ("rate-dependent-hysteresis", 5),
    ("stick-slip", 4),
    ("valve-dead-band", 4),
    ("hold-after-reversal", 3),
    ("leakage", 3),
    ("pneumatic-lag", 3),
    ("fill-vent-asymmetry", 3),
    ("asymmetric-hysteresis", 3),
];

/// The laws of each effect, in the same order.
pub(super) type Laws = [fn(u64, &mut Draw<'_>) -> Drawn; COUNTS.len()];

/// Those of this file and `seventh_laws_of_time`.
pub(super) const LAWS: Laws = [
    of_time::softening,
    of_time::resonance,
    of_time::creep,
    rate_dependent_hysteresis,
    stick_slip,
    valve,
    hold,
    leakage,
    lag,
    fill_vent_asymmetry,
    asymmetric_hysteresis,
];

/// Draws the law of the effect `name` that belongs to `seed`.
pub(super) fn tuning(laws: &Laws, name: &str, seed: u64, draw: &mut Draw<'_>) -> Drawn {
    match COUNTS.iter().position(|(known, _)| *known == name) {
        Some(at) => laws[at](seed % COUNTS[at].1, draw),
        None => laws::tuning(name, draw),
    }
}

/// Laws of a loop whose width goes with the speed.
fn rate_dependent_hysteresis(law: u64, draw: &mut Draw<'_>) -> Drawn {
    let (span, range, smooth_s) = (draw.span_bar, draw.range_mm, draw.even(0.015, 0.04));
    let (mut speed, mut last, mut state) = (Speed::default(), 0.0, 0.0_f64);
    match law {
        // Strands of the braid rub by the pressure on them, less when they slide: Tondu and Lopez (2000).
        0 => {
            let (rests, slides, slow) = (draw.even(0.16, 0.26), draw.even(0.02, 0.05), span * draw.log(0.2, 0.6));
            Drawn::Before(stage(move |value: f64, _| {
                let rate = speed.step(value, smooth_s).abs();
                let half = value.max(0.0) * (slides + (rests - slides) * (-rate / slow).exp());
                state = state.clamp(value - half, value + half);
                state
            }))
        }
        // A Bouc and Wen element (Wen 1976) whose strength grows by a power of the rate.
        1 => {
            let (size, onset) = (range * draw.even(0.012, 0.025), range * draw.even(0.06, 0.15));
            let (growth, power) = (draw.even(1.2, 2.5), draw.even(0.5, 0.8));
            Drawn::Behind(stage(move |value: f64, _| {
                let rate = (speed.step(value, smooth_s).abs() / range).min(4.0);
                state = nears(state, (value - last).signum(), value - last, onset);
                last = value;
                value - size * state * (1.0 + growth * rate.powf(power))
            }))
        }
        // Viscoplastic overstress: it slips by a power of what is above the yield stress, Perzyna (1966).
        2 => {
            let (yields, scale) = (span * draw.even(0.01, 0.03), span * draw.even(0.05, 0.08));
            let (power, slip) = (draw.even(1.8, 3.2), span * draw.log(0.5, 1.5));
            Drawn::Before(stage(move |value: f64, _| {
                let over = ((value - state).abs() - yields).max(0.0);
                state += (STEP_S * slip * (over / scale).powf(power)).min(over) * (value - state).signum();
                state
            }))
        }
        // Loss by parts, a classical one in proportion to the rate and an excess one by its root: Bertotti (1988).
        3 => {
            let (classical, excess) = (draw.even(0.003, 0.008), draw.even(0.05, 0.08));
            let most = span * draw.even(0.12, 0.18);
            Drawn::Before(stage(move |value: f64, _| {
                let rate = speed.step(value, smooth_s) / span;
                let loss = span * (classical * rate.abs() + excess * rate.abs().sqrt());
                value - most * (loss / most).tanh() * rate.signum()
            }))
        }
        // Friction that relaxes as soon as it rests, so that slow strokes drag little: contacts that creep, Bowden and Tabor (1950).
        _ => {
            let (half, rest_s, slow) = (span * draw.even(0.05, 0.09), draw.log(0.1, 0.4), span * draw.log(0.3, 0.9));
            Drawn::Before(stage(move |value: f64, _| {
                let still = (-speed.step(value, smooth_s).abs() / slow).exp();
                state += (value - state) * still * STEP_S / rest_s;
                state = state.clamp(value - half, value + half);
                state
            }))
        }
    }
}

/// Laws of a tip that sticks and breaks away.
fn stick_slip(law: u64, draw: &mut Draw<'_>) -> Drawn {
    let (range, kinetic) = (draw.range_mm, draw.even(0.1, 0.4));
    let (mut place, mut slides) = (0.0_f64, false);
    match law {
        // A catheter around a bend: what holds it grows as a rope's around a capstan, Euler and Eytelwein.
        0 => {
            let (hold, wrap) = (range * draw.even(0.03, 0.05), draw.even(0.5, 1.1));
            Drawn::Behind(stage(move |value: f64, _| {
                let own = hold * (wrap * (place / range).clamp(0.0, 1.2)).exp();
                let stretch: f64 = value - place;
                slides = stretch.abs() > if slides { kinetic * own } else { own };
                if slides {
                    place += (stretch - 0.8 * kinetic * own * stretch.signum()) * STEP_S / 0.006;
                }
                place
            }))
        }
        // Dragged over the crests of the guide's wall, always the same ones: Prandtl (1928) and Tomlinson (1929).
        1 => {
            let (crest, slip_s) = (range * draw.even(0.04, 0.08), draw.even(0.01, 0.02));
            let depth = crest * draw.even(0.5, 0.8);
            Drawn::Behind(first_order(move |value, place| (value - place - depth * (TAU * place / crest).sin()) / slip_s))
        }
        // Two blocks on springs, one behind another, of which the tip is the second: Burridge and Knopoff (1967).
        2 => {
            let (holds, stiffness) = ([range * draw.even(0.02, 0.035), range * draw.even(0.04, 0.06)], draw.even(0.8, 1.4));
            let (mut blocks, mut sliding) = ([0.0_f64; 2], [false; 2]);
            Drawn::Behind(stage(move |value: f64, _| {
                let between = stiffness * (blocks[0] - blocks[1]);
                let forces = [value - blocks[0] - between, between];
                for block in 0..2 {
                    let (force, hold) = (forces[block], holds[block]);
                    sliding[block] = force.abs() > if sliding[block] { kinetic * hold } else { hold };
                    if sliding[block] {
                        blocks[block] += (force - 0.8 * kinetic * hold * force.signum()) * STEP_S / 0.008;
                    }
                }
                blocks[1]
            }))
        }
        // It sticks when it is dragged slowly, and a film carries it when it is dragged fast: Stribeck (1902).
        _ => {
            let (most, slow) = (range * draw.even(0.06, 0.1), range * draw.log(0.5, 1.2));
            let mut speed = Speed::default();
            Drawn::Behind(stage(move |value: f64, _| {
                let hold = most * (-speed.step(value, 0.02).abs() / slow).exp();
                let stretch: f64 = value - place;
                slides = stretch.abs() > if slides { 0.2 * kinetic * most } else { hold };
                if slides {
                    place += stretch * STEP_S / 0.006;
                }
                place
            }))
        }
    }
}

/// Valves that let a small error be.
fn valve(law: u64, draw: &mut Draw<'_>) -> Drawn {
    let (span, wider) = (draw.span_bar, if law < 2 { 1.0 } else { 1.4 });
    let band = span * wider * draw.log(0.04, 0.09);
    let flow_s = draw.log(0.012, 0.04);
    let (mut state, mut open, mut left) = (0.0_f64, false, 0_u32);
    if law < 3 {
        draw.tell("valve-dead-band.band_bar", band);
    }
    match law {
        // Pulses as wide as the error, and none for one that is too short to open: van Varseveld and Bone (1997) on pulse width modulation.
        0 => {
            let (cycle, full) = (draw.even(40.0, 80.0) as u32, span * draw.even(0.4, 0.8));
            let ramp = full / f64::from(cycle);
            let mut way = 0.0_f64;
            Drawn::Before(stage(move |value: f64, _| {
                let error: f64 = value - state;
                left = (left + 1) % cycle;
                if left == 0 {
                    way = if error.abs() > band { error.clamp(-full, full) } else { 0.0 };
                }
                let moves = way.clamp(-ramp, ramp);
                way -= moves;
                state += moves;
                state
            }))
        }
        // A metering valve that lets through one charge at a time, all of one size, as digital fluid power does.
        1 => {
            let (charge, refills) = (band * draw.even(1.1, 1.6), draw.even(8.0, 20.0) as u32);
            Drawn::Before(stage(move |value: f64, _| {
                left = left.saturating_sub(1);
                let error: f64 = value - state;
                if left == 0 && error.abs() > band {
                    state = (state + charge * error.signum()).max(0.0);
                    left = refills;
                }
                state
            }))
        }
        // A relieving regulator fills at once, and its relief opens only when the pressure is too high by the band: textbooks of pneumatics.
        2 => Drawn::Before(stage(move |value: f64, _| {
            let error = value - state;
            open = error < if open { -0.05 * band } else { -band };
            state += if error > 0.0 || open { error * STEP_S / flow_s } else { 0.0 };
            state
        })),
        // The pressure presses the packing onto the spool: what it takes to open grows with it.
        _ => Drawn::Before(stage(move |value: f64, _| {
            let error = value - state;
            let own = band * (0.4 + 1.5 * (state / span).clamp(0.0, 1.0));
            open = error.abs() > if open { 0.1 * own } else { own };
            state += if open { error * STEP_S / flow_s } else { 0.0 };
            state
        })),
    }
}

/// Laws of what stands still after its command has turned.
fn hold(law: u64, draw: &mut Draw<'_>) -> Drawn {
    let (span, hold_s) = (draw.span_bar, draw.log(0.15, 0.4));
    let (mut turn, mut state) = (Turn::default(), 0.0_f64);
    match law {
        // It holds until the command is so far away from where it turned, then is there at once: play in a valve's linkage that snaps over.
        0 => {
            let (far, mut stroke, mut holds, mut anchor) = (span * draw.even(0.12, 0.22), Stroke::default(), false, 0.0);
            Drawn::Before(stage(move |value: f64, _| {
                if stroke.turned(value, 1e-4 * span).is_some() && !holds {
                    (holds, anchor) = (true, stroke.start);
                }
                holds &= (value - anchor).abs() < far;
                state = if holds { state } else { value };
                state
            }))
        }
        // The magnet lets go of its armature later the higher the pressure on it: switching times in data sheets of solenoids.
        1 => {
            let flow_s = draw.log(0.01, 0.03);
            Drawn::Before(stage(move |value: f64, _| {
                let own_s = hold_s * (0.4 + 1.2 * (value / span).clamp(0.0, 1.0));
                state += if turn.holds(value, own_s) { 0.0 } else { (value - state) * STEP_S / flow_s };
                state
            }))
        }
        // It holds for a time, unless the error forces the valve over sooner: a timer with an override.
        _ => {
            draw.tell("hold-after-reversal.hold_s", hold_s);
            let (far, ramp, mut forced) = (span * draw.even(0.25, 0.4), span * draw.log(3.0, 8.0) * STEP_S, false);
            Drawn::Before(stage(move |value: f64, _| {
                let (holds, error) = (turn.holds(value, hold_s), value - state);
                forced = holds && (forced || error.abs() > far);
                state += if holds && !forced { 0.0 } else { error.clamp(-ramp, ramp) };
                state
            }))
        }
    }
}

/// Laws of air that gets lost.
fn leakage(law: u64, draw: &mut Draw<'_>) -> Drawn {
    let span = draw.span_bar;
    let (mut lost, mut last, mut speed) = (0.0_f64, 0.0, Speed::default());
    match law {
        // A fitting whose lip lifts above a pressure; the regulator's integral makes it good by and by.
        0 => {
            let (lifts, leak_s, refill_s) = (span * draw.even(0.25, 0.45), draw.log(3.0, 8.0), draw.log(2.0, 6.0));
            Drawn::Before(stage(move |value: f64, _| {
                lost += STEP_S * ((value - lost - lifts).max(0.0) / leak_s - lost / refill_s);
                (value - lost).max(0.0)
            }))
        }
        // A metered charge through a long crack: laminar and isothermal, by the difference of the squared absolute pressures, Poiseuille.
        1 => {
            let time_s = draw.log(20.0, 80.0);
            Drawn::Before(stage(move |value: f64, _| {
                let loss = ((1.0 + lost).powi(2) - 1.0) / (2.0 * time_s);
                lost = (lost + value - last - STEP_S * loss).max(0.0);
                last = value;
                lost
            }))
        }
        // A valve that is shut while the command rests cannot make good what leaks; it does as soon as the command moves.
        _ => {
            let (leak_s, slow, refill_s) = (draw.log(4.0, 14.0), span * draw.log(0.2, 0.4), draw.log(0.05, 0.15));
            Drawn::Before(stage(move |value: f64, _| {
                let still = (-(speed.step(value, 0.02) / slow).powi(2)).exp();
                lost += STEP_S * ((value - lost) * still / leak_s - lost * (1.0 - still) / refill_s);
                (value - lost).max(0.0)
            }))
        }
    }
}

/// Laws of a pressure that comes late.
fn lag(law: u64, draw: &mut Draw<'_>) -> Drawn {
    match law {
        // A narrow tube as five volumes behind five restrictions, told by its slowest time constant: Schuder and Binder (1959).
        0 => {
            let drawn_s = draw.log(0.08, 0.4);
            let cell_s = draw.tell("pneumatic-lag.time_constant_s", drawn_s) * 4.0 * (PI / 22.0).sin().powi(2);
            let mut cells = [0.0; 5];
            Drawn::Before(stage(move |value, _| {
                let mut behind = value;
                for cell in 0..5 {
                    let ahead = cells.get(cell + 1).copied().unwrap_or(cells[cell]);
                    let next = cells[cell] + STEP_S * (behind - 2.0 * cells[cell] + ahead) / cell_s;
                    behind = cells[cell];
                    cells[cell] = next;
                }
                cells[4]
            }))
        }
        // Air that is compressed at once and warm, and what its heat holds back until the wall has taken it: two lags beside each other.
        1 => {
            let (quick_s, slow_s, share) = (draw.log(0.03, 0.08), draw.log(0.25, 0.8), draw.even(0.35, 0.6));
            let (mut quick, mut slow) = (0.0, 0.0);
            Drawn::Before(stage(move |value, _| {
                quick += STEP_S * (value - quick) / quick_s;
                slow += STEP_S * (value - slow) / slow_s;
                (1.0 - share) * quick + share * slow
            }))
        }
        // A bundle of passages of every length up to the longest: even times of residence, Danckwerts (1953).
        _ => {
            let longest = draw.log(120.0, 300.0) as usize;
            let (mut passages, mut sum) = (VecDeque::from(vec![0.0; longest]), 0.0);
            Drawn::Before(stage(move |value, _| {
                passages.push_back(value);
                sum += value - passages.pop_front().unwrap_or(0.0);
                sum / longest as f64
            }))
        }
    }
}

/// Laws of a muscle that fills otherwise than it vents.
fn fill_vent_asymmetry(law: u64, draw: &mut Draw<'_>) -> Drawn {
    let (span, fill_s) = (draw.span_bar, draw.log(0.06, 0.14));
    match law {
        // Switched between a supply little above it and the room: it fills by what the supply is above it, vents by what it is above the room.
        0 => {
            let (supply, full) = (span * draw.even(1.1, 1.35), span * draw.even(0.04, 0.1));
            let vent_s = fill_s * draw.even(1.5, 3.0);
            Drawn::Before(first_order(move |value, state| {
                let duty = ((value - state) / full).clamp(-1.0, 1.0);
                duty * if duty > 0.0 { (supply - state).max(0.0) / fill_s } else { (state + 0.03 * span).max(0.0) / vent_s }
            }))
        }
        // The bladder collapses onto its outlet as it empties: a collapsible tube, Knowlton and Starling (1912).
        1 => {
            let (collapses, vent_s) = (span * draw.even(0.2, 0.5), fill_s * draw.even(1.0, 1.6));
            Drawn::Before(first_order(move |value, state: f64| {
                let width = (0.05 * span + state.max(0.0)) / (collapses + state.max(0.0));
                (value - state) / if value > state { fill_s } else { vent_s / width.min(1.0) }
            }))
        }
        // What it vents piles up in a silencer that passes it on slowly: back pressure in textbooks of pneumatics.
        _ => {
            let (piles, passes_s) = (draw.even(0.7, 1.6), draw.log(0.1, 0.3));
            let mut back = 0.0;
            Drawn::Before(first_order(move |value, state| {
                let vents = (state - value - back).max(0.0) / fill_s;
                back += STEP_S * (piles * vents - back / passes_s);
                if value > state { (value - state) / fill_s } else { -vents }
            }))
        }
    }
}

/// Laws of a loop that is another one up than down.
fn asymmetric_hysteresis(law: u64, draw: &mut Draw<'_>) -> Drawn {
    let range = draw.range_mm;
    let (mut state, mut last) = (0.0_f64, 0.0);
    match law {
        // A Bowden cable takes a share of the load, one up and a larger one down: Euler and Eytelwein.
        0 => {
            let (up, down) = (draw.even(0.02, 0.06), draw.even(0.12, 0.22));
            Drawn::Behind(stage(move |value: f64, _| {
                state = state.max(value * (1.0 - up)).min(value * (1.0 + down)).max(value.min(0.0));
                state
            }))
        }
        // Relays that open the later the higher they shut, beside the direct path: Preisach (1935).
        1 => {
            let (share, narrow, wide) = (draw.even(0.35, 0.5), draw.even(0.02, 0.06), draw.even(0.4, 0.6));
            let mut shut = [false; 60];
            Drawn::Behind(stage(move |value: f64, _| {
                let mut sum = 0.0;
                for (relay, shut) in (1..=60).zip(&mut shut) {
                    let level = f64::from(relay) / 60.0;
                    let opens = level - (narrow + wide * level * level).min(0.95 * level);
                    *shut = value > range * if *shut { opens } else { 0.9 * level };
                    sum += if *shut { 0.9 * range / 60.0 } else { 0.0 };
                }
                (1.0 - share) * value + share * sum
            }))
        }
        // It nears one curve as it rises and another as it falls, over a length of travel: Duhem's model after Coleman and Hodgdon (1986).
        _ => {
            let (lower, upper, onset) = (draw.even(0.02, 0.05), draw.even(0.08, 0.15), range * draw.even(0.12, 0.3));
            Drawn::Behind(stage(move |value: f64, _| {
                let share = (value / range).clamp(0.0, 1.0);
                let curve = if value > last { -lower * share * share } else { upper * share.sqrt() * (1.0 - 0.4 * share) };
                state = nears(state, range * curve, value - last, onset);
                last = value;
                value + state
            }))
        }
    }
}
