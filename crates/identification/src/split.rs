//! Which recordings may enter a fit, which a choice, and which a figure: three types that only a [`Partition`] makes.
//!
//! A *unit* is a whole recording, or a block of one where there are fewer than three recordings. A *fold* is the units of one group
//! (a day, a load, an amplitude), or of several groups where there are many. *Outer* folds measure the error on recordings that took
//! no part; within the rest, *inner* folds choose. This is nested cross-validation (M. Stone, J. R. Stat. Soc. B 36, 1974; S. Varma
//! and R. Simon, BMC Bioinformatics 7, 2006).

use std::ops::Range;

use crate::Series;

/// Outer folds at most: more cost time and tell little.
const FOLDS: usize = 8;
/// Recordings below which whole ones cannot be left out.
const WHOLE: usize = 3;
/// Blocks that few recordings are cut into, in all.
const BLOCKS: usize = 6;

/// A recording, or a block of one.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Unit {
    /// Index of the recording.
    pub series: usize,
    /// Its samples that count.
    pub samples: Range<usize>,
}

/// Units whose outputs may enter weights.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Fit(Vec<usize>);
/// Units that settings are chosen on.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Select(Vec<usize>);
/// Units that figures are made on; nothing is decided there.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Test(Vec<usize>);

impl Fit {
    /// Indices of the units.
    #[must_use]
    pub fn units(&self) -> &[usize] {
        &self.0
    }
}

impl Select {
    /// Indices of the units.
    #[must_use]
    pub fn units(&self) -> &[usize] {
        &self.0
    }
}

impl Test {
    /// Indices of the units.
    #[must_use]
    pub fn units(&self) -> &[usize] {
        &self.0
    }
}

/// What is left out at a time.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum SplitKind {
    /// Groups of recordings: days, loads, amplitudes.
    Groups,
    /// Whole recordings.
    Recordings,
    /// Blocks, because there are too few recordings; the error on another recording may be larger.
    Blocks,
}

/// Units and the folds they belong to.
#[derive(Clone, Debug)]
pub struct Partition {
    units: Vec<Unit>,
    folds: Vec<Vec<usize>>,
    kind: SplitKind,
}

/// One outer fold: what is tested, and how the rest chooses.
#[derive(Clone, Debug)]
pub struct Outer {
    /// What is left out.
    pub test: Test,
    /// The rest.
    pub training: Training,
}

/// Units that choose and fit.
#[derive(Clone, Debug)]
pub struct Training {
    /// All of them, for the last fit.
    pub all: Fit,
    /// Inner folds.
    pub inner: Vec<(Fit, Select)>,
}

impl Partition {
    /// Cuts recordings into units and folds.
    #[must_use]
    pub fn new(series: &[Series]) -> Self {
        if series.len() < WHOLE {
            return Self::blocks(series);
        }
        let units: Vec<Unit> = series.iter().enumerate().map(|(index, one)| Unit { series: index, samples: one.skip..one.len() }).collect();
        let mut groups: Vec<(&str, Vec<usize>)> = Vec::new();
        for (index, one) in series.iter().enumerate() {
            match groups.iter_mut().find(|(name, _)| *name == one.group && !one.group.is_empty()) {
                Some((_, members)) => members.push(index),
                None => groups.push((&one.group, vec![index])),
            }
        }
        let grouped = groups.len() >= WHOLE && groups.len() < series.len();
        let parts: Vec<Vec<usize>> = match grouped {
            true => groups.into_iter().map(|(_, members)| members).collect(),
            false => (0..series.len()).map(|index| vec![index]).collect(),
        };
        let kind = if grouped { SplitKind::Groups } else { SplitKind::Recordings };
        Self { units, folds: deal(parts), kind }
    }

    /// Blocks of few recordings, each recording cut into equally many.
    fn blocks(series: &[Series]) -> Self {
        let each = BLOCKS / series.len().max(1);
        let mut units = Vec::new();
        for (index, one) in series.iter().enumerate() {
            let counted = one.len().saturating_sub(one.skip);
            for block in 0..each {
                let edge = |block: usize| one.skip + block * counted / each;
                units.push(Unit { series: index, samples: edge(block)..edge(block + 1) });
            }
        }
        let folds = (0..units.len()).map(|unit| vec![unit]).collect();
        Self { units, folds, kind: SplitKind::Blocks }
    }

    /// All units.
    #[must_use]
    pub fn units(&self) -> &[Unit] {
        &self.units
    }

    /// Number of folds.
    #[must_use]
    pub fn folds(&self) -> usize {
        self.folds.len()
    }

    /// What is left out at a time.
    #[must_use]
    pub fn kind(&self) -> SplitKind {
        self.kind
    }

