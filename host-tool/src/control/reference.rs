//! References: where the tip shall go, one point each 20 ms, in mm as the laser sees them.
//!
//! Those of the bench are used for nothing else: controllers are tuned on [`tuning`], with other shapes and other seeds.

use std::f64::consts::PI;
use std::path::Path;

use anyhow::Context as _;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::recording::simulation::interpolate;
use crate::recording::{self, ColumnMap, ColumnName, Recording};

/// Time from one point to the next, s.
pub const PERIOD_S: f64 = 0.02;
/// Rest at the first point before a reference begins to move, s.
const REST_S: f64 = 1.0;

/// Longest reference of a file, s.
const LONGEST_S: f64 = 86_400.0;

/// Names of the references that need no file.
pub const NAMES: [&str; 7] = ["steps", "a", "b", "c", "d", "point-to-point", "hand"];

/// A reference.
#[derive(Clone, Debug, PartialEq)]
pub struct Reference {
    /// Its name.
    pub name: String,
    /// Points in mm, [`PERIOD_S`] apart.
    pub points_mm: Vec<f64>,
}

/// Where the tip can go.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reach {
    /// Lowest reference, mm.
    pub low_mm: f64,
    /// Highest reference, mm.
    pub high_mm: f64,
}

impl Reach {
    fn at(self, share: f64) -> f64 {
        self.low_mm + share * (self.high_mm - self.low_mm)
    }
}

/// A named reference, scaled to a reach.
///
/// `steps` holds random levels for two seconds each. `a` to `d` are the paper's test families in shape: a decaying sine, a decaying triangle, a
/// rising sine, a rising chirp; 0.2 to 0.8 Hz. `point-to-point` moves to random places in random times along minimum-jerk paths and rests
/// there. `hand` imitates a recorded hand on a catheter handle: it is synthetic, a sum of slow intended moves and a physiological tremor
/// of 8 to 12 Hz and some hundredths of a millimetre (tremor band: Riviere, Reich, Thakor, IEEE EMBS 1997).
#[must_use]
pub fn named(name: &str, reach: Reach, seed: u64) -> Option<Reference> {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let seconds = 20.0;
    let shares: Vec<f64> = match name {
        "steps" => {
            let levels: Vec<f64> = (0..10).map(|_| random.random_range(0.05..0.95)).collect();
            sampled(seconds, |time| levels[((time / 2.0) as usize).min(9)])
        }
        "a" => {
            let (frequency, decay) = (random.random_range(0.25..0.75), random.random_range(0.03..0.12));
            sampled(seconds, |time| 0.48 * (-decay * time).exp() * (1.0 - (2.0 * PI * frequency * time).cos()))
        }
        "b" => {
            let (frequency, decay) = (random.random_range(0.25..0.75), random.random_range(0.03..0.12));
            sampled(seconds, |time| 0.96 * (-decay * time).exp() * (1.0 - (2.0 * (frequency * time).fract() - 1.0).abs()))
        }
        "c" => {
            let (frequency, growth) = (random.random_range(0.25..0.75), random.random_range(0.03..0.08));
            sampled(seconds, |time| 0.48 * (growth * (time - seconds)).exp() * (1.0 - (2.0 * PI * frequency * time).cos()))
        }
        "d" => {
            let (from, to) = (0.2, random.random_range(0.6..0.8));
            sampled(seconds, |time| {
                let turns = from * time + 0.5 * (to - from) / seconds * time * time;
                (0.15 + 0.33 * time / seconds) * (1.0 - (2.0 * PI * turns).cos())
            })
        }
        "point-to-point" => point_to_point(seconds, &mut random),
        "hand" => hand(seconds, &mut random),
        _ => return None,
    };
    Some(Reference { name: name.to_owned(), points_mm: with_rest(shares.into_iter().map(|share| reach.at(share)).collect()) })
}

/// What controllers are tuned on: a sine with a wandering mean, then levels; none of the shapes that [`named`] has.
#[must_use]
pub fn tuning(reach: Reach, seed: u64) -> Reference {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let (frequency, phase) = (random.random_range(0.35..0.5), random.random_range(0.0..2.0 * PI));
    let levels: Vec<f64> = (0..6).map(|_| random.random_range(0.1..0.9)).collect();
    let mut shares = sampled(12.0, |time| 0.45 + 0.2 * (0.7 * time + phase).sin() + 0.2 * (2.0 * PI * frequency * time).sin());
    shares.extend(sampled(9.0, |time| levels[((time / 1.5) as usize).min(5)]));
    Reference { name: "tuning".to_owned(), points_mm: with_rest(shares.into_iter().map(|share| reach.at(share)).collect()) }
}

