//! How a layer's weights lie in the fast kernel's stream: its dimensions and the words that they take.

/// What is added to the weight in the low byte.
pub(super) const BYTE_OFFSET: i32 = 128;
/// Most columns that are kept as pairs: they cost fewer instructions and twice the memory of bytes.
pub(super) const MAX_PAIR_COLUMNS: usize = 8;
/// Words of a unit behind its matrices.
pub(super) const ROW_WORDS: usize = 4 * 4;

/// Dimensions of a layer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Shape {
    /// Width of the input.
    pub(super) inputs: usize,
    /// Hidden units.
    pub(super) units: usize,
}

impl Shape {
    /// Whether the input matrix is kept as pairs.
    pub(super) const fn has_pairs(self) -> bool {
        self.inputs <= MAX_PAIR_COLUMNS
    }

    /// Words of a unit's input columns.
    pub(super) const fn input_words(self) -> usize {
        if self.has_pairs() { 4 * self.inputs.div_ceil(2) } else { byte_words(self.inputs) }
    }

    /// Words of a unit's recurrent columns.
    pub(super) const fn recurrent_words(self) -> usize {
        byte_words(self.units)
    }

    /// Words of a unit.
    pub(super) const fn unit_words(self) -> usize {
        self.input_words() + self.recurrent_words() + ROW_WORDS
    }

    /// Words of the layer.
    pub(super) const fn words(self) -> usize {
        self.units * self.unit_words()
    }
}

/// Words of a unit's columns as bytes.
pub(super) const fn byte_words(columns: usize) -> usize {
    4 * columns.div_ceil(4)
}
