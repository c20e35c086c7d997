//! Turning points of an input: those that operators remember, and those that lie between two samples.
//!
//! Operators remember the farthest point of a stroke, and a sampled input has passed it by up to half a step when it turns at a corner:
//! with a triangle of 0.35 Hz at 50 Hz that is up to 0.7 % of its span, and it stays in the output until a later stroke wipes it out.

/// Points at which the input turned between two samples: the sample after each, and the farthest value, beyond both neighbours.
///
/// Either side is continued by the parabola through its three samples, which is exact for corners between straight lines and close for
/// whatever is smooth. Both sides must go straight up or down over their three samples, and none is continued by more than two straight lines
/// through the neighbouring steps could be. An input that jitters from sample to sample has no such turns: what it does between them is
/// anybody's guess, and mostly it holds.
#[must_use]
pub fn between_samples(path: &[f64]) -> Vec<(usize, f64)> {
    if jitters(path) {
        return Vec::new();
    }
    let turn = |(index, near): (usize, &[f64])| {
        let &[a, b, c, d, e, f] = near else { return None };
        let sign = if c > b { 1.0 } else { -1.0 };
        let monotone = sign * (b - a) > 0.0 && sign * (c - b) > 0.0 && sign * (e - d) < 0.0 && sign * (f - e) < 0.0;
        let beyond = if monotone { farthest([c, c - b, c - 2.0 * b + a], [d, d - e, d - 2.0 * e + f], sign) } else { 0.0 };
        (beyond > 0.0).then(|| (index + 3, sign * (sign * c).max(sign * d) + sign * beyond))
    };
    path.windows(6).enumerate().filter_map(turn).collect()
}

/// Share of the samples at which a jittering input bends the other way than just before; a wave of eight samples does at a quarter.
const BENDS_BACK: f64 = 0.45;
/// Root mean square of its bends over that of its steps; steps of a converter are far smaller.
const LARGE_BENDS: f64 = 0.3;

/// Whether the path bends to and fro from sample to sample, and by as much as it moves.
fn jitters(path: &[f64]) -> bool {
    let (mut back, mut count, mut of_bends, mut of_steps) = (0.0, 1e-30, 0.0, 1e-30);
    for near in path.windows(4) {
        let (before, bend) = (near[2] - 2.0 * near[1] + near[0], near[3] - 2.0 * near[2] + near[1]);
        of_bends += bend * bend;
        of_steps += (near[3] - near[2]).powi(2);
        if before != 0.0 && bend != 0.0 {
            count += 1.0;
            back += f64::from(u8::from((before > 0.0) != (bend > 0.0)));
        }
    }
    back > BENDS_BACK * count && of_bends > LARGE_BENDS * LARGE_BENDS * of_steps
}

/// How far, in the direction of `sign`, two sides reach beyond the last sample of each before they meet. A side is its last value, its
/// last step and its second difference.
fn farthest(left: [f64; 3], right: [f64; 3], sign: f64) -> f64 {
    let at = |side: [f64; 3], steps: f64| sign * (side[0] + steps * side[1] + 0.5 * steps * (steps + 1.0) * side[2]);
    let nearer = |share: f64| at(left, share).min(at(right, 1.0 - share));
    let top = (sign * left[0]).max(sign * right[0]);
    // Straight lines through the neighbouring steps would meet so far out at most.
    let (rise, fall) = (sign * left[1], sign * right[1]);
    let most = rise * fall / (rise + fall);
    // The nearer side is highest where the two meet or where the nearer one has its vertex.
    let difference = [at(left, 0.0) - at(right, 1.0), 0.0, at(left, 1.0) - at(right, 0.0)];
    let bend = 0.5 * sign * (left[2] - right[2]);
    let slope = difference[2] - difference[0] - bend;
    let vertex = |side: [f64; 3]| if side[2] == 0.0 { 0.5 } else { -0.5 - side[1] / side[2] };
    let root = (slope * slope - 4.0 * bend * difference[0]).max(0.0).sqrt();
    // Written so that a vanishing bend does no harm.
    let sum = -0.5 * (slope + root.copysign(slope));
    [difference[0] / sum, sum / bend, vertex(left), 1.0 - vertex(right)]
        .into_iter()
        .filter(|share| (0.0..=1.0).contains(share))
        .map(|share| nearer(share) - top)
        .fold(0.0, f64::max)
        .min(most)
}

/// Adds the turning points of `input` to `history` and forgets those that later, larger ones wipe out.
pub fn remember(history: &mut Vec<f64>, input: &[f64]) {
    let mut turns = between_samples(input).into_iter().peekable();
    for (sample, &value) in input.iter().enumerate() {
        if let Some((_, turn)) = turns.next_if(|(at, _)| *at == sample) {
            remember_one(history, turn);
        }
        remember_one(history, value);
    }
}

fn remember_one(history: &mut Vec<f64>, value: f64) {
    loop {
        let count = history.len();
        if count >= 2 {
            let (before, last) = (history[count - 2], history[count - 1]);
            // Still going the same way: the last point was no turning point.
            if (last - before) * (value - last) >= 0.0 {
                history.pop();
                continue;
            }
            // A stroke that swallows the one before wipes it out.
            if count >= 3 && (value - last).abs() >= (last - before).abs() {
                history.pop();
                history.pop();
                continue;
            }
        }
        break;
    }
    history.push(value);
}

