//! The linear part of a model for one recording: a column for each weight, several columns side by side.
//!
//! Rows lie one after the other, a row for each sample, so that whatever runs along the samples with a memory of its own (an operator,
//! a filter, a sum of products) does so for many columns at once and none waits for its own last step. What is done to one column does
//! not depend on how many a processor takes at a time: results are the same on all of them.
//!
//! The columns of the operators are apart from those that effects add: the former stay as they are while the latter are searched.

use pulp::{Arch, Simd, WithSimd};

/// Columns side by side: rows are as long as a multiple of this.
pub const SIDE: usize = 8;

/// Some columns, row after row.
#[derive(Clone, Debug, Default)]
pub struct Rows {
    /// Values, row after row.
    pub values: Vec<f64>,
    /// Length of a row, a multiple of [`SIDE`]; what no column needs is zero or repeats another column.
    pub stride: usize,
    /// Columns in use, the first of each row.
    pub count: usize,
}

impl Rows {
    /// Makes room for so many samples and columns; the values are still to be written.
    pub fn shape(&mut self, samples: usize, count: usize, stride: usize) {
        (self.count, self.stride) = (count, stride);
        self.values.resize(samples * stride, 0.0);
    }

    /// Adds a column with a value per sample.
    fn push(&mut self, samples: usize, mut value: impl FnMut(usize) -> f64) {
        if self.stride == 0 {
            self.shape(samples, 0, SIDE);
        } else if self.count == self.stride {
            let stride = self.stride + SIDE;
            let mut values = vec![0.0; samples * stride];
            for (wide, narrow) in values.chunks_exact_mut(stride).zip(self.values.chunks_exact(self.stride.max(1))) {
                wide[..self.count].copy_from_slice(&narrow[..self.count]);
            }
            (self.values, self.stride) = (values, stride);
        }
        for (sample, row) in self.values.chunks_exact_mut(self.stride).enumerate() {
            row[self.count] = value(sample);
        }
        self.count += 1;
    }
}

/// Replaces columns by what a filter makes of them.
struct Filtering<'a, const STATES: usize, F> {
    rows: &'a mut Rows,
    filter: &'a F,
}

impl<const STATES: usize, F: Filter<STATES>> WithSimd for Filtering<'_, STATES, F> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _simd: S) {
        let Rows { values, stride, count } = self.rows;
        for from in (0..*count).step_by(SIDE) {
            let Some(first) = values.get(from..from + SIDE) else { return };
            let mut states = [[0.0; SIDE]; STATES];
            for (lane, &value) in first.iter().enumerate() {
                for (state, begun) in states.iter_mut().zip(self.filter.begin(value)) {
                    state[lane] = begun;
                }
            }
            for row in values.chunks_exact_mut(*stride) {
                let mut values = [0.0; SIDE];
                values.copy_from_slice(&row[from..from + SIDE]);
                for (lane, value) in values.iter_mut().enumerate() {
                    let mut own: [f64; STATES] = std::array::from_fn(|state| states[state][lane]);
                    *value = self.filter.step(&mut own, *value);
                    (0..STATES).for_each(|state| states[state][lane] = own[state]);
                }
                row[from..from + SIDE].copy_from_slice(&values);
            }
        }
    }
}

/// Adds columns, each by its weight, to a sum.
struct Weighing<'a> {
    rows: &'a Rows,
    weights: Vec<f64>,
    sum: &'a mut [f64],
}

impl WithSimd for Weighing<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(mut self, _simd: S) {
        self.weights.resize(self.rows.stride, 0.0);
        for (sum, row) in self.sum.iter_mut().zip(self.rows.values.chunks_exact(self.rows.stride)) {
            let mut lanes = [0.0; SIDE];
            for (values, weights) in row.chunks_exact(SIDE).zip(self.weights.chunks_exact(SIDE)) {
                for lane in 0..SIDE {
                    lanes[lane] += values[lane] * weights[lane];
                }
            }
            *sum += ((lanes[0] + lanes[4]) + (lanes[2] + lanes[6])) + ((lanes[1] + lanes[5]) + (lanes[3] + lanes[7]));
        }
    }
}

