//! The physics rungs of the ladder, from a curve to everything together.
//!
//! A rung is a start (what an earlier rung found, with something added) and the settings that are searched on it, one after the other.

use crate::recipe::{Bound, DAMPINGS, OutputKey, Recipe, Spectrum, Surroundings};

/// Alternatives to a recipe along one setting.
pub type Alternatives = fn(&Recipe, &Surroundings) -> Vec<Recipe>;

/// One rung.
#[derive(Clone, Debug)]
pub struct Rung {
    /// Short name.
    pub name: &'static str,
    /// What it is, in words.
    pub what: &'static str,
    /// Rungs whose results it starts from: the best of them.
    pub from: &'static [&'static str],
    /// What is added to the start.
    pub enter: fn(Recipe, &Surroundings) -> Recipe,
    /// Settings searched, in turn.
    pub settings: &'static [Alternatives],
    /// Rounds over the settings.
    pub rounds: usize,
    /// Whether weights are bound in sign: such a rung may be trusted beyond histories that were seen.
    pub bound: bool,
    /// Whether little data may choose it.
    pub small: bool,
}

/// The rungs, simplest first. Those whose weights are bound in sign come first: what they do beyond the data is physics.
#[must_use]
pub fn physics_rungs() -> Vec<Rung> {
    let bound = |name, what, from, enter, settings, rounds| Rung { name, what, from, enter, settings, rounds, bound: true, small: true };
    let large = |rung: Rung| Rung { small: false, ..rung };
    let free = |name, what, from, enter, settings, rounds| Rung { name, what, from, enter, settings, rounds, bound: false, small: false };
    vec![
        bound(
            "curve",
            "a monotone curve of the input",
            &[],
            |_, _| Recipe { polynomial: 0, ramps: 8, bound: Bound::Play, ..Recipe::line() },
            &[directions, ramps, zeros],
            1,
        ),
        bound(
            "PI",
            "Prandtl-Ishlinskii: play or stop operators",
            &[],
            |_, _| Recipe { polynomial: 0, plays: 16, bound: Bound::Play, rest_at_zero: true, ..Recipe::line() },
            &[directions, rests, zeros],
            1,
        ),
        bound(
            "PI + curve",
            "play or stop operators beside a monotone curve",
            &["PI"],
            |recipe, _| Recipe { ramps: 8, ..recipe },
            &[directions, ramps, counts, rests, zeros],
            1,
        ),
        bound(
            "PI + dynamics",
            "play or stop operators behind dead time and lag, and a filter of the sum",
            &["PI"],
            |recipe, _| recipe,
            &[dead_times, lags, outputs, directions, rests, zeros],
            2,
        ),
        bound(
            "curve + dynamics",
            "a monotone curve behind dead time and lag, and a filter of the sum",
            &["curve"],
            |recipe, _| recipe,
            &[dead_times, lags, outputs, directions, zeros],
            2,
        ),
        large(bound(
            "PI + curve + dynamics",
            "operators and a monotone curve behind dead time and lag, and a filter of the sum",
            &["PI + curve", "PI + dynamics", "curve + dynamics"],
            |recipe, _| Recipe { ramps: recipe.ramps.max(4), plays: recipe.plays.max(8), ..recipe },
            &[dead_times, lags, outputs, directions, ramps, counts, rests, zeros],
            2,
        )),
        large(bound(
            "PI + curve + rate",
            "the same, with thresholds that follow the speed of the input",
            // Not from the rung with dynamics: a lag that stands in for wider loops would have to go first.
            &["PI + curve"],
            |recipe, _| recipe,
            &[widenings, directions, dead_times, lags, outputs, ramps, counts, rests, zeros],
            2,
        )),
        large(bound(
            "PI + curve + creep",
            "operators, a curve and dynamics, thresholds that may follow the speed, and creep by a spectrum of lags",
            &["PI + curve + dynamics", "PI + curve + rate"],
            |recipe, _| Recipe { spectrum: Spectrum::Input, ..recipe },
            &[spectra, outputs, dead_times, lags, directions, rests, zeros],
            1,
        )),
        free(
            "polynomial",
            "a polynomial of the input",
            &[],
            |_, _| Recipe { polynomial: 3, ..Recipe::line() },
            &[degrees, products, zeros],
            1,
        ),
        free(
            "polynomial + dynamics",
            "a polynomial behind dead time and lag, and a filter of the sum",
            &["polynomial"],
            |recipe, _| recipe,
            &[dead_times, lags, outputs, degrees, products, zeros],
            2,
        ),
        free(
            "operators + dynamics",
            "play operators of any sign and a polynomial behind dead time and lag, and a filter of the sum",
            &["PI + dynamics", "polynomial + dynamics"],
            |recipe, _| Recipe { polynomial: recipe.polynomial.max(3), ramps: 0, plays: recipe.plays.max(8), bound: Bound::Free, ..recipe },
            &[dead_times, lags, outputs, degrees, counts, products, rests, zeros],
            2,
        ),
        free(
            "polynomial + spectrum",
            "a polynomial, and its terms behind a spectrum of lags",
            &["polynomial + dynamics"],
            |recipe, _| Recipe { spectrum: Spectrum::Curve, ..recipe },
            &[oscillators, spectra, outputs, dead_times, lags, degrees, zeros],
            1,
        ),
        free(
            "operators + spectrum",
            "play operators and a polynomial, and their terms behind a spectrum of lags",
            &["operators + dynamics"],
            |recipe, _| Recipe { spectrum: Spectrum::Input, ..recipe },
            &[oscillators, spectra, outputs, dead_times, lags, degrees, counts, rests, zeros],
            1,
        ),
        free(
            "random features",
            "the best of the above and random sigmoids of input, play operators and lags",
            &["operators + spectrum", "polynomial + spectrum"],
            |recipe, _| Recipe { sigmoids: 60, ..recipe },
            &[oscillators, sigmoids, zeros],
            1,
        ),
    ]
}