#[cfg(test)]
mod tests {
    use super::*;

    const PERIOD_S: f64 = 0.02;

    /// The largest distance of reconstructed turns and of the samples from the true extremes of `wave`, whose turns are at `times_s`.
    fn missed(wave: impl Fn(f64) -> f64, times_s: &[f64]) -> [f64; 2] {
        let path: Vec<f64> = (0..1000).map(|sample| wave(f64::from(sample) * PERIOD_S)).collect();
        let turns = between_samples(&path);
        let mut worst = [0.0_f64; 2];
        for &time_s in times_s.iter().filter(|time_s| **time_s > 0.1 && **time_s < 19.8) {
            let after = (time_s / PERIOD_S).ceil() as usize;
            let near = [path[after - 1], path[after]].into_iter().map(|value| (value - wave(time_s)).abs()).fold(f64::MAX, f64::min);
            let turned = turns.iter().filter(|(at, _)| at.abs_diff(after) <= 1).map(|(_, value)| (value - wave(time_s)).abs());
            worst = [worst[0].max(turned.fold(near, f64::min)), worst[1].max(near)];
        }
        worst
    }

    #[test]
    fn an_input_that_jitters_turns_at_its_samples_and_a_fast_wave_between_them() {
        let wave = |frequency_hz: f64| move |sample: u32| (2.0 * std::f64::consts::PI * frequency_hz * f64::from(sample) * PERIOD_S).sin();
        // A multiplicative generator (Park and Miller 1988) is random enough.
        let mut state = 12_345_u64;
        let mut jitter = || {
            state = state * 48_271 % 2_147_483_647;
            state as f64 / 2_147_483_647.0
        };
        let slow = wave(0.3);
        let jittering: Vec<f64> = (0..1000).map(|sample| slow(sample) + 0.05 * jitter()).collect();
        assert!(between_samples(&jittering).is_empty());
        let read_in_steps: Vec<f64> = (0..1000).map(|sample| (slow(sample) * 500.0).round() / 500.0).collect();
        assert!(!jitters(&read_in_steps));
        assert!(!between_samples(&(0..1000).map(wave(6.0)).collect::<Vec<_>>()).is_empty());
    }

    #[test]
    fn a_corner_between_two_samples_is_found_to_rounding() {
        let (frequency_hz, phase) = (0.37, 0.123);
        let wave = |time_s: f64| 1.8 * (2.0 * ((frequency_hz * time_s + phase).rem_euclid(1.0) - 0.5)).abs();
        let times_s: Vec<f64> = (1..14).map(|half| (0.5 * f64::from(half) - phase) / frequency_hz).collect();
        let [turned, sampled] = missed(wave, &times_s);
        assert!(turned < 1e-9 && sampled > 5e-3, "{turned} {sampled}");
    }

    #[test]
    fn the_crest_of_a_sine_is_found_within_a_tenth_of_what_the_samples_miss() {
        let frequency_hz = 0.83;
        let wave = |time_s: f64| (std::f64::consts::TAU * frequency_hz * time_s).sin() * (-0.05 * time_s).exp();
        // The decay moves the crests to where the tangent is that of the phase.
        let lead_s = (0.05 / (std::f64::consts::TAU * frequency_hz)).atan() / (std::f64::consts::TAU * frequency_hz);
        let times_s: Vec<f64> = (0..30).map(|half| (0.25 + 0.5 * f64::from(half)) / frequency_hz - lead_s).collect();
        let [turned, sampled] = missed(wave, &times_s);
        assert!(turned < 0.1 * sampled, "{turned} {sampled}");
    }

    #[test]
    fn steps_holds_and_ramps_that_end_on_samples_have_no_turn_between_them() {
        let mut path = vec![0.0; 10];
        path.extend((0..=10).map(|step| 0.1 * f64::from(step)));
        path.extend([1.0; 10]);
        path.extend([0.2; 10]);
        path.extend((0..=10).rev().map(|step| 0.02 * f64::from(step)));
        path.extend((1..=10).map(|step| 0.05 * f64::from(step)));
        for (at, value) in between_samples(&path) {
            let beyond = (value - path[at]).abs().min((value - path[at - 1]).abs());
            assert!(beyond < 1e-12, "{at}: {beyond}");
        }
    }

    #[test]
    fn noise_is_continued_by_no_more_than_its_own_steps() {
        let mut state = 1_u64;
        let mut next = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 11) as f64 / (1_u64 << 53) as f64
        };
        let path: Vec<f64> = (0..5000).map(|_| next()).collect();
        let turns = between_samples(&path);
        assert!(turns.len() < path.len() / 10, "{}", turns.len());
        for (at, value) in turns {
            let step = (path[at - 1] - path[at - 2]).abs().min((path[at] - path[at + 1]).abs());
            let beyond = (value - path[at]).abs().min((value - path[at - 1]).abs());
            assert!(beyond <= step, "{at}: {beyond} {step}");
        }
    }
}
