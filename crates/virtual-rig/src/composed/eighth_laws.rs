//! Further laws to tune on as the literature has them, for the effects of [`super::seventh_laws`] and none of them twice: this file holds those of the
//! pressure side, of the loop and of the tip's friction, `eighth_laws_of_time` those of rubber and of what swings.

use std::collections::VecDeque;
use std::f64::consts::PI;

use rand::RngExt;

use super::draw::{Draw, STEP_S};
use super::eighth_laws_of_time as of_time;
use super::laws::{Drawn, first_order, stage};
use super::motion::{Speed, Stroke, nears};
use super::seventh_laws::Laws;

/// The laws of this file and `eighth_laws_of_time`.
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

/// Laws of a loop whose width goes with the speed.
fn rate_dependent_hysteresis(law: u64, draw: &mut Draw<'_>) -> Drawn {
    let (span, range, smooth_s) = (draw.span_bar, draw.range_mm, draw.even(0.015, 0.04));
    let (mut speed, mut last, mut state) = (Speed::default(), 0.0, 0.0_f64);
    match law {
        // Filling presses the strands together, the faster the more, and venting does not: play that only a rising pressure widens.
        0 => {
            let (still, growth, power) = (span * draw.even(0.01, 0.025), span * draw.even(0.05, 0.09), draw.even(0.5, 0.8));
            Drawn::Before(stage(move |value: f64, _| {
                let rate = speed.step(value, smooth_s).max(0.0) / span;
                let rising = still + (growth * rate.powf(power)).min(0.2 * span);
                state = state.max(value - rising).min(value + still);
                state
            }))
        }
        // Friction by the logarithm of the rate and of the contacts' age, which a length of slip renews: Dieterich (1979) and Ruina (1983).
        1 => {
            let (half, direct, evolving) = (span * draw.even(0.015, 0.025), draw.even(0.5, 0.9), draw.even(0.1, 0.2));
            let (slow, renews, mut age_s) = (0.05 * span, span * draw.even(0.05, 0.15), 1.0_f64);
            Drawn::Before(stage(move |value: f64, _| {
                let rate = speed.step(value, smooth_s).abs();
                age_s = ((age_s + STEP_S) / (1.0 + STEP_S * rate / renews)).min(20.0);
                let own = half * (1.0 + direct * (rate / slow).ln_1p() + evolving * (age_s / 0.1).ln_1p());
                state = state.clamp(value - own, value + own);
                state
            }))
        }
        // Relays that take their time to switch, less the further they are driven beyond their level: the dynamic Preisach model, Bertotti (1992).
        2 => {
            let (share, wide, quick) = (draw.even(0.3, 0.5), draw.even(0.06, 0.14), draw.log(25.0, 80.0));
            let mut relays = [0.0_f64; 30];
            Drawn::Behind(stage(move |value: f64, _| {
                let mut sum = 0.0;
                for (number, relay) in (1..=30).zip(&mut relays) {
                    let beyond = value / range - 0.9 * f64::from(number) / 30.0;
                    *relay = (*relay + STEP_S * quick * (beyond.max(0.0) + (beyond + wide).min(0.0))).clamp(0.0, 1.0);
                    sum += 0.9 * range / 30.0 * *relay;
                }
                (1.0 - share) * value + share * sum
            }))
        }
        // A film of grease that motion builds up, not at once, carries the strands: Hess and Soom (1990) on friction that lags the speed.
        3 => {
            let (half, slow, film_s) = (span * draw.even(0.1, 0.16), span * draw.log(0.3, 0.8), draw.log(0.3, 1.5));
            let mut film = 0.0;
            Drawn::Before(stage(move |value: f64, _| {
                film += STEP_S * (speed.step(value, smooth_s).abs() - film) / film_s;
                let own = half / (1.0 + film / slow);
                state = state.clamp(value - own, value + own);
                state
            }))
        }
        // Bristles that bend, with a damping of their own and the less force the faster they slide: Canudas de Wit and others (1995).
        _ => {
            let (slides, slow) = (range * draw.even(0.015, 0.03), range * draw.log(0.3, 0.8));
            let (rests, damping_s) = (slides * draw.even(2.5, 4.0), draw.even(0.02, 0.05));
            let mut bending = Speed::default();
            Drawn::Behind(stage(move |value: f64, _| {
                let rate = speed.step(value, smooth_s) / slow;
                let most = slides + (rests - slides) * (-rate * rate).exp();
                state = nears(state, most * (value - last).signum(), value - last, most);
                last = value;
                value - state - (damping_s * bending.step(state, smooth_s)).clamp(-slides, slides)
            }))
        }
    }
}

