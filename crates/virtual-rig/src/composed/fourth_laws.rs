//! Two more laws of every effect to tune on, written without knowledge of the catalogue's forms.

use std::collections::VecDeque;
use std::f64::consts::TAU;

use super::draw::{Draw, STEP_S};
use super::fourth_laws_of_time as of_time;
use super::laws::{self, Drawn, first_order, map, stage};

/// Draws law `which` (0 or 1) of the effect `name`.
pub(super) fn tuning(name: &str, which: u64, draw: &mut Draw<'_>) -> Drawn {
    match (name, which) {
        ("pneumatic-lag", 0) => laminar_tube(draw),
        ("pneumatic-lag", _) => tube_and_chamber(draw),
        ("fill-vent-asymmetry", 0) => two_orifices(draw),
        ("fill-vent-asymmetry", _) => throttle_with_check_valve(draw),
        ("slew-limit", 0) => choked_servo(draw),
        ("slew-limit", _) => ramp_generator(draw),
        ("valve-dead-band", 0) => overlapped_spool(draw),
        ("valve-dead-band", _) => switching_valve(draw),
        ("supply-saturation", 0) => drooping_regulator(draw),
        ("supply-saturation", _) => falling_head(draw),
        ("activation-threshold", 0) => slack_bladder(draw),
        ("activation-threshold", _) => cracking_valve(draw),
        ("static-nonlinearity", 0) => bending_tip(draw),
        ("static-nonlinearity", _) => recruited_braid(draw),
        ("asymmetric-hysteresis", 0) => lopsided_friction(draw),
        ("asymmetric-hysteresis", _) => bulging_return(draw),
        ("rate-dependent-hysteresis", 0) => widening_play(draw),
        ("rate-dependent-hysteresis", _) => relaxing_sliders(draw),
        ("creep", 0) => chain_of_dashpots(draw),
        ("creep", _) => thermal_flow(draw),
        ("first-cycle-softening", 0) => softer_below_the_peak(draw),
        ("first-cycle-softening", _) => softer_by_travel(draw),
        ("stick-slip", 0) => jumping_contact(draw),
        ("stick-slip", _) => dragged_mass(draw),
        ("resonance", 0) => air_column(draw),
        ("resonance", _) => shaken_tip(draw),
        ("periodic-disturbance", 0) => of_time::breath(draw),
        ("periodic-disturbance", _) => of_time::pump_strokes(draw),
        ("offset-drift", 0) => of_time::warming_sensor(draw),
        ("offset-drift", _) => of_time::wandering_zero(draw),
        ("gain-drift", 0) => of_time::ageing_rubber(draw),
        ("gain-drift", _) => of_time::swaying_room(draw),
        ("setup-change", 0) => of_time::remounted_sensor(draw),
        ("setup-change", _) => of_time::reconnected_line(draw),
        ("leakage", 0) => of_time::seeping_charge(draw),
        ("leakage", _) => of_time::pinhole(draw),
        ("sample-and-hold", 0) => of_time::free_running_clock(draw),
        ("sample-and-hold", _) => of_time::averaging_converter(draw),
        ("hold-after-reversal", 0) => of_time::changing_over_valve(draw),
        ("hold-after-reversal", _) => of_time::resting_tip(draw),
        _ => laws::tuning(name, draw),
    }
}

/// Air as thick as its pressure creeps through a narrow tube: flow follows the difference of the squared absolute pressures.
fn laminar_tube(draw: &mut Draw<'_>) -> Drawn {
    let middle = 1.0 + 0.5 * draw.span_bar;
    let middle_s = draw.log(0.06, 0.25);
    Drawn::Before(first_order(move |command, pressure| ((1.0 + command).powi(2) - (1.0 + pressure).powi(2)) / (2.0 * middle * middle_s)))
}

