//! How well the recordings determine a model's parameters.
//!
//! Residuals of a model that is not quite the rig's are correlated over whole strokes, and the likelihood of independent samples then makes
//! intervals far too narrow. The covariance here is the sandwich of Huber (1967) and White (1982), with recordings as clusters (Liang and
//! Zeger 1986): `H^-1 (sum_r g_r g_r') H^-1`, with the curvature `H` of the sum of squares and its gradient `g_r` in recording `r`, the linear
//! weights solved for along the way. With `R` clusters it is scaled by `R / (R - 1)`, and intervals take Student's t with `R - 1` degrees of
//! freedom (Cameron and Miller 2015).
//!
//! A form that is not quite the rig's errs the same way in every recording, and no scatter between them shows it. What such a model leaves above
//! the noise is taken for one coherent error of unknown direction (a model discrepancy without repetitions, Kennedy and O'Hagan 2001): a parameter
//! could be off by as much as changes the mean square by that excess, `sqrt(2 e / H)`, added in quadrature. An error of the form that is no larger
//! than the mean square is known to cannot be seen: its standard error between recordings is part of the excess.
//!
//! Nor does one form know what another one says. Where another of the same effect has the same parameter and leaves no more above the mean square than
//! that excess, the interval reaches as far beyond what that one has for it (model selection uncertainty, Buckland, Burnham and Augustin 1997).

use identification::nnls;
use statrs::distribution::{ContinuousCDF, StudentsT};

use crate::chain::form::{Form, Parameter};
use crate::data::session::{Role, Run, Session};
use crate::effects::catalogue;
use crate::model::line::{Axis, axes, inward, outward, place};
use crate::model::structure::{Model, Scope};
use crate::model::workspace::Workspace;
use crate::search::forms::polished;
use crate::search::parallel::is_narrow;
use crate::search::simplex::{indices_of, objective};

/// Half width of the 95 % interval of every non-linear parameter, all parameters on one line, in the parameters' own normalised units. Discrete
/// parameters have none: zero. `excess` is the mean square that the form leaves above the noise.
#[must_use]
pub fn half_widths(model: &Model, session: &Session, excess: f64) -> Vec<f64> {
    let axes = axes(model);
    let line: Vec<f64> = model.slots.iter().flat_map(|slot| slot.parameters.iter().copied()).collect();
    let searched: Vec<usize> =
        (0..model.slots.len()).filter(|&slot| !model.slots[slot].form.spec().discrete).flat_map(|slot| indices_of(model, slot)).collect();
    // What jumps does so within a sample or in the next one, and a small step shows nothing but that.
    let is_narrow = model.slots.iter().any(|slot| slot.form.spec().is_narrow);
    let nudge = if is_narrow { 1.0 } else { 0.13 };
    let mut result = vec![0.0; line.len()];
    let n = searched.len();
    if n == 0 {
        return result;
    }
    let centre = inward(&axes, &line);
    let mut workspace = Workspace::new(session);
    let moved = |moves: &[(usize, f64)]| {
        let mut point = centre.clone();
        for &(axis, step) in moves {
            point[searched[axis]] += step;
        }
        let mut trial = model.clone();
        place(&mut trial, &outward(&axes, &point));
        trial
    };
    let here = objective(&moved(&[]), &mut workspace, Scope::Fit);
    let mut curvature = vec![0.0; n * n];
    // Sums of squares in each cluster, a step up and a step down each parameter.
    let mut gradients: Vec<Vec<f64>> = Vec::new();
    for row in 0..n {
        let sides = [nudge, -nudge].map(|step| {
            let mut trial = moved(&[(row, step)]);
            let sums = workspace.sums(&trial, Scope::Fit);
            let weights = sums.fit.solve(&sums.free, &trial.weights());
            trial.take(&weights);
            (sums.fit.mean_square(&weights), clusters(&trial, session, &mut workspace))
        });
        curvature[row * n + row] = ((sides[0].0 + sides[1].0 - 2.0 * here) / (nudge * nudge)).max(1e-12 * here);
        gradients.push(sides[0].1.iter().zip(&sides[1].1).map(|(up, down)| (up.0 - down.0) / (2.0 * nudge)).collect());
        for column in 0..row {
            let mut value = |one: f64, other: f64| objective(&moved(&[(row, one), (column, other)]), &mut workspace, Scope::Fit);
            let mixed = value(nudge, nudge) + value(-nudge, -nudge) - value(nudge, -nudge) - value(-nudge, nudge);
            curvature[row * n + column] = mixed / (4.0 * nudge * nudge);
            curvature[column * n + row] = curvature[row * n + column];
        }
    }
    let at_centre = clusters(&moved(&[]), session, &mut workspace);
    let count = at_centre.len();
    let samples = session.count(Role::Fit) as f64;
    if count < 2 {
        return axes.iter().map(|axis| axis.parameter.high - axis.parameter.low).collect();
    }
    let factor = count as f64 / (count - 1) as f64;
    let hidden = standard_error(&at_centre);
    let quantile = StudentsT::new(0.0, 1.0, (count - 1) as f64).map_or(f64::INFINITY, |student| student.inverse_cdf(0.975));
    for (axis, &index) in searched.iter().enumerate() {
        // A row of the inverse curvature; one that is not definite falls back on its diagonal.
        let diagonal = || (0..n).map(|at| if at == axis { 1.0 / curvature[axis * n + axis] } else { 0.0 }).collect();
        let row = inverse_row(&curvature, n, axis).unwrap_or_else(diagonal);
        // The influence of each cluster on this parameter.
        let influence = |cluster: usize| -> f64 { row.iter().zip(&gradients).map(|(inverse, gradient)| inverse * gradient[cluster]).sum() };
        let variance = factor * (0..count).map(|cluster| influence(cluster).powi(2)).sum::<f64>() / (samples * samples);
        let Axis { parameter, step } = &axes[index];
        let reach = (quantile * quantile * variance + 2.0 * (excess + hidden) * row[axis]).sqrt() * step;
        result[index] = if parameter.logarithmic { line[index] * reach } else { reach / 4.0 * (parameter.high - parameter.low) };
    }
    result
}

