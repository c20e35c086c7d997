//! What an effect must say of itself: its place in the chain, its parameters, its law.

use std::collections::BTreeMap;

use crate::chain::columns::Columns;
use crate::chain::definition::Definition;
use crate::data::session::{Run, Session};

/// What a parameter is measured in, so that the normalised value can be told in the lab's units.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Quantity {
    /// Time, s.
    Time,
    /// Frequency, Hz.
    Frequency,
    /// A value of the input.
    Input,
    /// A change of the input per s.
    InputRate,
    /// A value of the output.
    Output,
    /// A change of the output per s.
    OutputRate,
    /// A number.
    Ratio,
    /// A number per unit of input.
    PerInput,
}

/// One non-linear parameter of a form.
#[derive(Clone, Copy, Debug)]
pub struct Parameter {
    /// Name without unit.
    pub name: &'static str,
    /// Quantity.
    pub quantity: Quantity,
    /// Smallest value, normalised.
    pub low: f64,
    /// Largest value, normalised.
    pub high: f64,
    /// Whether it is searched in its logarithm; then both limits are positive.
    pub logarithmic: bool,
}

impl Parameter {
    /// Where a value lies between the limits, 0 to 1.
    #[must_use]
    pub fn share(&self, value: f64) -> f64 {
        let on_the_scale = |value: f64| if self.logarithmic { value.ln() } else { value };
        let (low, high) = (on_the_scale(self.low), on_the_scale(self.high));
        (on_the_scale(value.clamp(self.low, self.high)) - low) / (high - low)
    }

    /// Name with unit and value in that unit.
    #[must_use]
    pub fn tell(&self, value: f64, session: &Session) -> (String, f64) {
        let (input, output) = (&session.input_unit, &session.output_unit);
        match self.quantity {
            Quantity::Time => (format!("{}_s", self.name), value),
            Quantity::Frequency => (format!("{}_hz", self.name), value),
            Quantity::Input => (format!("{}_{input}", self.name), value * session.input_scale + session.input_offset),
            Quantity::InputRate => (format!("{}_{input}_per_s", self.name), value * session.input_scale),
            Quantity::Output => (format!("{}_{output}", self.name), value * session.output_scale.abs()),
            Quantity::OutputRate => (format!("{}_{output}_per_s", self.name), value * session.output_scale.abs()),
            Quantity::Ratio => (self.name.to_owned(), value),
            Quantity::PerInput => (format!("{}_per_{input}", self.name), value / session.input_scale),
        }
    }
}

/// How the play operators deviate from plain ones; all zero is plain.
#[derive(Clone, Copy, Default)]
pub struct OperatorLaw {
    /// Thresholds grow by this per unit of input.
    pub growth_per_input: f64,
    /// Thresholds of the unloading branch alone grow by this more per unit of input.
    pub growth_unloading: f64,
    /// Loading and unloading envelopes part by these times `v`, `v (1 - v)` and `v (1 - v) (1 - 2 v)`.
    pub envelopes: [f64; 3],
    /// Thresholds grow by this times their size times the rate, or its inverse hyperbolic sine.
    pub growth_per_rate: f64,
    /// Thresholds grow by this times the rate or its inverse hyperbolic sine, whatever their size.
    pub extra_per_rate: f64,
    /// Rate above which growth is logarithmic instead of in proportion, spans per s; zero for in proportion at any rate.
    pub rate_scale_per_s: f64,
    /// Time constant with which what the rate does builds up and fades, s; zero when it follows at once.
    pub rate_memory_s: f64,
    /// Operators follow their bounds with this time constant, s: the one whose threshold is a tenth of the span.
    pub viscous_s: f64,
    /// Power of the threshold that the time constants of the others go with.
    pub viscous_power: f64,
    /// Distance from its bound at which an operator is twice as fast as in proportion; zero when it stays in proportion.
    pub stiffening: f64,
    /// A law of the thresholds that somebody else has written, with its parameters.
    pub law: Option<(&'static dyn ThresholdLaw, [f64; LAW_PARAMETERS])>,
}

/// Threshold, in spans, of the operator that a viscous law's time constant is of.
const VISCOUS_AT: f64 = 0.1;

/// Most parameters of a [`ThresholdLaw`].
pub const LAW_PARAMETERS: usize = 4;

/// A law of the operators' thresholds.
pub trait ThresholdLaw: Sync {
    /// What thresholds are multiplied by at an input (over its span) and at the size of its rate (spans per s).
    fn factor(&self, parameters: &[f64], input: f64, rate_per_s: f64) -> f64;
    /// Whether the rate has a part in it.
    fn has_rate(&self) -> bool;
}

impl OperatorLaw {
    /// Whether the operators are plain ones.
    #[must_use]
    pub fn is_plain(&self) -> bool {
        let own = [
            self.growth_per_input,
            self.growth_unloading,
            self.growth_per_rate,
            self.extra_per_rate,
            self.rate_memory_s,
            self.viscous_s,
            self.stiffening,
        ];
        self.law.is_none() && own.iter().chain(&self.envelopes).all(|value| *value == 0.0)
    }

