//! What the programs run: samples of every kind, and resets in the middle.

use firmware::estimator::{Estimator, EstimatorState, MAX_NORMALISED};
use firmware::parity::{Excitation, Noise};
use model_export::schema::{Channel, Model};

/// Samples with resets.
#[derive(Clone, Debug)]
pub struct Script {
    /// Whether to reset first, and a value of each input.
    samples: Vec<(bool, Vec<f32>)>,
}

impl Script {
    /// Mostly a wandering signal with rests, jumps and samples that are no number; between that whatever 32 bits can be, the bounds of what
    /// is believed, and stretches far outside the range. The first sample after a reset is of any kind, too.
    pub fn new(model: &Model<'_>, seed: u32, samples: usize) -> Self {
        let channels = std::iter::once(&model.input).chain(&model.more_inputs).zip(seed..);
        let inputs: Vec<Vec<(bool, f32)>> = channels.map(|(channel, seed)| Self::of_input(channel, seed, samples)).collect();
        // The resets of the first input.
        let sample = |index: usize| (inputs[0][index].0, inputs.iter().map(|input| input[index].1).collect());
        Self { samples: (0..samples).map(sample).collect() }
    }

    fn of_input(input: &Channel<'_>, seed: u32, samples: usize) -> Vec<(bool, f32)> {
        let mut noise = Noise::new(seed ^ 0x00c0_ffee);
        let mut excitation = Excitation::new(input.minimum, input.maximum, seed);
        let bounds = [1.0, -1.0].map(|sign| input.offset + sign * MAX_NORMALISED * input.scale);
        let mut far = 0;
        let one = |_| {
            let wandering = excitation.sample();
            far = if noise.below(600) == 0 { 40 } else { far - i32::from(far > 0) };
            let sample = match noise.below(100) {
                0 => f32::from_bits(noise.word()),
                1 => *pick(&mut noise, &[0.0, -0.0, f32::MAX, f32::MIN, f32::MIN_POSITIVE, 1e-45, f32::NEG_INFINITY, -f32::NAN]),
                2 => *pick(&mut noise, &[input.offset, bounds[0], bounds[1], bounds[0].next_up(), bounds[1].next_down()]),
                _ if far > 0 => input.offset + noise.symmetric() * MAX_NORMALISED * input.scale,
                _ => wandering,
            };
            (noise.below(400) == 0, sample)
        };
        (0..samples).map(one).collect()
    }

    /// Samples in it.
    pub fn len(&self) -> usize {
        self.samples.len()
    }

    /// The first `length` samples as the programs read them.
    pub fn bytes(&self, length: usize) -> Vec<u8> {
        let sample = |(reset, sample): &(bool, Vec<f32>)| -> Vec<u32> {
            std::iter::once(u32::from(*reset)).chain(sample.iter().map(|value| value.to_bits())).collect()
        };
        self.samples[..length].iter().flat_map(sample).flat_map(u32::to_ne_bytes).collect()
    }
}

fn pick<'a, T>(noise: &mut Noise, values: &'a [T]) -> &'a T {
    let index = noise.below(u32::try_from(values.len()).expect("a few values"));
    &values[usize::try_from(index).expect("a few values")]
}

/// What the firmware makes of a script: held samples and the bits of the estimate.
pub fn expected(model: &Model<'_>, script: &Script) -> Vec<(u32, u32)> {
    let estimator = Estimator::new(model).expect("a valid model");
    let mut state = EstimatorState::default();
    let step = |(reset, sample): &(bool, Vec<f32>)| {
        if *reset {
            state.reset();
        }
        let value = estimator.step_all(&mut state, sample).value;
        (state.front_end().held_samples(), value.to_bits())
    };
    script.samples.iter().map(step).collect()
}
