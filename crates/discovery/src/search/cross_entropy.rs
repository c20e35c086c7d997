//! Down a narrow valley among many: points are drawn from a normal distribution, which then moves to the best fifth of them and takes their shape (the
//! cross-entropy method, Rubinstein 1999; that their shape is taken from half way, so that a cloud that moves stays wide, after Hansen 2016).
//! A simplex ends in the nearest valley, and points about the best so far know nothing of how the valley lies.

use statrs::distribution::{ContinuousCDF, Normal};

use crate::data::session::Session;
use crate::model::line::Line;
use crate::model::structure::{Model, Scope};
use crate::model::workspace::Workspace;
use crate::search::parallel::in_parallel;
use crate::search::simplex::{indices_of, objective};

/// Points of a round, and the best of them.
const POINTS: (usize, usize) = (40, 8);

/// Standard deviation at first, in first steps of each parameter.
const SPREAD: f64 = 3.0;

/// Rounds after which the better half of the clouds goes on (successive halving, Karnin et al. 2013), and how many the last two have in all.
const ROUNDS: (usize, usize) = (3, 20);

/// Points about the best, of all parameters of a slot.
#[derive(Clone)]
struct Cloud {
    /// The best point drawn so far, and what it leaves of the fitted samples.
    model: Model,
    square: f64,
    line: Line,
    centre: Vec<f64>,
    /// The covariance is the sum of their squares: a step along each parameter at first, then from where the cloud was half way to each of the best points.
    directions: Vec<Vec<f64>>,
    drawn: u32,
}

/// Ratio of the steps of an even sequence in as many dimensions as there are best points, `x^9 = x + 1` (Roberts 2018).
const RATIO: f64 = 1.085_070_245_491_450_8;

impl Cloud {
    fn about(model: &Model, slot: usize) -> Self {
        let line = Line::of(model, &indices_of(model, slot));
        let centre = line.begin();
        let along = |axis: usize| (0..centre.len()).map(|other| if other == axis { SPREAD } else { 0.0 }).collect();
        let directions = (0..centre.len()).map(along).collect();
        Self { model: model.clone(), square: f64::INFINITY, line, centre, directions, drawn: 0 }
    }

    fn contract(&mut self, rounds: usize, workspace: &mut Workspace<'_>) {
        for _ in 0..rounds {
            let mut points: Vec<(f64, Vec<f64>)> = (0..POINTS.0).map(|_| self.draw(workspace)).collect();
            points.sort_by(|x, y| x.0.total_cmp(&y.0));
            // It moves to the best points and takes their shape.
            let (elite, count) = (&points[..POINTS.1], POINTS.1 as f64);
            let mean = |axis: usize| elite.iter().map(|(_, point)| point[axis]).sum::<f64>() / count;
            let centre: Vec<f64> = (0..self.centre.len()).map(mean).collect();
            let half_way = || self.centre.iter().zip(&centre).map(|(old, new)| 0.5 * (old + new));
            let direction = |point: &Vec<f64>| point.iter().zip(half_way()).map(|(to, from)| (to - from) / count.sqrt()).collect();
            (self.directions, self.centre) = (elite.iter().map(|(_, point)| direction(point)).collect(), centre);
        }
    }

    /// A point and what it leaves; the best is kept.
    fn draw(&mut self, workspace: &mut Workspace<'_>) -> (f64, Vec<f64>) {
        self.drawn += 1;
        let (normal, mut point) = (Normal::standard(), self.centre.clone());
        for (direction, power) in self.directions.iter().zip(1..) {
            let deviate = normal.inverse_cdf((f64::from(self.drawn) * RATIO.powi(-power)).fract());
            point.iter_mut().zip(direction).for_each(|(value, along)| *value += deviate * along);
        }
        let mut model = self.model.clone();
        self.line.put(&mut model, &point);
        let square = objective(&model, workspace, Scope::Fit);
        if square < self.square {
            (self.square, self.model) = (square, model);
        }
        (square, point)
    }
}

/// The best point about these models, which differ in the parameters of their narrow form, if any soon leaves less of the fitted samples than `bar`.
pub fn search(models: &[Model], bar: f64, session: &Session, threads: usize) -> Option<Model> {
    let slot = models.first()?.slots.iter().position(|slot| slot.form.spec().is_narrow)?;
    let halved = |clouds: &[Cloud], rounds: usize| {
        let mut better = in_parallel(clouds, threads, |cloud| {
            let mut cloud = cloud.clone();
            cloud.contract(rounds, &mut Workspace::new(session));
            cloud
        });
        better.retain(|cloud| cloud.square < bar);
        better.sort_by(|x, y| x.square.total_cmp(&y.square));
        better.truncate(clouds.len().div_ceil(2));
        better
    };
    let (mut clouds, mut further) = (models.iter().map(|model| Cloud::about(model, slot)).collect::<Vec<Cloud>>(), ROUNDS.1);
    while clouds.len() > 2 {
        clouds = halved(&clouds, ROUNDS.0);
        further = further.saturating_sub(ROUNDS.0);
    }
    halved(&clouds, further).pop().map(|cloud| cloud.model)
}
