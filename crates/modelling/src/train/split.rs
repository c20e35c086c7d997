//! What is for training and what for validation: whole recordings, or blocks of one or two.
//!
//! The end of a recording is more of the same motion: an error there says little about the next recording, so it is no validation set
//! as long as whole recordings can be left out.

use rand::seq::SliceRandom as _;

use super::tracks::{Purpose, stream};
use recording::Recording;

/// Blocks that a single recording is cut into.
const BLOCKS: usize = 20;

/// Up to this many recordings, each gives its end to the validation: leaving one out would leave out half of what is known.
const FEW: usize = 2;

/// For every sample of every recording: is it for training? At least one recording (or block) is on each side.
#[must_use]
pub fn split(recordings: &[Recording], validation_fraction: f64, seed: u64) -> Vec<Vec<bool>> {
    let mut random = stream(seed, Purpose::Split, 0);
    let mut choose = |count: usize| {
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a fraction of a small count")]
        let validating = ((count as f64 * validation_fraction).round() as usize).clamp(1, count.max(2) - 1);
        let mut order: Vec<usize> = (0..count).collect();
        order.shuffle(&mut random);
        let mut training = vec![true; count];
        order.iter().take(validating).for_each(|&index| training[index] = false);
        training
    };
    if let [only] = recordings {
        let training = choose(BLOCKS);
        return vec![(0..only.len()).map(|sample| training[sample * BLOCKS / only.len()]).collect()];
    }
    if recordings.len() <= FEW {
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a fraction of a length")]
        let kept = |length: usize| ((length as f64 * (1.0 - validation_fraction)).round() as usize).clamp(1, length.max(2) - 1);
        return recordings.iter().map(|recording| (0..recording.len()).map(|sample| sample < kept(recording.len())).collect()).collect();
    }
    let training = choose(recordings.len());
    recordings.iter().zip(training).map(|(recording, training)| vec![training; recording.len()]).collect()
}
