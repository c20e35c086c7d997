//! Effects that a laboratory writes itself, as a TOML file, in one of four shapes; they take part in everything as the built-in ones do.
//!
//! | shape | law | what it does |
//! |---|---|---|
//! | `static-map` | `f(u)` | replaces the pressure, or adds a column of the model's own output |
//! | `first-order` | `dx/dt = f(u, x)`, per s | the state `x` replaces the pressure, or is a column beside the output |
//! | `threshold` | `f(u, rate)` | multiplies the thresholds of all play operators |
//! | `column` | `f(u, rate, t, session)` | adds a column to the output |
//!
//! `u` is the signal at that place over its span: the pressure, or on the displacement's side the model's own output. `rate` is the size of
//! its change, spans per s; `t` is the time since the recording began and `session` since the session did, s. Columns have a weight of their
//! own, which is fitted and may be negative. A law sees no measured output.

use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

use exmex::{Express, FlatEx};
use serde::Deserialize;

pub use crate::chain::definition::{Definition, Shape, Side, Unit};

use crate::chain::columns::Columns;
use crate::chain::filters::{ladder, with};
use crate::chain::form::{Form, OperatorLaw, Parameter, Place, Quantity, Spec, ThresholdLaw};
use crate::data::session::{Run, Session};

/// Steps of a first-order law inside a sample.
const STEPS: usize = 4;

/// Points of the grid from which the search of the parameters begins, at most.
const MOST_STARTS: usize = 48;

/// Longest law, characters: longer ones are no law that a person wrote.
const LONGEST_LAW: usize = 500;

/// What stands for a value that a law does not have, in spans: so far off that no fit takes it for an explanation.
const FAR: f64 = 1e6;

/// Most parameters: a grid of more is too coarse to find anything.
const MOST_PARAMETERS: usize = 4;

/// A file of effects: `[[effect]]` tables.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    effect: Vec<Definition>,
}

/// What can be wrong with an effect of a file.
#[derive(Debug, thiserror::Error)]
pub enum DefinitionError {
    /// The file cannot be read.
    #[error("{}: cannot be read ({problem}); check the path", path.display())]
    Open {
        /// Which file.
        path: PathBuf,
        /// Why.
        problem: String,
    },
    /// It is no list of effects.
    #[error("{}: {problem}", path.display())]
    Parse {
        /// Which file.
        path: PathBuf,
        /// Why.
        problem: String,
    },
    /// An effect makes no sense.
    #[error("the effect {name:?}: {problem}")]
    Effect {
        /// Which effect.
        name: String,
        /// What is wrong and what would be right.
        problem: String,
    },
}

impl Definition {
    /// Reads the effects of a file.
    ///
    /// # Errors
    /// When the file cannot be read or an effect makes no sense.
    pub fn read(path: &Path) -> Result<Vec<&'static dyn Form>, DefinitionError> {
        let text = output::read_text(path).map_err(|error| DefinitionError::Open { path: path.into(), problem: error.to_string() })?;
        let file: File = toml::from_str(&text).map_err(|error| DefinitionError::Parse { path: path.into(), problem: error.to_string() })?;
        file.effect.iter().map(Self::form).collect()
    }

    /// The form of this definition; equal definitions have one form.
    ///
    /// # Errors
    /// When it makes no sense.
    pub fn form(&self) -> Result<&'static dyn Form, DefinitionError> {
        static KNOWN: Mutex<Vec<&'static OfAFile>> = Mutex::new(Vec::new());
        let mut known = KNOWN.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(form) = known.iter().find(|form| form.0.definition == *self) {
            return Ok(*form);
        }
        let problem = |problem: String| DefinitionError::Effect { name: self.name.clone(), problem };
        // Forms live as long as the program: models refer to them from everywhere, and there are as many as files name.
        let law: &'static Law = Box::leak(Box::new(Law::new(self).map_err(problem)?));
        let form: &'static OfAFile = Box::leak(Box::new(OfAFile(law)));
        known.push(form);
        Ok(form)
    }
}

/// An effect of a file, ready to run.
struct OfAFile(&'static Law);

/// What it does.
struct Law {
    definition: Definition,
    name: &'static str,
    form: &'static str,
    parameters: &'static [Parameter],
    law: FlatEx<f64>,
    /// What each variable of the law is.
    variables: Vec<Variable>,
}

/// A variable of a law.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Variable {
    Signal,
    State,
    Rate,
    Time,
    Session,
    Parameter(usize),
}

