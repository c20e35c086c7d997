//! What a model must satisfy before anything runs it: every number finite and bounded, every index inside its table.
//!
//! The bounds are far outside any sensible model and exist so that nothing downstream can overflow, divide by zero or index past an
//! end: with them the front end's signals stay finite in `f32` for any input.
//!
//! # Example
//! ```
//! use model_export::schema::{Channel, Curve, FrontEnd, Layer, Model, Network};
//! use model_export::validate::{Invalid, MAX_CHANNEL, MAX_PARAMETER, MIN_STOP_THRESHOLD};
//!
//! let pressure = Channel { quantity: "pressure", unit: "bar", scale: 3.0, maximum: 3.0, ..Channel::default() };
//! assert!(pressure.validate().is_ok());
//! let flat = Channel { scale: 0.5 / MAX_CHANNEL, ..pressure };
//! let Invalid { field, index, must } = flat.validate().unwrap_err();
//! assert_eq!((field, index, must), ("channel.scale", 0, "between 1e-12 and 1e12"));
//! assert_eq!(flat.validate().unwrap_err().to_string(), "channel.scale[0] must be between 1e-12 and 1e12");
//!
//! assert!(Curve { slope: 2.0 * MAX_PARAMETER, ..Curve::default() }.validate().is_err());
//! let no_lag = FrontEnd { lag_coefficient: 1.0, ..FrontEnd::default() };
//! assert!(no_lag.validate().is_ok());
//! assert!(FrontEnd { play_thresholds: [MIN_STOP_THRESHOLD].into_iter().collect(), ..no_lag }.validate().is_err(), "a weight is missing");
//! assert!(Network::default().validate(1).is_err(), "a network has a layer");
//! assert!(Network { layers: [Layer::default()].into_iter().collect(), ..Network::default() }.activation().is_ok());
//! assert!(Model::default().validate().is_err(), "a sample period is above zero");
//! ```

use crate::compensation::Extension;
use crate::fixed::{MAX_BIAS, MAX_CELL_EXPONENT, MAX_CELL_LIMIT, MAX_DENSE_SUM, MAX_HIDDEN_SHIFT};
pub use crate::invalid::{Invalid, MAX_PARAMETER};
use crate::invalid::{bounded, require};
use crate::schema::{
    Activation, Channel, Curve, FeatureSource, Filter, FrontEnd, Golden, Layer, MAX_DEAD_TIME_SAMPLES, MAX_GOLDEN, MAX_UNITS, MAX_WIDTH,
    MAX_WINDOW_VALUES, Mode, Model, Network, Stages,
};

/// Largest magnitude of an offset or scale of a physical channel; the reciprocal is the smallest scale.
pub const MAX_CHANNEL: f32 = 1.0e12;
/// Smallest positive threshold that a stop feature may divide by.
pub const MIN_STOP_THRESHOLD: f32 = 1.0e-6;
/// Most momentum of a [`Filter`], and the largest of its gains: with them nothing swings up beyond what `f32` holds.
const MAX_MOMENTUM: f32 = 0.9999;
const MAX_GAIN: f32 = 100.0;
/// How far the poles of a [`Filter`] stay from where it would no longer settle, in the value of their polynomial at 1 and at -1.
const MIN_DECAY: f32 = 1.0e-7;

impl Channel<'_> {
    /// Checks the map and the range.
    ///
    /// # Errors
    /// The first field that is not finite, not positive or not ordered.
    pub fn validate(&self) -> Result<(), Invalid> {
        let in_reach = |value: f32| value.abs() <= MAX_CHANNEL;
        require(in_reach(self.offset), "channel.offset", 0, "finite and at most 1e12 in magnitude")?;
        require(in_reach(self.scale) && self.scale >= 1.0 / MAX_CHANNEL, "channel.scale", 0, "between 1e-12 and 1e12")?;
        require(in_reach(self.minimum), "channel.minimum", 0, "finite and at most 1e12 in magnitude")?;
        require(in_reach(self.maximum), "channel.maximum", 0, "finite and at most 1e12 in magnitude")?;
        require(self.minimum <= self.maximum, "channel.minimum", 0, "at most the maximum")
    }
}