/// A tube has a small volume halfway and the muscle's at its end; its truth is the slower of the two time constants.
fn tube_and_chamber(draw: &mut Draw<'_>) -> Drawn {
    let drawn_s = draw.log(0.05, 0.25);
    let time_constant_s = draw.tell("pneumatic-lag.time_constant_s", drawn_s);
    let volume = draw.even(0.1, 0.4);
    let slowest = 0.5 * (2.0 / volume + 1.0 - (4.0 / (volume * volume) + 1.0).sqrt());
    let flow = 1.0 / (slowest * time_constant_s);
    let (mut halfway, mut end) = (0.0, 0.0);
    Drawn::Before(stage(move |command, _| {
        let (entering, leaving) = (flow * (command - halfway), flow * (halfway - end));
        halfway += STEP_S * (entering - leaving) / volume;
        end += STEP_S * leaving;
        end
    }))
}

/// Turbulent flow through an inlet and an outlet of other area: each goes with the root of the pressure drop.
fn two_orifices(draw: &mut Draw<'_>) -> Drawn {
    let wide = draw.log(6.0, 12.0);
    let narrow = wide / draw.even(1.8, 3.5);
    let [inlet, outlet] = if draw.sign() > 0.0 { [wide, narrow] } else { [narrow, wide] };
    let span = draw.span_bar;
    Drawn::Before(first_order(move |command, pressure| {
        let drop: f64 = command - pressure;
        let area = if drop > 0.0 { inlet } else { outlet };
        area * drop / (drop.abs() / span + 0.005).sqrt()
    }))
}

/// A throttle works both ways; one way, a check valve beside it cracks open and lets the air pass freely.
fn throttle_with_check_valve(draw: &mut Draw<'_>) -> Drawn {
    let (throttle_s, free_s) = (draw.log(0.15, 0.4), draw.log(0.02, 0.05));
    let cracking = draw.even(0.02, 0.06) * draw.span_bar;
    let way = draw.sign();
    Drawn::Before(first_order(move |command, pressure| {
        let drop = command - pressure;
        drop / throttle_s + way * (way * drop - cracking).max(0.0) / free_s
    }))
}

/// A quick servo whose flow is choked: the pressure's rate is clipped.
fn choked_servo(draw: &mut Draw<'_>) -> Drawn {
    let drawn = draw.log(0.8, 2.0) * draw.span_bar;
    let limit = draw.tell("slew-limit.limit_bar_per_s", drawn);
    let servo_s = draw.even(0.01, 0.03);
    Drawn::Before(first_order(move |command, pressure| ((command - pressure) / servo_s).clamp(-limit, limit)))
}

/// A controller moves its set point by so much at most in every cycle and rounds the ramp's corners by a moving mean.
fn ramp_generator(draw: &mut Draw<'_>) -> Drawn {
    let drawn = draw.log(0.8, 2.0) * draw.span_bar;
    let limit = draw.tell("slew-limit.limit_bar_per_s", drawn);
    let cycle = draw.even(5.0, 20.0) as usize;
    let window = draw.even(20.0, 60.0) as usize;
    let farthest = limit * cycle as f64 * STEP_S;
    let (mut count, mut point, mut sum) = (0, 0.0, 0.0);
    let mut points = VecDeque::from(vec![0.0; window]);
    Drawn::Before(stage(move |command, _| {
        if count % cycle == 0 {
            point += (command - point).clamp(-farthest, farthest);
        }
        count += 1;
        points.push_back(point);
        sum += point - points.pop_front().unwrap_or(0.0);
        sum / window as f64
    }))
}

/// A spool covers its port by more than the port's width: flow begins beyond the overlap and grows with what is beyond.
fn overlapped_spool(draw: &mut Draw<'_>) -> Drawn {
    let drawn = draw.even(0.03, 0.08) * draw.span_bar;
    let band = draw.tell("valve-dead-band.band_bar", drawn);
    let opening_s = draw.even(0.01, 0.03);
    Drawn::Before(first_order(move |command, pressure| {
        let error = command - pressure;
        (error - error.clamp(-band, band)) / opening_s
    }))
}