/// The reference of a file: a recording whose output in mm is the path, or a CSV with the columns `time_s,reference_mm`. Points that do not
/// lie 20 ms apart are taken as a path with straight lines between them.
///
/// # Errors
/// When the file is none of both, or has a gap.
pub fn from_file(path: &Path) -> anyhow::Result<Reference> {
    let bytes = crate::output::read(path).with_context(|| format!("{}: cannot be read", path.display()))?;
    let text = String::from_utf8_lossy(&bytes);
    let header = text.lines().find(|line| !line.starts_with('#')).unwrap_or_default();
    let own = ColumnMap::own();
    let map = if header.split(',').any(|name| name.trim() == "reference_mm") {
        let reference = ColumnName::kept("reference_mm", own.output.signal.clone());
        // A reference has no input: the path stands in for it.
        ColumnMap { input: reference.clone(), output: reference, own: false, ..own }
    } else {
        own
    };
    let recording = recording::parse(path, &bytes, &map)?;
    let name = path.file_stem().map_or_else(|| "file".to_owned(), |stem| stem.to_string_lossy().into_owned());
    anyhow::ensure!(recording.gaps.is_empty(), "{}: has a gap; where the tip shall be in it is not known", path.display());
    let length_s = recording.time_s[recording.len() - 1] - recording.time_s[0];
    anyhow::ensure!(
        length_s <= LONGEST_S,
        "{}: lasts {length_s:e} s, {LONGEST_S} s at most are followed; is its time in s?",
        path.display()
    );
    let points_mm = if (recording.sample_period_s / PERIOD_S - 1.0).abs() < 0.01 { recording.output } else { resampled(&recording) };
    Ok(Reference { name, points_mm })
}

/// A recording's output each [`PERIOD_S`].
fn resampled(recording: &Recording) -> Vec<f64> {
    let times = &recording.time_s;
    let (first_s, last_s) = (times[0], times[times.len() - 1]);
    let points = ((last_s - first_s) / PERIOD_S).floor() as usize + 1;
    let clock: Vec<f64> = (0..points).map(|point| first_s + point as f64 * PERIOD_S).collect();
    interpolate(times, &recording.output, &clock)
}

fn sampled(seconds: f64, shape: impl Fn(f64) -> f64) -> Vec<f64> {
    let points = (seconds / PERIOD_S).round() as usize;
    (0..points).map(|point| shape(point as f64 * PERIOD_S).clamp(0.0, 1.0)).collect()
}

fn with_rest(points_mm: Vec<f64>) -> Vec<f64> {
    let first = points_mm.first().copied().unwrap_or(0.0);
    let rest = (REST_S / PERIOD_S).round() as usize;
    std::iter::repeat_n(first, rest).chain(points_mm).collect()
}

fn point_to_point(seconds: f64, random: &mut ChaCha8Rng) -> Vec<f64> {
    let mut shares = Vec::new();
    let mut from = random.random_range(0.1..0.3);
    while (shares.len() as f64) * PERIOD_S < seconds {
        let to: f64 = random.random_range(0.05..0.95);
        let move_s = random.random_range(0.5..1.2) * (0.4 + (to - from).abs());
        let hold_s = random.random_range(0.3..1.5);
        shares.extend(sampled(move_s, |time| {
            let part = time / move_s;
            from + (to - from) * part.powi(3) * (10.0 - 15.0 * part + 6.0 * part * part)
        }));
        shares.extend(sampled(hold_s, |_| to));
        from = to;
    }
    shares.truncate((seconds / PERIOD_S) as usize);
    shares
}