impl Curve {
    /// Checks every number and the order of the bends.
    ///
    /// # Errors
    /// The first field out of its domain.
    pub fn validate(&self) -> Result<(), Invalid> {
        bounded(&[self.offset], "front_end.curve.offset")?;
        bounded(&[self.slope], "front_end.curve.slope")?;
        bounded(&self.bend_points, "front_end.curve.bend_points")?;
        bounded(&self.bends, "front_end.curve.bends")?;
        require(self.bends.len() == self.bend_points.len(), "front_end.curve.bends", 0, "as many as there are bend points")?;
        for (index, pair) in self.bend_points.windows(2).enumerate() {
            require(matches!(pair, [low, high] if low < high), "front_end.curve.bend_points", index + 1, "ascending")?;
        }
        Ok(())
    }
}

impl Filter {
    /// Checks that it is stable.
    ///
    /// # Errors
    /// The first field out of its domain.
    pub fn validate(&self) -> Result<(), Invalid> {
        let (field, must) = ("front_end.stages.momentum", "at most 0.9999 in magnitude");
        require(self.momentum.abs() <= MAX_MOMENTUM, field, 0, must)?;
        let field = "front_end.stages.gains";
        for (index, gain) in self.gains.iter().enumerate() {
            require(gain.abs() <= MAX_GAIN, field, index, "at most 100 in magnitude")?;
        }
        let [now, before, long_before] = self.gains;
        let sum = now + before + long_before;
        require(sum >= MIN_DECAY && 2.0 * (1.0 + self.momentum) - sum >= MIN_DECAY, field, 0, "those of a filter that settles")
    }
}

impl Stages {
    /// Checks every stage.
    ///
    /// # Errors
    /// The first field out of its domain.
    pub fn validate(&self) -> Result<(), Invalid> {
        let coefficient = |value: f32| value > 0.0 && value <= 1.0;
        [&self.supply, &self.muscle].into_iter().flatten().try_for_each(Curve::validate)?;
        [&self.line, &self.tip].into_iter().flatten().try_for_each(Filter::validate)?;
        if let Some(flow) = &self.flow {
            flow.fill.validate()?;
            flow.vent.validate()?;
        }
        if let Some(growth) = &self.growth {
            growth.law.validate()?;
            bounded(&growth.per_path, "front_end.stages.per_path")?;
            bounded(&growth.apart, "front_end.stages.apart")?;
            bounded(&[growth.share, growth.extra], "front_end.stages.share")?;
            require(coefficient(growth.fading), "front_end.stages.fading", 0, "above 0 and at most 1")?;
            growth.follow.iter().try_for_each(Curve::validate)?;
        }
        Ok(())
    }
}

