//! Whether the tip of a rig sticks, read from its recordings.

use recording::Recording;

/// Half-width of the stick band in output units, 0 when nothing sticks.
///
/// A tip that sticks gives itself away: for a good part of the time the output does not move at all, and when it moves it moves by
/// more than the band, so that small motions are missing. A coarse analogue-to-digital converter does much the same, but its motions
/// are whole steps, most of them the smallest.
pub(super) fn stick_band(recordings: &[Recording], parts: &[Vec<bool>]) -> f64 {
    let mut motions = Vec::new();
    let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
    for (recording, part) in recordings.iter().zip(parts) {
        for segment in recording.segments() {
            for index in segment.skip(1).filter(|index| part[*index]) {
                // Only while the input moves: a rest of the rig is no sticking.
                if recording.input[index] != recording.input[index - 1] {
                    motions.push((recording.output[index] - recording.output[index - 1]).abs());
                }
                low = low.min(recording.output[index]);
                high = high.max(recording.output[index]);
            }
        }
    }
    motions.sort_by(f64::total_cmp);
    let count = motions.len();
    let tolerance = 1e-6 * (high - low);
    let resting = motions.partition_point(|motion| *motion <= tolerance);
    let slips = &motions[resting..];
    if count < 200 || resting < count / 10 || slips.len() < 50 {
        return 0.0;
    }
    // A few small motions may come from noise or from edges of the recordings.
    let band = slips[slips.len() / 100];
    let smaller = slips.partition_point(|motion| *motion < 0.8 * band);
    let steps = slips.partition_point(|motion| *motion < 1.01 * band);
    let sticks = band > 0.002 * (high - low) && smaller * 100 < count && steps * 5 < slips.len();
    if sticks { band } else { 0.0 }
}