/// A filter with a memory of `STATES` numbers, for columns side by side or a path alone.
pub trait Filter<const STATES: usize> {
    /// Its memory when it has settled at the first value.
    fn begin(&self, first: f64) -> [f64; STATES];
    /// What it makes of the next value.
    fn step(&self, memory: &mut [f64; STATES], value: f64) -> f64;

    /// Sends a signal through.
    fn run(&self, signal: &mut [f64]) {
        let mut memory = self.begin(signal[0]);
        for value in signal {
            *value = self.step(&mut memory, *value);
        }
    }
}

/// Where the constant lies among the operators' columns.
const CONSTANT: usize = 0;

/// Where the measured output lies among them.
pub const OUTPUT: usize = 1;

/// Columns before the first operator.
pub const AHEAD: usize = 2;

/// Where the column of a weight lies among the operators' columns.
pub fn place(weight: usize) -> usize {
    if weight == 0 { CONSTANT } else { weight - 1 + AHEAD }
}

/// Columns of the linear part for one recording.
///
/// In the order of the weights: the constant, the operators, what effects add.
#[derive(Debug, Default)]
pub struct Columns {
    /// The constant, the measured output and the operators.
    operators: Rows,
    /// The same behind filters, where there are any.
    filtered: Rows,
    is_filtered: bool,
    /// What effects add.
    added: Rows,
    /// Samples of a column.
    pub samples: usize,
    /// Whether each column's weight may be negative.
    pub free: Vec<bool>,
    /// The input as the muscle is told it, by everything that the model puts before it.
    pub command: Vec<f64>,
    /// What the sensor's effects add to the output by their last weights.
    pub at_sensor: Vec<f64>,
    /// The operators and nothing else, where a valve's own pressure may be led through them.
    pub bank: Option<Bank>,
}

/// Play operators with their weights.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Bank {
    /// Their sum where all of them are zero.
    pub constant: f64,
    /// Thresholds and weights.
    pub operators: Vec<(f64, f64)>,
    /// Turning points before the recording, oldest first.
    pub history: Vec<f64>,
}

impl Columns {
    /// No columns yet, of so many samples.
    #[must_use]
    pub fn of(samples: usize) -> Self {
        Self { samples, ..Self::default() }
    }

    /// Begins anew with so many operators, which `write` puts into the columns behind the first `AHEAD`, as many at a time as it likes:
    /// the constant and the measured output come before them.
    pub fn begin(&mut self, operators: usize, output: &[f64], write: impl FnOnce(&mut Rows)) {
        self.samples = output.len();
        let count = AHEAD + operators;
        let stride = count.next_multiple_of(SIDE);
        self.operators.shape(self.samples, count, stride);
        write(&mut self.operators);
        for (row, output) in self.operators.values.chunks_exact_mut(stride).zip(output) {
            row[CONSTANT] = 1.0;
            row[OUTPUT] = *output;
            row[count..].fill(0.0);
        }
        self.free.clear();
        self.free.push(true);
        self.free.resize(1 + operators, false);
        self.forget_added();
    }

    /// As if new, but for the memory.
    pub fn clear(&mut self) {
        let Self { operators, filtered, is_filtered, added, samples, free, command, at_sensor, bank } = self;
        for rows in [operators, filtered, added] {
            (rows.count, rows.stride) = (0, 0);
        }
        (*is_filtered, *samples, *bank) = (false, 0, None);
        free.clear();
        command.clear();
        at_sensor.clear();
    }

    /// Begins anew behind the operators.
    pub fn forget_added(&mut self) {
        self.is_filtered = false;
        self.added.shape(0, 0, 0);
        self.free.truncate(self.of_operators());
    }

    /// Number of weights of the constant and the operators.
    fn of_operators(&self) -> usize {
        (self.operators.count + 1).saturating_sub(AHEAD)
    }

    /// The constant, the measured output and the operators, behind filters if there are any; and whether there are.
    #[must_use]
    pub fn operators(&self) -> (&Rows, bool) {
        (if self.is_filtered { &self.filtered } else { &self.operators }, self.is_filtered)
    }

    /// What effects add.
    #[must_use]
    pub fn added(&self) -> &Rows {
        &self.added
    }

