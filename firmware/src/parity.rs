//! Proof that a machine computes what another one computes: the same random work on both, a digest of the results to compare.
//!
//! The desktop, the emulator and a real board run this. Work comes from seeds alone, so nothing but the digest has to cross a link.
//!
//! Terms. *Digest*: CRC-32 of result bits in the order in which they arise. *Shape*: width of the input, cell and units of each layer.

use model_export::blob::crc32;
use model_export::fixed::{MAX_CELL_EXPONENT, MAX_CELL_LIMIT, MAX_HIDDEN_SHIFT};
use model_export::schema::{Activation, Cell, Dense, Layer, MAX_FEATURES, MAX_LAYERS, MAX_UNITS, MAX_WIDTH, Network as Wire};

use crate::estimator::{Estimator, EstimatorState, Kernel, Network, NetworkState};

/// Rows of a layer at most.
const ROWS: usize = 4 * MAX_UNITS;
/// Largest matrix, and room to begin anywhere in the first part.
const POOL_BYTES: usize = ROWS * MAX_WIDTH + 4096;

/// Reproducible numbers: the 32-bit xorshift generator (Marsaglia, "Xorshift RNGs", 2003) with the shifts 13, 17, 5.
#[derive(Clone, Debug)]
pub struct Noise(u32);

impl Noise {
    /// Starts a sequence; every seed has its own.
    #[must_use]
    pub fn new(seed: u32) -> Self {
        // Neighbouring seeds far apart, and never zero, where the generator would stay.
        Self(seed.wrapping_mul(0x9e37_79b9).rotate_left(7) | 1)
    }

    /// The next 32 bits.
    pub fn word(&mut self) -> u32 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 17;
        self.0 ^= self.0 << 5;
        self.0
    }

    /// A number below `bound`.
    pub fn below(&mut self, bound: u32) -> u32 {
        let [_, _, _, _, high @ ..] = (u64::from(self.word()) * u64::from(bound)).to_le_bytes();
        u32::from_le_bytes(high)
    }

    /// A number between -1 and 1, exact in `f32`.
    pub fn symmetric(&mut self) -> f32 {
        let [low, high, ..] = self.word().to_le_bytes();
        f32::from(i16::from_le_bytes([low, high])) / 32_768.0
    }

    fn sample(&mut self) -> i16 {
        let [low, high, ..] = self.word().to_le_bytes();
        i16::from_le_bytes([low, high])
    }
}

/// Cell and units of each layer.
pub type Layers = heapless::Vec<(Cell, usize), MAX_LAYERS>;

/// Every shape of up to two LSTM layers that a blob's network may have: each number of units in each layer. Then every number of units of
/// the other cells, alone and behind each other. Input widths come in turn.
pub fn shapes() -> impl Iterator<Item = (usize, Layers)> {
    use Activation::{Hard, Relu, Tanh};
    use Cell::{Dense, Gru, Lstm};

    let single = (1..=MAX_UNITS).map(|units| [(Lstm, units), (Lstm, 0), (Lstm, 0), (Lstm, 0)]);
    let double = (1..=MAX_UNITS).flat_map(|first| (1..=MAX_UNITS).map(move |second| [(Lstm, first), (Lstm, second), (Lstm, 0), (Lstm, 0)]));
    let mixed = (1..=MAX_UNITS).flat_map(|units| {
        let other = MAX_UNITS + 1 - units;
        [
            [(Gru, units), (Lstm, 0), (Lstm, 0), (Lstm, 0)],
            [(Dense(Tanh), units), (Lstm, 0), (Lstm, 0), (Lstm, 0)],
            [(Dense(Relu), units), (Dense(Hard), other), (Dense(Tanh), units), (Dense(Relu), other)],
            [(Gru, units), (Gru, other), (Lstm, 0), (Lstm, 0)],
            [(Gru, other), (Dense(Hard), units), (Lstm, 0), (Lstm, 0)],
            [(Dense(Tanh), other), (Gru, 1 + units / 2), (Lstm, 1 + other / 2), (Dense(Relu), units)],
        ]
    });
    single.chain(double).chain(mixed).enumerate().map(|(index, layers)| {
        let layers = layers.into_iter().filter(|(_, units)| *units > 0).collect();
        (index % MAX_FEATURES + 1, layers)
    })
}

