//! Of [`super::fourth_laws`] those that go with the session's time: rhythms, drifts, changes, leaks, clocks and holds.

use super::draw::{Draw, STEP_S};
use super::laws::{Drawn, stage};
use std::f64::consts::TAU;

/// Breath lifts the tip: a short swell, a longer rest, again and again.
pub(super) fn breath(draw: &mut Draw<'_>) -> Drawn {
    let drawn = draw.log(0.18, 0.4);
    let frequency_hz = draw.tell("periodic-disturbance.frequency_hz", drawn);
    let lift = draw.sign() * draw.even(0.05, 0.12) * draw.range_mm;
    let (sharpness, phase) = (draw.even(0.8, 2.0), draw.even(0.0, TAU));
    Drawn::Behind(stage(move |place, moment| {
        place + lift * (sharpness * ((TAU * frequency_hz * moment.session_s + phase).cos() - 1.0)).exp()
    }))
}

/// A pump's strokes come through the regulator, the more the wider it is open: a quick rise and a slow fall each.
pub(super) fn pump_strokes(draw: &mut Draw<'_>) -> Drawn {
    let drawn = draw.log(1.2, 4.0);
    let frequency_hz = draw.tell("periodic-disturbance.frequency_hz", drawn);
    let (ripple, span) = (draw.even(0.06, 0.12), draw.span_bar);
    let phase = draw.even(0.0, TAU);
    Drawn::Before(stage(move |command, moment| {
        let angle = TAU * frequency_hz * moment.session_s + phase;
        (command + ripple * (0.4 * span + 0.6 * command) * (angle.sin() + 0.35 * (2.0 * angle).sin())).max(0.0)
    }))
}

/// The sensor warms up after it is switched on, and its zero with it.
pub(super) fn warming_sensor(draw: &mut Draw<'_>) -> Drawn {
    let zero = draw.sign() * draw.even(0.07, 0.16) * draw.range_mm;
    let warming_s = draw.even(0.15, 0.5) * draw.session_s;
    Drawn::Behind(stage(move |place, moment| place - zero * (-moment.session_s.max(0.0) / warming_s).exp_m1()))
}

/// The zero wanders at random, by a straight line between one place and the next.
pub(super) fn wandering_zero(draw: &mut Draw<'_>) -> Drawn {
    let mut zero = 0.0;
    let mut zeros = vec![zero];
    for _ in 0..9 {
        zero += draw.sign() * draw.even(0.02, 0.06) * draw.range_mm;
        zeros.push(zero);
    }
    let session_s = draw.session_s;
    Drawn::Behind(stage(move |place, moment| {
        let along = (moment.session_s / session_s).clamp(0.0, 1.0) * (zeros.len() - 1) as f64;
        let below = (along as usize).min(zeros.len() - 2);
        place + zeros[below] + (along - below as f64) * (zeros[below + 1] - zeros[below])
    }))
}

/// Rubber ages under work, quickly at first: the stroke changes by the logarithm of the time.
pub(super) fn ageing_rubber(draw: &mut Draw<'_>) -> Drawn {
    let first_s = draw.log(0.02, 0.2) * draw.session_s;
    let change = draw.sign() * draw.even(0.1, 0.25) / (draw.session_s / first_s).ln_1p();
    Drawn::Behind(stage(move |place, moment| place * (1.0 + change * (moment.session_s.max(0.0) / first_s).ln_1p())))
}

/// The room's temperature sways, and the regulator's gain with it.
pub(super) fn swaying_room(draw: &mut Draw<'_>) -> Drawn {
    let (swing, phase) = (draw.even(0.07, 0.14), draw.even(0.0, TAU));
    let omega = TAU * draw.even(0.6, 1.5) / draw.session_s;
    Drawn::Before(stage(move |command, moment| command * (1.0 + swing * (omega * moment.session_s + phase).sin())))
}

/// The sensor was taken off and put back: another zero, another gain.
pub(super) fn remounted_sensor(draw: &mut Draw<'_>) -> Drawn {
    let changed = draw.even(5.0, 15.0) as usize;
    let zero = draw.sign() * draw.even(0.04, 0.12) * draw.range_mm;
    let gain = 1.0 + draw.sign() * draw.even(0.05, 0.18);
    Drawn::Behind(stage(move |place, moment| if moment.recording < changed { place } else { zero + gain * place }))
}

/// The line was taken apart, and the regulator trimmed anew: the muscle gets another pressure for the same command.
pub(super) fn reconnected_line(draw: &mut Draw<'_>) -> Drawn {
    let changed = draw.even(5.0, 15.0) as usize;
    let zero = draw.sign() * draw.even(0.03, 0.1) * draw.span_bar;
    let gain = 1.0 + draw.sign() * draw.even(0.08, 0.2);
    Drawn::Before(stage(move |command, moment| if moment.recording < changed { command } else { zero + gain * command }))
}

