//! How many optimiser steps a budget of processor time holds: counted on a nominal machine, so that equal budgets mean equal steps.

use super::blocks::Block;
use super::config::TrainConfig;
use super::optimizer::Method;
use super::shares::shares;
use crate::network::{Architecture, Layout, Network};

/// Multiply-accumulates a CPU second that the budget counts on. Nominal, so that equal budgets mean equal steps on every machine:
/// measured on one core of an AMD EPYC 9004 (AVX-512) with the element-wise work counted apart.
const NOMINAL_MACS_PER_CPU_S: f64 = 45e9;
/// CPU time of the element-wise work of one LSTM unit, forward and backward, in s; same conditions.
const NOMINAL_UNIT_S: f64 = 5e-9;
/// CPU time that each sample costs whatever the network, in s; same conditions.
const NOMINAL_SAMPLE_S: f64 = 60e-9;
/// Multiply-accumulates a CPU second of SOAP's products, which are smaller; same conditions.
const NOMINAL_SOAP_MACS_PER_CPU_S: f64 = 22e9;
/// CPU time of one multiply-accumulate of the fixed-point forward pass in s, and of the element-wise work of a unit; same conditions.
const NOMINAL_FIXED_MAC_S: f64 = 0.25e-9;
const NOMINAL_FIXED_UNIT_S: f64 = 60e-9;
/// Share of the budget that optimiser steps may plan with; the rest is validation and preparation.
const STEP_SHARE: f64 = 0.9;

/// The optimiser steps of a run: in f32, then with the fixed-point code in the forward pass.
#[derive(Clone, Copy, Debug)]
pub(super) struct Plan {
    pub(super) float_steps: u64,
    pub(super) quantised_steps: u64,
}

pub(super) fn planned_steps(config: &TrainConfig, architecture: &Architecture, steps_an_epoch: f64) -> Plan {
    let share = f64::from(config.quantised);
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a positive count far below 2^63")]
    let whole = |steps: f64| steps.ceil() as u64;
    let (float, quantised) = match config.epochs {
        Some(epochs) => ((1.0 - share) * epochs * steps_an_epoch, share * epochs * steps_an_epoch),
        None => {
            let seconds = STEP_SHARE * config.budget_cpu_s;
            let steps = |share: f64, quantised: bool| share * seconds / nominal_step_s(architecture, config, quantised);
            (steps(1.0 - share, false), steps(share, true))
        }
    };
    Plan { float_steps: whole(float).max(1), quantised_steps: whole(quantised) }
}

/// CPU time of one optimiser step on the nominal machine in s; `quantised` with the fixed-point forward pass.
fn nominal_step_s(architecture: &Architecture, config: &TrainConfig, quantised: bool) -> f64 {
    let macs = Network::zeros(architecture.features, &architecture.units, architecture.activation, architecture.state_limit).macs_per_step()
        as f64;
    let units = architecture.units.iter().sum::<usize>() as f64;
    let forward_and_backward = 3.0 * macs / NOMINAL_MACS_PER_CPU_S + units * NOMINAL_UNIT_S + NOMINAL_SAMPLE_S;
    let fixed = if quantised { macs * NOMINAL_FIXED_MAC_S + units * NOMINAL_FIXED_UNIT_S } else { 0.0 };
    // Adam passes over all parameters once a step.
    let update = Layout::new(architecture).len() as f64 * 1e-9 + soap_macs_per_step(architecture, config) / NOMINAL_SOAP_MACS_PER_CPU_S;
    (forward_and_backward + fixed) * (config.lanes * config.chunk) as f64 + update
}

/// Multiply-accumulates of SOAP's products and factorisations in one optimiser step; none for Adam.
fn soap_macs_per_step(architecture: &Architecture, config: &TrainConfig) -> f64 {
    if config.optimizer.method == Method::Adam {
        return 0.0;
    }
    let blocks = shares(&Layout::new(architecture), Method::Soap, 1);
    let one = |block: &Block| {
        let (rows, columns) = (block.rows as f64, block.columns as f64);
        // Each step: two moments and a rotation there and back. Each turn: on either side one product, and a factorisation that makes two
        // and two thirds as many operations.
        let step = 3.0 * rows * columns * (rows + columns);
        let turn = 11.0 / 3.0 * (rows.powi(3) + columns.powi(3));
        step + turn / config.optimizer.basis_interval as f64
    };
    blocks.iter().flatten().map(one).sum()
}
