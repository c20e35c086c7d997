//! What schema version 4 adds behind the model: the inputs beside the first.

use heapless::Vec;
use serde::{Deserialize, Serialize};

use crate::schema::{Channel, MAX_FEATURES, MAX_MORE_INPUTS, MAX_PLAY, Model};

/// The inputs beside the first, and who follows which.
#[derive(Default, Serialize, Deserialize)]
pub struct SeveralInputs<'a> {
    #[serde(borrow)]
    channels: Vec<Channel<'a>, MAX_MORE_INPUTS>,
    weights: Vec<f32, MAX_MORE_INPUTS>,
    play_inputs: Vec<u8, MAX_PLAY>,
    feature_inputs: Vec<u8, MAX_FEATURES>,
}

impl<'a> SeveralInputs<'a> {
    /// Puts them into the model's places.
    pub fn put_into(self, model: &mut Model<'a>) {
        model.more_inputs = self.channels;
        model.front_end.more_input_weights = self.weights;
        model.front_end.play_inputs = self.play_inputs;
        model.front_end.feature_inputs = self.feature_inputs;
    }

    /// Those of a model.
    #[cfg(feature = "std")]
    pub fn of(model: &Model<'a>) -> Self {
        Self {
            channels: model.more_inputs.clone(),
            weights: model.front_end.more_input_weights.clone(),
            play_inputs: model.front_end.play_inputs.clone(),
            feature_inputs: model.front_end.feature_inputs.clone(),
        }
    }
}