/// A switching valve opens when the error passes the band, and shuts only once the pressure is right.
fn switching_valve(draw: &mut Draw<'_>) -> Drawn {
    let drawn = draw.even(0.05, 0.12) * draw.span_bar;
    let band = draw.tell("valve-dead-band.band_bar", drawn);
    let farthest = draw.even(4.0, 8.0) * draw.span_bar * STEP_S;
    let (mut pressure, mut open) = (0.0, false);
    Drawn::Before(stage(move |command, _| {
        let error: f64 = command - pressure;
        open = error.abs() > if open { farthest } else { band };
        if open {
            pressure += error.clamp(-farthest, farthest);
        }
        pressure
    }))
}

/// A regulator droops as it nears what the supply has: a rounded knee, then the limit.
fn drooping_regulator(draw: &mut Draw<'_>) -> Drawn {
    let drawn = draw.even(0.5, 0.8) * draw.span_bar;
    let limit = draw.tell("supply-saturation.limit_bar", drawn);
    let knee = draw.even(0.01, 0.03) * draw.span_bar;
    Drawn::Before(map(move |command| command - knee * ((command - limit) / knee).exp().ln_1p()))
}

/// Air flows in by what the supply has above the muscle: the last of the way to the limit is slow.
fn falling_head(draw: &mut Draw<'_>) -> Drawn {
    let drawn = draw.even(0.5, 0.8) * draw.span_bar;
    let limit = draw.tell("supply-saturation.limit_bar", drawn);
    let (servo_s, inlet_s) = (draw.even(0.008, 0.02), draw.log(0.03, 0.1));
    Drawn::Before(first_order(move |command, pressure| ((command - pressure) / servo_s).min((limit - pressure) / inlet_s)))
}

/// A slack bladder must touch its braid first: only what is above that pressure pulls.
fn slack_bladder(draw: &mut Draw<'_>) -> Drawn {
    let drawn = draw.even(0.06, 0.16) * draw.span_bar;
    let threshold = draw.tell("activation-threshold.threshold_bar", drawn);
    let knee = draw.even(0.005, 0.015) * draw.span_bar;
    Drawn::Before(map(move |command| knee * ((command - threshold) / knee).exp().ln_1p()))
}

/// A valve in the line cracks open at the threshold and soon passes the whole pressure.
fn cracking_valve(draw: &mut Draw<'_>) -> Drawn {
    let drawn = draw.even(0.12, 0.25) * draw.span_bar;
    let threshold = draw.tell("activation-threshold.threshold_bar", drawn);
    let opening = draw.even(0.1, 0.25) * threshold;
    Drawn::Before(map(move |command| {
        let share = ((command - threshold) / opening).clamp(0.0, 1.0);
        command * share * share * (3.0 - 2.0 * share)
    }))
}

/// The tip bends along an arc, and the laser sees only its way sideways: a sine of the angle.
fn bending_tip(draw: &mut Draw<'_>) -> Drawn {
    let arm = draw.range_mm / draw.even(1.0, 1.35);
    Drawn::Behind(map(move |arc| arm * (arc / arm).sin()))
}

/// The braid's fibres come to bear one after another, then all do: a saturating curve with a foot.
fn recruited_braid(draw: &mut Draw<'_>) -> Drawn {
    let (power, half) = (draw.even(1.6, 2.4), draw.even(0.5, 0.8));
    let (span, rest) = (draw.span_bar, half.powf(power));
    Drawn::Before(map(move |command| {
        let share = (command / span).max(0.0).powf(power);
        span * (1.0 + rest) * share / (rest + share)
    }))
}

/// Internal friction by a differential equation whose two directions saturate at other levels.
fn lopsided_friction(draw: &mut Draw<'_>) -> Drawn {
    let level = draw.even(0.04, 0.08) * draw.range_mm;
    let onset = level * draw.even(2.5, 4.0);
    let lean = draw.sign() * draw.even(0.3, 0.5);
    let (mut last, mut friction) = (0.0, 0.0);
    Drawn::Behind(stage(move |place, _| {
        let way: f64 = (place - last) / onset;
        last = place;
        // A jump is a long way: it goes in small parts.
        let parts = (20.0 * way.abs()).ceil();
        for _ in 0..parts as usize {
            let along = if way * friction > 0.0 { 0.7 } else { -0.7 };
            friction += way / parts * (1.0 - friction.abs() * (0.3 + along + lean * way.signum()));
        }
        place - level * friction
    }))
}

