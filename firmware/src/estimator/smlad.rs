//! One step of a layer in assembly for the Cortex-M4 (`smlad/step.s`), over the stream of [`super::packed`].
//!
//! This file is the one place of the library outside the board code that needs `unsafe`: plain Rust never gets the compiler to keep
//! sixteen values in the right registers.

use core::arch::global_asm;

use model_export::fixed::CELL_FRACTION;
use model_export::schema::{Activation, Cell, MAX_UNITS, MAX_WIDTH};

use super::layer::{Layer, LayerState};
use super::shape::{BYTE_OFFSET, MAX_PAIR_COLUMNS, Shape};
use tables::{SIGMOID_LOW_HALF, TANH_LOW_HALF, middle};

mod tables;

/// Bytes of code for two columns as pairs.
const PAIR_CODE_BYTES: usize = 6 * 4;
/// Bytes of code for four columns as bytes.
const BYTES_CODE_BYTES: usize = 14 * 4;

// What the unrolled loops below count on.
const _: () = assert!(MAX_WIDTH == 64 && MAX_UNITS == 64 && MAX_PAIR_COLUMNS == 8 && BYTE_OFFSET == 128);

global_asm!(include_str!("smlad/step.s"), options(raw));

// The lengths that the assembler has checked.
const _: () = assert!(PAIR_CODE_BYTES == 24 && BYTES_CODE_BYTES == 56);

// SAFETY: the signature is that of the assembly above. The others are places inside it, declared for their addresses and never called.
unsafe extern "C" {
    fn firmware_smlad_step(plan: &Plan, stream: *const u32, input: &[i16; MAX_WIDTH], state: &mut LayerState);
    fn firmware_smlad_after_pairs();
    fn firmware_smlad_after_bytes();
    fn firmware_smlad_after_recurrent();
    fn firmware_smlad_tanh();
    fn firmware_smlad_relu();
    fn firmware_smlad_hard();
    fn firmware_smlad_gru_tanh();
    fn firmware_smlad_gru_relu();
    fn firmware_smlad_gru_hard();
    fn firmware_smlad_dense_tanh();
    fn firmware_smlad_dense_relu();
    fn firmware_smlad_dense_hard();
}

/// A layer's constants in the order in which the assembly reads them; only [`Plan::new`] makes one.
#[repr(C)]
#[derive(Clone, Debug)]
pub(super) struct Plan {
    groups: usize,
    input_samples_words: usize,
    input_offset: i32,
    hidden_samples_words: usize,
    enter_input: usize,
    enter_recurrent: usize,
    enter_elements: usize,
    sigmoid: usize,
    /// Table of the tanh; room above the relu's cap; room above one for the hard tanh.
    activation: usize,
    exponent: i32,
    to_cell: i32,
    cell_room: i32,
    rounding: i32,
    hidden_shift: i32,
}

impl Plan {
    pub(super) fn new(layer: &Layer<'_>, shape: Shape) -> Self {
        let wire = layer.wire();
        let exponent = i32::from(wire.cell_exponent);
        let to_cell = 14 - exponent;
        let activation = match layer.activation() {
            Activation::Tanh => middle(&TANH_LOW_HALF),
            Activation::Relu => room_above(wire.cell_limit >> to_cell).cast_unsigned() as usize,
            Activation::Hard => room_above((1 << (i32::from(CELL_FRACTION) - exponent)) - 1).cast_unsigned() as usize,
        };
        let enter_elements = address(match (layer.cell(), layer.activation()) {
            (Cell::Lstm, Activation::Tanh) => firmware_smlad_tanh,
            (Cell::Lstm, Activation::Relu) => firmware_smlad_relu,
            (Cell::Lstm, Activation::Hard) => firmware_smlad_hard,
            (Cell::Gru, Activation::Tanh) => firmware_smlad_gru_tanh,
            (Cell::Gru, Activation::Relu) => firmware_smlad_gru_relu,
            (Cell::Gru, Activation::Hard) => firmware_smlad_gru_hard,
            (Cell::Dense(_), Activation::Tanh) => firmware_smlad_dense_tanh,
            (Cell::Dense(_), Activation::Relu) => firmware_smlad_dense_relu,
            (Cell::Dense(_), Activation::Hard) => firmware_smlad_dense_hard,
        });
        // The product of gate and activated cell has a fractional bit less than a state.
        let hidden_shift = match layer.cell() {
            Cell::Lstm => i32::from(wire.hidden_shift),
            Cell::Gru | Cell::Dense(_) => i32::from(wire.hidden_shift) + 1,
        };
        let (hidden_samples_words, recurrent_code_bytes) = (shape.recurrent_words() / 2, shape.recurrent_words() / 4 * BYTES_CODE_BYTES);
        let (input_samples_words, input_offset, enter_input) = if shape.has_pairs() {
            let pairs = shape.input_words() / 4;
            (pairs, 0, address(firmware_smlad_after_pairs) - pairs * PAIR_CODE_BYTES)
        } else {
            let fours = shape.input_words() / 4;
            (2 * fours, -BYTE_OFFSET, address(firmware_smlad_after_bytes) - fours * BYTES_CODE_BYTES)
        };
        Self {
            groups: shape.groups(),
            input_samples_words,
            input_offset,
            hidden_samples_words,
            enter_input,
            enter_recurrent: address(firmware_smlad_after_recurrent) - recurrent_code_bytes,
            enter_elements,
            sigmoid: middle(&SIGMOID_LOW_HALF),
            activation,
            exponent,
            to_cell,
            // Half the limit less one, doubled: the largest cell.
            cell_room: room_above(wire.cell_limit - 2),
            rounding: 1 << (hidden_shift - 1),
            hidden_shift,
        }
    }

    /// One step of the layer that this plan and `stream` were made of.
    pub(super) fn step(&self, stream: &[u32], input: &[i16; MAX_WIDTH], state: &mut LayerState) {
        // SAFETY: a plan is only made from a layer's shape together with its stream, and kept with it: the assembly reads exactly the
        // stream's words. `Layer` has proven inputs and units to lie in 1..=64, so that rounded up to a multiple of four columns it
        // reads within the 64 samples of `input` and `hidden`, and writes within the 64 cells and hidden states. `LayerState` is
        // `repr(C)`: 64 cells of 4 bytes, then the hidden states. Table indices are saturated to the 512 segments. It keeps the
        // registers of the procedure call standard, its frame is its own, and it neither calls nor unwinds.
        unsafe { firmware_smlad_step(self, stream.as_ptr(), input, state) }
    }
}

/// The place's address, with the lowest bit set as a jump to Thumb code wants it.
fn address(place: unsafe extern "C" fn()) -> usize {
    place as usize
}

/// The difference from the largest number.
fn room_above(bound: i32) -> i32 {
    i32::MAX - bound
}
