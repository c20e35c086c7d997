//! A second set of laws to report on, written without knowledge of the catalogue's forms.

use std::f64::consts::TAU;

use rand::RngExt;

use super::draw::{Draw, STEP_S, ThresholdLaw};
use super::laws::{self, Drawn, first_order, map, stage, swing};
use crate::command::Excitation;

/// Draws the law of the effect `name`.
pub(super) fn reporting(name: &str, draw: &mut Draw<'_>) -> Drawn {
    let second = draw.generator.random_bool(0.5);
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
        "creep" => creep(second, draw),
        "first-cycle-softening" => first_cycle_softening(second, draw),
        "stick-slip" => stick_slip(second, draw),
        "resonance" => resonance(second, draw),
        "periodic-disturbance" => periodic_disturbance(second, draw),
        "offset-drift" => offset_drift(second, draw),
        "gain-drift" => gain_drift(second, draw),
        "setup-change" => setup_change(second, draw),
        "leakage" => leakage(second, draw),
        "sample-and-hold" => sample_and_hold(second, draw),
        "hold-after-reversal" => hold_after_reversal(second, draw),
        _ => laws::tuning(name, draw),
    }
}

fn pneumatic_lag(second: bool, draw: &mut Draw<'_>) -> Drawn {
    let span = draw.span_bar;
    if second {
        // The muscle's volume grows as it fills, so that the line takes longer at high pressure.
        let empty_s = draw.log(0.04, 0.12);
        let growth = draw.even(0.5, 1.5);
        return Drawn::Before(first_order(move |value, state| {
            (value - state) / (empty_s * (1.0 + growth * (state / span).clamp(0.0, 1.5)))
        }));
    }
    // A thin line fills a fixed volume.
    let time_constant_s = draw.log(0.04, 0.2);
    draw.tell("pneumatic-lag.time_constant_s", time_constant_s);
    Drawn::Before(first_order(move |value, state| (value - state) / time_constant_s))
}

fn fill_vent_asymmetry(second: bool, draw: &mut Draw<'_>) -> Drawn {
    let span = draw.span_bar;
    if second {
        // The exhaust is driven by nothing but the pressure that is left, so that the last of the air goes slowly; the supply pushes evenly.
        let fill_s = draw.log(0.02, 0.05);
        let vent_s = draw.log(0.04, 0.1);
        let floor = draw.even(0.15, 0.3);
        return Drawn::Before(first_order(move |value, state| {
            let error = value - state;
            if error > 0.0 { error / fill_s } else { error / vent_s * (floor + (state / span).clamp(0.0, 1.5)) }
        }));
    }
    // Inlet and outlet of the valve have cross-sections of their own.
    let quick_s = draw.log(0.02, 0.06);
    let slow_s = quick_s * draw.even(2.5, 5.0);
    let [fill_s, vent_s] = if draw.generator.random_bool(0.7) { [quick_s, slow_s] } else { [slow_s, quick_s] };
    Drawn::Before(first_order(move |value, state| (value - state) / if value > state { fill_s } else { vent_s }))
}

fn slew_limit(second: bool, draw: &mut Draw<'_>) -> Drawn {
    let limit = draw.span_bar * draw.log(0.8, 1.9);
    draw.tell("slew-limit.limit_bar_per_s", limit);
    if second {
        // The valve opens with the error, and its flow saturates gently.
        let response_s = draw.even(0.01, 0.03);
        return Drawn::Before(first_order(move |value, state| limit * ((value - state) / (limit * response_s)).tanh()));
    }
    // The regulator ramps no faster than it is set to.
    let most = limit * STEP_S;
    let mut pressure = 0.0;
    Drawn::Before(stage(move |value, _| {
        pressure += (value - pressure).clamp(-most, most);
        pressure
    }))
}

