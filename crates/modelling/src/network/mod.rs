//! The f32 network: architecture, forward pass, backpropagation through time, weights on disk.
//!
//! A [`TrainedModel`] is a front end (physics, see [`model_export::schema`]) and, usually, a [`Network`] that corrects it. One LSTM layer
//! computes, with `x` its input, `h` its hidden state and `c` its cell state,
//!
//! ```text
//! z   = W_x x + W_h h + b                 rows in gate order i, f, g, o, one row per unit in each
//! i,f,o = sigmoid(z)      g = act(z)
//! c  := clamp(f*c + i*g, -limit, limit)   limit: the state limit
//! h  := o * act(c)
//! y   = w . h_last + b                    after the last layer; added to the front end's linear readout
//! ```
//!
//! `act` is one of [`Activation`]; [`Cell`] has the equations of GRU and dense layers. Training knows LSTM layers only; the others are imported.
//! Everything is normalised: the input by the input channel, the output by the output channel.

mod activation;
mod elementwise;
mod file;
mod layer_buffers;
mod parameters;
pub(crate) mod product;
mod run;
mod sequence;
mod step;
mod trained;

pub use model_export::schema::{Activation, Cell};

pub use file::{FORMAT_VERSION, ModelFileError, from_bytes, load, save, to_bytes};
pub use parameters::{Architecture, LayerLayout, Layout};
pub use run::{Runner, limit_feature, window_sample};
pub use sequence::Sequence;
pub use step::NetworkState;
pub use trained::{Channel, Layer, Mode, Network, Provenance, TrainedModel, built, described, narrowed};

#[cfg(test)]
mod tests;
