//! Matrices inside the flat vector of parameters.

use std::ops::Range;

/// A matrix inside the flat vector of parameters: one row after another.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Block {
    /// Index of the first element.
    pub start: usize,
    /// Number of rows.
    pub rows: usize,
    /// Elements of a row.
    pub columns: usize,
}

impl Block {
    /// A contiguous run of parameters that is no matrix.
    pub(super) fn run(start: usize, end: usize) -> Self {
        Self { start, rows: 1, columns: end - start }
    }

    /// Its place in the flat vector.
    #[must_use]
    pub fn range(&self) -> Range<usize> {
        self.start..self.start + self.rows * self.columns
    }
}

/// The blocks' elements, one block after another.
#[must_use]
pub fn gather(blocks: &[Block], flat: &[f32]) -> Vec<f32> {
    blocks.iter().flat_map(|block| &flat[block.range()]).copied().collect()
}

/// Puts what [`gather`] took back into its places.
pub fn scatter(blocks: &[Block], values: &[f32], flat: &mut [f32]) {
    let mut rest = values;
    for block in blocks {
        let target = &mut flat[block.range()];
        let (values, after) = rest.split_at(target.len());
        target.copy_from_slice(values);
        rest = after;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_was_gathered_is_put_back_into_its_places() {
        let blocks = [Block { start: 4, rows: 2, columns: 2 }, Block { start: 1, rows: 1, columns: 2 }];
        let flat: Vec<f32> = (0..8_u8).map(f32::from).collect();
        assert_eq!(gather(&blocks, &flat), [4.0, 5.0, 6.0, 7.0, 1.0, 2.0]);
        let mut target = [9.0; 8];
        scatter(&blocks, &gather(&blocks, &flat), &mut target);
        assert_eq!(target, [9.0, 1.0, 2.0, 9.0, 4.0, 5.0, 6.0, 7.0]);
    }
}