/// A backlash with a straight edge to load along and a bulging one to unload along.
fn bulging_return(draw: &mut Draw<'_>) -> Drawn {
    let (slope, bulge) = (1.0 - draw.even(0.02, 0.06), 4.0 * draw.even(0.08, 0.18));
    let span = draw.span_bar;
    let mut carried = 0.0_f64;
    Drawn::Before(stage(move |command, _| {
        let share = (command / span).clamp(0.0, 1.0);
        carried = carried.max(slope * command).min(command + bulge * span * share * (1.0 - share));
        carried
    }))
}

/// Play between the strands that lubricant widens by a power of the speed.
fn widening_play(draw: &mut Draw<'_>) -> Drawn {
    let span = draw.span_bar;
    let (still, power) = (draw.even(0.02, 0.04) * span, draw.even(0.5, 0.9));
    let growth = draw.even(1.0, 2.0);
    let share = STEP_S / draw.even(0.02, 0.05);
    let (mut last, mut speed, mut carried) = (0.0, 0.0, 0.0_f64);
    Drawn::Before(stage(move |command, _| {
        let now: f64 = (command - last) / STEP_S;
        last = command;
        speed += share * (now.abs() - speed);
        let half = (still * (1.0 + growth * (speed / span).powf(power))).min(0.2 * span);
        carried = carried.max(command - half).min(command + half);
        carried
    }))
}

/// Springs in series with sliders and dashpots: slow strokes relax them away, quick ones drag them to where they slip.
fn relaxing_sliders(draw: &mut Draw<'_>) -> Drawn {
    let mut sliders = [0.3, 1.0].map(|scale| {
        let relaxing_s = scale * draw.log(0.4, 1.0);
        (draw.even(0.15, 0.3), draw.even(0.03, 0.06) * draw.span_bar, relaxing_s, 0.0_f64)
    });
    let mut last = 0.0;
    Drawn::Before(stage(move |command, _| {
        let way = command - last;
        last = command;
        let mut left = command;
        for (stiffness, slip, relaxing_s, force) in &mut sliders {
            *force = (*force + *stiffness * way - STEP_S * *force / *relaxing_s).clamp(-*slip, *slip);
            left -= *force;
        }
        left
    }))
}

/// Springs with dashpots beside them, one behind another: part of the motion comes late, at three speeds.
fn chain_of_dashpots(draw: &mut Draw<'_>) -> Drawn {
    let mut elements = [(0.4, 1.0), (2.0, 5.0), (8.0, 20.0)].map(|(low, high)| (draw.even(0.04, 0.1), draw.log(low, high), 0.0));
    Drawn::Behind(stage(move |place, _| {
        let mut sum = place;
        for (share, slow_s, late) in &mut elements {
            *late += STEP_S * (*share * place - *late) / *slow_s;
            sum += *late;
        }
        sum
    }))
}

/// Rubber flows by thermally activated jumps, a hyperbolic sine of what is left: it creeps as the logarithm of time.
fn thermal_flow(draw: &mut Draw<'_>) -> Drawn {
    let share = draw.even(0.12, 0.22);
    let scale = draw.even(0.03, 0.05) * draw.span_bar;
    let slow_s = draw.log(3.0, 12.0);
    let mut flowed = 0.0;
    Drawn::Before(stage(move |command, _| {
        let left: f64 = share * command - flowed;
        flowed += STEP_S * scale / slow_s * (left / scale).clamp(-8.0, 8.0).sinh();
        command + flowed
    }))
}

/// Filled rubber is softer below the largest stretch since the pause than it is on its way there.
fn softer_below_the_peak(draw: &mut Draw<'_>) -> Drawn {
    let softening = draw.even(0.1, 0.25);
    let scale = draw.even(0.15, 0.4) * draw.range_mm;
    let mut peak = 0.0_f64;
    Drawn::Behind(stage(move |place, moment| {
        if moment.begins {
            peak = 0.0;
        }
        peak = peak.max(place);
        place * (1.0 + softening * ((peak - place) / scale).tanh())
    }))
}

