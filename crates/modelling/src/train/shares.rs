//! Which thread updates which matrices.

use super::blocks::Block;
use super::optimizer::Method;
use crate::network::Layout;

/// Which blocks each thread updates. Adam treats every parameter by itself: equal runs. SOAP needs whole matrices: each layer's
/// `[W_x, W_h, b]`, which lies in the flat vector as one transposed matrix; and the dense weights with their bias. One matrix for all four
/// gates does better than one for each, and costs a tenth more.
#[must_use]
pub fn shares(layout: &Layout, method: Method, threads: usize) -> Vec<Vec<Block>> {
    match method {
        Method::Adam => {
            // Whole cache lines, so that no two threads write to the same one.
            let units = layout.len().div_ceil(64);
            let edge = |part: usize| (units * part / threads * 64).min(layout.len());
            (0..threads).map(|part| vec![Block::run(edge(part), edge(part + 1))]).collect()
        }
        Method::Soap => {
            let mut matrices = Vec::new();
            for layer in &layout.layers {
                let rows = layer.inputs + layer.units + 1;
                matrices.push(Block { start: layer.input_weights.start, rows, columns: 4 * layer.units });
            }
            let dense = layout.dense_weights.len() + 1;
            matrices.push(Block { start: layout.dense_weights.start, rows: dense, columns: 1 });
            // The costliest first, each to the thread that has least to do.
            let cost = |block: &Block| block.range().len() * (block.rows + block.columns);
            matrices.sort_by_key(|block| std::cmp::Reverse(cost(block)));
            let mut shares = vec![Vec::new(); threads];
            let mut loads = vec![0; threads];
            for block in matrices {
                let least = (0..threads).min_by_key(|&thread| loads[thread]).unwrap_or(0);
                loads[least] += cost(&block);
                shares[least].push(block);
            }
            shares
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::network::{Activation, Architecture};

    #[test]
    fn every_parameter_is_updated_by_one_thread_once() {
        let architecture = Architecture { features: 3, units: vec![8, 5], activation: Activation::Relu, state_limit: 1.0 };
        let layout = Layout::new(&architecture);
        for method in [Method::Adam, Method::Soap] {
            for threads in 1..=5 {
                let mut owners = vec![0; layout.len()];
                let shares = shares(&layout, method, threads);
                assert_eq!(shares.len(), threads);
                shares.iter().flatten().flat_map(Block::range).for_each(|index| owners[index] += 1);
                assert!(owners.iter().all(|&owners| owners == 1), "{method:?} with {threads} threads: {owners:?}");
            }
        }
    }
}
