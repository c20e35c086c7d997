//! One step of a layer in assembly for the Cortex-M4, over the stream of [`super::packed`].
//!
//! This file is the one place of the library outside the board code that needs `unsafe`: plain Rust never gets the compiler to keep
//! sixteen values in the right registers.
//!
//! # Registers
//!
//! While a unit's columns are read:
//!
//! ```text
//! r0 stream    r1 samples    r2 row i    r3:r4 rows i, f    r5 row o    r6:r7 rows o, g    r8-r11 weights    r12, lr samples
//! ```
//!
//! Then, element by element, `r2 r3 r5` hold the gates i, f, o, `r7` the candidate and later the activated cell, `r8` the cell. In a GRU the
//! rows are r, u, m, n: `r3` holds u and `r2` what is left to one, so that the state is made as an LSTM's cell. In a dense layer the rows are
//! four units, whose outputs take the places of their sums. All else is in the frame below, where one `LDM` or `LDRD` fetches what is
//! needed next.
//!
//! # Frame, offsets from the stack pointer
//!
//! ```text
//!   0  sums over the input columns, row by row             48  cell, hidden: where the next group's are
//!  16  where to enter input columns, recurrent columns,     56  rounding and shift of the hidden state
//!      element-wise part                                    64  end of the groups' cells
//!  28  sigmoid table                                        68  start of the input sums (6 words), input samples,
//!  32  tanh table, or the relu's or hard tanh's room            start of the recurrent sums (6 words), hidden samples
//!  36  cell exponent, 14 minus it, room above the cell
//! ```
//!
//! Loops over columns are unrolled for the widest layer and entered in the middle, at the place that leaves as many columns as there
//! are. Nothing branches on data, so a layer costs the same number of instructions in every step.
//!
//! # Saturating to any bound
//!
//! With `room = 2^31 - 1 - b`, `QADD` by the room and `SUB` of it give `min(x, b)`; `QSUB` and `ADD` likewise a lower bound. `QDADD` doubles
//! on the way, which makes the stored cell of its half.

use core::arch::global_asm;

use model_export::fixed::{CELL_FRACTION, SEGMENTS, SIGMOID, SIGMOID_STEP_BITS, TANH, TANH_STEP_BITS, Table};
use model_export::schema::{Activation, Cell, MAX_UNITS, MAX_WIDTH};

use super::network::{Layer, LayerState};
use super::shape::{BYTE_OFFSET, MAX_PAIR_COLUMNS, Shape};

/// Bytes of code for two columns as pairs.
const PAIR_CODE_BYTES: usize = 6 * 4;
/// Bytes of code for four columns as bytes.
const BYTES_CODE_BYTES: usize = 14 * 4;

// What the unrolled loops below count on.
const _: () = assert!(MAX_WIDTH == 64 && MAX_UNITS == 64 && MAX_PAIR_COLUMNS == 8 && BYTE_OFFSET == 128);