/// A piston meters the air, and part of the charge seeps through the muscle's wall, either way.
pub(super) fn seeping_charge(draw: &mut Draw<'_>) -> Drawn {
    let seeping_s = draw.log(12.0, 40.0);
    leaking(move |pressure| pressure / seeping_s)
}

/// A pinhole lets the metered air out by the root of its pressure; an inlet valve keeps it from going below the room's.
pub(super) fn pinhole(draw: &mut Draw<'_>) -> Drawn {
    let (span, emptying_s) = (draw.span_bar, draw.log(8.0, 25.0));
    leaking(move |pressure| if pressure > 0.0 { span / emptying_s * (pressure / span).sqrt() } else { pressure / STEP_S })
}

/// A pressure that follows the command's changes and loses `loss(pressure)` per second; the pause starts it anew.
pub(super) fn leaking(loss: impl Fn(f64) -> f64 + 'static) -> Drawn {
    let (mut last, mut pressure, mut recording) = (0.0, 0.0, 0);
    Drawn::Before(stage(move |command, moment| {
        if moment.recording == recording {
            pressure += command - last;
        } else {
            (recording, pressure) = (moment.recording, command);
        }
        last = command;
        pressure -= STEP_S * loss(pressure);
        pressure
    }))
}

/// A converter takes the command at the ticks of a clock that runs through the whole session.
pub(super) fn free_running_clock(draw: &mut Draw<'_>) -> Drawn {
    let drawn_s = draw.log(0.08, 0.3);
    let period_s = draw.tell("sample-and-hold.period_s", drawn_s);
    let phase = draw.even(0.0, 1.0);
    let (mut tick, mut held) = (f64::NEG_INFINITY, 0.0);
    Drawn::Before(stage(move |command, moment| {
        let now = (moment.session_s / period_s + phase).floor();
        if now.total_cmp(&tick).is_ne() {
            (tick, held) = (now, command);
        }
        held
    }))
}

/// A converter averages the command over the last part of each period and holds that; its clock starts with the recording.
pub(super) fn averaging_converter(draw: &mut Draw<'_>) -> Drawn {
    let period = draw.log(80.0, 300.0) as usize;
    draw.tell("sample-and-hold.period_s", period as f64 * STEP_S);
    let opens = (draw.even(0.5, 0.85) * period as f64) as usize;
    let (mut count, mut sum, mut held) = (0, 0.0, 0.0);
    Drawn::Before(stage(move |command, moment| {
        if moment.begins {
            (count, sum) = (0, 0.0);
        }
        if count >= opens {
            sum += command;
        }
        count += 1;
        if count == period {
            held = sum / (period - opens) as f64;
            (count, sum) = (0, 0.0);
        }
        held
    }))
}

/// Tells when a signal has turned back.
#[derive(Default)]
struct Reversals {
    farthest: f64,
    falling: bool,
}

impl Reversals {
    /// Whether the signal has just gone back by more than `margin` from where it was farthest.
    fn turned(&mut self, value: f64, margin: f64) -> bool {
        let ahead = if self.falling { self.farthest - value } else { value - self.farthest };
        if ahead >= 0.0 {
            self.farthest = value;
        }
        let turned = ahead < -margin;
        if turned {
            (self.farthest, self.falling) = (value, !self.falling);
        }
        turned
    }
}

/// The valve needs a while to change from filling to venting: until then the pressure stays, then it is at once where it should be.
pub(super) fn changing_over_valve(draw: &mut Draw<'_>) -> Drawn {
    let drawn_s = draw.log(0.2, 0.4);
    let hold_s = draw.tell("hold-after-reversal.hold_s", drawn_s);
    let margin = 0.002 * draw.span_bar;
    let (mut reversals, mut left_s, mut held) = (Reversals::default(), 0.0, 0.0);
    Drawn::Before(stage(move |command, _| {
        let turned = reversals.turned(command, margin);
        if left_s > 0.0 {
            left_s -= STEP_S;
        } else if turned {
            left_s = hold_s;
        } else {
            held = command;
        }
        held
    }))
}

/// The tip rests in its guide for a while after every turn, then comes after by and by.
pub(super) fn resting_tip(draw: &mut Draw<'_>) -> Drawn {
    let drawn_s = draw.log(0.2, 0.4);
    let hold_s = draw.tell("hold-after-reversal.hold_s", drawn_s);
    let margin = 0.002 * draw.range_mm;
    let fading = 1.0 - STEP_S / draw.even(0.03, 0.1);
    let (mut reversals, mut left_s, mut tip, mut behind) = (Reversals::default(), 0.0, 0.0, 0.0);
    Drawn::Behind(stage(move |place, _| {
        let turned = reversals.turned(place, margin);
        if left_s > 0.0 {
            left_s -= STEP_S;
            behind = tip - place;
        } else if turned {
            left_s = hold_s;
            behind = tip - place;
        } else {
            behind *= fading;
            tip = place + behind;
        }
        tip
    }))
}