fn hand(seconds: f64, random: &mut ChaCha8Rng) -> Vec<f64> {
    let intended: Vec<(f64, f64, f64)> = (0..5)
        .map(|line| (0.18 / f64::from(line + 1), random.random_range(0.06..0.16) * f64::from(line + 1), random.random_range(0.0..2.0 * PI)))
        .collect();
    let tremor: Vec<(f64, f64, f64)> =
        (0..3).map(|_| (0.0015, random.random_range(8.0..12.0), random.random_range(0.0..2.0 * PI))).collect();
    sampled(seconds, |time| {
        let sum = |lines: &[(f64, f64, f64)]| {
            lines.iter().map(|(size, hertz, phase)| size * (2.0 * PI * hertz * time + phase).sin()).sum::<f64>()
        };
        0.5 + sum(&intended) + sum(&tremor)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    const REACH: Reach = Reach { low_mm: 3.0, high_mm: 9.0 };

    #[test]
    fn every_reference_stays_within_reach_and_moves_and_begins_at_rest() {
        for name in NAMES {
            for seed in 0..20 {
                let reference = named(name, REACH, seed).unwrap();
                let (low, high) = reference.points_mm.iter().fold((f64::MAX, f64::MIN), |(l, h), v| (l.min(*v), h.max(*v)));
                assert!(low >= REACH.low_mm && high <= REACH.high_mm, "{name} with seed {seed}: {low} to {high}");
                assert!(high - low > 1.0, "{name} with seed {seed}");
                assert!(reference.points_mm[..50].iter().all(|point| *point == reference.points_mm[0]), "{name}");
            }
        }
        assert_eq!(named("z", REACH, 1), None);
    }

    fn read(text: &str) -> anyhow::Result<Reference> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("path.csv");
        std::fs::write(&path, text).unwrap();
        from_file(&path)
    }

    #[test]
    fn a_file_is_a_path_whatever_its_period_and_a_recording_is_one_too() {
        let alone = read("# a hand\ntime_s,reference_mm\n0,1\n0.02,1.5\n0.04,2\n").unwrap();
        assert_eq!((alone.name.as_str(), alone.points_mm), ("path", vec![1.0, 1.5, 2.0]));
        // A run of `track` has both: the reference, not what became of it.
        let run = read("time_s,pressure_bar,displacement_mm,reference_mm\n0,0,7,1\n0.02,0,7,2\n").unwrap();
        assert_eq!(run.points_mm, [1.0, 2.0]);
        assert_eq!(read("time_s,pressure_bar,displacement_mm\n0,0,7\n0.02,0,8\n").unwrap().points_mm, [7.0, 8.0]);
        // 10 Hz, and 100 Hz.
        let slow = read("time_s,reference_mm\n5.0,1\n5.1,2\n5.2,1\n").unwrap().points_mm;
        assert_eq!(slow.len(), 11);
        assert!((slow[3] - 1.6).abs() < 1e-9 && (slow[7] - 1.6).abs() < 1e-9, "{slow:?}");
        assert_eq!(read("time_s,reference_mm\n0,0\n0.01,1\n0.02,2\n0.03,3\n0.04,4\n").unwrap().points_mm, [0.0, 2.0, 4.0]);
    }

    #[test]
    fn what_is_no_path_is_refused_with_what_is_wrong() {
        for (text, word) in [
            ("", "empty"),
            ("time_s,reference_mm\n", "two are needed"),
            ("time_s,reference_mm\n0,1\n", "two are needed"),
            ("time_s,reference_mm\n0,1\n0.02,NaN\n", ":3:"),
            ("time_s,reference_mm\n0,1\n0.02,up\n", ":3:"),
            ("time_s,reference_mm\n0,1\n0,2\n", ":3:"),
            ("time_s,pressure_bar\n0,1\n0.02,2\n", "displacement_mm"),
            ("time_s,reference_mm\n0,1\n0.02,1\n0.04,1\n0.06,1\n5,1\n5.02,1\n", "gap"),
            ("time_s,reference_mm\n0,1\n1e6,2\n2e6,3\n", "is its time in s"),
        ] {
            let said = format!("{:#}", read(text).map(|_| ()).expect_err(text));
            assert!(said.to_lowercase().contains(word), "{text:?}: {said}");
        }
    }

    #[test]
    fn a_reference_depends_on_its_seed_alone() {
        assert_eq!(named("hand", REACH, 5), named("hand", REACH, 5));
        assert_ne!(named("hand", REACH, 5), named("hand", REACH, 6));
        assert_ne!(tuning(REACH, 5), tuning(REACH, 6));
    }
}