fn valve_dead_band(second: bool, draw: &mut Draw<'_>) -> Drawn {
    let band = draw.span_bar * draw.log(0.035, 0.1);
    draw.tell("valve-dead-band.band_bar", band);
    let (mut pressure, mut open) = (0.0, false);
    if second {
        // Switching valves at full flow: on when the error leaves the band, off when it is gone.
        let most = draw.span_bar * draw.even(5.0, 10.0) * STEP_S;
        return Drawn::Before(stage(move |value, _| {
            let error: f64 = value - pressure;
            open = if open { error.abs() > 1e-9 } else { error.abs() > band };
            if open {
                pressure += error.clamp(-most, most);
            }
            pressure
        }));
    }
    // The spool lets go of its edge when the error leaves the band, and sits down again when little of it is left.
    let response_s = draw.even(0.015, 0.035);
    let rest = band * draw.even(0.1, 0.35);
    Drawn::Before(stage(move |value, _| {
        let error: f64 = value - pressure;
        open = error.abs() > if open { rest } else { band };
        if open {
            pressure += error * STEP_S / response_s;
        }
        pressure
    }))
}

fn supply_saturation(second: bool, draw: &mut Draw<'_>) -> Drawn {
    let limit = draw.span_bar * draw.even(0.6, 0.85);
    draw.tell("supply-saturation.limit_bar", limit);
    if second {
        // Near the pressure of the supply the flow dies away, so that the ceiling has a round edge.
        let width = draw.span_bar * draw.even(0.015, 0.035);
        return Drawn::Before(map(move |value| {
            let over = (value - limit) / width;
            value - width * (over.max(0.0) + (-over.abs()).exp().ln_1p())
        }));
    }
    // The supply has no more to give.
    Drawn::Before(map(move |value| value.min(limit)))
}

fn activation_threshold(second: bool, draw: &mut Draw<'_>) -> Drawn {
    let threshold = draw.span_bar * draw.even(0.07, 0.2);
    draw.tell("activation-threshold.threshold_bar", threshold);
    if second {
        // A loose bladder does nothing until it touches its sleeve, and then the pressure comes to bear in full within a short stretch.
        let stretch = draw.span_bar * draw.even(0.03, 0.1);
        return Drawn::Before(map(move |value| {
            let above = (value - threshold).max(0.0);
            value * -(-above / stretch).exp_m1()
        }));
    }
    // A bladder's own stiffness takes the first of the pressure.
    Drawn::Before(map(move |value| (value - threshold).max(0.0)))
}

fn static_nonlinearity(second: bool, draw: &mut Draw<'_>) -> Drawn {
    if second {
        // The regulator's characteristic meanders about the straight line.
        let span = draw.span_bar;
        let depth = draw.sign() * draw.even(0.25, 0.55);
        return Drawn::Before(map(move |value| value + depth * span / TAU * (TAU * value / span).sin()));
    }
    // A segment that bends to an arc moves its tip across by the arc's chord, less and less for the same further bend.
    let bend_per_mm = draw.even(1.2, 1.9) / draw.range_mm;
    Drawn::Behind(map(move |value| {
        let bend = bend_per_mm * value;
        if bend.abs() < 1e-6 { value } else { 4.0 * (0.5 * bend).sin().powi(2) / (bend_per_mm * bend) }
    }))
}

fn asymmetric_hysteresis(second: bool, draw: &mut Draw<'_>) -> Drawn {
    if second {
        // The braid's fibres lock late on the way up and let go early on the way down: each way has a bulge in another place.
        let span = draw.span_bar;
        let [sag, bulge] = [span * draw.even(0.06, 0.1), span * draw.even(0.04, 0.1)];
        let [up, down] = [span * draw.even(0.3, 0.6), span * draw.even(0.3, 0.6)];
        let (mut last, mut way) = (0.0, 0.0);
        return Drawn::Before(stage(move |value: f64, _| {
            let travel: f64 = value - last;
            last = value;
            let share = (travel.abs() / if travel > 0.0 { up } else { down }).min(1.0);
            if travel != 0.0 {
                way += (travel.signum() - way) * share;
            }
            let place = (value / span).clamp(0.0, 1.0);
            let [high, low] = [6.75 * place.powi(2) * (1.0 - place), 6.75 * place * (1.0 - place).powi(2)];
            value - if way > 0.0 { sag * high * way } else { bulge * low * way }
        }));
    }
    // The sleeve is stiff at first while it is loaded and yields evenly while it is unloaded.
    let powers = [draw.even(1.25, 1.6), draw.even(0.9, 1.05)];
    Drawn::Muscle(ThresholdLaw { powers: Some(powers), ..ThresholdLaw::default() })
}