    /// What an operator of this threshold goes of the way to its bound in so many seconds.
    #[must_use]
    pub fn followed(&self, threshold: f64, seconds: f64) -> f64 {
        -(-seconds / (self.viscous_s * (threshold / VISCOUS_AT).powf(self.viscous_power))).exp_m1()
    }

    /// What growth goes with at a rate: the rate itself, or Eyring's inverse hyperbolic sine of it.
    #[must_use]
    pub fn saturated(&self, rate_per_s: f64) -> f64 {
        if self.rate_scale_per_s > 0.0 { (rate_per_s / self.rate_scale_per_s).asinh() } else { rate_per_s }
    }

    /// Lets thresholds follow a law.
    pub fn set_law(&mut self, law: &'static dyn ThresholdLaw, parameters: &[f64]) {
        let mut padded = [0.0; LAW_PARAMETERS];
        padded.iter_mut().zip(parameters).for_each(|(own, value)| *own = *value);
        self.law = Some((law, padded));
    }

    /// What its law multiplies thresholds by.
    #[must_use]
    pub fn factor(&self, input: f64, rate_per_s: f64) -> f64 {
        self.law.map_or(1.0, |(law, parameters)| law.factor(&parameters, input, rate_per_s))
    }

    /// Whether the operators' states hang on how fast they went: turning points do not tell them.
    #[must_use]
    pub fn hangs_on_rates(&self) -> bool {
        let has_law = self.law.is_some_and(|(law, _)| law.has_rate());
        has_law || self.growth_per_rate != 0.0 || self.extra_per_rate != 0.0 || self.viscous_s != 0.0
    }
}

/// Where in the chain a form acts, in the order of the signal.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Place {
    /// Supply and valve, before everything.
    Supply,
    /// The valve's flow.
    Flow,
    /// The tube.
    Tube,
    /// The muscle's bladder and braid.
    Muscle,
    /// The hysteresis itself.
    Operators,
    /// The material behind the hysteresis.
    Material,
    /// Friction and inertia of the tip.
    Tip,
    /// What is added on the way to the sensor.
    Sensor,
    /// What is read from the measured output itself: it comes last, and knows all that the others expect.
    Reading,
}

/// A key for files, in lower case with hyphens, and a sentence for people.
pub type Told = (&'static str, &'static str);

