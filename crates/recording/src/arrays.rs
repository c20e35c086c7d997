//! Named columns of numbers, as binary files hold them.

use super::Note;

/// What a binary file holds, before anybody asked for a column.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Arrays {
    pub(super) names: Vec<String>,
    /// One list of values for each name; their lengths may differ.
    pub(super) columns: Vec<Vec<f64>>,
    pub(super) notes: Vec<Note>,
}

impl Arrays {
    /// Adds an array of `rows` rows and `width` columns, whose element in row `r` and column `c` is `at(r, c)`. One column, or one row,
    /// keeps its name; several are called `name.1`, `name.2` and so on.
    pub(super) fn push(&mut self, name: &str, rows: usize, width: usize, at: impl Fn(usize, usize) -> f64) {
        if rows == 1 || width == 1 {
            self.names.push(name.to_owned());
            self.columns.push((0..rows * width).map(|index| if width == 1 { at(index, 0) } else { at(0, index) }).collect());
            return;
        }
        for column in 0..width {
            self.names.push(format!("{name}.{}", column + 1));
            self.columns.push((0..rows).map(|row| at(row, column)).collect());
        }
    }
}
