//! The curves' tables as the assembly reads them.

use model_export::fixed::{SEGMENTS, SIGMOID, SIGMOID_STEP_BITS, TANH, TANH_STEP_BITS, Table};

/// Where segment 0 lies: the index of a table is signed.
pub(super) fn middle(table: &'static Table) -> usize {
    table.as_ptr().wrapping_add(SEGMENTS / 2).expose_provenance()
}

/// [`SIGMOID`] for [`low_half`].
pub(super) static SIGMOID_LOW_HALF: Table = low_half(&SIGMOID, SIGMOID_STEP_BITS);
/// [`TANH`] for [`low_half`].
pub(super) static TANH_LOW_HALF: Table = low_half(&TANH, TANH_STEP_BITS);

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
