//! Of [`super::eighth_laws`] those of rubber, which softens and creeps, and of what swings.

use std::f64::consts::PI;

use super::draw::{Draw, STEP_S};
use super::laws::{Drawn, stage};
use super::motion::{Stroke, nears};
use super::seventh_laws_of_time::told;

/// Laws of a muscle whose first strokes are other ones.
pub(super) fn softening(law: u64, draw: &mut Draw<'_>) -> Drawn {
    let (span, range, size) = (draw.span_bar, draw.range_mm, draw.even(0.12, 0.25));
    let (few, mut last, mut fresh) = (draw.log(0.8, 3.0), 0.0_f64, 1.0_f64);
    let mut state = 0.0_f64;
    match law {
        // Friction that its own work weakens and makes yield later: strength and stiffness that degrade with energy, Baber and Wen (1981).
        0 => {
            let (weakens, yields, onset) = (draw.log(0.4, 1.5), draw.even(0.02, 0.1), range * draw.even(0.08, 0.15));
            let mut energy = 0.0;
            Drawn::Behind(stage(move |value: f64, moment| {
                if moment.begins {
                    (state, energy, last) = (0.0, 0.0, value);
                }
                let (way, strength) = (value - last, 1.0 / (1.0 + weakens * energy));
                last = value;
                state = nears(state, strength * way.signum(), way, strength * onset * (1.0 + yields * energy));
                energy += (state * way / range).max(0.0);
                value - 0.8 * size * range * state
            }))
        }
        // Grease that is stiff after a pause: the tip comes late until motion has broken its structure, thixotropy after Moore (1959).
        1 => {
            let (late_s, far, builds_s) = (draw.log(0.2, 0.5), range * few, draw.log(8.0, 40.0));
            Drawn::Behind(stage(move |value: f64, moment| {
                if moment.begins {
                    (state, fresh, last) = (value, 1.0, value);
                }
                fresh *= (-(value - last).abs() / far).exp();
                fresh += STEP_S * (1.0 - fresh) / builds_s;
                last = value;
                state += (value - state) * STEP_S / (STEP_S + late_s * fresh);
                state
            }))
        }
        // Strands slip for good where the stretch passes a yield stress, which slip raises until nothing slips any more: shakedown, Voce (1948).
        2 => {
            let (share, first, harder) = (draw.even(0.2, 0.35), range * draw.even(0.1, 0.25), range * draw.even(0.4, 0.6));
            let (far, mut slipped) = (0.3 * range * few, 0.0_f64);
            Drawn::Behind(stage(move |value: f64, moment| {
                if moment.begins {
                    (state, slipped) = (0.0, 0.0);
                }
                let yields = first + harder * (1.0 - (-slipped / far).exp());
                let over = ((value - state).abs() - yields).max(0.0);
                state += over * (value - state).signum();
                slipped += over;
                value - share * state
            }))
        }
        // Bonds whose rate of rupture grows exponentially with the load, and which heal slowly: Bell (1978).
        3 => {
            let (breaks_s, weaker, heals_s) = (draw.log(8.0, 25.0), draw.even(2.5, 4.0), draw.log(30.0, 120.0));
            Drawn::Before(stage(move |value: f64, moment| {
                fresh = if moment.begins { 1.0 } else { fresh };
                let breaks = (weaker * (value / span).clamp(0.0, 1.2)).exp() / breaks_s;
                fresh += STEP_S * ((1.0 - fresh) / heals_s - fresh * breaks);
                value * (1.0 - size * fresh)
            }))
        }
        // The way up is always the same, only the first ways down bulge: Bouasse and Carriere (1903) on the loops of rubber.
        4 => Drawn::Behind(stage(move |value: f64, moment| {
            if moment.begins {
                (state, fresh, last) = (0.0, 1.0, value);
            }
            let way = value - last;
            last = value;
            state = nears(state, if way < 0.0 { 1.0 } else { 0.0 }, way, 0.08 * range);
            fresh *= (way.min(0.0) / (range * few)).exp();
            let share = (value / range).clamp(0.0, 1.0);
            value + 4.0 * size * range * fresh * state * share * (1.0 - share)
        })),
        // Contacts that rested are strong, by the logarithm of their age, and slip renews them: Dieterich (1979), against the motion.
        _ => {
            let (friction, onset, renews) = (0.7 * size * span, span * draw.even(0.2, 0.35), span * draw.log(0.3, 1.0));
            let mut age_s = 0.0;
            Drawn::Before(stage(move |value: f64, moment| {
                let way = value - last;
                last = value;
                age_s = if moment.begins { 20.0 } else { (age_s + STEP_S) * (-way.abs() / renews).exp() };
                state = nears(state, way.signum(), way, onset);
                value - friction * state * (age_s / 0.05_f64).ln_1p() / 6.0
            }))
        }
    }
}

