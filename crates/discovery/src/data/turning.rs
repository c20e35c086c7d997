//! Turning points of an input: those that operators remember, and those that lie between two samples.
//!
//! Operators remember the farthest point of a stroke, and a sampled input has passed it by up to half a step when it turns at a corner:
//! with a triangle of 0.35 Hz at 50 Hz that is up to 0.7 % of its span, and it stays in the output until a later stroke wipes it out.

use pulp::{Arch, Simd, WithSimd};

/// Points at which the input turned between two samples: the sample after each, and the farthest value, beyond both neighbours.
///
/// Either side is continued by the parabola through its three samples, which is exact for corners between straight lines and close for
/// whatever is smooth. Both sides must go straight up or down over their three samples, and none is continued by more than two straight lines
/// through the neighbouring steps could be. An input that jitters from sample to sample has no such turns: what it does between them is
/// anybody's guess, and mostly it holds.
#[must_use]
pub fn between_samples(path: &[f64]) -> Vec<(usize, f64)> {
    turns(path, &steps(path))
}

/// From each sample to the next.
fn steps(path: &[f64]) -> Vec<f64> {
    path.windows(2).map(|pair| pair[1] - pair[0]).collect()
}

/// As [`between_samples`], with the path's steps.
fn turns(path: &[f64], steps: &[f64]) -> Vec<(usize, f64)> {
    let mut found = Vec::new();
    if jitters(steps) {
        return found;
    }
    // Hardly any sample has a turn behind it: whoever goes on the same way has none.
    for before in unlike(&steps[1.min(steps.len())..], &steps[3.min(steps.len())..], |product| product < 0.0) {
        let Some(&[a, b, _, d, e]) = steps.get(before..before + 5) else { break };
        let sign = b.signum();
        if sign * a > 0.0 && sign * e < 0.0 {
            let (left, right) = (path[before + 2], path[before + 3]);
            let beyond = farthest([left, b, b - a], [right, -d, e - d], sign);
            if beyond > 0.0 {
                found.push((before + 3, sign * (sign * left).max(sign * right) + sign * beyond));
            }
        }
    }
    found
}

/// Indices at which the products of two rows are as `counts` says, which must be true of negative ones; most are not, so many at a time are
/// passed over.
fn unlike(one: &[f64], other: &[f64], counts: impl Fn(f64) -> bool) -> Vec<usize> {
    let mut found = Vec::new();
    let count = one.len().min(other.len());
    for first in (0..count).step_by(SIDE) {
        let last = (first + SIDE).min(count);
        let (one, other) = (&one[first..last], &other[first..last]);
        if let (Some(one), Some(other)) = (one.first_chunk::<SIDE>(), other.first_chunk::<SIDE>()) {
            let mut least = [0.0; SIDE];
            (0..SIDE).for_each(|at| least[at] = one[at] * other[at]);
            for width in [SIDE / 2, SIDE / 4, SIDE / 8] {
                (0..width).for_each(|at| least[at] = if least[at + width] < least[at] { least[at + width] } else { least[at] });
            }
            if !least[..SIDE / 8].iter().any(|product| counts(*product)) {
                continue;
            }
        }
        found.extend(one.iter().zip(other).zip(first..).filter(|((one, other), _)| counts(*one * *other)).map(|(_, at)| at));
    }
    found
}

/// Share of the samples at which a jittering input bends the other way than just before; a wave of eight samples does at a quarter.
const BENDS_BACK: f64 = 0.45;

/// Root mean square of its bends over that of its steps; steps of a converter are far smaller.
const LARGE_BENDS: f64 = 0.3;

/// Whether a path of these steps bends to and fro from sample to sample, and by as much as it moves.
fn jitters(steps: &[f64]) -> bool {
    let Bends { back, count, of_bends, of_steps } = Arch::new().dispatch(Bending { steps });
    back > BENDS_BACK * (1e-30 + count) && of_bends > LARGE_BENDS * LARGE_BENDS * (1e-30 + of_steps)
}

/// What a path's bends come to.
struct Bends {
    /// How often it bends the other way than just before.
    back: f64,
    /// How often it bends twice in a row.
    count: f64,
    /// Sum of squares of its bends.
    of_bends: f64,
    /// Sum of squares of its steps.
    of_steps: f64,
}

/// The argument of [`jitters`].
struct Bending<'a> {
    steps: &'a [f64],
}

/// Neighbours that are looked at side by side.
const SIDE: usize = 16;

/// Neighbours from one on, zeros behind the last.
#[inline(always)]
fn group(of: &[f64], from: usize) -> [f64; SIDE] {
    let mut lanes = [0.0; SIDE];
    match of[from..].first_chunk() {
        Some(whole) => lanes = *whole,
        None => lanes.iter_mut().zip(&of[from..]).for_each(|(lane, value)| *lane = *value),
    }
    lanes
}

