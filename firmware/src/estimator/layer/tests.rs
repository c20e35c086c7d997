//! Units against the specification, computed anew in wide integers.

extern crate std;

use std::vec::Vec;

use model_export::fixed::{SIGMOID, TANH};
use proptest::prelude::*;

use super::super::kernel::{Kernel, Portable};
use super::*;

/// The specification again, in wide integers and floor division, without a line of the code under test.
mod specification {
    use super::*;

    fn floor_shift(value: i128, bits: u32) -> i128 {
        value.div_euclid(1 << bits)
    }

    fn smmulr(a: i128, b: i128) -> i128 {
        floor_shift(a * b + (1 << 31), 32)
    }

    fn table(entries: &[[i32; 2]], z: i128, bits: u32, step_bits: u32) -> i128 {
        let q = z.clamp(-(1 << (bits - 1)), (1 << (bits - 1)) - 1);
        let n = floor_shift(q, step_bits) + 256;
        let [base, slope] = entries[usize::try_from(n).unwrap()].map(i128::from);
        base + floor_shift(slope * q.rem_euclid(1 << step_bits), 16)
    }

    fn act(activation: Activation, layer: &schema::Layer<'_>, z: i128) -> i128 {
        let (k, limit) = (u32::from(layer.cell_exponent), i128::from(layer.cell_limit));
        match activation {
            Activation::Tanh => floor_shift(table(&TANH, z, 20, 11), k),
            Activation::Hard => z.clamp(-65_536, 65_535) << (14 - k),
            Activation::Relu => z.clamp(0, floor_shift(limit, 14 - k)) << (14 - k),
        }
    }

    fn narrowed(layer: &schema::Layer<'_>, state: i128) -> i128 {
        let s = u32::from(layer.hidden_shift);
        floor_shift(state + (1 << s), s + 1).clamp(-32_768, 32_767)
    }

    /// New state and hidden state of one unit of a GRU.
    pub fn gru(activation: Activation, layer: &schema::Layer<'_>, [r, u, n, m]: [i128; 4], c: i128) -> (i128, i128) {
        let sigmoid = |z| table(&SIGMOID, z, 21, 12);
        let saturated = |x: i128| x.clamp(i128::from(i32::MIN), i128::from(i32::MAX));
        let q = saturated(n + saturated(2 * smmulr(sigmoid(r), m)));
        let limit = i128::from(layer.cell_limit);
        let t = smmulr(sigmoid(u), c) + smmulr((1 << 31) - 1 - sigmoid(u), act(activation, layer, q));
        let c = t.clamp(-limit / 2, limit / 2 - 1) * 2;
        (c, narrowed(layer, c))
    }

    /// Output of one unit of a dense layer.
    pub fn dense(activation: Activation, layer: &schema::Layer<'_>, z: i128) -> i128 {
        narrowed(layer, act(activation, layer, z))
    }

    /// New cell and hidden state of one unit of an LSTM.
    pub fn unit(activation: Activation, layer: &schema::Layer<'_>, z: [i128; 4], c: i128) -> (i128, i128) {
        let (k, limit) = (u32::from(layer.cell_exponent), i128::from(layer.cell_limit));
        let sigmoid = |z| table(&SIGMOID, z, 21, 12);
        let tanh = |z| table(&TANH, z, 20, 11);
        let [i, f, o] = [z[0], z[1], z[3]].map(sigmoid);
        let g = act(activation, layer, z[2]);
        let c = (smmulr(f, c) + smmulr(i, g)).clamp(-limit / 2, limit / 2 - 1) * 2;
        let a = match activation {
            Activation::Tanh => tanh(floor_shift(c, 14 - k)),
            Activation::Hard => c.clamp(-(1 << (30 - k)), (1 << (30 - k)) - 1) << k,
            Activation::Relu => c.max(0),
        };
        let s = u32::from(layer.hidden_shift);
        (c, floor_shift(smmulr(o, a) + (1 << (s - 1)), s).clamp(-32_768, 32_767))
    }

    /// With the rows of both matrices and the bias, where there are such.
    pub fn pre_activation(layer: &schema::Layer<'_>, rows: (Option<usize>, Option<usize>, usize), x: &[i16], h: &[i16]) -> i128 {
        let dot = |weights: &[u8], values: &[i16]| -> i128 {
            weights.iter().zip(values).map(|(w, v)| i128::from(w.cast_signed()) * i128::from(*v)).sum()
        };
        let word = |bytes: &[u8], row: usize| i128::from(i32::from_le_bytes(bytes[4 * row..4 * row + 4].try_into().unwrap()));
        let (input, recurrent, bias) = rows;
        let bias = i128::from(i64::from_le_bytes(layer.biases[8 * bias..8 * bias + 8].try_into().unwrap()));
        let from_x = input.map_or(0, |row| dot(&layer.input_weights[row * x.len()..][..x.len()], x) * word(layer.input_multipliers, row));
        let from_h = recurrent
            .map_or(0, |row| dot(&layer.recurrent_weights[row * h.len()..][..h.len()], h) * word(layer.recurrent_multipliers, row));
        floor_shift(bias + from_x + from_h, 32)
    }
}