/// Laws of a material that goes on giving.
pub(super) fn creep(law: u64, draw: &mut Draw<'_>) -> Drawn {
    let (span, range, size) = (draw.span_bar, draw.range_mm, draw.even(0.12, 0.22));
    let mut strain = 0.0_f64;
    match law {
        // By a power of the stress that is left: Norton (1929).
        0 => {
            let (time_s, power, stress) = (draw.log(1.0, 6.0), draw.even(2.5, 4.0), 0.5 * size * range);
            Drawn::Behind(stage(move |value: f64, _| {
                let left: f64 = size * value - strain;
                strain += (STEP_S * stress / time_s * (left.abs() / stress).powf(power)).min(left.abs()) * left.signum();
                value + strain
            }))
        }
        // What diffuses into a wall of six layers swells it: by the root of time at first, Biot (1941) and Fick (1855).
        1 => {
            let (layer_s, mut layers) = (draw.log(0.15, 0.8), [0.0; 7]);
            Drawn::Before(stage(move |value: f64, _| {
                layers[0] = value.min(1.5 * span);
                let before = layers;
                for layer in 1..7 {
                    let beyond = before.get(layer + 1).copied().unwrap_or(before[layer]);
                    layers[layer] += STEP_S * (before[layer - 1] - 2.0 * before[layer] + beyond) / layer_s;
                }
                value + 1.2 * size * layers[1..].iter().sum::<f64>() / 6.0
            }))
        }
        // Contacts creep while they rest, and travel wipes out what has crept: Dieterich and Kilgore (1994).
        2 => {
            let (time_s, wipes, mut last) = (draw.log(0.4, 1.5), range * draw.log(0.15, 0.5), 0.0);
            Drawn::Behind(stage(move |value: f64, _| {
                strain = strain * (-(value - last).abs() / wipes).exp() + STEP_S * (1.5 * size * value - strain) / time_s;
                last = value;
                value + strain
            }))
        }
        // A stretched exponential, Kohlrausch (1854), whose clock every turn of the load sets back: latches that give one by one.
        3 => {
            let (time_s, power, mut since_s, mut stroke) = (draw.log(1.0, 6.0), draw.even(0.35, 0.6), 0.01_f64, Stroke::default());
            Drawn::Behind(stage(move |value: f64, _| {
                since_s = if stroke.turned(value, 0.02 * range).is_some() { 0.01 } else { since_s + STEP_S };
                strain += STEP_S * power / time_s * (since_s / time_s).powf(power - 1.0) * (size * value - strain);
                value + strain
            }))
        }
        // Quasi-linear viscoelasticity: an exponential elastic response through a spectrum even in the logarithm of time, Fung (1972).
        _ => {
            let (bend, first_s, mut strains) = (draw.even(1.0, 2.5), draw.log(0.05, 0.2), [0.0; 6]);
            Drawn::Behind(stage(move |value: f64, _| {
                let elastic = range * (bend * (value / range).clamp(0.0, 1.3)).exp_m1() / bend.exp_m1();
                let mut sum = value;
                for (element, strain) in (0..6).zip(&mut strains) {
                    *strain += STEP_S * (0.25 * size * elastic - *strain) / (first_s * 3.0_f64.powi(element));
                    sum += *strain;
                }
                sum
            }))
        }
    }
}

