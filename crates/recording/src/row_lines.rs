//! On which line of its file each row stands, kept as the few places where lines are passed over.

/// The line of every row.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct RowLines {
    rows: usize,
    /// First row of a stretch of rows on lines that follow each other, and its line.
    stretches: Vec<(usize, u64)>,
}

impl RowLines {
    /// Adds the line of the next row.
    pub(super) fn push(&mut self, line: u64) {
        let follows = self.stretches.last().is_some_and(|&(row, first)| line == first + (self.rows - row) as u64);
        if !follows {
            self.stretches.push((self.rows, line));
        }
        self.rows += 1;
    }

    /// Adds so many rows on lines that follow each other, from this one on.
    pub(super) fn extend(&mut self, line: u64, rows: usize) {
        if rows > 0 {
            self.push(line);
            self.rows += rows - 1;
        }
    }

    /// Number of rows.
    pub(super) fn len(&self) -> usize {
        self.rows
    }

    /// The line of a row; 0 when there is no such row.
    pub(super) fn line(&self, row: usize) -> u64 {
        let after = self.stretches.partition_point(|&(first, _)| first <= row);
        let stretch = after.checked_sub(1).and_then(|before| self.stretches.get(before));
        stretch.filter(|_| row < self.rows).map_or(0, |&(first, line)| line + (row - first) as u64)
    }
}

impl FromIterator<u64> for RowLines {
    fn from_iter<I: IntoIterator<Item = u64>>(lines: I) -> Self {
        let mut rows = Self::default();
        lines.into_iter().for_each(|line| rows.push(line));
        rows
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_row_keeps_its_line() {
        let lines = [2, 3, 4, 7, 8, 20, 19, 21];
        let rows: RowLines = lines.into_iter().collect();
        assert_eq!((0..lines.len()).map(|row| rows.line(row)).collect::<Vec<_>>(), lines);
        assert_eq!((rows.len(), rows.line(8)), (8, 0));
        assert_eq!((2..1_000_000).collect::<RowLines>().stretches.len(), 1);
        let mut many: RowLines = [2, 3].into_iter().collect();
        for (line, count) in [(4, 0), (4, 3), (9, 2), (11, 1)] {
            many.extend(line, count);
        }
        assert_eq!(many, [2, 3, 4, 5, 6, 9, 10, 11].into_iter().collect());
    }
}
