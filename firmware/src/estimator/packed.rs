//! The fast kernel's weights: packed once when a model is loaded, in the order in which a step reads them.
//!
//! # Terms
//!
//! *Row*: the weights of one gate of one unit. *Group*: four rows that are computed together: those of a unit in the order i, f, o, g (LSTM)
//! or r, u, m, n (GRU), or those of four units of a dense layer. *Column*: a position in the vector that a row is multiplied with.
//! *Stream*: all 32-bit words of a layer; a step reads it once from the first word to the last. A weight that there is not is zero: a
//! GRU's n has none in the recurrent matrix and its m none in the input's, and a last group may have fewer than four units.
//!
//! # Layout
//!
//! For each group: the input matrix's columns, the recurrent matrix's columns (none in a dense layer), then for each row bias (low word,
//! high word), input multiplier and recurrent multiplier. A matrix comes in one of two forms:
//!
//! ```text
//! pairs (at most 8 columns)   for columns c, c+1: four words, one a row              w[c] in bits 0..16, w[c+1] in bits 16..32
//! bytes (any number)          for columns c, c+1 and then c+2, c+3: a word of the first two rows and one of the others
//!                             each half word, low half column c, is                  256 * second + (first + 128)
//! ```
//!
//! # How two rows share a multiplication
//!
//! A half word `v = 256 * second + first + 128` lies in the range of `i16` whatever the two weights are. Multiplying the word as it is
//! with a pair of samples (`SMLALD`) adds `256 * second * x + (first + 128) * x` to a 64-bit sum; taking the low bytes alone (`UXTB16`) and
//! multiplying again (`SMLAD`) gives `(first + 128) * x`. With both sums started at `-128 * sum x`, the second is the first row's dot
//! product, and the difference of the two is 256 times the second row's. That is three instructions for four weights, one less than
//! unpacking each row by itself, and exact.
//!
//! On the microcontroller the stream is read by assembly (`smlad`), elsewhere by the plain Rust here; both give the bits of
//! [`super::Portable`].

use heapless::Vec;
use model_export::schema::{Cell, MAX_FEATURES, MAX_LAYERS, MAX_UNITS, MAX_WIDTH};
use model_export::validate::Invalid;

use super::network::{Kernel, KernelSource, Layer, LayerState, Network};
use super::shape::Shape;
#[cfg(target_os = "none")]
use super::smlad::Plan;

/// Words that a board has for the packed weights, 64 KiB: those of two LSTM layers as large as a blob may hold. A network that needs
/// more is not exported.
pub const MAX_PACKED_WORDS: usize = Shape { cell: Cell::Lstm, inputs: MAX_FEATURES, units: MAX_UNITS }.words()
    + Shape { cell: Cell::Lstm, inputs: MAX_UNITS, units: MAX_UNITS }.words();

/// Rows of a recurrent unit in the stream's order, as numbers of [`Cell::gates`].
const GATES: [usize; 4] = [0, 1, 3, 2];

/// Gate, by its number, and unit of each row of a group.
fn rows(shape: Shape, group: usize) -> [(usize, usize); 4] {
    match shape.cell {
        Cell::Lstm | Cell::Gru => GATES.map(|gate| (gate, group)),
        Cell::Dense(_) => [0, 1, 2, 3].map(|row| (0, 4 * group + row)),
    }
}

/// A network's weights in the fast kernel's layout.
#[derive(Clone, Debug)]
pub struct Packed<'b> {
    layers: Vec<PackedLayer<'b>, MAX_LAYERS>,
}

#[derive(Clone, Debug)]
struct PackedLayer<'b> {
    stream: &'b [u32],
    #[cfg(not(target_os = "none"))]
    shape: Shape,
    #[cfg(target_os = "none")]
    plan: Plan,
}

/// Packs into memory of the caller's, [`MAX_PACKED_WORDS`] for any network that is exported: on the board the core-coupled memory, which no wait states slow.
impl<'b> KernelSource for &'b mut [u32] {
    type Kernel = Packed<'b>;

