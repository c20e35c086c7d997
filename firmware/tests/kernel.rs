//! The packed kernel against the portable one, as plain Rust on the desktop; the assembly that replaces it on the microcontroller is
//! compared in the emulator.

use firmware::estimator::{Kernel, KernelSource, LayerState, MAX_PACKED_WORDS, Network, Portable};
use firmware::parity::{RandomNetwork, network_digest, shapes};
use model_export::schema::{Activation, Cell, MAX_WIDTH};

#[test]
fn networks_of_every_shape_give_the_portable_kernels_bits() {
    let mut random = RandomNetwork::new();
    random.fill_pool(1);
    // What a larger network left behind must not matter.
    let mut memory = vec![u32::MAX; MAX_PACKED_WORDS];
    let mut digests = std::collections::BTreeSet::new();
    for (seed, (inputs, units)) in (0..).zip(shapes()) {
        random.draw(seed, inputs, &units);
        let network = Network::new(&random.wire(), inputs).unwrap();
        let packed = memory.as_mut_slice().kernel(&network).unwrap();
        let digest = network_digest(&network, &packed, seed, 3);
        assert_eq!(digest, network_digest(&network, &Portable, seed, 3), "seed {seed}: {inputs} features, {units:?} units");
        digests.insert(digest);
    }
    assert!(digests.len() > 4480, "{} different digests of 4544: the networks do not differ", digests.len());
}

#[test]
fn random_networks_meet_every_activation_inside_and_outside_its_range() {
    let mut random = RandomNetwork::new();
    random.fill_pool(1);
    let mut moving = [[0; 3]; 2];
    for seed in 0..600 {
        let (number, cell) = [(0, Cell::Lstm), (1, Cell::Gru)][usize::from(seed % 2 == 1)];
        random.draw(seed, 8, &[(cell, 32)]);
        let wire = random.wire();
        let network = Network::new(&wire, 8).unwrap();
        let mut state = LayerState::default();
        let mut features = [0; MAX_WIDTH];
        features[..8].copy_from_slice(&[1000, -20_000, 30_000, 5, -32_768, 32_767, 0, -1]);
        for _ in 0..3 {
            Portable.step(0, &network.layers()[0], &features, &mut state);
        }
        let cells = &state.cell[..32];
        let inside = cells.iter().filter(|cell| **cell != 0 && cell.abs() < wire.layers[0].cell_limit - 2).count();
        let hidden = state.hidden[..32].iter().filter(|hidden| **hidden != 0 && hidden.unsigned_abs() < 32_767).count();
        if inside > 4 && hidden > 4 {
            moving[number][usize::from(wire.activation_code)] += 1;
        }
    }
    for (cell, moving) in [Cell::Lstm, Cell::Gru].into_iter().zip(moving) {
        for (code, count) in (0..).zip(moving) {
            let activation = Activation::from_code(code).unwrap().name();
            assert!(count > 30, "{}, {activation}: only {count} of 100 networks move between their limits", cell.name());
        }
    }
}

#[test]
fn a_network_that_does_not_fit_its_memory_is_refused() {
    let mut random = RandomNetwork::new();
    random.draw(5, 32, &[(Cell::Lstm, 64), (Cell::Lstm, 64)]);
    let wire = random.wire();
    let network = Network::new(&wire, 32).unwrap();
    let mut memory = vec![0; MAX_PACKED_WORDS];
    assert!(memory[..].as_mut().kernel(&network).is_ok());
    let error = memory[1..].as_mut().kernel(&network).unwrap_err();
    assert_eq!((error.field, error.index), ("network", 1));
}