/// Travel since the pause breaks bonds in the rubber: what is stiff at first yields with every stroke.
fn softer_by_travel(draw: &mut Draw<'_>) -> Drawn {
    let stiffness = draw.even(0.12, 0.25);
    let breaking = draw.log(1.0, 3.0) * draw.span_bar;
    let (mut last, mut bonds) = (0.0, 1.0);
    Drawn::Before(stage(move |command, moment| {
        if moment.begins {
            bonds = 1.0;
        }
        let travel: f64 = command - last;
        last = command;
        bonds *= (-travel.abs() / breaking).exp();
        command * (1.0 - stiffness * bonds)
    }))
}

/// A dry contact sticks until it is stretched far enough, then darts most of the way and sticks anew.
fn jumping_contact(draw: &mut Draw<'_>) -> Drawn {
    let sticks = draw.even(0.05, 0.1) * draw.range_mm;
    let rests = sticks * draw.even(0.15, 0.45);
    let farthest = draw.even(6.0, 12.0) * draw.range_mm * STEP_S;
    let (mut contact, mut slips) = (0.0, false);
    Drawn::Behind(stage(move |place, _| {
        let stretch: f64 = place - contact;
        let left = stretch.abs() - rests;
        if slips || stretch.abs() > sticks {
            contact += stretch.signum() * left.clamp(0.0, farthest);
            slips = left > farthest;
        }
        contact
    }))
}

/// A mass dragged on a spring over a dry floor, whose friction falls as it gets going.
fn dragged_mass(draw: &mut Draw<'_>) -> Drawn {
    let omega = TAU * draw.log(5.0, 9.0);
    let damping = draw.even(0.3, 0.5);
    let sticks = draw.even(0.05, 0.1) * draw.range_mm;
    let slides = sticks * draw.even(0.3, 0.6);
    let going = draw.even(0.1, 0.25) * draw.range_mm;
    let still = 1e-3 * draw.range_mm;
    let (mut mass, mut speed) = (0.0, 0.0_f64);
    Drawn::Behind(stage(move |place, _| {
        let stretch: f64 = place - mass;
        if speed.abs() < still && stretch.abs() < sticks {
            speed = 0.0;
            return mass;
        }
        let way = if speed.abs() < still { stretch.signum() } else { speed.signum() };
        let friction = way * (slides + (sticks - slides) * (-speed.abs() / going).exp());
        let next = speed + STEP_S * (omega * omega * (stretch - friction) - 2.0 * damping * omega * speed);
        // What comes to a stop may stick there before it turns.
        speed = if next * speed < 0.0 { 0.0 } else { next };
        mass += STEP_S * speed;
        mass
    }))
}

/// Draws and tells a resonance: angular frequency and damping ratio.
fn told_resonance(draw: &mut Draw<'_>) -> [f64; 2] {
    let (frequency_hz, damping) = (draw.log(1.6, 3.2), draw.log(0.1, 0.4));
    [TAU * draw.tell("resonance.frequency_hz", frequency_hz), draw.tell("resonance.damping_ratio", damping)]
}

/// The air in the tube is a mass on the muscle's air spring, braked by the tube's wall.
fn air_column(draw: &mut Draw<'_>) -> Drawn {
    let [omega, damping] = told_resonance(draw);
    let (mut pressure, mut flow) = (0.0, 0.0);
    Drawn::Before(stage(move |command, _| {
        flow += STEP_S * (omega * omega * (command - pressure) - 2.0 * damping * omega * flow);
        pressure += STEP_S * flow;
        pressure
    }))
}

/// The tip's mass hangs on a spring and a damper that the muscle moves together: the damper drives too.
fn shaken_tip(draw: &mut Draw<'_>) -> Drawn {
    let [omega, damping] = told_resonance(draw);
    let (mut tip, mut impulse) = (0.0, 0.0);
    Drawn::Behind(stage(move |place, _| {
        impulse += STEP_S * omega * omega * (place - tip);
        tip += STEP_S * (impulse + 2.0 * damping * omega * (place - tip));
        tip
    }))
}
