//! Of [`super::seventh_laws`] those of rubber, which softens and creeps, and of what swings.

use std::collections::VecDeque;
use std::f64::consts::{PI, TAU};

use super::draw::{Draw, STEP_S};
use super::laws::{Drawn, stage};
use super::motion::{Speed, Stroke};

/// Laws of a muscle whose first strokes are other ones.
pub(super) fn softening(law: u64, draw: &mut Draw<'_>) -> Drawn {
    let (span, range, size) = (draw.span_bar, draw.range_mm, draw.even(0.12, 0.25));
    let (few, mut last, mut fresh) = (draw.log(0.8, 3.0), 0.0_f64, 1.0_f64);
    match law {
        // Every level of stretch has chains of its own, which break as it is passed: alteration of the network, Marckmann and others (2002).
        0 => {
            let (width, mut chains) = (0.03 * range, [1.0_f64; 40]);
            Drawn::Behind(stage(move |value: f64, moment| {
                if moment.begins {
                    (chains, last) = ([1.0; 40], value);
                }
                let (low, high) = (value.min(last), value.max(last));
                last = value;
                let mut missing = 0.0;
                for (level, whole) in (0..40).zip(&mut chains) {
                    let within = |place: f64| (place - width * f64::from(level)).clamp(0.0, width);
                    let passed = within(high) - within(low);
                    if passed > 0.0 {
                        *whole *= (-passed / (2.0 * few * width)).exp();
                    }
                    missing += *whole * within(value);
                }
                value - size * missing
            }))
        }
        // Each half stroke damages by a power of its length, and damages add up: Basquin (1910) and Miner (1945).
        1 => {
            let (power, mut damage, mut gain, mut stroke) = (draw.even(2.0, 4.0), 0.0_f64, 1.0, Stroke::default());
            Drawn::Before(stage(move |value: f64, moment| {
                if moment.begins {
                    (damage, gain) = (0.0, 1.0 - size);
                }
                damage += stroke.turned(value, 0.01 * span).map_or(0.0, |length| (length / span).powf(power) / few);
                gain += (1.0 - size * (-damage).exp() - gain) * STEP_S / 0.05;
                value * gain
            }))
        }
        // Cold rubber is stiff, and the work of its own friction warms it: heat build-up, by the square of the speed, and cooling with time.
        2 => {
            let (warms, cools_s) = (range * draw.log(0.8, 2.0), draw.log(2.0, 5.0));
            let (mut speed, mut warmth) = (Speed::default(), 0.0_f64);
            Drawn::Behind(stage(move |value: f64, _| {
                let heat = (speed.step(value, 0.05) / warms).powi(2).min(40.0);
                warmth += STEP_S * (heat - warmth) / cools_s;
                value * (1.0 - 1.3 * size * (-warmth).exp())
            }))
        }
        // A share of the strands is stuck at first and comes free by its own slip: a part of the hysteresis that wears off, Archard (1953).
        3 => {
            let (share, half, far) = (draw.even(0.4, 0.6), range * draw.even(0.12, 0.2), 1.5 * range * few);
            let mut strands = 0.0_f64;
            Drawn::Behind(stage(move |value: f64, moment| {
                if moment.begins {
                    (strands, fresh) = (value, 1.0);
                }
                let slipped = strands.clamp(value - half, value + half);
                fresh *= (-(slipped - strands).abs() / far).exp();
                strands = slipped;
                value + share * fresh * (strands - value)
            }))
        }
        // A dead volume that runs empty at rest takes its fill from the first strokes: inflow counts, outflow does not.
        4 => {
            let (empty, volume, empties_s) = (0.7 * size * span, span * few, draw.log(1.0, 4.0));
            let mut missing = empty;
            Drawn::Before(stage(move |value: f64, _| {
                missing *= (-(value - last).max(0.0) / volume).exp();
                last = value;
                let rests = (1.0 - value / (0.1 * span)).clamp(0.0, 1.0);
                missing += STEP_S * (empty - missing) * rests / empties_s;
                (value - missing).max(0.0)
            }))
        }
        // A proportional magnet warms up from its first movement on, along a hyperbola of time: drift in data sheets of valves.
        _ => {
            let mut since_s = 0.0;
            Drawn::Before(stage(move |value: f64, moment| {
                let moves = !moment.begins && (since_s > 0.0 || value > 0.02 * span);
                since_s = if moves { since_s + STEP_S } else { 0.0 };
                value * (1.0 - 1.2 * size / (1.0 + 0.5 * since_s / few))
            }))
        }
    }
}