fn rate_dependent_hysteresis(second: bool, draw: &mut Draw<'_>) -> Drawn {
    if second {
        // Fibres slide over each other with a friction that grows with the logarithm of the speed, as thermally activated sliding does.
        let span = draw.span_bar;
        let friction = span * draw.even(0.014, 0.025);
        let growth = draw.even(0.8, 1.3);
        let slow = span * draw.even(0.08, 0.2);
        let length = span * draw.even(0.25, 0.35);
        let (mut last, mut speed, mut way) = (0.0, 0.0, 0.0);
        return Drawn::Before(stage(move |value: f64, _| {
            let travel: f64 = value - last;
            last = value;
            speed += STEP_S / 0.05 * ((travel.abs() / STEP_S).min(4.0 * span) - speed);
            if travel != 0.0 {
                way += (travel.signum() - way) * (travel.abs() / length).min(1.0);
            }
            value - friction * way * (1.0 + growth * (speed / slow).ln_1p())
        }));
    }
    // Lubricated sliding: friction grows with the root of the speed.
    let root_of_rate = draw.even(0.18, 0.4);
    Drawn::Muscle(ThresholdLaw { root_of_rate, ..ThresholdLaw::default() })
}

fn creep(second: bool, draw: &mut Draw<'_>) -> Drawn {
    let share = draw.even(0.08, 0.18);
    let mut crept = 0.0;
    if second {
        // Rubber whose dashpot yields more than in proportion to the stress: creep that is quick at first and then goes on for long.
        let width = 0.3 * share * draw.range_mm;
        let time_s = draw.log(6.0, 20.0);
        return Drawn::Behind(stage(move |value: f64, _| {
            let stress: f64 = ((share * value - crept) / width).clamp(-6.0, 6.0);
            crept += STEP_S * width / time_s * stress.sinh();
            value + crept
        }));
    }
    // A spring and a dashpot side by side, in series with the muscle.
    let time_s = draw.log(2.5, 12.0);
    Drawn::Behind(stage(move |value: f64, _| {
        crept += STEP_S * (share * value - crept) / time_s;
        value + crept
    }))
}

fn first_cycle_softening(second: bool, draw: &mut Draw<'_>) -> Drawn {
    let range = draw.range_mm;
    if second {
        // Stretched for the first time after a pause the rubber is stiff; as far as it has been stretched, bonds are broken and it is soft.
        let stiffness = draw.even(0.28, 0.45);
        let kept = draw.even(0.0, 0.25);
        let mut farthest: f64 = 0.0;
        return Drawn::Behind(stage(move |value, moment| {
            if moment.begins {
                farthest *= kept;
            }
            farthest = farthest.max(value);
            value * (1.0 - stiffness * (1.0 - farthest / range).max(0.0))
        }));
    }
    // Every stroke since the pause breaks some of the bonds that are left.
    let softening = draw.even(0.1, 0.22);
    let path_mm = range * draw.even(2.0, 6.0);
    let (mut last, mut worn) = (0.0, 0.0);
    Drawn::Behind(stage(move |value: f64, moment| {
        if moment.begins {
            worn = 0.0;
        } else {
            worn += (1.0 - worn) * ((value - last).abs() / path_mm).min(1.0);
        }
        last = value;
        value * (1.0 + softening * worn)
    }))
}