/// Evaluations for each parameter when another form takes a form's place.
const POLISH: usize = 20;

/// As [`half_widths`], wide enough for other forms of the effects that leave as little.
#[must_use]
pub fn half_widths_over_forms(model: &Model, session: &Session, excess: f64) -> Vec<f64> {
    let mut widths = half_widths(model, session, excess);
    let mut workspace = Workspace::new(session);
    let most = objective(model, &mut workspace, Scope::Fit) + excess + standard_error(&clusters(model, session, &mut workspace));
    let mut first = 0;
    for (at, slot) in model.slots.iter().enumerate() {
        let mut farthest = vec![0.0_f64; slot.parameters.len()];
        let residual = model.without(at).residuals(session);
        let is_other = |form: &&'static dyn Form| form.name() == slot.form.name() && form.form() != slot.form.form();
        let searched = |form: &&'static dyn Form| !form.spec().discrete && !is_narrow(*form);
        for form in catalogue::forms().into_iter().filter(|form| is_other(form) && searched(form) && searched(&slot.form)) {
            let same = |(index, parameter): (usize, &Parameter)| {
                let is_same = |own: &Parameter| own.name == parameter.name && own.quantity == parameter.quantity;
                Some((index, slot.form.parameters().iter().position(is_same)?))
            };
            let shared: Vec<(usize, usize)> = form.parameters().iter().enumerate().filter_map(same).collect();
            let starts = if shared.is_empty() { Vec::new() } else { form.starts(session, &residual) };
            let begun = starts.into_iter().map(|mut start| {
                shared.iter().for_each(|&(index, same)| start[index] = slot.parameters[same]);
                let trial = model.with_in_place_of(at, form, start);
                (objective(&trial, &mut workspace, Scope::Screen), trial)
            });
            let Some((_, begun)) = begun.min_by(|x, y| x.0.total_cmp(&y.0)) else { continue };
            let other = polished(&begun, &mut workspace, Scope::Fit, POLISH);
            if objective(&other, &mut workspace, Scope::Fit) < most {
                let found = other.slots.iter().find(|slot| slot.form.form() == form.form()).map_or(&[][..], |slot| &slot.parameters);
                for (far, own, other) in shared.iter().filter_map(|&(index, same)| Some((same, slot.parameters[same], found.get(index)?))) {
                    farthest[far] = farthest[far].max((other - own).abs());
                }
            }
        }
        farthest.iter().zip(&mut widths[first..]).for_each(|(far, width)| *width += far);
        first += slot.parameters.len();
    }
    widths
}

