//! Time stamps that are wrong while their neighbours are right: repeated ones, glitches, and rows that changed places.
//!
//! The longest row of stamps that never decreases is taken as right. What lies off it must be little, come in short runs, and come back to
//! it; else the time really runs backwards and nothing is repaired.

use super::{Note, Subject, clock};

/// Most rows of one run of wrong stamps.
const LONGEST_RUN: usize = 20;
/// One row in so many may have a wrong stamp.
const ONE_IN: usize = 20;

/// How often something was repaired, and the first row it happened at.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Count {
    pub(super) rows: usize,
    pub(super) first: usize,
}

impl Count {
    fn add(&mut self, row: usize) {
        self.first = if self.rows == 0 { row } else { self.first.min(row) };
        self.rows += 1;
    }
}

/// What became of the stamps.
pub(super) struct Repaired {
    /// Strictly increasing times, one for each row of `order`.
    pub(super) time_s: Vec<f64>,
    /// The rows that are kept, in the order in which they are to stand.
    pub(super) order: Vec<usize>,
    pub(super) repeated: Count,
    pub(super) doubled: Count,
    pub(super) glitches: Count,
    pub(super) swapped: Count,
}

/// Makes stamps strictly increasing; `same_row` tells whether two rows hold the same values.
///
/// # Errors
/// The row at which the time runs backwards or stands still for good.
pub(super) fn repair(stamps_s: &[f64], same_row: impl Fn(usize, usize) -> bool) -> Result<Repaired, usize> {
    let none = Count::default();
    let mut result = Repaired {
        time_s: stamps_s.to_vec(),
        order: (0..stamps_s.len()).collect(),
        repeated: none,
        doubled: none,
        glitches: none,
        swapped: none,
    };
    if stamps_s.windows(2).all(|pair| pair[0] < pair[1]) {
        return Ok(result);
    }
    let right = longest_ascent(stamps_s);
    let wrong = refuse_too_much(stamps_s, &right)?;
    let typical_s = typical_step_s(stamps_s, &right);
    place(&mut result, stamps_s, &right, &wrong, typical_s);
    spread(&mut result, typical_s, same_row)?;
    Ok(result)
}

/// The indices of a longest row of values that never decreases.
fn longest_ascent(values: &[f64]) -> Vec<usize> {
    let mut ends: Vec<usize> = Vec::new();
    let mut before: Vec<Option<usize>> = vec![None; values.len()];
    for (index, value) in values.iter().enumerate() {
        let length = ends.partition_point(|&end| values[end] <= *value);
        before[index] = length.checked_sub(1).map(|last| ends[last]);
        if length == ends.len() {
            ends.push(index);
        } else {
            ends[length] = index;
        }
    }
    let mut ascent = Vec::with_capacity(ends.len());
    let mut next = ends.last().copied();
    while let Some(index) = next {
        ascent.push(index);
        next = before[index];
    }
    ascent.reverse();
    // Either of two first rows may be the wrong one: the one that lies nearer to the third is right.
    if let [1, 2, ..] = ascent[..]
        && (values[1]..=values[2]).contains(&values[0])
    {
        ascent[0] = 0;
    }
    ascent
}

/// The wrong rows as runs between right ones, or the row at which the time runs backwards for good.
fn refuse_too_much(stamps_s: &[f64], right: &[usize]) -> Result<Vec<std::ops::Range<usize>>, usize> {
    let mut runs = Vec::new();
    for pair in right.windows(2).filter(|pair| pair[1] > pair[0] + 1) {
        runs.push(pair[0] + 1..pair[1]);
    }
    let wrong = stamps_s.len() - right.len();
    let comes_back = right.last().is_some_and(|&last| last + 1 == stamps_s.len());
    // One row before the first right one is the stale reading of a logger that starts.
    let stale = right.first().copied().unwrap_or(0);
    let few = wrong <= 2.max(stamps_s.len() / ONE_IN) && stamps_s.len() >= 4;
    if wrong > 0 && !(comes_back && stale <= 1 && few && runs.iter().all(|run| run.len() <= LONGEST_RUN)) {
        let back = |index: &usize| stamps_s[*index] - stamps_s[index - 1];
        let deepest = (1..stamps_s.len()).min_by(|one, other| back(one).total_cmp(&back(other)));
        return Err(deepest.unwrap_or(0));
    }
    if stale == 1 {
        runs.insert(0, 0..1);
    }
    Ok(runs)
}

/// The median step between right stamps that differ, by row.
fn typical_step_s(stamps_s: &[f64], right: &[usize]) -> f64 {
    let (mut steps, mut run) = (Vec::new(), 1usize);
    for pair in right.windows(2) {
        let step = stamps_s[pair[1]] - stamps_s[pair[0]];
        if step > 0.0 {
            // Repeated stamps share the step to the next one.
            steps.push(step / run as f64);
            run = 1;
        } else {
            run += 1;
        }
    }
    clock::quantile(steps, 0.5)
}