fn stick_slip(second: bool, draw: &mut Draw<'_>) -> Drawn {
    let grip = draw.range_mm * draw.even(0.035, 0.08);
    let sliding = grip * draw.even(0.2, 0.5);
    let (mut place, mut speed) = (0.0, 0.0);
    if second {
        // A tip with mass on a dry surface, pulled by a spring: it sticks, breaks loose, shoots ahead and sticks again.
        let omega = TAU * draw.even(6.0, 12.0);
        let damping = draw.even(0.1, 0.4);
        return Drawn::Behind(stage(move |value: f64, _| {
            let tug: f64 = value - place;
            if speed == 0.0 && tug.abs() <= grip {
                return place;
            }
            let way = if speed == 0.0 { tug.signum() } else { f64::signum(speed) };
            speed += STEP_S * (omega * omega * (tug - sliding * way) - 2.0 * damping * omega * speed);
            if speed * way <= 0.0 {
                speed = 0.0;
            }
            place += STEP_S * speed;
            place
        }));
    }
    // A tip without mass: it sticks until the spring overcomes the grip, then slips until the spring carries no more than the sliding friction.
    let slip_s = draw.even(0.008, 0.025);
    let mut slips = false;
    Drawn::Behind(stage(move |value: f64, _| {
        let tug: f64 = value - place;
        slips = tug.abs() > if slips { sliding } else { grip };
        if slips {
            place += tug * STEP_S / slip_s;
        }
        place
    }))
}

fn resonance(second: bool, draw: &mut Draw<'_>) -> Drawn {
    let frequency_hz = match draw.excitation {
        Excitation::Paper => draw.log(1.3, 2.4),
        Excitation::Rich => draw.log(1.6, 4.5),
    };
    let damping = draw.log(0.08, 0.3);
    draw.tell("resonance.frequency_hz", frequency_hz);
    draw.tell("resonance.damping_ratio", damping);
    let mut mode = swing(frequency_hz, damping, 0.0, draw.range_mm);
    if second {
        // One bending mode carries a part of the tip's motion; the rest of it follows at once.
        let share = draw.even(0.45, 0.8);
        return Drawn::Behind(stage(move |value, moment| value + share * (mode(value, moment) - value)));
    }
    // The tip is a mass on the muscle's spring.
    Drawn::Behind(mode)
}

fn periodic_disturbance(second: bool, draw: &mut Draw<'_>) -> Drawn {
    let frequency_hz = draw.log(0.8, 7.0);
    draw.tell("periodic-disturbance.frequency_hz", frequency_hz);
    let phase = draw.even(0.0, TAU);
    if second {
        // The compressor's strokes reach the line, with an overtone.
        let height = draw.span_bar * draw.even(0.035, 0.07);
        let overtone = draw.even(0.2, 0.5);
        let shift = draw.even(0.0, TAU);
        return Drawn::Before(stage(move |value, moment| {
            let angle = TAU * frequency_hz * moment.session_s + phase;
            value + height * (angle.sin() + overtone * (2.0 * angle + shift).sin())
        }));
    }
    // The table shakes under the laser.
    let height = draw.range_mm * draw.even(0.02, 0.06);
    Drawn::Behind(stage(move |value, moment| value + height * (TAU * frequency_hz * moment.session_s + phase).sin()))
}

fn offset_drift(second: bool, draw: &mut Draw<'_>) -> Drawn {
    let session_s = draw.session_s;
    if second {
        // The room warms up and cools down, and the mount with it.
        let height = draw.range_mm * draw.even(0.04, 0.1);
        let period_s = session_s * draw.even(0.7, 1.6);
        let phase = draw.even(0.0, TAU);
        return Drawn::Behind(stage(move |value, moment| {
            value + height * ((TAU * moment.session_s / period_s + phase).sin() - phase.sin())
        }));
    }
    // The laser's electronics warm up.
    let height = draw.sign() * draw.range_mm * draw.even(0.1, 0.25);
    let time_s = session_s * draw.even(0.2, 0.6);
    Drawn::Behind(stage(move |value, moment| value - height * (-moment.session_s.max(0.0) / time_s).exp_m1()))
}

fn gain_drift(second: bool, draw: &mut Draw<'_>) -> Drawn {
    let session_s = draw.session_s;
    let change = draw.sign() * draw.even(0.12, 0.28);
    if second {
        // The regulator's gain creeps away evenly.
        return Drawn::Before(stage(move |value, moment| value * (1.0 + change * (moment.session_s.max(0.0) / session_s))));
    }
    // The rubber warms up with use and yields otherwise than when it was cold.
    let time_s = session_s * draw.even(0.2, 0.5);
    Drawn::Behind(stage(move |value, moment| value * (1.0 - change * (-moment.session_s.max(0.0) / time_s).exp_m1())))
}