/// Standard error of the mean square over clusters, from their sums of squares and numbers of samples.
fn standard_error(clusters: &[(f64, f64)]) -> f64 {
    let (sum, samples) = clusters.iter().fold((0.0, 0.0), |all, cluster| (all.0 + cluster.0, all.1 + cluster.1));
    let scatter: f64 = clusters.iter().map(|cluster| (cluster.0 - sum / samples * cluster.1).powi(2)).sum();
    let count = clusters.len() as f64;
    (count / (count - 1.0) * scatter).sqrt() / samples
}

/// Sums of squares over the fitted samples of each cluster, and how many these are: a recording, or a stretch of one that is fitted where others of it
/// are not.
fn clusters(model: &Model, session: &Session, workspace: &mut Workspace<'_>) -> Vec<(f64, f64)> {
    let fitted = |run: &Run| run.role.contains(&Role::Fit);
    let outputs = workspace.outputs(model, fitted);
    let mut sums = Vec::new();
    for (run, output) in session.runs.iter().zip(outputs).filter(|(run, _)| fitted(run)) {
        for stretch in run.role.chunk_by(|one, other| (*one == Role::Fit) == (*other == Role::Fit)).scan(0, |end, chunk| {
            *end += chunk.len();
            Some(*end - chunk.len()..*end)
        }) {
            if run.role[stretch.start] == Role::Fit {
                let kept = stretch.filter(|&sample| run.keep[sample]).map(|sample| (run.output[sample] - output[sample]).powi(2));
                sums.push(kept.fold((0.0, 0.0), |(sum, samples), square| (sum + square, samples + 1.0)));
            }
        }
    }
    sums
}