/// Laws of a tip that sticks and breaks away.
fn stick_slip(law: u64, draw: &mut Draw<'_>) -> Drawn {
    let hold = draw.range_mm * draw.even(0.045, 0.075);
    let (mut place, mut slides) = (0.0_f64, false);
    match law {
        // Contacts differ: how much one holds is another value each time it sticks, Rabinowicz (1958).
        0 => {
            let (mut own, mut seed) = (hold, draw.generator.random::<u64>());
            Drawn::Behind(stage(move |value: f64, _| {
                let stretch: f64 = value - place;
                if slides && stretch.abs() < 0.1 * hold {
                    seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
                    (slides, own) = (false, hold * (0.4 + 1.2 * (seed >> 33) as f64 / 2_f64.powi(31)));
                }
                slides |= stretch.abs() > own;
                place += if slides { stretch * STEP_S / 0.006 } else { 0.0 };
                place
            }))
        }
        // What sticks gives a little before it breaks away: elastic first, plastic then, Dupont and others (2002).
        1 => {
            let gives = draw.even(0.15, 0.35);
            Drawn::Behind(stage(move |value: f64, _| {
                let stretch: f64 = value - place;
                slides = stretch.abs() > if slides { 0.1 * hold } else { 1.4 * hold };
                place += if slides { stretch * STEP_S / 0.006 } else { 0.0 };
                place + gives * (value - place)
            }))
        }
        // A mass that has broken away swings half a period and sticks where it comes to rest, beyond its aim or short of it: Bowden and Leben (1939).
        2 => {
            let (beyond, steps) = (draw.even(-0.35, 0.35), draw.even(20.0, 60.0) as u32);
            let (mut from, mut jump, mut done) = (0.0, 0.0, steps);
            Drawn::Behind(stage(move |value: f64, _| {
                let stretch: f64 = value - place;
                if done == steps && stretch.abs() > 0.8 * hold {
                    (from, jump, done) = (place, stretch + beyond * stretch.clamp(-hold, hold), 0);
                }
                if done < steps {
                    done += 1;
                    place = from + 0.5 * jump * (1.0 - (PI * f64::from(done) / f64::from(steps)).cos());
                }
                place
            }))
        }
        // The tip glides on its way out and catches on its way back: friction against the scales, as wool has it, Makinson (1948).
        _ => {
            let rests = draw.even(0.05, 0.25);
            Drawn::Behind(stage(move |value: f64, _| {
                let ahead: f64 = place - value;
                slides = ahead > if slides { rests * hold } else { 1.1 * hold };
                place = place.max(value) - if slides { ahead * STEP_S / 0.006 } else { 0.0 };
                place
            }))
        }
    }
}