/// Laws of a material that goes on giving.
pub(super) fn creep(law: u64, draw: &mut Draw<'_>) -> Drawn {
    let (range, size) = (draw.range_mm, draw.even(0.1, 0.2));
    let mut strain = 0.0_f64;
    match law {
        // An element that comes back and a dashpot in series that does not before the next recording: Burgers (1935).
        0 => {
            let (time_s, flows_s, mut flowed) = (draw.log(0.5, 4.0), draw.log(80.0, 200.0), 0.0);
            Drawn::Behind(stage(move |value: f64, moment| {
                strain += STEP_S * (0.6 * size * value - strain) / time_s;
                flowed = if moment.begins { 0.0 } else { flowed + STEP_S * value / flows_s };
                value + strain + flowed
            }))
        }
        // The longer since the pause the slower: physical ageing, Struik (1978).
        1 => {
            let (first_s, power, mut age_s) = (draw.log(0.3, 1.5), draw.even(0.7, 1.0), 0.0_f64);
            Drawn::Behind(stage(move |value: f64, moment| {
                age_s = if moment.begins { 0.0 } else { age_s + STEP_S };
                strain += STEP_S * (1.2 * size * value - strain) / (first_s * (1.0 + age_s).powf(power));
                value + strain
            }))
        }
        // The load speeds up the material's clock: Schapery (1969).
        2 => {
            let (time_s, faster, span) = (draw.log(8.0, 30.0), draw.even(2.5, 4.0), draw.span_bar);
            Drawn::Before(stage(move |value: f64, _| {
                let clock = (faster * (value / span).clamp(0.0, 1.2)).exp();
                strain += STEP_S * clock * (0.8 * size * value - strain) / time_s;
                value + strain
            }))
        }
        // By the cube root of time, and what has crept hardens: Andrade (1910); it is for good until the next recording.
        3 => {
            let (time_s, least) = (draw.log(8.0, 30.0), 0.05 * size * range);
            Drawn::Behind(stage(move |value: f64, moment| {
                strain = if moment.begins { 0.0 } else { strain };
                strain += STEP_S * (size * value.max(0.0)).powi(3) / (3.0 * time_s * strain.max(least).powi(2));
                value + strain
            }))
        }
        // Damage under load makes what is left bear more, so that it creeps ever faster: Kachanov (1958); the pause heals it.
        _ => {
            let (time_s, power) = (draw.log(30.0, 60.0), draw.even(1.5, 2.5));
            Drawn::Behind(stage(move |value: f64, moment| {
                strain = if moment.begins { 0.0 } else { strain };
                let load = (value / range).clamp(0.0, 1.2) / (1.0 - strain);
                strain = (strain + STEP_S * load.powf(power) / time_s).min(0.25);
                value / (1.0 - strain)
            }))
        }
    }
}

/// Draws and tells a natural frequency, as an angular one, and a damping ratio.
pub(super) fn told(draw: &mut Draw<'_>) -> [f64; 2] {
    let (frequency_hz, damping) = (draw.log(1.3, 5.5), draw.log(0.08, 0.32));
    [TAU * draw.tell("resonance.frequency_hz", frequency_hz), draw.tell("resonance.damping_ratio", damping)]
}

