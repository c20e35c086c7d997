//! What computes a layer: plain Rust, or on the target the routine in assembly that must match it to the bit.

use model_export::schema::MAX_WIDTH;

use super::layer::{Layer, LayerState, NoTrace, step_traced};

/// Computes layers; the place where the target's fast kernel comes in.
pub trait Kernel {
    /// One step of layer number `index`: reads `input` (the layer's width is used) and moves `state` on.
    ///
    /// # Deadline
    /// Runs in the control tick.
    fn step(&self, index: usize, layer: &Layer<'_>, input: &[i16; MAX_WIDTH], state: &mut LayerState);
}

/// Plain Rust, the same on every machine.
#[derive(Clone, Copy, Debug, Default)]
pub struct Portable;

impl Kernel for Portable {
    fn step(&self, index: usize, layer: &Layer<'_>, input: &[i16; MAX_WIDTH], state: &mut LayerState) {
        step_traced(index, layer, input, state, &mut NoTrace);
    }
}
