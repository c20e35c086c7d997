//! The network of schema version 2, which has LSTM layers only and says no cell.

use heapless::Vec;
use serde::{Deserialize, Serialize};

use crate::schema::{Cell, Dense, Layer, MAX_LAYERS, Network};

/// [`Layer`] without its cell.
#[derive(Serialize, Deserialize)]
pub struct LstmLayer<'a> {
    inputs: u16,
    units: u16,
    input_weights: &'a [u8],
    recurrent_weights: &'a [u8],
    input_multipliers: &'a [u8],
    recurrent_multipliers: &'a [u8],
    biases: &'a [u8],
    cell_exponent: u8,
    cell_limit: i32,
    hidden_shift: u8,
}

/// [`Network`] of such layers.
#[derive(Serialize, Deserialize)]
pub struct LstmNetwork<'a> {
    activation_code: u8,
    #[serde(borrow)]
    layers: Vec<LstmLayer<'a>, MAX_LAYERS>,
    #[serde(borrow)]
    dense: Dense<'a>,
}

impl<'a> From<LstmLayer<'a>> for Layer<'a> {
    fn from(layer: LstmLayer<'a>) -> Self {
        let LstmLayer {
            inputs,
            units,
            input_weights,
            recurrent_weights,
            input_multipliers,
            recurrent_multipliers,
            biases,
            cell_exponent,
            cell_limit,
            hidden_shift,
        } = layer;
        Self {
            cell: Cell::Lstm,
            inputs,
            units,
            input_weights,
            recurrent_weights,
            input_multipliers,
            recurrent_multipliers,
            biases,
            cell_exponent,
            cell_limit,
            hidden_shift,
        }
    }
}

impl<'a> From<LstmNetwork<'a>> for Network<'a> {
    fn from(network: LstmNetwork<'a>) -> Self {
        let LstmNetwork { activation_code, layers, dense } = network;
        Self { activation_code, layers: layers.into_iter().map(Layer::from).collect(), dense }
    }
}

/// For a network whose layers are all LSTM.
#[cfg(feature = "std")]
impl<'a> From<&Network<'a>> for LstmNetwork<'a> {
    fn from(network: &Network<'a>) -> Self {
        let layer = |layer: &Layer<'a>| {
            let Layer {
                cell: _,
                inputs,
                units,
                input_weights,
                recurrent_weights,
                input_multipliers,
                recurrent_multipliers,
                biases,
                cell_exponent,
                cell_limit,
                hidden_shift,
            } = *layer;
            LstmLayer {
                inputs,
                units,
                input_weights,
                recurrent_weights,
                input_multipliers,
                recurrent_multipliers,
                biases,
                cell_exponent,
                cell_limit,
                hidden_shift,
            }
        };
        Self { activation_code: network.activation_code, layers: network.layers.iter().map(layer).collect(), dense: network.dense.clone() }
    }
}