#[derive(Clone, Debug)]
struct RandomLayer {
    cell: Cell,
    inputs: u16,
    units: u16,
    /// Where the matrices begin in the pool.
    input_at: usize,
    recurrent_at: usize,
    input_multipliers: [u8; 4 * ROWS],
    recurrent_multipliers: [u8; 4 * ROWS],
    biases: [u8; 8 * ROWS],
    cell_exponent: u8,
    cell_limit: i32,
    hidden_shift: u8,
}

/// A valid network of random numbers: weights of the whole range, multipliers, biases, limits and shifts of every size.
#[derive(Clone, Debug)]
pub struct RandomNetwork {
    pool: [u8; POOL_BYTES],
    layers: [RandomLayer; MAX_LAYERS],
    dense: [u8; 2 * MAX_UNITS],
    activation: Activation,
}

impl RandomNetwork {
    /// Empty until it is filled; about 37 KiB.
    #[must_use]
    pub const fn new() -> Self {
        const EMPTY: RandomLayer = RandomLayer {
            cell: Cell::Lstm,
            inputs: 0,
            units: 0,
            input_at: 0,
            recurrent_at: 0,
            input_multipliers: [0; 4 * ROWS],
            recurrent_multipliers: [0; 4 * ROWS],
            biases: [0; 8 * ROWS],
            cell_exponent: 0,
            cell_limit: 0,
            hidden_shift: 0,
        };
        Self { pool: [0; POOL_BYTES], layers: [EMPTY; MAX_LAYERS], dense: [0; 2 * MAX_UNITS], activation: Activation::Tanh }
    }

    /// New weights in the pool that all networks take theirs from.
    pub fn fill_pool(&mut self, seed: u32) {
        let mut noise = Noise::new(seed);
        self.pool.as_chunks_mut().0.iter_mut().for_each(|bytes| *bytes = noise.word().to_le_bytes());
    }

    /// A new network over `inputs` features with these layers.
    pub fn draw(&mut self, seed: u32, inputs: usize, cells: &[(Cell, usize)]) {
        let mut noise = Noise::new(seed);
        self.activation = match seed % 3 {
            0 => Activation::Tanh,
            1 => Activation::Relu,
            _ => Activation::Hard,
        };
        let mut width = u16::try_from(inputs).unwrap_or(0);
        for (index, layer) in self.layers.iter_mut().enumerate() {
            let (cell, units) = cells.get(index).copied().unwrap_or((Cell::Lstm, 0));
            layer.cell = cell;
            layer.inputs = width;
            layer.units = u16::try_from(units).unwrap_or(0);
            width = layer.units;
            layer.draw(&mut noise);
        }
        for bytes in self.dense.as_chunks_mut().0 {
            // At most 512 each, so that the sum keeps below the bound.
            *bytes = (noise.sample() >> 6).to_le_bytes();
        }
    }

    /// The network as a blob holds it.
    #[must_use]
    pub fn wire(&self) -> Wire<'_> {
        let mut layers = heapless::Vec::new();
        let mut width = 0;
        for layer in self.layers.iter().filter(|layer| layer.units > 0) {
            let (inputs, units) = (usize::from(layer.inputs), usize::from(layer.units));
            let (input_rows, recurrent_rows) = (layer.cell.input_rows() * units, layer.cell.recurrent_rows() * units);
            let matrix = |at: usize, rows: usize, columns: usize| self.pool.get(at..at + rows * columns).unwrap_or(&[]);
            let wire = Layer {
                cell: layer.cell,
                inputs: layer.inputs,
                units: layer.units,
                input_weights: matrix(layer.input_at, input_rows, inputs),
                recurrent_weights: matrix(layer.recurrent_at, recurrent_rows, units),
                input_multipliers: layer.input_multipliers.get(..4 * input_rows).unwrap_or(&[]),
                recurrent_multipliers: layer.recurrent_multipliers.get(..4 * recurrent_rows).unwrap_or(&[]),
                biases: layer.biases.get(..8 * units * layer.cell.gates().len()).unwrap_or(&[]),
                cell_exponent: layer.cell_exponent,
                cell_limit: layer.cell_limit,
                hidden_shift: layer.hidden_shift,
            };
            // Both lists have the same capacity.
            let _ = layers.push(wire);
            width = units;
        }
        let dense = Dense { weights: self.dense.get(..2 * width).unwrap_or(&[]), scale: 1.0 / 65_536.0, bias: 0.25 };
        Wire { activation_code: self.activation.code(), layers, dense }
    }
}

impl Default for RandomNetwork {
    fn default() -> Self {
        Self::new()
    }
}