/// Laws of what swings.
pub(super) fn resonance(law: u64, draw: &mut Draw<'_>) -> Drawn {
    let (range, span) = (draw.range_mm, draw.span_bar);
    let [omega, damping] = if law < 3 { told(draw) } else { [2.0 * PI * draw.log(1.5, 5.0), draw.log(0.1, 0.3)] };
    let (mut place, mut speed, mut branch, mut last) = (0.0_f64, 0.0_f64, 0.0_f64, 0.0_f64);
    match law {
        // Damping that grows with the square of how far it swings out; told is that of small swings: Eichler and others (2011).
        0 => {
            let growth = draw.even(20.0, 60.0);
            Drawn::Behind(stage(move |value: f64, moment| {
                if moment.begins {
                    (place, speed) = (value, 0.0);
                }
                let away: f64 = value - place;
                let drag = 2.0 * damping * omega * (1.0 + growth * (away / range).powi(2).min(1.0));
                speed = (speed + STEP_S * omega * omega * away) / (1.0 + STEP_S * drag);
                place += STEP_S * speed;
                place
            }))
        }
        // A tube as a line of four plugs of air and four volumes, told by its lowest mode: Iberall (1950).
        1 => {
            let line = omega / (2.0 * (PI / 18.0).sin());
            let (mut plugs, mut volumes) = ([0.0; 4], [0.0; 4]);
            Drawn::Before(stage(move |value: f64, _| {
                for cell in 0..4 {
                    let behind = if cell == 0 { value } else { volumes[cell - 1] };
                    plugs[cell] += STEP_S * (line * (behind - volumes[cell]) - 2.0 * damping * omega * plugs[cell]);
                }
                for cell in 0..4 {
                    let leaves = plugs.get(cell + 1).copied().unwrap_or(0.0);
                    volumes[cell] = (volumes[cell] + STEP_S * line * (plugs[cell] - leaves)).max(-0.9);
                }
                volumes[3]
            }))
        }
        // A regulator with an integral and a valve that lets through so much and no more: it winds up, textbooks of control.
        2 => {
            let most = span * draw.log(2.0, 6.0);
            Drawn::Before(stage(move |value: f64, _| {
                let error = value - place;
                branch = (branch + STEP_S * omega * omega * error).clamp(-1.5 * most, 1.5 * most);
                place = (place + STEP_S * (2.0 * damping * omega * error + branch).clamp(-most, most)).max(0.0);
                place
            }))
        }
        // The spring is rubber, which relaxes a part of its force: the standard linear solid of Zener (1948) under a mass.
        3 => {
            let (stiffer, relaxes_s) = (draw.even(0.5, 1.2), draw.even(0.6, 1.6) / omega);
            Drawn::Behind(stage(move |value: f64, moment| {
                if moment.begins {
                    (place, speed, branch, last) = (value, 0.0, 0.0, 0.0);
                }
                let away: f64 = value - place;
                branch += stiffer * (away - last) - STEP_S * branch / relaxes_s;
                last = away;
                speed += STEP_S * omega * omega * (away + branch);
                place += STEP_S * speed;
                place
            }))
        }
        // A joint beside the spring that sticks at small swings and slips at large ones: Jenkins's element, Iwan (1966).
        4 => {
            let (stiffer, slips) = (draw.even(0.5, 1.2), range * draw.even(0.02, 0.05));
            Drawn::Behind(stage(move |value: f64, moment| {
                if moment.begins {
                    (place, speed, branch, last) = (value, 0.0, 0.0, 0.0);
                }
                let away: f64 = value - place;
                branch = (branch + stiffer * (away - last)).clamp(-slips, slips);
                last = away;
                speed += STEP_S * omega * (omega * (away + branch) - damping * speed);
                place += STEP_S * speed;
                place
            }))
        }
        // A hinge with free play, where nothing pulls the tip back: Woolston and others (1957).
        _ => {
            let play = range * draw.even(0.012, 0.03);
            Drawn::Behind(stage(move |value: f64, moment| {
                if moment.begins {
                    (place, speed) = (value, 0.0);
                }
                let away: f64 = value - place;
                speed += STEP_S * omega * (omega * (away - away.clamp(-play, play)) - 2.0 * damping * speed);
                place += STEP_S * speed;
                place
            }))
        }
    }
}