    /// Values of the column of this weight.
    #[must_use]
    pub fn column(&self, weight: usize) -> Vec<f64> {
        let (rows, at) = match weight.checked_sub(self.of_operators()) {
            Some(at) => (&self.added, at),
            None => (self.operators().0, place(weight)),
        };
        rows.values.chunks_exact(rows.stride).map(|row| row[at]).collect()
    }

    /// Adds a column made from a value per sample.
    pub fn push(&mut self, free: bool, value: impl FnMut(usize) -> f64) {
        self.added.push(self.samples, value);
        self.free.push(free);
    }

    /// Makes a copy of the operators to be changed, where there is none yet.
    fn set_apart(&mut self) {
        if !self.is_filtered {
            self.filtered.clone_from(&self.operators);
            self.is_filtered = true;
        }
    }

    /// Replaces every column by what `filter` makes of it.
    pub fn filter<const STATES: usize>(&mut self, filter: &impl Filter<STATES>) {
        self.set_apart();
        for rows in [&mut self.filtered, &mut self.added] {
            Arch::new().dispatch(Filtering { rows, filter });
        }
        // The measured output stands beside the columns and is none.
        let stride = self.operators.stride.max(1);
        for (row, own) in self.filtered.values.chunks_exact_mut(stride).zip(self.operators.values.chunks_exact(stride)) {
            row[OUTPUT] = own[OUTPUT];
        }
    }

    /// Replaces the operators by those that `write` puts into the columns behind the first `AHEAD`, as in [`Self::begin`].
    pub fn lead_anew(&mut self, write: impl FnOnce(&mut Rows)) {
        self.filtered.clone_from(&self.operators);
        self.is_filtered = true;
        write(&mut self.filtered);
        let Rows { stride, count, .. } = self.operators;
        for (row, own) in self.filtered.values.chunks_exact_mut(stride).zip(self.operators.values.chunks_exact(stride)) {
            row[CONSTANT] = own[CONSTANT];
            row[OUTPUT] = own[OUTPUT];
            row[count..].fill(0.0);
        }
    }

    /// Puts other values in the place of the measured output, and multiplies each sample by its share.
    pub fn tell(&mut self, value_and_share: impl Fn(usize) -> (f64, f64)) {
        self.set_apart();
        let own = self.filtered.stride.max(1);
        for (sample, row) in self.filtered.values.chunks_exact_mut(own).enumerate() {
            row[OUTPUT] = value_and_share(sample).0;
        }
        for rows in [&mut self.filtered, &mut self.added] {
            for (sample, row) in rows.values.chunks_exact_mut(rows.stride.max(1)).enumerate() {
                let (_, share) = value_and_share(sample);
                row.iter_mut().for_each(|value| *value *= share);
            }
        }
    }