/// Laws of what swings.
pub(super) fn resonance(law: u64, draw: &mut Draw<'_>) -> Drawn {
    let ([omega, damping], range, span) = (told(draw), draw.range_mm, draw.span_bar);
    let (mut place, mut speed, mut last) = (0.0_f64, 0.0_f64, 0.0_f64);
    match law {
        // Two masses on springs, one behind another, of which the tip is the second; told is the lower mode: Den Hartog (1934).
        0 => {
            let (mass, stiffness) = (draw.even(0.2, 0.6), draw.even(0.8, 2.0));
            let sum = 1.0 + mass * stiffness + stiffness;
            let scale = omega * omega / (0.5 * (sum - (sum * sum - 4.0 * stiffness).sqrt()));
            let (mut first, mut first_speed) = (0.0, 0.0);
            Drawn::Behind(stage(move |value: f64, moment| {
                if moment.begins {
                    (place, first, speed, first_speed) = (value, value, 0.0, 0.0);
                }
                let between: f64 = stiffness * (place - first);
                first_speed += STEP_S * (scale * (value - first + mass * between) - 2.0 * damping * omega * first_speed);
                speed -= STEP_S * (scale * between + 2.0 * damping * omega * speed);
                first += STEP_S * first_speed;
                place += STEP_S * speed;
                place
            }))
        }
        // Damping of the material's own: a share of the spring's force against the speed, whatever the frequency, Reid (1956).
        1 => {
            let (loss, still) = (PI * damping, 0.01 * range * omega);
            Drawn::Behind(stage(move |value: f64, moment| {
                if moment.begins {
                    (place, speed) = (value, 0.0);
                }
                let away: f64 = value - place;
                speed += STEP_S * omega * omega * (away - loss * away.abs() * (speed / still).tanh());
                place += STEP_S * speed;
                place
            }))
        }
        // A plug of air in the tube on the spring of the muscle's gas, which is as stiff as its absolute pressure: Helmholtz; told is that at half the span.
        2 => Drawn::Before(stage(move |value: f64, _| {
            speed += STEP_S * (omega * omega * (value - place) - 2.0 * damping * omega * speed);
            place = (place + STEP_S * speed * (1.0 + place) / (1.0 + 0.5 * span)).max(-0.9);
            place
        })),
        // A regulator that integrates what its sensor tells late: Callender, Hartree and Porter (1936).
        3 => {
            let turning = omega * (1.0 - damping * damping).sqrt();
            let late_s = damping.acos() / turning;
            let gain = omega * (-damping * omega * late_s).exp();
            let mut seen = VecDeque::from(vec![0.0; (late_s / STEP_S).round() as usize]);
            Drawn::Before(stage(move |value, _| {
                seen.push_back(place);
                place = (place + STEP_S * gain * (value - seen.pop_front().unwrap_or(0.0))).max(0.0);
                place
            }))
        }
        // The tip follows and tilts as it is moved, against its way, and the sensor sees the tilt on a lever: Abbe's error.
        4 => {
            let lever = draw.even(0.5, 0.9);
            Drawn::Behind(stage(move |value: f64, moment| {
                if moment.begins {
                    (place, speed, last) = (0.0, 0.0, value);
                }
                speed += lever * omega * (value - last) - STEP_S * (omega * omega * place + 2.0 * damping * omega * speed);
                last = value;
                place += STEP_S * speed;
                value - place
            }))
        }
        // Stiffer as it is pushed than as it is pulled; told is what both halves of a swing take: Shaw and Holmes (1983).
        _ => {
            let ratio = draw.even(1.4, 2.0);
            let pulled = omega * (1.0 + ratio) / (2.0 * ratio);
            Drawn::Behind(stage(move |value: f64, moment| {
                if moment.begins {
                    (place, speed) = (value, 0.0);
                }
                let away: f64 = value - place;
                let own = pulled * if away > 0.0 { 1.0 } else { ratio };
                speed += STEP_S * (own * own * away - 2.0 * damping * omega * speed);
                place += STEP_S * speed;
                place
            }))
        }
    }
}