    /// Fold of a unit.
    #[must_use]
    pub fn fold_of(&self, unit: usize) -> usize {
        self.folds.iter().position(|fold| fold.contains(&unit)).unwrap_or(0)
    }

    /// Outer folds, each with the inner folds of the rest.
    #[must_use]
    pub fn outer(&self) -> Vec<Outer> {
        (0..self.folds.len())
            .map(|left_out| Outer { test: Test(self.folds[left_out].clone()), training: self.without(&[left_out]) })
            .collect()
    }

    /// Everything chooses and fits: for the model that is shipped.
    #[must_use]
    pub fn training(&self) -> Training {
        self.without(&[])
    }

    /// Everything but some folds, by number, chooses and fits.
    #[must_use]
    pub fn without(&self, left_out: &[usize]) -> Training {
        let rest: Vec<usize> = (0..self.folds.len()).filter(|fold| !left_out.contains(fold)).collect();
        let units = |folds: &mut dyn Iterator<Item = usize>| -> Vec<usize> { folds.flat_map(|fold| self.folds[fold].clone()).collect() };
        let all = Fit(units(&mut rest.iter().copied()));
        let inner = rest
            .iter()
            .map(|&select| (Fit(units(&mut rest.iter().copied().filter(|&fold| fold != select))), Select(self.folds[select].clone())))
            .collect();
        Training { all, inner }
    }
}

/// Cuts parts into at most [`FOLDS`] folds of neighbours. Recordings that follow each other are alike where a rig changes over the day; dealt in
/// turn, every fold would have its twin among what it is judged by (blocked cross-validation: P. Burman, E. Chow and D. Nolan, Biometrika 81, 1994).
fn deal(parts: Vec<Vec<usize>>) -> Vec<Vec<usize>> {
    let (count, all) = (parts.len().min(FOLDS), parts.len());
    let mut folds = vec![Vec::new(); count];
    for (index, part) in parts.into_iter().enumerate() {
        folds[index * count / all].extend(part);
    }
    folds
}

#[cfg(test)]
mod tests {
    use super::*;

    fn series(count: usize, groups: &[&str]) -> Vec<Series> {
        (0..count)
            .map(|index| Series {
                name: index.to_string(),
                group: groups.get(index).copied().unwrap_or_default().to_owned(),
                inputs: vec![vec![0.0; 60]],
                output: vec![0.0; 60],
                gaps: Vec::new(),
                skip: 6,
            })
            .collect()
    }

    #[test]
    fn no_unit_has_two_roles() {
        for (count, groups) in [(1, vec![]), (2, vec![]), (5, vec![]), (20, vec![]), (6, vec!["a", "a", "b", "b", "c", "c"])] {
            let partition = Partition::new(&series(count, &groups));
            for outer in partition.outer() {
                for (fit, select) in &outer.training.inner {
                    for unit in outer.test.units() {
                        assert!(
                            !fit.units().contains(unit) && !select.units().contains(unit) && !outer.training.all.units().contains(unit)
                        );
                    }
                    assert!(fit.units().iter().all(|unit| !select.units().contains(unit)));
                    assert!(!fit.units().is_empty() && !select.units().is_empty());
                }
            }
            let mut tested: Vec<usize> = partition.outer().iter().flat_map(|outer| outer.test.units().to_vec()).collect();
            tested.sort_unstable();
            assert_eq!(tested, (0..partition.units().len()).collect::<Vec<_>>(), "each unit is tested once");
        }
    }

    #[test]
    fn folds_of_many_recordings_are_neighbours() {
        let partition = Partition::new(&series(20, &[]));
        let folds: Vec<Vec<usize>> = partition.outer().iter().map(|outer| outer.test.units().to_vec()).collect();
        assert_eq!((folds.len(), &folds[0], &folds[7]), (8, &vec![0, 1, 2], &vec![18, 19]));
        assert!(folds.iter().all(|fold| fold.windows(2).all(|pair| pair[1] == pair[0] + 1)));
    }

    #[test]
    fn a_group_is_left_out_whole_and_few_recordings_are_cut() {
        let grouped = Partition::new(&series(6, &["a", "a", "b", "b", "c", "c"]));
        assert_eq!((grouped.kind(), grouped.folds()), (SplitKind::Groups, 3));
        assert_eq!(grouped.outer()[1].test.units(), &[2, 3]);
        let single = Partition::new(&series(1, &[]));
        assert_eq!((single.kind(), single.units().len()), (SplitKind::Blocks, 6));
        assert_eq!((single.units()[0].samples.clone(), single.units()[5].samples.end), (6..15, 60));
    }
}
