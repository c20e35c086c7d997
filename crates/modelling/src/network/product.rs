//! Matrix products on slices: a checked front to the `gemm` crate.

use gemm::Parallelism;

/// A dense matrix inside a slice: element `(row, column)` lies at `row * row_stride + column * column_stride`.
#[derive(Clone, Copy)]
pub struct Matrix<'a> {
    /// The elements.
    pub data: &'a [f32],
    /// Distance between rows.
    pub row_stride: usize,
    /// Distance between columns.
    pub column_stride: usize,
}

impl<'a> Matrix<'a> {
    /// Rows one after another, `stride` apart.
    pub fn rows(data: &'a [f32], stride: usize) -> Self {
        Self { data, row_stride: stride, column_stride: 1 }
    }

    /// The transpose.
    pub fn transposed(self) -> Self {
        Self { data: self.data, row_stride: self.column_stride, column_stride: self.row_stride }
    }

    fn covers(&self, rows: usize, columns: usize) -> bool {
        (rows - 1) * self.row_stride + (columns - 1) * self.column_stride < self.data.len()
    }
}

/// `target[rows x columns] = keep * target + left[rows x depth] * right[depth x columns]`, with `keep` 0 or 1; the target's rows are
/// `target_stride` apart.
///
/// # Panics
/// When a slice is too short for its shape.
pub fn multiply(
    (rows, columns, depth): (usize, usize, usize),
    left: Matrix<'_>,
    right: Matrix<'_>,
    target: &mut [f32],
    target_stride: usize,
    keep: bool,
) {
    if rows == 0 || columns == 0 || depth == 0 {
        return;
    }
    assert!(left.covers(rows, depth) && right.covers(depth, columns), "matrix product outside its operands");
    assert!(columns <= target_stride && (rows - 1) * target_stride + columns <= target.len(), "matrix product outside its target");
    let signed = |stride: usize| isize::try_from(stride).expect("a stride within a slice fits");
    // SAFETY: the assertions above keep every element that the shapes and strides address inside the three slices; `target` is
    // exclusively borrowed and its rows do not overlap.
    unsafe {
        gemm::gemm(
            rows,
            columns,
            depth,
            target.as_mut_ptr(),
            1,
            signed(target_stride),
            keep,
            left.data.as_ptr(),
            signed(left.column_stride),
            signed(left.row_stride),
            right.data.as_ptr(),
            signed(right.column_stride),
            signed(right.row_stride),
            1.0,
            1.0,
            false,
            false,
            false,
            Parallelism::None,
        );
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn products_match_a_plain_triple_loop_for_odd_shapes_and_transposes() {
        for (rows, columns, depth) in [(1, 1, 1), (8, 256, 64), (3, 17, 5), (9, 33, 100), (64, 2, 50)] {
            let value = |index: usize| ((index * 2_654_435_761) % 1000) as f32 / 500.0 - 1.0;
            let left: Vec<f32> = (0..rows * depth).map(value).collect();
            let right: Vec<f32> = (0..columns * depth).map(|index| value(index + 7)).collect();
            let stride = columns + 3;
            let start: Vec<f32> = (0..rows * stride).map(|index| value(index + 99)).collect();
            for keep in [false, true] {
                let mut target = start.clone();
                // The right operand is stored by columns here: a transpose.
                let right_view = Matrix::rows(&right, depth).transposed();
                multiply((rows, columns, depth), Matrix::rows(&left, depth), right_view, &mut target, stride, keep);
                for row in 0..rows {
                    for column in 0..stride {
                        let index = row * stride + column;
                        let mut expected = if keep || column >= columns { start[index] } else { 0.0 };
                        if column < columns {
                            expected += (0..depth).map(|k| left[row * depth + k] * right[column * depth + k]).sum::<f32>();
                        }
                        // Rounding of `depth` sums of terms up to one.
                        let tolerance = 1e-6 * (depth as f32 + 1.0);
                        assert!((target[index] - expected).abs() <= tolerance, "{rows}x{columns}x{depth} at {row},{column}");
                    }
                }
            }
        }
    }
}