/// Forms, each with parameters.
pub type Limits = Vec<(&'static dyn Form, Vec<f64>)>;

/// What a form says of itself.
#[derive(Clone, Copy, Debug)]
pub struct Spec {
    /// Name of the effect, from the vocabulary.
    pub name: &'static str,
    /// What distinguishes this form from others of the effect: a key for files, and a sentence for people.
    pub form: Told,
    /// Where it acts.
    pub place: Place,
    /// Non-linear parameters.
    pub parameters: &'static [Parameter],
    /// Where to begin the search, where that does not hang on the session.
    pub starts: fn() -> Vec<Vec<f64>>,
    /// First step of the search around a start for each parameter (the last one for all further), in the logarithm or in a quarter of the range.
    pub steps: &'static [f64],
    /// Parameters (by their numbers) and values at which its law is a simpler one that lacks them: no limits of the search, and for free.
    pub simpler_at: &'static [(usize, f64)],
    /// What [`Form::nested_limits`] says, where that hangs on the parameters alone.
    pub nested_limits: fn(&[f64]) -> Limits,
    /// Number of linear weights that it adds.
    pub weights: usize,
    /// Number of parameters it counts as when effects compete, where these are not its parameters and weights.
    pub cost: Option<usize>,
    /// Whether the valley of its search is much narrower than any grid: no round tries it, it has a search of its own.
    pub is_narrow: bool,
    /// Whether its input path has no memory.
    pub is_static: bool,
    /// Whether it leaves the turning points of the input as they are.
    pub keeps_turning_points: bool,
    /// Whether its parameters are searched on the grid only, and there by all samples that are not kept out.
    pub discrete: bool,
    /// What it breaks away by, if its stick position is seen in the output: such a form is tried when nothing smooth explains enough, and judged by
    /// what the output shows.
    pub jumps: Option<Drive>,
    /// Whether it reads values from every recording that it explains, those included that judge it. Coloured noise gives way to any such form by a
    /// little: a gain must be worth its price beside everything else.
    pub reads_output: bool,
    /// Whether what it does differs between recordings rather than within them: with few recordings it has as many values as there are recordings.
    pub is_between_recordings: bool,
    /// Whether it is a zero that each recording has of its own: what it reads then counts from the constant.
    pub is_a_zero: bool,
    /// Whether a stick position that is seen in the output feels what the sensor's effects add.
    pub feels_sensor: bool,
    /// Whether it needs the model's own output.
    pub needs_sum: bool,
}

impl Spec {
    /// A form that has no parameters and does nothing special.
    #[must_use]
    pub const fn new(name: &'static str, form: Told, place: Place) -> Self {
        Self {
            name,
            form,
            place,
            parameters: &[],
            starts: || vec![Vec::new()],
            steps: &[0.15],
            simpler_at: &[],
            nested_limits: |_| Vec::new(),
            weights: 0,
            cost: None,
            is_narrow: false,
            is_static: false,
            keeps_turning_points: false,
            discrete: false,
            jumps: None,
            reads_output: false,
            is_between_recordings: false,
            is_a_zero: false,
            feels_sensor: false,
            needs_sum: false,
        }
    }
}

/// One form of an effect: what it says of itself and what it does to the signals. All values are normalised; the defaults do nothing.
pub trait Form: Sync {
    /// What it says of itself.
    fn spec(&self) -> Spec;
    /// Its definition, where it is one of a file: a model then carries it along.
    fn definition(&self) -> Option<&Definition> {
        None
    }
    /// Simpler effects that it has come near with these parameters, in the form and with the parameters that come nearest.
    fn nested_limits(&self, parameters: &[f64]) -> Limits {
        (self.spec().nested_limits)(parameters)
    }
    /// Places in the session at which it changes everything, by the recordings' numbers.
    fn changes_at<'a>(&self, _parameters: &'a [f64]) -> &'a [f64] {
        &[]
    }
    /// Where to begin the search.
    fn starts(&self, _session: &Session, _residual: &[Vec<f64>]) -> Vec<Vec<f64>> {
        (self.spec().starts)()
    }
    /// Seconds of measured output, at the start of a recording, from which a simulation reads what the recording has of its own; zero when
    /// nothing is read.
    fn start_up_s(&self, _parameters: &[f64]) -> f64 {
        0.0
    }
    /// Changes the input path, if it leads the operators.
    fn input(&self, _parameters: &[f64], _run: &Run, _path: &mut [f64]) {}
    /// Changes the input paths of several recordings as [`Self::input`] does one by one, side by side where that is faster.
    fn inputs(&self, parameters: &[f64], runs: &[&Run], paths: &mut [Vec<f64>]) {
        for (run, path) in runs.iter().zip(paths) {
            self.input(parameters, run, path);
        }
    }
    /// Changes the operators, if it leads them.
    fn operator_law(&self, _parameters: &[f64], _law: &mut OperatorLaw) {}
    /// Changes all columns, or adds some; `sum` is the model's output without constant (with it where a stick position or a zero is read from the output).
    fn output(&self, _parameters: &[f64], _run: &Run, _sum: &[f64], _columns: &mut Columns) {}
    /// What weights and parameters mean together, in the lab's units, beside the parameters themselves.
    fn tell(&self, _parameters: &[f64], _weights: &[f64], _session: &Session) -> BTreeMap<String, f64> {
        BTreeMap::new()
    }
}