    fn kernel(self, network: &Network<'_>) -> Result<Packed<'b>, Invalid> {
        let mut layers = Vec::new();
        let mut free = self;
        for layer in network.layers() {
            let shape = Shape { cell: layer.cell(), inputs: layer.inputs(), units: layer.units() };
            let Some((stream, rest)) = free.split_at_mut_checked(shape.words()) else {
                return Err(Invalid {
                    field: "network",
                    index: layers.len(),
                    must: "small enough for the memory its weights are packed into",
                });
            };
            free = rest;
            pack(layer, shape, stream);
            let packed = PackedLayer {
                stream,
                #[cfg(not(target_os = "none"))]
                shape,
                #[cfg(target_os = "none")]
                plan: Plan::new(layer, shape),
            };
            // Both lists have the same capacity.
            let _ = layers.push(packed);
        }
        Ok(Packed { layers })
    }
}

fn pack(layer: &Layer<'_>, shape: Shape, stream: &mut [u32]) {
    let wire = layer.wire();
    let gates = shape.cell.gates();
    for (group, words) in stream.chunks_exact_mut(shape.group_words()).enumerate() {
        let rows =
            rows(shape, group).map(|(number, unit)| gates.get(number).filter(|_| unit < shape.units).map(|gate| (number, gate, unit)));
        let input_rows = rows.map(|row| row.and_then(|(_, gate, unit)| Some(gate.input? * shape.units + unit)));
        let recurrent_rows = rows.map(|row| row.and_then(|(_, gate, unit)| Some(gate.recurrent? * shape.units + unit)));
        let mut words = words.iter_mut();
        let inputs = Rows { matrix: wire.input_weights, columns: shape.inputs, rows: input_rows };
        if shape.has_pairs() {
            for column in (0..shape.inputs).step_by(2) {
                inputs.pairs(column).into_iter().zip(&mut words).for_each(|(word, slot)| *slot = word);
            }
        } else {
            inputs.bytes().zip(&mut words).for_each(|(word, slot)| *slot = word);
        }
        if shape.recurrent_words() > 0 {
            let recurrent = Rows { matrix: wire.recurrent_weights, columns: shape.units, rows: recurrent_rows };
            recurrent.bytes().zip(&mut words).for_each(|(word, slot)| *slot = word);
        }
        for ((row, input_row), recurrent_row) in rows.into_iter().zip(input_rows).zip(recurrent_rows) {
            let bias = row.and_then(|(number, _, unit)| wire.biases.as_chunks::<4>().0.as_chunks::<2>().0.get(number * shape.units + unit));
            let [bias_low, bias_high] = bias.copied().unwrap_or_default();
            let multiplier =
                |bytes: &[u8], row: Option<usize>| row.and_then(|row| bytes.as_chunks::<4>().0.get(row).copied()).unwrap_or_default();
            let by_input = multiplier(wire.input_multipliers, input_row);
            let constants = [bias_low, bias_high, by_input, multiplier(wire.recurrent_multipliers, recurrent_row)];
            constants.into_iter().zip(&mut words).for_each(|(bytes, slot)| *slot = u32::from_le_bytes(bytes));
        }
    }
}

/// The four rows of a group in one matrix; none where a row is not in it.
struct Rows<'a> {
    matrix: &'a [u8],
    columns: usize,
    rows: [Option<usize>; 4],
}

impl Rows<'_> {
    /// A weight; zero behind the last column.
    fn weight(&self, row: Option<usize>, column: usize) -> i8 {
        match row {
            Some(row) if column < self.columns => self.matrix.get(row * self.columns + column).copied().unwrap_or(0).cast_signed(),
            _ => 0,
        }
    }

    fn pairs(&self, column: usize) -> [u32; 4] {
        self.rows.map(|row| word([i16::from(self.weight(row, column)), i16::from(self.weight(row, column + 1))]))
    }

    fn bytes(&self) -> impl Iterator<Item = u32> {
        let [first, second, third, fourth] = self.rows;
        let columns = (0..self.columns.next_multiple_of(4)).step_by(2);
        columns.flat_map(move |column| {
            [(first, second), (third, fourth)].map(|(first, second)| {
                word([column, column + 1].map(|column| {
                    // The low byte is the first weight with 128 added, which flips its upper bit.
                    let low = self.weight(first, column).cast_unsigned() ^ 0x80;
                    i16::from_le_bytes([low, self.weight(second, column).cast_unsigned()])
                }))
            })
        })
    }
}

fn word(halves: [i16; 2]) -> u32 {
    let [low, high] = halves.map(i16::to_le_bytes);
    u32::from_le_bytes([low[0], low[1], high[0], high[1]])
}

#[cfg(target_os = "none")]
impl Kernel for Packed<'_> {
    fn step(&self, index: usize, _layer: &Layer<'_>, input: &[i16; MAX_WIDTH], state: &mut LayerState) {
        if let Some(layer) = self.layers.get(index) {
            layer.plan.step(layer.stream, input, state);
        }
    }
}