/// What nuisances are inferred from: flexible, once with weights of any sign and once without.
pub(crate) fn references() -> [Rung; 2] {
    let rung = |bound, enter| Rung {
        name: "reference",
        what: "operators, a curve and a spectrum of lags",
        from: &[],
        enter,
        settings: &[rests, dead_times, lags, counts],
        rounds: 1,
        bound,
        small: false,
    };
    let free = |_: Recipe, _: &Surroundings| Recipe { polynomial: 3, plays: 8, spectrum: Spectrum::Input, ..Recipe::line() };
    let bound = |_: Recipe, _: &Surroundings| Recipe {
        polynomial: 0,
        plays: 16,
        ramps: 6,
        bound: Bound::Play,
        rest_at_zero: true,
        spectrum: Spectrum::Input,
        ..Recipe::line()
    };
    [rung(false, free), rung(true, bound)]
}

fn degrees(recipe: &Recipe, _: &Surroundings) -> Vec<Recipe> {
    let lowest = u8::from(recipe.plays == 0);
    [0, 1, 2, 3, 5].into_iter().filter(|&degree| degree >= lowest).map(|polynomial| Recipe { polynomial, ..recipe.clone() }).collect()
}

fn products(recipe: &Recipe, around: &Surroundings) -> Vec<Recipe> {
    if around.scalings.len() < 2 { Vec::new() } else { vec![Recipe { products: !recipe.products, ..recipe.clone() }] }
}

fn counts(recipe: &Recipe, _: &Surroundings) -> Vec<Recipe> {
    [4, 8, 16, 24].into_iter().map(|plays| Recipe { plays, ..recipe.clone() }).collect()
}

/// Play or stop operators, on an output that rises or falls with each input.
fn directions(recipe: &Recipe, around: &Surroundings) -> Vec<Recipe> {
    let inputs = around.scalings.len().min(8);
    let masks: Vec<u8> = match inputs {
        0..=2 => (0..1 << inputs).collect(),
        _ => (0..inputs).map(|input| recipe.falling ^ 1 << input).collect(),
    };
    let kinds: &[Bound] = if recipe.plays > 0 { &[Bound::Play, Bound::Stop] } else { &[Bound::Play] };
    let of = |&bound: &Bound| {
        // A force of friction needs the input itself beside the operators.
        let polynomial = u8::from(bound == Bound::Stop);
        masks.iter().map(move |&falling| Recipe { bound, falling, polynomial, ..recipe.clone() })
    };
    kinds.iter().flat_map(of).collect()
}

fn ramps(recipe: &Recipe, _: &Surroundings) -> Vec<Recipe> {
    [3, 6, 12].into_iter().map(|ramps| Recipe { ramps, ..recipe.clone() }).collect()
}