    /// Adds the columns from `first` on, each by its weight, to `sum`.
    pub fn weigh(&self, weights: &[f64], first: usize, sum: &mut [f64]) {
        let (operators, count) = (self.operators().0, self.of_operators());
        let (of_operators, of_added) = weights.split_at(count.min(weights.len()));
        if first < of_operators.len() {
            let mut weights = vec![0.0; operators.stride];
            (first..of_operators.len()).for_each(|weight| weights[place(weight)] = of_operators[weight]);
            Arch::new().dispatch(Weighing { rows: operators, weights, sum });
        }
        if of_added.iter().any(|weight| *weight != 0.0) {
            let mut weights = of_added.to_vec();
            let skipped = first.saturating_sub(count).min(weights.len());
            weights[..skipped].fill(0.0);
            Arch::new().dispatch(Weighing { rows: &self.added, weights, sum });
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Ten operators with values that tell column and sample, and two columns more.
    fn columns() -> Columns {
        let output: Vec<f64> = (0..5).map(|sample| 1000.0 + f64::from(sample)).collect();
        let mut columns = Columns::default();
        columns.begin(10, &output, |rows| {
            for (sample, row) in rows.values.chunks_exact_mut(rows.stride).enumerate() {
                (0..10).for_each(|operator| row[AHEAD + operator] = (10 * sample + operator) as f64);
            }
        });
        columns.push(true, |sample| -(sample as f64));
        columns.push(false, |sample| 0.5 * sample as f64);
        columns
    }

    impl Columns {
        fn clone_of_all(&self) -> Vec<Vec<f64>> {
            (0..self.free.len()).map(|weight| self.column(weight)).collect()
        }
    }

    /// Half of the value and half of the last one.
    struct Mean;

    impl Filter<1> for Mean {
        fn begin(&self, first: f64) -> [f64; 1] {
            [first]
        }
        fn step(&self, [last]: &mut [f64; 1], value: f64) -> f64 {
            0.5 * (std::mem::replace(last, value) + value)
        }
    }

    #[test]
    fn columns_are_counted_as_their_weights_are() {
        let columns = columns();
        assert_eq!(columns.column(0), [1.0; 5]);
        assert_eq!(columns.column(1), [0.0, 10.0, 20.0, 30.0, 40.0]);
        assert_eq!(columns.column(10), [9.0, 19.0, 29.0, 39.0, 49.0]);
        assert_eq!(columns.column(12), [0.0, 0.5, 1.0, 1.5, 2.0]);
        assert_eq!(columns.free[..2], [true, false]);
        assert_eq!(columns.free[10..], [false, true, false]);
    }

    #[test]
    fn the_sum_of_the_columns_begins_with_the_first_that_is_asked_for() {
        let columns = columns();
        let weights: Vec<f64> = (0..13).map(|weight| f64::from(weight * weight % 7)).collect();
        for first in [0, 1, 11, 12] {
            let mut sum = vec![3.0; 5];
            columns.weigh(&weights, first, &mut sum);
            for (sample, sum) in sum.into_iter().enumerate() {
                let wanted: f64 = 3.0 + (first..13).map(|weight| weights[weight] * columns.column(weight)[sample]).sum::<f64>();
                assert!((sum - wanted).abs() < 1e-9, "from {first} on: {sum} instead of {wanted}");
            }
        }
    }

    #[test]
    fn operators_led_anew_leave_the_constant_the_measured_output_and_what_effects_add() {
        let mut columns = columns();
        let before = columns.clone_of_all();
        columns.lead_anew(|rows| rows.values.fill(7.0));
        let after = columns.clone_of_all();
        assert_eq!((&after[0], &after[11..]), (&before[0], &before[11..]));
        assert!(after[1..11].iter().flatten().all(|value| *value == 7.0));
        let (rows, _) = columns.operators();
        assert!(rows.values.chunks_exact(rows.stride).zip(1000..).all(|(row, output)| row[OUTPUT] == f64::from(output)));
        assert!(rows.values.chunks_exact(rows.stride).all(|row| row[12..].iter().all(|value| *value == 0.0)));
    }

    #[test]
    fn what_is_told_takes_the_place_of_the_measured_output_and_every_sample_counts_by_its_share() {
        let mut columns = columns();
        let before = columns.clone_of_all();
        let share = |sample: usize| 0.5 + 0.1 * sample as f64;
        columns.tell(|sample| (3.0 + sample as f64, share(sample)));
        for (weight, before) in before.iter().enumerate() {
            for (sample, (got, before)) in columns.column(weight).into_iter().zip(before).enumerate() {
                assert!((got - share(sample) * before).abs() < 1e-12, "column {weight}, sample {sample}");
            }
        }
        let (rows, is_filtered) = columns.operators();
        assert!(is_filtered, "the operators themselves stay");
        for (sample, row) in rows.values.chunks_exact(rows.stride).enumerate() {
            assert!((row[OUTPUT] - share(sample) * (3.0 + sample as f64)).abs() < 1e-12);
        }
        columns.forget_added();
        assert_eq!(columns.column(1), before[1]);
    }

    #[test]
    fn a_filter_changes_every_column_but_the_measured_output_until_the_operators_are_wanted_again() {
        let mut columns = columns();
        let before: Vec<Vec<f64>> = (0..13).map(|weight| columns.column(weight)).collect();
        columns.filter(&Mean);
        for (weight, before) in before.iter().enumerate() {
            let mut wanted = before.clone();
            Mean.run(&mut wanted);
            assert_eq!(columns.column(weight), wanted, "column {weight}");
        }
        let (rows, is_filtered) = columns.operators();
        assert!(is_filtered && rows.values[rows.stride + OUTPUT] == 1001.0);
        columns.forget_added();
        assert_eq!(columns.column(1), before[1]);
        assert_eq!(columns.free.len(), 11);
    }
}