fn setup_change(second: bool, draw: &mut Draw<'_>) -> Drawn {
    if second {
        // Taken apart twice, and put together with another zero each time.
        let first = draw.generator.random_range(3..9);
        let then = draw.generator.random_range(11..17);
        let zeros = [draw.sign() * draw.range_mm * draw.even(0.04, 0.12), draw.sign() * draw.range_mm * draw.even(0.04, 0.12)];
        return Drawn::Behind(stage(move |value, moment| {
            value
                + match moment.recording {
                    recording if recording >= then => zeros[1],
                    recording if recording >= first => zeros[0],
                    _ => 0.0,
                }
        }));
    }
    // Taken apart once: the lever is another length, and in most cases the zero is elsewhere too.
    let from = draw.generator.random_range(5..15);
    let gain = 1.0 + draw.sign() * draw.even(0.07, 0.18);
    let zero = if draw.generator.random_bool(0.7) { draw.sign() * draw.range_mm * draw.even(0.03, 0.1) } else { 0.0 };
    Drawn::Behind(stage(move |value, moment| if moment.recording >= from { zero + gain * value } else { value }))
}

fn leakage(second: bool, draw: &mut Draw<'_>) -> Drawn {
    let span = draw.span_bar;
    let time_s = draw.log(6.0, 20.0);
    let (mut last, mut pressure) = (0.0, 0.0);
    Drawn::Before(stage(move |value: f64, _| {
        // The valve passes the air that a change of the command asks for and shuts; what seeps out is not made good.
        let held = f64::max(pressure, 0.0);
        let loss = if second {
            // Through a hole, with the root of the pressure.
            (held * span).sqrt()
        } else {
            // Through a porous wall, in proportion to the pressure.
            held
        };
        pressure = (pressure + value - last - STEP_S * loss / time_s).max(0.0);
        last = value;
        pressure
    }))
}

fn sample_and_hold(second: bool, draw: &mut Draw<'_>) -> Drawn {
    let period_s = draw.log(0.08, 0.3);
    draw.tell("sample-and-hold.period_s", period_s);
    let mut held = 0.0;
    if second {
        // The program that sends the command starts anew with every recording.
        let mut left_s = 0.0;
        return Drawn::Before(stage(move |value, moment| {
            if moment.begins {
                left_s = 0.0;
            }
            if left_s < 0.5 * STEP_S {
                held = value;
                left_s += period_s;
            }
            left_s -= STEP_S;
            held
        }));
    }
    // The controller's clock runs through the whole session.
    let mut tick = f64::NAN;
    Drawn::Before(stage(move |value, moment| {
        let now = (moment.session_s / period_s).floor();
        if now != tick {
            (tick, held) = (now, value);
        }
        held
    }))
}

fn hold_after_reversal(second: bool, draw: &mut Draw<'_>) -> Drawn {
    let hold_s = draw.log(0.08, 0.3);
    draw.tell("hold-after-reversal.hold_s", hold_s);
    let scale = if second { draw.range_mm } else { draw.span_bar };
    // Behind a mechanism the tip catches up in a short while; a valve that changes over catches up at once.
    let follow = if second { STEP_S / draw.even(0.01, 0.03) } else { 1.0 };
    let least = 0.002 * scale;
    let (mut extreme, mut way, mut left_s, mut output, mut catching) = (0.0, 0.0, 0.0, 0.0, false);
    let step = stage(move |value: f64, moment| {
        if moment.begins {
            // Setting out from rest is no reversal.
            (extreme, way, left_s) = (value, 0.0, 0.0);
        }
        let away: f64 = value - extreme;
        if away * way > 0.0 {
            extreme = value;
        } else if away.abs() > least {
            if way != 0.0 && left_s <= 0.0 {
                left_s = hold_s;
            }
            (extreme, way) = (value, away.signum());
        }
        if left_s > 0.0 {
            left_s -= STEP_S;
            catching = true;
            return output;
        }
        if catching {
            output += follow * (value - output);
            catching = (value - output).abs() > least;
        } else {
            output = value;
        }
        output
    });
    if second { Drawn::Behind(step) } else { Drawn::Before(step) }
}