/// A row of the inverse of a symmetric matrix; nothing where it is not positive definite.
fn inverse_row(matrix: &[f64], n: usize, wanted: usize) -> Option<Vec<f64>> {
    let unit: Vec<f64> = (0..n).map(|row| f64::from(u8::from(row == wanted))).collect();
    nnls::solve_definite(matrix, &unit, &vec![false; n], &vec![true; n])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::effects::{pneumatic_lag, supply_saturation};
    use crate::model::initial_state::InitialState;
    use crate::search::forms::polish;
    use virtual_rig as rig;
    use virtual_rig::{CaseConfig, Generator};

    #[test]
    fn the_row_of_an_inverse_solves_its_equation() {
        let matrix = [4.0, 1.0, 0.5, 1.0, 3.0, -0.7, 0.5, -0.7, 2.0];
        for wanted in 0..3 {
            let row = inverse_row(&matrix, 3, wanted).expect("an inverse");
            for column in 0..3 {
                let product: f64 = (0..3).map(|at| row[at] * matrix[at * 3 + column]).sum();
                assert!((product - if column == wanted { 1.0 } else { 0.0 }).abs() < 1e-12);
            }
        }
        assert!(inverse_row(&[0.0; 4], 2, 0).is_none());
    }

    #[test]
    fn the_standard_error_of_a_mean_square_is_that_of_its_clusters() {
        // Mean squares of 1, 2 and 3, as many samples each: the standard deviation of one is 1.
        assert!((standard_error(&[(10.0, 10.0), (20.0, 10.0), (30.0, 10.0)]) - 1.0 / 3.0_f64.sqrt()).abs() < 1e-12);
        assert!(standard_error(&[(10.0, 5.0), (40.0, 20.0)]) < 1e-12);
    }

    /// A normal deviate: the sum of twelve even ones of a linear congruential generator (Numerical Recipes, 7.1).
    fn deviate(state: &mut u32) -> f64 {
        (0..12).fold(-6.0, |sum, _| {
            *state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            sum + f64::from(*state) / f64::from(u32::MAX)
        })
    }

    /// How many of twelve intervals of a lag of 0.15 s hold it, where the noise is 0.3 % of the span and its neighbours are so correlated; and the
    /// middle one of the half widths, over the lag.
    fn held(correlation: f64) -> (usize, f64) {
        const TRUTH_S: f64 = 0.15;
        let case = rig::hide(&CaseConfig { seed: 570, generator: Generator::Rival, noise: 0.0, ..CaseConfig::default() }).expect("a case");
        let mut session = Session::new(&case.recordings, &[]).expect("a session");
        let mut model = Model::baseline(InitialState::carrying(case.truth.continuous), false).with(pneumatic_lag::FORMS[0], vec![TRUTH_S]);
        model.fit(&session, Scope::Both);
        let exact = model.outputs(&session, |_| true);
        let (mut held, mut shares) = (0, Vec::new());
        for seed in 0..12 {
            let mut state = 7919 * seed + 1;
            for (run, exact) in session.runs.iter_mut().zip(&exact) {
                let mut noise = 0.0;
                for (value, exact) in run.output.iter_mut().zip(exact) {
                    noise = correlation * noise + (1.0 - correlation * correlation).sqrt() * deviate(&mut state);
                    *value = exact + 0.003 * noise;
                }
            }
            let found = polish(&model, &session, Scope::Fit, 30).model;
            let (found_s, half_s) = (found.slots[0].parameters[0], half_widths(&found, &session, 0.0)[0]);
            held += usize::from((found_s - TRUTH_S).abs() <= half_s);
            shares.push(half_s / TRUTH_S);
        }
        shares.sort_by(f64::total_cmp);
        (held, shares[6])
    }

    #[test]
    fn an_interval_reaches_what_another_form_says_that_leaves_as_little() {
        // A supply with a wide corner, and what a law of another knee has for its limit.
        let case =
            rig::hide(&CaseConfig { seed: 571, generator: Generator::Rival, noise: 0.003, ..CaseConfig::default() }).expect("a case");
        let mut session = Session::new(&case.recordings, &[]).expect("a session");
        let [corner, drooping] = [0, 1].map(|at| supply_saturation::FORMS[at]);
        let bare = Model::baseline(InitialState::carrying(case.truth.continuous), false);
        let mut limited = bare.with(corner, vec![0.7, 0.05, 0.0]);
        limited.fit(&session, Scope::Both);
        let exact = limited.outputs(&session, |_| true);
        session.runs.iter_mut().zip(&exact).for_each(|(run, exact)| run.output.clone_from(exact));
        // Where the recordings show which law it is, the other one has no say.
        assert_eq!(half_widths_over_forms(&limited, &session, 0.0), half_widths(&limited, &session, 0.0));
        let mut state = 571;
        for (run, exact) in session.runs.iter_mut().zip(exact) {
            run.output = exact.into_iter().map(|value| value + 0.003 * deviate(&mut state)).collect();
        }
        let found = polish(&bare.with(drooping, vec![0.72, 15.0]), &session, Scope::Fit, 30).model;
        let own = half_widths(&found, &session, 0.0);
        let least = objective(&found, &mut Workspace::new(&session), Scope::Fit);
        let wide = half_widths_over_forms(&found, &session, least);
        let far = (found.slots[0].parameters[0] - 0.7).abs();
        assert!(own[0] < far && wide[0] >= far, "{far}: {own:?}, {wide:?}");
    }

    #[test]
    fn intervals_of_a_law_that_is_the_rigs_hold_its_parameter_whatever_the_colour_of_the_noise() {
        let (white, narrow) = held(0.0);
        let (coloured, wide) = held(0.9);
        // With 95 % each, fewer than ten of twelve come out once in fifty.
        assert!(white >= 10 && coloured >= 10, "{white} and {coloured} of twelve hold the truth; half widths {narrow} and {wide}");
        // Noise that is correlated over ten samples tells less, and none so little that the interval says nothing.
        assert!(wide > 1.5 * narrow && wide < 0.1, "half widths over the lag: {narrow} and {wide}");
    }
}