fn bytes(length: usize) -> impl Strategy<Value = Vec<u8>> {
    prop::collection::vec(any::<u8>(), length)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(1200))]

    #[test]
    fn a_step_is_the_specification_to_the_bit(
        (inputs, units, matrices, recurrent) in (1usize..=64, 1usize..=6).prop_flat_map(|(inputs, units)| {
            (Just(inputs), Just(units), bytes(4 * units * inputs), bytes(4 * units * units))
        }),
        words in bytes(4 * 24 * 2),
        biases in prop::collection::vec(-(1i64 << 52)..(1 << 52), 24),
        damping in 0u32..14,
        (code, kind) in (0u8..3, 0u8..3),
        (cell_exponent, hidden_shift, half_limit) in (0u8..=7, 1u8..=14, 1i32..=(1 << 29)),
        steps in prop::collection::vec(prop::collection::vec(any::<i16>(), 64), 4),
    ) {
        let activation = Activation::from_code(code).unwrap();
        let cell = [Cell::Lstm, Cell::Gru, Cell::Dense(activation)][usize::from(kind)];
        let (input_rows, recurrent_rows) = (cell.input_rows() * units, cell.recurrent_rows() * units);
        // Multipliers of every size, so that pre-activations fall inside the tables as well as far outside.
        let scaled = |words: &[u8]| -> Vec<u8> {
            words.as_chunks::<4>().0.iter().flat_map(|word| (i32::from_le_bytes(*word) >> damping).to_le_bytes()).collect()
        };
        let biases: Vec<u8> = biases.iter().flat_map(|bias| bias.to_le_bytes()).collect();
        let (input_multipliers, recurrent_multipliers) = (scaled(&words[..4 * input_rows]), scaled(&words[96..96 + 4 * recurrent_rows]));
        let wire = schema::Layer {
            cell,
            inputs: u16::try_from(inputs).unwrap(),
            units: u16::try_from(units).unwrap(),
            input_weights: &matrices[..input_rows * inputs],
            recurrent_weights: &recurrent[..recurrent_rows * units],
            input_multipliers: &input_multipliers,
            recurrent_multipliers: &recurrent_multipliers,
            biases: &biases[..8 * units * cell.gates().len()],
            cell_exponent,
            cell_limit: 2 * half_limit,
            hidden_shift,
        };
        let layer = Layer { wire: wire.clone(), activation, inputs, units };
        let mut state = LayerState::default();
        let (mut h, mut c) = (std::vec![0i16; units], std::vec![0i128; units]);
        for input in steps {
            let input: [i16; 64] = input.try_into().unwrap();
            Portable.step(0, &layer, &input, &mut state);
            let mut next = Vec::new();
            for (unit, memory) in c.iter_mut().enumerate() {
                let row = |gate: usize| Some(gate * units + unit);
                let z = |input_gate: Option<usize>, recurrent_gate: Option<usize>, bias: usize| {
                    let rows = (input_gate.and_then(row), recurrent_gate.and_then(row), bias * units + unit);
                    specification::pre_activation(&wire, rows, &input[..inputs], &h)
                };
                let (state, hidden) = match cell {
                    Cell::Lstm => {
                        specification::unit(activation, &wire, [0, 1, 2, 3].map(|gate| z(Some(gate), Some(gate), gate)), *memory)
                    }
                    Cell::Gru => {
                        let z = [z(Some(0), Some(0), 0), z(Some(1), Some(1), 1), z(Some(2), None, 2), z(None, Some(2), 3)];
                        specification::gru(activation, &wire, z, *memory)
                    }
                    Cell::Dense(_) => (0, specification::dense(activation, &wire, z(Some(0), None, 0))),
                };
                *memory = state;
                next.push(i16::try_from(hidden).unwrap());
            }
            h = next;
            prop_assert_eq!(&state.hidden[..units], &h[..]);
            prop_assert!(state.cell[..units].iter().map(|cell| i128::from(*cell)).eq(c.iter().copied()));
            prop_assert!(state.hidden[units..].iter().all(|hidden| *hidden == 0));
        }
    }
}