impl FrontEnd {
    /// Checks every coefficient, threshold and feature index.
    ///
    /// # Errors
    /// The first field out of its domain.
    pub fn validate(&self) -> Result<(), Invalid> {
        let coefficient = |value: f32| value > 0.0 && value <= 1.0;
        // Exact: 32 is representable.
        let longest = f32::from(u16::try_from(MAX_DEAD_TIME_SAMPLES).unwrap_or(u16::MAX));
        let dead_time = self.dead_time_samples;
        require((0.0..=longest).contains(&dead_time), "front_end.dead_time_samples", 0, "between 0 and 32")?;
        require(coefficient(self.lag_coefficient), "front_end.lag_coefficient", 0, "above 0 and at most 1")?;
        require((0.0..=MAX_PARAMETER).contains(&self.stick_band), "front_end.stick_band", 0, "0 or above and at most a million")?;
        bounded(&self.play_thresholds, "front_end.play_thresholds")?;
        bounded(&self.play_weights, "front_end.play_weights")?;
        bounded(&self.creep_weights, "front_end.creep_weights")?;
        bounded(&[self.input_weight], "front_end.input_weight")?;
        bounded(&[self.bias], "front_end.bias")?;
        if let Some(curve) = &self.curve {
            curve.validate()?;
        }
        if let Some(stages) = &self.stages {
            require(
                self.lag_coefficient >= 1.0,
                "front_end.lag_coefficient",
                0,
                "1 where there are stages: these have a lag of their own",
            )?;
            require(self.more_input_weights.is_empty(), "front_end.stages", 0, "none where there are several inputs")?;
            stages.validate()?;
        }
        let plays = self.play_thresholds.len();
        require(self.play_weights.len() == plays, "front_end.play_weights", 0, "as many as there are thresholds")?;
        let creeps = self.creep_coefficients.len();
        require(self.creep_weights.len() == creeps, "front_end.creep_weights", 0, "as many as there are creep coefficients")?;
        let mut least = 0.0;
        for (index, &threshold) in self.play_thresholds.iter().enumerate() {
            require(threshold >= least, "front_end.play_thresholds", index, "non-negative and ascending")?;
            least = threshold;
        }
        for (index, &value) in self.creep_coefficients.iter().enumerate() {
            require(coefficient(value), "front_end.creep_coefficients", index, "above 0 and at most 1")?;
        }
        bounded(&self.more_input_weights, "front_end.more_input_weights")?;
        let lists = [
            (&self.play_inputs[..], plays, "front_end.play_inputs"), //
            (&self.feature_inputs[..], self.features.len(), "front_end.feature_inputs"),
        ];
        for (list, length, field) in lists {
            require(list.is_empty() || list.len() == length, field, 0, "empty, or as many as there are operators or features")?;
            for (index, &input) in list.iter().enumerate() {
                require(usize::from(input) < self.inputs(), field, index, "an existing input")?;
            }
        }
        for (index, feature) in self.features.iter().enumerate() {
            bounded(&[feature.offset, feature.gain], "front_end.features")?;
            match feature.source {
                FeatureSource::Play(operator) => {
                    require(usize::from(operator) < plays, "front_end.features", index, "an existing play operator")?;
                }
                FeatureSource::Stop(operator) => {
                    let threshold = self.play_thresholds.get(usize::from(operator)).copied().unwrap_or(0.0);
                    require(
                        threshold >= MIN_STOP_THRESHOLD,
                        "front_end.features",
                        index,
                        "an existing operator with a positive threshold",
                    )?;
                }
                FeatureSource::Creep(filter) => {
                    require(usize::from(filter) < creeps, "front_end.features", index, "an existing creep filter")?;
                }
                FeatureSource::Past(age) => {
                    require(usize::from(age) <= MAX_DEAD_TIME_SAMPLES, "front_end.features", index, "at most 32 samples old")?;
                }
                FeatureSource::Input
                | FeatureSource::InputDifference
                | FeatureSource::Path
                | FeatureSource::PathDifference
                | FeatureSource::Readout => {}
            }
        }
        Ok(())
    }
}

impl Layer<'_> {
    fn validate(&self) -> Result<(), Invalid> {
        let (inputs, units) = (usize::from(self.inputs), usize::from(self.units));
        let (input_rows, recurrent_rows) = (self.cell.input_rows() * units, self.cell.recurrent_rows() * units);
        require((1..=MAX_WIDTH).contains(&inputs), "layer.inputs", 0, "between 1 and 64")?;
        require((1..=MAX_UNITS).contains(&units), "layer.units", 0, "between 1 and 64")?;
        require(self.input_weights.len() == input_rows * inputs, "layer.input_weights", 0, "as many bytes as rows and inputs make")?;
        require(
            self.recurrent_weights.len() == recurrent_rows * units,
            "layer.recurrent_weights",
            0,
            "as many bytes as rows and units make",
        )?;
        require(self.input_multipliers.len() == 4 * input_rows, "layer.input_multipliers", 0, "4 bytes a row long")?;
        require(self.recurrent_multipliers.len() == 4 * recurrent_rows, "layer.recurrent_multipliers", 0, "4 bytes a row long")?;
        require(self.biases.len() == 8 * units * self.cell.gates().len(), "layer.biases", 0, "8 bytes a gate and unit long")?;
        for (row, bytes) in self.biases.as_chunks::<8>().0.iter().enumerate() {
            require((-MAX_BIAS..=MAX_BIAS).contains(&i64::from_le_bytes(*bytes)), "layer.biases", row, "at most 2^61 in magnitude")?;
        }
        require(self.cell_exponent <= MAX_CELL_EXPONENT, "layer.cell_exponent", 0, "at most 7")?;
        let limit = self.cell_limit;
        require((2..=MAX_CELL_LIMIT).contains(&limit) && limit % 2 == 0, "layer.cell_limit", 0, "even and between 2 and 2^30")?;
        require((1..=MAX_HIDDEN_SHIFT).contains(&self.hidden_shift), "layer.hidden_shift", 0, "between 1 and 14")
    }
}

