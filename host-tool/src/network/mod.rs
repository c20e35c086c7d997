//! The f32 LSTM: architecture, forward pass, backpropagation through time, weights on disk.
