//! How a layer's weights lie in the fast kernel's stream: its dimensions and the words that they take.

use model_export::schema::Cell;

/// What is added to the weight in the low byte.
pub(super) const BYTE_OFFSET: i32 = 128;
/// Most columns that are kept as pairs: they cost fewer instructions and twice the memory of bytes.
pub(super) const MAX_PAIR_COLUMNS: usize = 8;
/// Words of a group behind its matrices.
pub(super) const ROW_WORDS: usize = 4 * 4;

/// Dimensions of a layer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Shape {
    /// What the layer computes.
    pub(super) cell: Cell,
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

    /// Groups of rows.
    pub(super) const fn groups(self) -> usize {
        match self.cell {
            Cell::Lstm | Cell::Gru => self.units,
            Cell::Dense(_) => self.units.div_ceil(4),
        }
    }

    /// Words of a group's input columns.
    pub(super) const fn input_words(self) -> usize {
        if self.has_pairs() { 4 * self.inputs.div_ceil(2) } else { byte_words(self.inputs) }
    }

    /// Words of a group's recurrent columns.
    pub(super) const fn recurrent_words(self) -> usize {
        match self.cell {
            Cell::Lstm | Cell::Gru => byte_words(self.units),
            Cell::Dense(_) => 0,
        }
    }

    /// Words of a group.
    pub(super) const fn group_words(self) -> usize {
        self.input_words() + self.recurrent_words() + ROW_WORDS
    }

    /// Words of the layer.
    pub(super) const fn words(self) -> usize {
        self.groups() * self.group_words()
    }
}

/// Words of a group's columns as bytes.
pub(super) const fn byte_words(columns: usize) -> usize {
    4 * columns.div_ceil(4)
}