global_asm!(
    r#"
    .syntax unified
    .thumb
    .section .text.firmware_smlad_step, "ax", %progbits

// Sums of 32 bits for both rows of a pair, from the sum of the first (a) and the sum of both (low:high).
.macro smlad_separate first, low, high
    subs    \low, \low, \first
    sbc     \high, \high, \first, asr #31
    lsr     \low, \low, #8
    orr     \low, \low, \high, lsl #24
.endm

// Four columns as bytes; 14 instructions, none of which has a form of less than 4 bytes.
.macro smlad_four_columns
    ldm.w   r0!, {r8-r11}
    ldm.w   r1!, {r12, lr}
    smlald  r3, r4, r8, r12
    uxtb16  r8, r8
    smlad   r2, r8, r12, r2
    smlald  r6, r7, r9, r12
    uxtb16  r9, r9
    smlad   r5, r9, r12, r5
    smlald  r3, r4, r10, lr
    uxtb16  r10, r10
    smlad   r2, r10, lr, r2
    smlald  r6, r7, r11, lr
    uxtb16  r11, r11
    smlad   r5, r11, lr, r5
.endm

// Copies samples of \words words from \source into the frame at lr, behind the six words that sums start from; lr moves behind them.
.macro smlad_copy_samples source, words, offset
    add     r3, lr, #24
    add     r11, r3, \words, lsl #2
    mov     r4, #0
    mov     r8, #0x00010001
1:
    ldr     r9, [\source], #4
    ldr     r10, [\source], #4
    smlad   r4, r9, r8, r4
    smlad   r4, r10, r8, r4
    strd    r9, r10, [r3], #8
    cmp     r3, r11
    blo     1b
    mul     r4, r4, \offset
    asr     r8, r4, #31
    strd    r4, r4, [lr]
    strd    r8, r4, [lr, #8]
    strd    r4, r8, [lr, #16]
    mov     lr, r11
.endm

// \out = table at \table of \argument, which is saturated to \bits bits first.
.macro smlad_curve out, table, argument, bits, step_bits
    ssat    \argument, #\bits, \argument
    asr     r8, \argument, #\step_bits
    add     r8, \table, r8, lsl #3
    ldrd    r8, r9, [r8]
    smlawb  \out, r9, \argument, r8
.endm

// Pre-activation of the next row into r7.
.macro smlad_pre_activation from_input, from_hidden
    ldm     r0!, {r4, r7, r8, r9}
    smlal   r4, r7, r8, \from_input
    smlal   r4, r7, r9, \from_hidden
.endm

// Gates into r2, r3, r5, the candidate's pre-activation into r7; then the constants.
.macro smlad_gates
    ldm     sp, {r10, r11, r12, lr}
    ldr     r1, [sp, #28]
    smlad_pre_activation r10, r2
    smlad_curve r2, r1, r7, 21, 12
    smlad_pre_activation r11, r3
    smlad_curve r3, r1, r7, 21, 12
    smlad_pre_activation r12, r5
    smlad_curve r5, r1, r7, 21, 12
    smlad_pre_activation lr, r6
    add     r1, sp, #32
    ldm     r1!, {r4, r6, r10, r11, r12, lr}
.endm

// New cell into r8 and to memory.
.macro smlad_cell
    ldr     r8, [r12]
    smmulr  r8, r3, r8
    smmlar  r8, r2, r7, r8
    qdadd   r8, r11, r8
    sub     r8, r8, r11
    sub     r11, r11, #1
    qsub    r8, r8, r11
    add     r8, r8, r11
    str     r8, [r12], #4
.endm

// New hidden state to memory, and on to the next unit.
.macro smlad_hidden
    ldm     r1, {r8, r9, r10}
    smmlar  r8, r5, r7, r8
    asr     r8, r8, r9
    ssat    r8, #16, r8
    strh    r8, [lr], #2
    smlad_next
.endm

// Back to the first column of the next group, if there is one.
.macro smlad_next
    strd    r12, lr, [sp, #48]
    cmp     r12, r10
    bne.w   firmware_smlad_unit
    b.w     firmware_smlad_end
.endm

// Gates of a GRU, u into r3 and the rest to one into r2, the candidate's pre-activation into r7; then the constants.
.macro smlad_gru_gates
    ldm     sp, {r10, r11, r12, lr}
    ldr     r1, [sp, #28]
    smlad_pre_activation r10, r2
    smlad_curve r2, r1, r7, 21, 12
    smlad_pre_activation r11, r3
    smlad_curve r3, r1, r7, 21, 12
    smlad_pre_activation r12, r5
    smmulr  r5, r2, r7
    smlad_pre_activation lr, r6
    qdadd   r7, r7, r5
    mvn     r2, r3
    bic     r2, r2, #0x80000000
    add     r1, sp, #32
    ldm     r1!, {r4, r6, r10, r11, r12, lr}
.endm

// The state in r8, in 16 bits to memory, and on to the next unit.
.macro smlad_gru_hidden
    ldm     r1, {r7, r9, r10}
    add     r8, r8, r7
    asr     r8, r8, r9
    ssat    r8, #16, r8
    strh    r8, [lr], #2
    smlad_next
.endm

.macro smlad_dense_tanh
    ldrd    r1, r4, [sp, #32]
    smlad_curve r7, r1, r7, 20, 11
    asr     r7, r7, r4
.endm

.macro smlad_dense_relu
    ldr     r1, [sp, #32]
    ldr     r4, [sp, #40]
    bic     r7, r7, r7, asr #31
    qadd    r7, r7, r1
    sub     r7, r7, r1
    lsl     r7, r7, r4
.endm

.macro smlad_dense_hard
    ldr     r4, [sp, #40]
    ssat    r7, #17, r7
    lsl     r7, r7, r4
.endm

// Output of a row of a dense layer, into the place of its sum over recurrent columns, which its multiplier of zero takes out.
.macro smlad_dense_row activation, from_input, output
    smlad_pre_activation \from_input, \output
    smlad_dense_\activation
    ldrd    r8, r9, [sp, #56]
    add     r7, r7, r8
    asr     r7, r7, r9
    ssat    \output, #16, r7
.endm

// Outputs of four units to memory, and on to the next four.
.macro smlad_dense activation
    ldm     sp, {r10, r11, r12, lr}
    smlad_dense_row \activation, r10, r2
    smlad_dense_row \activation, r11, r3
    smlad_dense_row \activation, r12, r5
    smlad_dense_row \activation, lr, r6
    pkhbt   r2, r2, r3, lsl #16
    pkhbt   r5, r5, r6, lsl #16
    ldrd    r12, lr, [sp, #48]
    strd    r2, r5, [lr], #8
    add     r12, r12, #4
    ldr     r10, [sp, #64]
    smlad_next
.endm

    .balign 4
    .global firmware_smlad_step
    .type firmware_smlad_step, %function
    .thumb_func
// r0 plan, r1 stream, r2 input, r3 state: cells, then hidden states
firmware_smlad_step:
    push    {r4-r11, lr}
    sub     sp, sp, #372
    add     r12, r3, #256
    strd    r3, r12, [sp, #48]
    ldm     r0!, {r4-r7}
    add     r4, r3, r4, lsl #2
    str     r4, [sp, #64]
    add     lr, sp, #16
    ldm     r0!, {r4, r8-r10}
    stm     lr!, {r4, r8-r10}
    ldm     r0!, {r4, r8-r10}
    stm     lr!, {r4, r8-r10}
    ldrd    r4, r8, [r0]
    strd    r4, r8, [sp, #56]
    mov     r0, r1
    add     lr, sp, #68
    smlad_copy_samples r2, r5, r6
    mvn     r6, #127
    smlad_copy_samples r12, r7, r6

    .thumb_func
firmware_smlad_unit:
    add     r1, sp, #68
    ldm     r1!, {r2-r7}
    ldr     pc, [sp, #16]

// Two columns as pairs; 6 instructions of 4 bytes.
firmware_smlad_pairs:
    .rept 4
    ldm.w   r0!, {r8-r11}
    ldr.w   r12, [r1], #4
    smlad   r2, r8, r12, r2
    smlad   r3, r9, r12, r3
    smlad   r5, r10, r12, r5
    smlad   r6, r11, r12, r6
    .endr
firmware_smlad_pairs_end:
    .global firmware_smlad_after_pairs
    .type firmware_smlad_after_pairs, %function
    .thumb_func
firmware_smlad_after_pairs:
    stm     sp, {r2, r3, r5, r6}
    ldm     r1!, {r2-r7}
    ldr     pc, [sp, #20]

firmware_smlad_bytes:
    .rept 16
    smlad_four_columns
    .endr
firmware_smlad_bytes_end:
    .global firmware_smlad_after_bytes
    .type firmware_smlad_after_bytes, %function
    .thumb_func
firmware_smlad_after_bytes:
    smlad_separate r2, r3, r4
    smlad_separate r5, r6, r7
    stm     sp, {r2, r3, r5, r6}
    ldm     r1!, {r2-r7}
    ldr     pc, [sp, #20]

firmware_smlad_recurrent:
    .rept 16
    smlad_four_columns
    .endr
firmware_smlad_recurrent_end:
    .global firmware_smlad_after_recurrent
    .type firmware_smlad_after_recurrent, %function
    .thumb_func
firmware_smlad_after_recurrent:
    smlad_separate r2, r3, r4
    smlad_separate r5, r6, r7
    ldr     pc, [sp, #24]

    .global firmware_smlad_tanh
    .type firmware_smlad_tanh, %function
    .thumb_func
firmware_smlad_tanh:
    smlad_gates
    smlad_curve r7, r4, r7, 20, 11
    asr     r7, r7, r6
    smlad_cell
    asr     r7, r8, r10
    smlad_curve r7, r4, r7, 20, 11
    smlad_hidden

    .global firmware_smlad_relu
    .type firmware_smlad_relu, %function
    .thumb_func
firmware_smlad_relu:
    smlad_gates
    bic     r7, r7, r7, asr #31
    qadd    r7, r7, r4
    sub     r7, r7, r4
    lsl     r7, r7, r10
    smlad_cell
    bic     r7, r8, r8, asr #31
    smlad_hidden

    .global firmware_smlad_hard
    .type firmware_smlad_hard, %function
    .thumb_func
firmware_smlad_hard:
    smlad_gates
    ssat    r7, #17, r7
    lsl     r7, r7, r10
    smlad_cell
    qadd    r7, r8, r4
    sub     r7, r7, r4
    qsub    r7, r7, r4
    add     r7, r7, r4
    lsl     r7, r7, r6
    smlad_hidden

    .global firmware_smlad_gru_tanh
    .type firmware_smlad_gru_tanh, %function
    .thumb_func
firmware_smlad_gru_tanh:
    smlad_gru_gates
    smlad_curve r7, r4, r7, 20, 11
    asr     r7, r7, r6
    smlad_cell
    smlad_gru_hidden

    .global firmware_smlad_gru_relu
    .type firmware_smlad_gru_relu, %function
    .thumb_func
firmware_smlad_gru_relu:
    smlad_gru_gates
    bic     r7, r7, r7, asr #31
    qadd    r7, r7, r4
    sub     r7, r7, r4
    lsl     r7, r7, r10
    smlad_cell
    smlad_gru_hidden

    .global firmware_smlad_gru_hard
    .type firmware_smlad_gru_hard, %function
    .thumb_func
firmware_smlad_gru_hard:
    smlad_gru_gates
    ssat    r7, #17, r7
    lsl     r7, r7, r10
    smlad_cell
    smlad_gru_hidden

    .global firmware_smlad_dense_tanh
    .type firmware_smlad_dense_tanh, %function
    .thumb_func
firmware_smlad_dense_tanh:
    smlad_dense tanh

    .global firmware_smlad_dense_relu
    .type firmware_smlad_dense_relu, %function
    .thumb_func
firmware_smlad_dense_relu:
    smlad_dense relu

    .global firmware_smlad_dense_hard
    .type firmware_smlad_dense_hard, %function
    .thumb_func
firmware_smlad_dense_hard:
    smlad_dense hard

firmware_smlad_end:
    add     sp, sp, #372
    pop     {r4-r11, pc}

// Jumps into the three runs of columns count on these lengths: no bytes follow where they are right, and the assembler stops where one is
// longer or shorter.
.macro smlad_is_exactly begin, end, bytes
    .space  (\end - \begin) - \bytes
    .space  \bytes - (\end - \begin)
.endm
    smlad_is_exactly firmware_smlad_pairs, firmware_smlad_pairs_end, 4 * 24
    smlad_is_exactly firmware_smlad_bytes, firmware_smlad_bytes_end, 16 * 56
    smlad_is_exactly firmware_smlad_recurrent, firmware_smlad_recurrent_end, 16 * 56
    .size firmware_smlad_step, . - firmware_smlad_step
"#,
    options(raw)
);

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

/// Where segment 0 lies: the index of a table is signed.
fn middle(table: &'static Table) -> usize {
    table.as_ptr().wrapping_add(SEGMENTS / 2).expose_provenance()
}

/// [`SIGMOID`] for [`low_half`].
static SIGMOID_LOW_HALF: Table = low_half(&SIGMOID, SIGMOID_STEP_BITS);
/// [`TANH`] for [`low_half`].
static TANH_LOW_HALF: Table = low_half(&TANH, TANH_STEP_BITS);

/// The table for `SMLAWB`, which multiplies the slope with the argument's whole low half word, taken as a signed number: that holds,
/// above the rest of `step_bits` bits, the lowest bits of the segment's index. What they add is a multiple of the slope that each
/// segment's base gives back, exactly, since slopes are multiples of `2^(16 - step_bits)`.
#[expect(clippy::indexing_slicing, reason = "runs in the compiler, where an index out of bounds is an error of the build")]
const fn low_half(table: &Table, step_bits: u8) -> Table {
    let mut entries = *table;
    let index_bits = 16 - step_bits;
    let (mut index, mut number) = (0, 0i32);
    while index < SEGMENTS {
        let [base, slope] = entries[index];
        let low = number & ((1 << index_bits) - 1);
        let signed = if low >= 1 << (index_bits - 1) { low - (1 << index_bits) } else { low };
        entries[index] = [base.wrapping_sub((slope >> index_bits).wrapping_mul(signed)), slope];
        index += 1;
        number += 1;
    }
    entries
}