/// Valves that let a small error be.
fn valve(law: u64, draw: &mut Draw<'_>) -> Drawn {
    let span = draw.span_bar;
    let drawn = span * draw.log(0.05, 0.11);
    let band = draw.tell("valve-dead-band.band_bar", drawn);
    let flow_s = draw.log(0.012, 0.04);
    let (mut state, mut open) = (0.0_f64, false);
    match law {
        // A large valve for large errors and a small one that trickles for the rest: coarse and fine dosing.
        0 => {
            let (trickle, large) = (span * draw.log(0.4, 1.2), band * draw.even(2.0, 3.0));
            Drawn::Before(stage(move |value: f64, _| {
                let error: f64 = value - state;
                open = error.abs() > if open { 0.15 * band } else { band };
                let flow = if error.abs() > large { error / flow_s } else { trickle * error.signum() };
                state += if open { STEP_S * flow } else { 0.0 };
                state
            }))
        }
        // It corrects what is within the band too, but only now and then: a regulator that trims by a clock.
        1 => {
            let (period, mut tick) = (draw.log(600.0, 2000.0) as u32, 0);
            Drawn::Before(stage(move |value: f64, _| {
                tick = (tick + 1) % period;
                let error: f64 = value - state;
                open = tick == 0 || error.abs() > if open { 0.05 * band } else { band };
                state += if open { error * STEP_S / flow_s } else { 0.0 };
                state
            }))
        }
        // It sees the pressure late, shuts late and goes too far: a sensor at the end of a line.
        2 => {
            let (late_s, mut seen) = (draw.log(0.01, 0.03), 0.0);
            Drawn::Before(stage(move |value: f64, _| {
                seen += STEP_S * (state - seen) / late_s;
                let error: f64 = value - seen;
                open = error.abs() > if open { 0.1 * band } else { band };
                state = (state + if open { error * STEP_S / flow_s } else { 0.0 }).max(0.0);
                state
            }))
        }
        // It fires when an integral of the error that forgets is full, and a lasting error within the band never fills it: Lapicque (1907).
        _ => {
            let (forgets_s, mut integral) = (draw.log(0.02, 0.06), 0.0_f64);
            Drawn::Before(stage(move |value: f64, _| {
                let error: f64 = value - state;
                integral += STEP_S * (error - integral / forgets_s);
                open = if open { error.abs() > 0.1 * band } else { integral.abs() > band * forgets_s };
                if open {
                    integral = 0.0;
                    state += error * STEP_S / flow_s;
                }
                state
            }))
        }
    }
}

/// Laws of what stands still after its command has turned.
fn hold(law: u64, draw: &mut Draw<'_>) -> Drawn {
    let (span, range, hold_s) = (draw.span_bar, draw.range_mm, draw.log(0.12, 0.35));
    let (mut stroke, mut state) = (Stroke::default(), 0.0_f64);
    match law {
        // A pilot pressure has to swing over before the main stage opens the other way: what is less than a whole swing takes less time.
        0 => {
            let opens = draw.even(0.2, 0.5);
            let pilot_s = draw.tell("hold-after-reversal.hold_s", hold_s) / (2.0 / (1.0 - opens)).ln();
            let mut pilot = 1.0;
            Drawn::Before(stage(move |value: f64, _| {
                stroke.turned(value, 1e-4 * span);
                let way = if stroke.falls { -1.0 } else { 1.0 };
                pilot += STEP_S * (way - pilot) / pilot_s;
                state += if way * pilot > opens { (value - state) * STEP_S / 0.01 } else { 0.0 };
                state
            }))
        }
        // The tip holds for a share of the stroke that it comes from, then comes after by and by: friction that the bend has stored.
        1 => {
            let (share, fades_s) = (draw.even(0.12, 0.25), draw.log(0.015, 0.05));
            let (mut anchor, mut far, mut behind) = (0.0, 0.0, 0.0);
            Drawn::Behind(stage(move |value: f64, _| {
                let turned = stroke.turned(value, 1e-3 * range);
                if (value - anchor).abs() < far {
                    behind = state - value;
                } else {
                    far = 0.0;
                    if let Some(length) = turned {
                        (anchor, far, behind) = (stroke.start, share * length, state - value);
                    }
                    behind *= 1.0 - STEP_S / fades_s;
                }
                state = value + behind;
                state
            }))
        }
        // A controller waits and then runs through what it has missed at a higher speed: a buffered set point.
        _ => {
            let steps = (draw.tell("hold-after-reversal.hold_s", hold_s) / STEP_S).round() as u32;
            let (faster, mut left, mut missed) = (draw.even(3.0, 8.0) as usize, 0_u32, VecDeque::new());
            Drawn::Before(stage(move |value: f64, _| {
                missed.push_back(value);
                if stroke.turned(value, 1e-4 * span).is_some() && left == 0 && missed.len() == 1 {
                    left = steps;
                }
                if left > 0 {
                    left -= 1;
                } else {
                    state = missed.drain(..faster.min(missed.len())).next_back().unwrap_or(state);
                }
                state
            }))
        }
    }
}