/// A form that is nothing but a law of the operators, perhaps beside a curve of the input that both branches share.
pub struct OfOperators {
    /// What it says of itself.
    pub spec: Spec,
    /// Sets the law.
    pub set: fn(&[f64], &mut OperatorLaw),
    /// Changes the input.
    pub curve: fn(&[f64], &mut [f64]),
}

impl OfOperators {
    /// A law alone.
    #[must_use]
    pub const fn new(
        (name, form): (&'static str, Told),
        parameters: &'static [Parameter],
        starts: fn() -> Vec<Vec<f64>>,
        set: fn(&[f64], &mut OperatorLaw),
    ) -> Self {
        Self { spec: Spec { parameters, starts, ..Spec::new(name, form, Place::Operators) }, set, curve: |_, _| {} }
    }
}

impl Form for OfOperators {
    fn spec(&self) -> Spec {
        self.spec
    }
    fn input(&self, parameters: &[f64], _: &Run, path: &mut [f64]) {
        (self.curve)(parameters, path);
    }
    fn operator_law(&self, parameters: &[f64], law: &mut OperatorLaw) {
        (self.set)(parameters, law);
    }
}

impl dyn Form + '_ {
    /// Name of the effect.
    pub fn name(&self) -> &'static str {
        self.spec().name
    }
    /// Key of this form in files: name and key together belong to one form.
    pub fn key(&self) -> &'static str {
        self.spec().form.0
    }
    /// What distinguishes this form.
    pub fn form(&self) -> &'static str {
        self.spec().form.1
    }
    /// Where it acts.
    pub fn place(&self) -> Place {
        self.spec().place
    }
    /// Non-linear parameters.
    pub fn parameters(&self) -> &'static [Parameter] {
        self.spec().parameters
    }
    /// Number of parameters it counts as when effects compete.
    pub fn cost(&self) -> usize {
        let spec = self.spec();
        spec.cost.unwrap_or(spec.parameters.len() + spec.weights)
    }
    /// Whether it does without a parameter that lies between these values, as good as: there the law is a simpler one.
    pub fn does_without(&self, parameter: usize, between: [f64; 2]) -> bool {
        /// Share of a range that makes no difference.
        const NEARLY: f64 = 0.05;
        self.spec().simpler_at.iter().filter(|simpler| simpler.0 == parameter).any(|&(_, simple)| {
            let [low, high, simple] = [between[0], between[1], simple].map(|value| self.parameters()[parameter].share(value));
            low - NEARLY < simple && simple < high + NEARLY
        })
    }
    /// First step of the search for one parameter.
    pub fn step(&self, parameter: usize) -> f64 {
        let steps = self.spec().steps;
        steps[parameter.min(steps.len() - 1)]
    }
    /// What it breaks away by, if it does.
    pub fn jumps(&self) -> Option<Drive> {
        self.spec().jumps
    }
    /// Whether operators that remember earlier recordings must be told what it made of all of them, not of their turning points alone. A
    /// delay changes none of these.
    pub fn follows_history(&self) -> bool {
        let spec = self.spec();
        spec.place < Place::Operators && !spec.is_static && !spec.keeps_turning_points
    }
    /// Whether what it does shows in the operators' columns: it changes the input path or the operators. What only adds columns or filters
    /// all of them does not, and the operators' columns are kept while such a form is searched.
    pub fn leads_operators(&self) -> bool {
        self.place() <= Place::Operators || self.jumps().is_some()
    }
}

/// What a stick position is compared with to break away.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Drive {
    /// The quasi-static response of the model: a tip that sticks.
    QuasiStatic,
    /// The command: a valve with a dead band.
    Command,
}

/// The form of a lag that stands for a valve that is never shut.
pub const FOLLOWING: Told = ("never-shut", "behind a valve that is never shut");