#[cfg(not(target_os = "none"))]
impl Kernel for Packed<'_> {
    fn step(&self, index: usize, layer: &Layer<'_>, input: &[i16; MAX_WIDTH], state: &mut LayerState) {
        let Some(PackedLayer { stream, shape }) = self.layers.get(index) else { return };
        let last = state.hidden;
        for (group, words) in stream.chunks_exact(shape.group_words()).enumerate() {
            let (inputs, words) = words.split_at_checked(shape.input_words()).unwrap_or_default();
            let (recurrent, rows) = words.split_at_checked(shape.recurrent_words()).unwrap_or_default();
            let from_input = if shape.has_pairs() { pair_sums(inputs, input) } else { byte_sums(inputs, input) };
            let sums = from_input.into_iter().zip(byte_sums(recurrent, &last));
            let mut pre_activations = [0; 4];
            for ((z, sums), constants) in pre_activations.iter_mut().zip(sums).zip(rows.as_chunks().0) {
                *z = pre_activation(sums, *constants);
            }
            let [first, second, third, fourth] = pre_activations;
            match shape.cell {
                Cell::Lstm | Cell::Gru => {
                    let memory = state.cell.iter_mut().zip(&mut state.hidden).nth(group);
                    memory.into_iter().for_each(|(cell, hidden)| (*cell, *hidden) = layer.next([first, second, fourth, third], *cell));
                }
                Cell::Dense(_) => {
                    let outputs = state.hidden.iter_mut().skip(4 * group).zip(pre_activations);
                    outputs.for_each(|(hidden, z)| (_, *hidden) = layer.next([z, 0, 0, 0], 0));
                }
            }
        }
    }
}

/// From the sums over the input and the recurrent columns of a row and its words in the stream.
#[cfg(not(target_os = "none"))]
fn pre_activation((from_input, from_hidden): (i32, i32), [bias_low, bias_high, by_input, by_hidden]: [u32; 4]) -> i32 {
    let bias = (u64::from(bias_high) << 32 | u64::from(bias_low)).cast_signed();
    let scaled = |sum: i32, multiplier: u32| i64::from(sum).wrapping_mul(i64::from(multiplier.cast_signed()));
    super::arithmetic::high(bias.wrapping_add(scaled(from_input, by_input)).wrapping_add(scaled(from_hidden, by_hidden)))
}

/// Low and high half of a word as signed numbers.
#[cfg(not(target_os = "none"))]
fn halves(word: u32) -> [i16; 2] {
    let [a, b, c, d] = word.to_le_bytes();
    [i16::from_le_bytes([a, b]), i16::from_le_bytes([c, d])]
}

#[cfg(not(target_os = "none"))]
fn pair_sums(words: &[u32], samples: &[i16; MAX_WIDTH]) -> [i32; 4] {
    let mut sums = [0i32; 4];
    for (rows, pair) in words.as_chunks::<4>().0.iter().zip(samples.as_chunks::<2>().0) {
        for (sum, word) in sums.iter_mut().zip(rows) {
            for (weight, sample) in halves(*word).into_iter().zip(pair) {
                *sum = sum.wrapping_add(i32::from(weight) * i32::from(*sample));
            }
        }
    }
    sums
}

#[cfg(not(target_os = "none"))]
fn byte_sums(words: &[u32], samples: &[i16; MAX_WIDTH]) -> [i32; 4] {
    let read = samples.iter().take(words.len());
    let start = -super::shape::BYTE_OFFSET * read.map(|sample| i32::from(*sample)).sum::<i32>();
    let (mut low, mut whole) = ([start; 2], [i64::from(start); 2]);
    for (rows, pair) in words.as_chunks::<2>().0.iter().zip(samples.as_chunks::<2>().0) {
        for ((low, whole), word) in low.iter_mut().zip(&mut whole).zip(rows) {
            for (half, sample) in halves(*word).into_iter().zip(pair) {
                *low = low.wrapping_add(i32::from(half & 0xff) * i32::from(*sample));
                *whole = whole.wrapping_add(i64::from(half) * i64::from(*sample));
            }
        }
    }
    let ([first, third], [first_whole, third_whole]) = (low, whole);
    // Exact: the difference is 256 times a sum that fits its 32 bits.
    let other = |low: i32, whole: i64| super::arithmetic::high((whole - i64::from(low)) << 24);
    [first, other(first, first_whole), third, other(third, third_whole)]
}
