//! The link between host and board, by its bytes.

mod examples;
mod numbers;
mod wire;