impl WithSimd for Bending<'_> {
    type Output = Bends;

    #[inline(always)]
    fn with_simd<S: Simd>(self, _simd: S) -> Bends {
        let count = self.steps.len().saturating_sub(2);
        let [first, second, third] = [0, 1, 2].map(|from| self.steps.get(from..from + count).unwrap_or(&[]));
        let (mut back, mut twice, mut of_bends, mut of_steps) = ([0.0; SIDE], [0.0; SIDE], [0.0; SIDE], [0.0; SIDE]);
        for from in (0..count).step_by(SIDE) {
            // What is missing in the last group stands still.
            let (first, second, third) = (group(first, from), group(second, from), group(third, from));
            for lane in 0..SIDE {
                let (before, bend) = (second[lane] - first[lane], third[lane] - second[lane]);
                let product = before * bend;
                back[lane] += if product < 0.0 { 1.0 } else { 0.0 };
                twice[lane] += if product != 0.0 { 1.0 } else { 0.0 };
                of_bends[lane] += bend * bend;
                of_steps[lane] += third[lane] * third[lane];
            }
        }
        let sum = |lanes: [f64; SIDE]| lanes.iter().sum();
        Bends { back: sum(back), count: sum(twice), of_bends: sum(of_bends), of_steps: sum(of_steps) }
    }
}

/// How far, in the direction of `sign`, two sides reach beyond the last sample of each before they meet. A side is its last value, its
/// last step and its second difference.
fn farthest(left: [f64; 3], right: [f64; 3], sign: f64) -> f64 {
    let at = |side: [f64; 3], steps: f64| sign * (side[0] + steps * side[1] + 0.5 * steps * (steps + 1.0) * side[2]);
    let nearer = |share: f64| at(left, share).min(at(right, 1.0 - share));
    let top = (sign * left[0]).max(sign * right[0]);
    // Straight lines through the neighbouring steps would meet so far out at most.
    let (rise, rate_weakening) = (sign * left[1], sign * right[1]);
    let most = rise * rate_weakening / (rise + rate_weakening);
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

/// Samples at which a path begins, turns by more than `least`, and ends, oldest first.
#[must_use]
pub fn large_turns(path: &[f64], least: f64) -> Vec<usize> {
    let mut turns: Vec<usize> = Vec::new();
    for (sample, &value) in path.iter().enumerate() {
        match turns[..] {
            [.., from, to] if (path[to] - path[from]) * (value - path[to]) >= 0.0 => *turns.last_mut().expect("two") = sample,
            [.., to] if (value - path[to]).abs() <= least => {}
            _ => turns.push(sample),
        }
    }
    turns
}

/// Adds the turning points of `input` to `history` and forgets those that later, larger ones wipe out.
pub fn remember(history: &mut Vec<f64>, input: &[f64]) {
    let (Some(first), Some(last)) = (input.first(), input.last()) else { return };
    let steps = steps(input);
    remember_one(history, *first);
    let mut turns = turns(input, &steps).into_iter().peekable();
    // A sample on the way from the last to the next is forgotten with the next one, and whatever it wipes out the next one does too.
    for sample in unlike(&steps, &steps[1.min(steps.len())..], |product| product <= 0.0).into_iter().map(|before| before + 1) {
        while let Some((at, turn)) = turns.next_if(|(at, _)| *at <= sample) {
            remember_one(history, turn);
            remember_one(history, input[at]);
        }
        remember_one(history, input[sample]);
    }
    for (at, turn) in turns {
        remember_one(history, turn);
        remember_one(history, input[at]);
    }
    remember_one(history, *last);
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
    fn small_turns_are_none_and_a_stroke_ends_where_it_was_farthest() {
        let path = [0.0, 0.3, 0.295, 0.5, 0.49, 0.2, 0.205, 0.1, 0.4];
        assert_eq!(large_turns(&path, 0.02), [0, 3, 7, 8]);
        // What stays where it is has not begun a stroke.
        assert_eq!(large_turns(&[0.7; 5], 0.02), [0]);
        assert!(large_turns(&[], 0.02).is_empty());
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
        assert!(!jitters(&steps(&read_in_steps)));
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
    fn what_is_remembered_is_what_every_sample_would_leave() {
        let mut state = 7_u64;
        let mut random = || {
            state = state * 48_271 % 2_147_483_647;
            state as f64 / 2_147_483_647.0
        };
        let (mut fast, mut slow) = (Vec::new(), Vec::new());
        for recording in 0..40 {
            let (rate, size, rest) = (0.02 + 0.2 * random(), random(), if recording % 3 == 0 { 0.3 } else { 0.0 });
            let path: Vec<f64> =
                (0..300).map(|sample| size * (rate * f64::from(sample)).sin() * (-0.01 * f64::from(sample)).exp()).collect();
            let path: Vec<f64> =
                path.into_iter().map(|value| value.max(rest - 0.2) + if rest > 0.2 { 1e-3 * random() } else { 0.0 }).collect();
            remember(&mut fast, &path);
            let turns = between_samples(&path);
            for (sample, &value) in path.iter().enumerate() {
                turns.iter().filter(|turn| turn.0 == sample).for_each(|turn| remember_one(&mut slow, turn.1));
                remember_one(&mut slow, value);
            }
            assert_eq!(fast, slow, "recording {recording}");
        }
        assert!(fast.len() > 5, "{fast:?}");
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