/// Gives every wrong row a time or a place: a stamp that fills a hole nearby belongs there, any other is made from its neighbours.
fn place(result: &mut Repaired, stamps_s: &[f64], right: &[usize], wrong: &[std::ops::Range<usize>], typical_s: f64) {
    let mut moved: Vec<(f64, usize)> = Vec::new();
    for run in wrong {
        for row in run.clone() {
            if fills_a_hole(stamps_s, right, row, typical_s) {
                result.swapped.add(row);
                moved.push((stamps_s[row], row));
                continue;
            }
            result.glitches.add(row);
            result.time_s[row] = if row == 0 {
                stamps_s[right[0]] - typical_s
            } else {
                let (from, to) = (run.start - 1, run.end);
                let share = (row - from) as f64 / (to - from) as f64;
                stamps_s[from] + share * (stamps_s[to] - stamps_s[from])
            };
        }
    }
    if !moved.is_empty() {
        let time_s = &result.time_s;
        result.order.sort_by(|&one, &other| time_s[one].total_cmp(&time_s[other]));
    }
    result.time_s = result.order.iter().map(|&row| result.time_s[row]).collect();
}

/// Whether the stamp of a wrong row lies in a hole of the right ones, no further away than a short run.
fn fills_a_hole(stamps_s: &[f64], right: &[usize], row: usize, typical_s: f64) -> bool {
    let after = right.partition_point(|&index| stamps_s[index] <= stamps_s[row]);
    let (Some(&high), Some(&low)) = (right.get(after), after.checked_sub(1).and_then(|before| right.get(before))) else { return false };
    let near = low.abs_diff(row) <= LONGEST_RUN && high.abs_diff(row) <= LONGEST_RUN;
    let (below_s, above_s) = (stamps_s[row] - stamps_s[low], stamps_s[high] - stamps_s[row]);
    near && below_s > 0.4 * typical_s && above_s > 0.4 * typical_s
}

/// Repeated stamps share the time to the next one; a row that stands twice with the same stamp and values stands once.
fn spread(result: &mut Repaired, typical_s: f64, same_row: impl Fn(usize, usize) -> bool) -> Result<(), usize> {
    let stamps_s = std::mem::take(&mut result.time_s);
    let order = std::mem::take(&mut result.order);
    let lengths: Vec<f64> = stamps_s.chunk_by(|one, other| one == other).map(|run| run.len() as f64).collect();
    let usual = clock::quantile(lengths, 0.5);
    let mut start = 0;
    while start < stamps_s.len() {
        let length = stamps_s[start..].iter().take_while(|stamp| **stamp == stamps_s[start]).count();
        let rows = &order[start..start + length];
        let next_s = stamps_s.get(start + length).copied();
        let step_s = next_s.map_or(typical_s, |next_s| (next_s - stamps_s[start]) / length as f64);
        let last_and_long = next_s.is_none() && length as f64 > 2.0_f64.max(2.0 * usual);
        if typical_s <= 0.0 || (length > 1 && last_and_long) {
            return Err(order[(start + 1).min(order.len() - 1)]);
        }
        let alike = length > 1 && rows.windows(2).all(|pair| same_row(pair[0], pair[1]));
        if alike && step_s * (length as f64) < 1.5 * typical_s && usual < 2.0 {
            rows[1..].iter().for_each(|&row| result.doubled.add(row));
            result.time_s.push(stamps_s[start]);
            result.order.push(rows[0]);
        } else {
            for (place, &row) in rows.iter().enumerate() {
                if place > 0 {
                    result.repeated.add(row);
                }
                result.time_s.push(stamps_s[start] + place as f64 * step_s);
                result.order.push(row);
            }
        }
        start += length;
    }
    Ok(())
}

impl Repaired {
    /// What was repaired, with counts and first lines; `lines` are those of the rows as read.
    pub(super) fn notes(&self, lines: &super::row_lines::RowLines) -> Vec<Note> {
        let said = [
            (self.repeated, "repeated time stamp(s) now share the time to the next one"),
            (self.doubled, "row(s) that stood twice now stand once"),
            (self.glitches, "time stamp(s) that jumped away and back were set from their neighbours"),
            (self.swapped, "row(s) that stood in the wrong order were put in the order of their times"),
        ];
        let found = said.into_iter().filter(|(count, _)| count.rows > 0);
        found
            .map(|(count, what)| {
                Note::counted(Subject::ClockRepaired, count.rows, lines.line(count.first), format!("{} {what}.", count.rows))
            })
            .collect()
    }
}