fn rests(recipe: &Recipe, _: &Surroundings) -> Vec<Recipe> {
    vec![Recipe { rest_at_zero: !recipe.rest_at_zero, ..recipe.clone() }]
}

fn zeros(recipe: &Recipe, _: &Surroundings) -> Vec<Recipe> {
    vec![Recipe { own_zeros: !recipe.own_zeros, ..recipe.clone() }]
}

/// A coarse grid, and neighbours of where the search is.
fn dead_times(recipe: &Recipe, around: &Surroundings) -> Vec<Recipe> {
    let here = recipe.dead_quarters;
    let coarse = [0, 2, 4, 8, 12, 16, 24, 32, 48, 64, 96, 128];
    let near = [here.saturating_sub(4), here.saturating_sub(2), here.saturating_sub(1), here + 1, here + 2, here + 4];
    let limit = around.longest / 2;
    let mut all: Vec<u16> = coarse.into_iter().chain(near).filter(|&quarters| usize::from(quarters) <= limit).collect();
    all.sort_unstable();
    all.dedup();
    all.into_iter().map(|dead_quarters| Recipe { dead_quarters, ..recipe.clone() }).collect()
}

/// Every second half octave, and neighbours.
fn steps(here: u16, around: &Surroundings) -> Vec<u16> {
    let last = around.longest_lag();
    let mut all: Vec<u16> = (1..=last).step_by(3).chain([here.saturating_sub(1), here + 1]).filter(|&step| step <= last).collect();
    all.sort_unstable();
    all.dedup();
    all
}

fn lags(recipe: &Recipe, around: &Surroundings) -> Vec<Recipe> {
    std::iter::once(0).chain(steps(recipe.lag, around)).map(|lag| Recipe { lag, ..recipe.clone() }).collect()
}

/// A coarse grid of speeds and gains, and neighbours of where the search is.
fn widenings(recipe: &Recipe, around: &Surroundings) -> Vec<Recipe> {
    let last = around.longest_lag();
    let coarse = (1..=last).step_by(3).flat_map(|step| [-2, 2, 5, 8].map(|gain| (step, gain)));
    let near = recipe.widening.map(|(step, gain)| [(step - 1, gain), (step + 1, gain), (step, gain - 1), (step, gain + 1)]);
    let within = |(step, gain): &(u16, i8)| (1..=last).contains(step) && (-4..=11).contains(gain) && *gain != 0;
    let all = coarse.chain(near.into_iter().flatten()).filter(within).map(Some);
    std::iter::once(None).chain(all).map(|widening| Recipe { widening, ..recipe.clone() }).collect()
}

fn outputs(recipe: &Recipe, around: &Surroundings) -> Vec<Recipe> {
    let with = |output| Recipe { output, ..recipe.clone() };
    let here = match recipe.output {
        OutputKey::Direct => 0,
        OutputKey::Lag(step) | OutputKey::Oscillator(step, _) => step,
    };
    let dampings = 0..u8::try_from(DAMPINGS.len()).unwrap_or(0);
    let steps: Vec<u16> = steps(here, around).into_iter().filter(|&step| step > 0).collect();
    let lagged = steps.iter().map(|&step| OutputKey::Lag(step));
    let swinging = steps.iter().flat_map(|&step| dampings.clone().map(move |damping| OutputKey::Oscillator(step, damping)));
    std::iter::once(OutputKey::Direct).chain(lagged).chain(swinging).map(with).collect()
}

fn spectra(recipe: &Recipe, _: &Surroundings) -> Vec<Recipe> {
    let all = [Spectrum::None, Spectrum::Input, Spectrum::Curve, Spectrum::Plays];
    let able = |spectrum: &Spectrum| recipe.plays > 0 || *spectrum != Spectrum::Plays;
    all.into_iter().filter(able).map(|spectrum| Recipe { spectrum, ..recipe.clone() }).collect()
}

fn oscillators(recipe: &Recipe, _: &Surroundings) -> Vec<Recipe> {
    vec![Recipe { oscillators: !recipe.oscillators, ..recipe.clone() }]
}

fn sigmoids(recipe: &Recipe, _: &Surroundings) -> Vec<Recipe> {
    [30, 120, 200].into_iter().map(|sigmoids| Recipe { sigmoids, ..recipe.clone() }).collect()
}