impl RandomLayer {
    fn draw(&mut self, noise: &mut Noise) {
        self.input_at = position(noise);
        self.recurrent_at = position(noise);
        // Of every size, so that pre-activations fall inside the tables as well as far outside.
        for multipliers in [&mut self.input_multipliers, &mut self.recurrent_multipliers] {
            let damping = noise.below(14);
            multipliers.as_chunks_mut().0.iter_mut().for_each(|bytes| *bytes = (noise.word().cast_signed() >> damping).to_le_bytes());
        }
        let damping = 3 + noise.below(16);
        for bytes in self.biases.as_chunks_mut().0 {
            let wide = u64::from(noise.word()) << 32 | u64::from(noise.word());
            *bytes = (wide.cast_signed() >> damping).to_le_bytes();
        }
        self.cell_exponent = small(noise, MAX_CELL_EXPONENT + 1);
        // Even and at least 2; the full range as often as any bound inside it.
        let half = (noise.word().cast_signed() & (MAX_CELL_LIMIT / 2 - 1)) >> noise.below(12);
        self.cell_limit = if noise.below(2) == 0 { MAX_CELL_LIMIT } else { 2 * half.max(1) };
        self.hidden_shift = 1 + small(noise, MAX_HIDDEN_SHIFT);
    }
}

fn position(noise: &mut Noise) -> usize {
    usize::try_from(noise.below(4096)).unwrap_or(0)
}

fn small(noise: &mut Noise, bound: u8) -> u8 {
    u8::try_from(noise.below(u32::from(bound))).unwrap_or(0)
}

/// Digest of the states and outputs of `steps` steps of a network on random features.
///
/// # Deadline
/// Not for the tick.
#[must_use]
pub fn network_digest(network: &Network<'_>, kernel: &impl Kernel, seed: u32, steps: usize) -> u32 {
    let mut noise = Noise::new(seed);
    let mut state = NetworkState::default();
    let mut digest = 0;
    for _ in 0..steps {
        let features: [i16; MAX_WIDTH] = core::array::from_fn(|_| noise.sample());
        let output = network.step(kernel, &mut state, &features);
        digest = crc32(digest, &output.to_le_bytes());
        for (layer, memory) in network.layers().iter().zip(state.layers()) {
            for (hidden, cell) in memory.hidden.iter().zip(&memory.cell).take(layer.units()) {
                digest = crc32(crc32(digest, &hidden.to_le_bytes()), &cell.to_le_bytes());
            }
        }
    }
    digest
}

/// Digest of the estimates of `steps` random samples: wandering over the input range `minimum` to `maximum` and beyond, with rests, jumps and
/// now and then a sample that is no number.
///
/// # Deadline
/// Not for the tick.
#[must_use]
pub fn estimator_digest<K: Kernel>(estimator: &Estimator<'_, K>, [minimum, maximum]: [f32; 2], seed: u32, steps: usize) -> u32 {
    let mut excitation = Excitation::new(minimum, maximum, seed);
    let mut state = EstimatorState::default();
    let mut digest = 0;
    for _ in 0..steps {
        let estimate = estimator.step(&mut state, excitation.sample());
        digest = crc32(crc32(digest, &estimate.value.to_le_bytes()), &estimate.correction.to_le_bytes());
    }
    digest
}

/// Random samples of an input channel.
#[derive(Clone, Debug)]
pub struct Excitation {
    noise: Noise,
    centre: f32,
    half_range: f32,
    position: f32,
    velocity: f32,
}

impl Excitation {
    /// Samples around `minimum` to `maximum`.
    #[must_use]
    pub fn new(minimum: f32, maximum: f32, seed: u32) -> Self {
        let centre = 0.5 * (minimum + maximum);
        Self { noise: Noise::new(seed), centre, half_range: 0.5 * (maximum - minimum), position: 0.0, velocity: 0.0 }
    }

    /// The next sample.
    pub fn sample(&mut self) -> f32 {
        match self.noise.below(256) {
            0 => return f32::NAN,
            1 => return f32::INFINITY,
            2..10 => self.velocity = 0.0,
            10..18 => self.position = self.noise.symmetric(),
            _ => self.velocity = 0.9 * self.velocity + 0.02 * self.noise.symmetric(),
        }
        self.position += self.velocity;
        // A little beyond the range, then back.
        if self.position > 1.25 || self.position < -1.25 {
            self.velocity = -self.velocity;
            self.position += self.velocity;
        }
        self.centre + self.half_range * self.position
    }
}