impl Network<'_> {
    /// The activation of the recurrent layers.
    ///
    /// # Errors
    /// When the code stands for none.
    pub fn activation(&self) -> Result<Activation, Invalid> {
        let must = "0 (tanh), 1 (relu) or 2 (hard)";
        Activation::from_code(self.activation_code).ok_or(Invalid { field: "network.activation", index: 0, must })
    }

    /// Checks every dimension and every number that the overflow proof rests on; `features` is what the front end offers.
    ///
    /// # Errors
    /// The first field out of its domain.
    pub fn validate(&self, features: usize) -> Result<(), Invalid> {
        self.activation()?;
        require(!self.layers.is_empty(), "network.layers", 0, "at least one")?;
        let mut width = features;
        for (index, layer) in self.layers.iter().enumerate() {
            layer.validate()?;
            require(usize::from(layer.inputs) == width, "network.layers", index, "as wide as what feeds it")?;
            width = usize::from(layer.units);
        }
        let dense = &self.dense;
        require(dense.weights.len() == 2 * width, "dense.weights", 0, "2 bytes a unit of the last layer long")?;
        let sum: u32 = dense.weights.as_chunks::<2>().0.iter().map(|bytes| u32::from(i16::from_le_bytes(*bytes).unsigned_abs())).sum();
        require(sum <= MAX_DENSE_SUM, "dense.weights", 0, "at most 65535 in the sum of magnitudes")?;
        bounded(&[dense.scale], "dense.scale")?;
        bounded(&[dense.bias], "dense.bias")
    }
}

impl Golden<'_> {
    fn validate(&self, inputs: usize) -> Result<(), Invalid> {
        let (samples, rest) = self.output.as_chunks::<4>();
        require(rest.is_empty() && samples.len() <= MAX_GOLDEN, "golden.output", 0, "at most 512 samples of 4 bytes")?;
        require(self.input.len() == inputs * self.output.len(), "golden.input", 0, "as long as the golden output, for each input")?;
        for (field, bytes) in [("golden.input", self.input), ("golden.output", self.output)] {
            for (index, sample) in bytes.as_chunks::<4>().0.iter().enumerate() {
                require(f32::from_le_bytes(*sample).is_finite(), field, index, "finite")?;
            }
        }
        require(self.tolerance >= 0.0 && self.tolerance.is_finite(), "golden.tolerance", 0, "finite and not negative")
    }
}

impl Model<'_> {
    /// Checks everything that running the model relies on.
    ///
    /// # Errors
    /// The first field out of its domain.
    pub fn validate(&self) -> Result<(), Invalid> {
        let period = self.sample_period_s;
        require(period.is_finite() && period > 0.0, "sample_period_s", 0, "finite and positive")?;
        self.input.validate()?;
        self.output.validate()?;
        self.more_inputs.iter().try_for_each(Channel::validate)?;
        self.front_end.validate()?;
        let weights = self.front_end.more_input_weights.len();
        require(weights == self.more_inputs.len(), "front_end.more_input_weights", 0, "as many as there are inputs beside the first")?;
        let features = self.front_end.features.len();
        if let Some(network) = &self.network {
            network.validate(features)?;
        }
        if let Mode::Window { length } = self.mode {
            let values = usize::from(length) * features;
            require(length > 0 && values <= MAX_WINDOW_VALUES, "mode.length", 0, "positive, and at most 1024 values with its features")?;
        }
        let metrics = &self.metrics;
        let figures = [metrics.validation_rmse, metrics.rmse_f32_vs_fixed, metrics.max_abs_f32_vs_fixed];
        for (index, value) in figures.iter().enumerate() {
            require(value.is_finite(), "metrics", index, "finite")?;
        }
        let envelope = &self.envelope;
        for (index, value) in [envelope.minimum, envelope.maximum, envelope.maximum_rate].iter().enumerate() {
            require(value.is_finite(), "envelope", index, "finite")?;
        }
        Extension::default().decode_into(self.extension)?;
        self.golden.validate(self.front_end.inputs())
    }
}