/// What a law sees at a sample.
#[derive(Clone, Copy, Debug, Default)]
struct Sight {
    signal: f64,
    state: f64,
    rate: f64,
    time_s: f64,
    session_s: f64,
}

impl Law {
    fn new(definition: &Definition) -> Result<Self, String> {
        let is_word =
            |text: &str| !text.is_empty() && text.chars().all(|one| one.is_ascii_lowercase() || one.is_ascii_digit() || one == '-');
        if !is_word(&definition.name) {
            return Err("a name is lower-case letters, digits and hyphens, as `dead-time`".to_owned());
        }
        if definition.parameters.len() > MOST_PARAMETERS {
            return Err(format!("{} parameters are too many to be searched; {MOST_PARAMETERS} at most", definition.parameters.len()));
        }
        if definition.law.len() > LONGEST_LAW {
            return Err(format!("the law has {} characters; {LONGEST_LAW} at most", definition.law.len()));
        }
        let mut parameters = Vec::new();
        for (name, range) in &definition.parameters {
            if !(range.low.is_finite() && range.high.is_finite() && range.low < range.high) {
                return Err(format!("the range of {name} is {} to {}; low must be less than high, both finite", range.low, range.high));
            }
            if VARIABLES.iter().any(|(variable, _)| variable == name) {
                return Err(format!("{name} is a variable of laws already; give the parameter another name"));
            }
            let quantity = match range.unit {
                Unit::Ratio => Quantity::Ratio,
                Unit::S => Quantity::Time,
                Unit::Hz => Quantity::Frequency,
                Unit::Input => Quantity::Input,
                Unit::Output => Quantity::Output,
            };
            let name: &'static str = Box::leak(name.clone().into_boxed_str());
            parameters.push(Parameter { name, quantity, low: range.low, high: range.high, logarithmic: range.low > 0.0 });
        }
        let law: FlatEx<f64> = exmex::parse(&definition.law).map_err(|error| {
            let law = &definition.law;
            format!(
                "the law `{law}` cannot be read: {error}; it may have numbers, + - * / ^, parentheses, and functions such as sin, exp, abs"
            )
        })?;
        let allowed: &[Variable] = match definition.shape {
            Shape::StaticMap => &[Variable::Signal],
            Shape::FirstOrder => &[Variable::Signal, Variable::State],
            Shape::Threshold => &[Variable::Signal, Variable::Rate],
            Shape::Column => &[Variable::Signal, Variable::Rate, Variable::Time, Variable::Session],
        };
        let known = || {
            let variables = VARIABLES.iter().filter(|(_, variable)| allowed.contains(variable)).map(|(name, _)| *name);
            variables.chain(parameters.iter().map(|parameter| parameter.name)).collect::<Vec<_>>().join(", ")
        };
        let mut variables = Vec::new();
        for name in law.var_names() {
            let variable =
                VARIABLES.iter().find(|(known, variable)| known == name && allowed.contains(variable)).map(|(_, variable)| *variable);
            let parameter = parameters.iter().position(|parameter| parameter.name == name).map(Variable::Parameter);
            variables.push(variable.or(parameter).ok_or_else(|| format!("the law has {name}, which is none of {}", known()))?);
        }
        if let Some(unused) = (0..parameters.len()).find(|&at| !variables.contains(&Variable::Parameter(at))) {
            return Err(format!("the parameter {} is not in the law", parameters[unused].name));
        }
        let [name, form] = [&definition.name, &definition.form].map(|text| -> &'static str { Box::leak(text.clone().into_boxed_str()) });
        let form =
            Self { definition: definition.clone(), name, form, parameters: Box::leak(parameters.into_boxed_slice()), law, variables };
        let middle: Vec<f64> = form.parameters.iter().map(|parameter| 0.5 * (parameter.low + parameter.high)).collect();
        let sight = Sight { signal: 0.5, state: 0.5, rate: 1.0, time_s: 1.0, session_s: 1.0 };
        if form.value(&middle, &sight).abs() >= FAR {
            return Err("the law has no finite value in the middle of its parameters' ranges at half of the span".to_owned());
        }
        Ok(form)
    }

    fn value(&self, parameters: &[f64], sight: &Sight) -> f64 {
        let mut values = [0.0; MOST_PARAMETERS + VARIABLES.len()];
        for (value, variable) in values.iter_mut().zip(&self.variables) {
            *value = match *variable {
                Variable::Signal => sight.signal,
                Variable::State => sight.state,
                Variable::Rate => sight.rate,
                Variable::Time => sight.time_s,
                Variable::Session => sight.session_s,
                Variable::Parameter(at) => parameters[at],
            };
        }
        let value = self.law.eval(&values[..self.variables.len()]).unwrap_or(f64::NAN);
        // Sums of squares take what is no number for nothing.
        if value.is_finite() { value.clamp(-FAR, FAR) } else { FAR }
    }

    /// What a law without operators makes of a signal.
    fn follow(&self, parameters: &[f64], run: &Run, signal: &[f64]) -> Vec<f64> {
        let mut state = signal.first().copied().unwrap_or(0.0);
        let mut last = state;
        let step_s = run.period_s / STEPS as f64;
        let of = |(sample, &signal): (usize, &f64)| {
            let rate = (signal - last).abs() / run.period_s;
            let before = std::mem::replace(&mut last, signal);
            let sight = Sight { signal, state, rate, time_s: run.time_s[sample], session_s: run.session_s[sample] };
            if self.definition.shape != Shape::FirstOrder {
                return self.value(parameters, &sight);
            }
            if sample > 0 {
                // Midpoint rule; the signal goes straight from sample to sample.
                for step in 0..STEPS {
                    let at = |share: f64| before + (signal - before) * (step as f64 + share) / STEPS as f64;
                    let slope = self.value(parameters, &Sight { signal: at(0.0), state, ..sight });
                    state += step_s * self.value(parameters, &Sight { signal: at(0.5), state: state + 0.5 * step_s * slope, ..sight });
                    state = state.clamp(-FAR, FAR);
                }
            }
            state
        };
        signal.iter().enumerate().map(of).collect()
    }
}

/// Names of the variables.
const VARIABLES: [(&str, Variable); 5] =
    [("u", Variable::Signal), ("x", Variable::State), ("rate", Variable::Rate), ("t", Variable::Time), ("session", Variable::Session)];

impl ThresholdLaw for Law {
    fn factor(&self, parameters: &[f64], input: f64, rate_per_s: f64) -> f64 {
        self.value(parameters, &Sight { signal: input, rate: rate_per_s, ..Sight::default() })
    }
    fn has_rate(&self) -> bool {
        self.variables.contains(&Variable::Rate)
    }
}

impl Form for OfAFile {
    fn spec(&self) -> Spec {
        let Definition { shape, side, .. } = self.0.definition;
        let place = match (shape, side) {
            (Shape::Threshold, _) => Place::Operators,
            (Shape::Column, _) => Place::Sensor,
            (_, Side::Pressure) => Place::Muscle,
            (_, Side::Displacement) => Place::Material,
        };
        Spec {
            parameters: self.0.parameters,
            weights: usize::from(place > Place::Operators),
            is_static: shape == Shape::StaticMap,
            needs_sum: place == Place::Material,
            ..Spec::new(self.0.name, (self.0.form, self.0.form), place)
        }
    }
    fn definition(&self) -> Option<&Definition> {
        Some(&self.0.definition)
    }
    fn starts(&self, _: &Session, _: &[Vec<f64>]) -> Vec<Vec<f64>> {
        let count = self.0.parameters.len() as u32;
        let points = (2..=8).rev().find(|points: &usize| points.pow(count) <= MOST_STARTS).unwrap_or(2);
        let mut starts = vec![Vec::new()];
        for parameter in self.0.parameters {
            let values = if parameter.logarithmic {
                // Not the limits themselves: there a search has nowhere to go.
                let margin = (parameter.high / parameter.low).powf(0.5 / points as f64);
                ladder(parameter.low * margin, parameter.high / margin, points)
            } else {
                let at = |point: usize| parameter.low + (parameter.high - parameter.low) * (point as f64 + 0.5) / points as f64;
                (0..points).map(at).collect()
            };
            starts = with(starts, &values);
        }
        starts
    }
    fn input(&self, parameters: &[f64], run: &Run, path: &mut [f64]) {
        if self.spec().place == Place::Muscle {
            let followed = self.0.follow(parameters, run, path);
            path.copy_from_slice(&followed);
        }
    }
    fn operator_law(&self, parameters: &[f64], operator_law: &mut OperatorLaw) {
        if self.0.definition.shape == Shape::Threshold {
            operator_law.set_law(self.0, parameters);
        }
    }
    fn output(&self, parameters: &[f64], run: &Run, sum: &[f64], columns: &mut Columns) {
        let signal = match self.spec().place {
            Place::Material => sum,
            Place::Sensor => &run.input,
            _ => return,
        };
        let column = self.0.follow(parameters, run, signal);
        columns.push(true, |sample| column[sample]);
    }
}