/// Laws of air that gets lost.
fn leakage(law: u64, draw: &mut Draw<'_>) -> Drawn {
    let span = draw.span_bar;
    let (mut state, mut last) = (0.0_f64, 0.0);
    match law {
        // Between two nozzles, one from the regulator and one to the room that chokes: Saint-Venant and Wantzel (1839).
        0 => {
            let (fill_s, droops) = (draw.log(0.03, 0.08), draw.even(0.08, 0.16));
            let inflow = move |share: f64| share / (share.abs() + 0.0025).sqrt() / fill_s;
            let outflow = |bar: f64| (1.0 + bar) * (1.0 - (2.0 / (1.0 + bar) - 1.0).max(0.0).powi(2)).max(0.0).sqrt();
            let leaks = inflow(droops) / outflow(span);
            Drawn::Before(first_order(move |value, state: f64| span * (inflow((value - state) / span) - leaks * outflow(state.max(0.0)))))
        }
        // A metered charge through a hole that the pressure stretches open: flow by the powers 0.5 and 1.5 of the pressure, May (1994).
        1 => {
            let (hole_s, stretched_s) = (draw.log(40.0, 100.0), draw.log(15.0, 40.0));
            Drawn::Before(stage(move |value: f64, _| {
                let share: f64 = (state / span).clamp(0.0, 1.5);
                state = (state + value - last - STEP_S * span * (share.sqrt() / hole_s + share.powf(1.5) / stretched_s)).max(0.0);
                last = value;
                state
            }))
        }
        // A metered charge that seeps into the sheath around the muscle, and comes back from there as long as the sheath has not let it go.
        _ => {
            let (volume, seeps_s, goes_s) = (draw.even(0.4, 0.9), draw.log(3.0, 10.0), draw.log(8.0, 30.0));
            let mut sheath = 0.0;
            Drawn::Before(stage(move |value: f64, _| {
                let seeps: f64 = STEP_S * (state - sheath) / seeps_s;
                sheath += seeps - STEP_S * sheath / goes_s;
                state = (state + value - last - volume * seeps).max(0.0);
                last = value;
                state
            }))
        }
    }
}

/// Laws of a pressure that comes late.
fn lag(law: u64, draw: &mut Draw<'_>) -> Drawn {
    let (span, time_s) = (draw.span_bar, draw.log(0.06, 0.2));
    match law {
        // Through a porous plug, whose pressure drop is a linear and a square part of the flow: Forchheimer (1901).
        0 => {
            let heavy = draw.log(0.2, 0.5).powi(2) / span;
            let porous_s = 0.5 * time_s;
            Drawn::Before(first_order(move |value, state| {
                let drop: f64 = value - state;
                2.0 * drop / (porous_s + (porous_s * porous_s + 4.0 * heavy * drop.abs()).sqrt())
            }))
        }
        // A dead end beside the muscle, that of the gauge, fills through a narrow branch and gives back through it.
        1 => {
            let (volume, branch_s, mut pocket) = (draw.even(0.5, 1.2), draw.log(0.15, 0.5), 0.0);
            Drawn::Before(first_order(move |value, state| {
                let enters = (state - pocket) / branch_s;
                pocket += STEP_S * enters;
                (value - state) / time_s - volume * enters
            }))
        }
        // A slack bladder takes much air before it lies against the braid, little afterwards: the volume of a McKibben muscle.
        _ => {
            let (lies, slack) = (span * draw.even(0.15, 0.35), draw.even(2.0, 5.0));
            Drawn::Before(first_order(move |value, state| (value - state) / (time_s * (1.0 + slack * (-(state / lies).powi(2)).exp()))))
        }
    }
}

/// Laws of a muscle that fills otherwise than it vents.
fn fill_vent_asymmetry(law: u64, draw: &mut Draw<'_>) -> Drawn {
    let span = draw.span_bar;
    match law {
        // Choked as it fills, so that the pressure rises by so much a second; as it vents it decays: tanks in textbooks of gas dynamics.
        0 => {
            let (most, vent_s) = (span * draw.log(1.0, 3.0), draw.log(0.1, 0.3));
            Drawn::Before(first_order(move |value, state| {
                let error: f64 = value - state;
                if error > 0.0 { (error / 0.015).min(most) } else { error / vent_s }
            }))
        }
        // Two chambers with a flap between them that lets air into the far one freely and back through a pore.
        1 => {
            let (line_s, flap_s, pore_s) = (draw.log(0.02, 0.05), draw.log(0.02, 0.06), draw.log(0.25, 0.6));
            let (share, mut near) = (draw.even(0.5, 0.8), 0.0);
            let mut far = 0.0;
            Drawn::Before(stage(move |value, _| {
                near += STEP_S * (value - near) / line_s;
                far += STEP_S * (near - far) / if near > far { flap_s } else { pore_s };
                (1.0 - share) * near + share * far
            }))
        }
        // Lips that the flow blows open one way and sucks shut the other, like a duckbill: an exponential of the pressure drop, as a diode has.
        _ => {
            let (way, scale, flow) = (draw.sign(), span * draw.even(0.15, 0.3), span * draw.log(1.5, 3.0));
            Drawn::Before(first_order(move |value, state| way * flow * (way * (value - state) / scale).min(4.0).exp_m1()))
        }
    }
}

/// Laws of a loop that is another one up than down.
fn asymmetric_hysteresis(law: u64, draw: &mut Draw<'_>) -> Drawn {
    let (span, range) = (draw.span_bar, draw.range_mm);
    let (mut state, mut last) = (0.0_f64, 0.0);
    match law {
        // Friction that builds up soon on the way up and late on the way down: Dahl (1968) with a stiffness for each direction.
        0 => {
            let (size, up, down) = (range * draw.even(0.06, 0.1), range * draw.even(0.04, 0.1), range * draw.even(0.35, 0.7));
            Drawn::Behind(stage(move |value: f64, _| {
                let way = value - last;
                state = nears(state, way.signum(), way, if way > 0.0 { up } else { down });
                last = value;
                value - size * state
            }))
        }
        // A flag: what changes phase high on the way up changes back low on the way down, as alloys with a memory, Liang and Rogers (1990).
        1 => {
            let (size, starts, ends) = (range * draw.even(0.12, 0.22), draw.even(0.35, 0.5), draw.even(0.65, 0.8));
            let (back, last_back) = (draw.even(0.35, 0.5), draw.even(0.08, 0.2));
            Drawn::Behind(stage(move |value: f64, _| {
                let share = value / range;
                state = state.max((share - starts) / (ends - starts)).min((share - last_back) / (back - last_back)).clamp(0.0, 1.0);
                value + size * state
            }))
        }
        // What it holds back on the way down is a share of the peak that it comes from: contacts keep the load that made them.
        _ => {
            let (up, share, mut stroke, mut down) = (span * draw.even(0.01, 0.03), draw.even(0.12, 0.22), Stroke::default(), 0.0);
            Drawn::Before(stage(move |value: f64, _| {
                if stroke.turned(value, 1e-3 * span).is_some() && stroke.falls {
                    down = share * stroke.start;
                }
                state = state.max(value - up).min(value + down);
                state
            }))
        }
    }
}
