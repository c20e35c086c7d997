//! The firmware as ARM code in QEMU gives the desktop's bits, at the recorded number of instructions.
//!
//! These need QEMU and the built image, so plain `cargo test` leaves them out and says so; `cargo xtask test` installs both and runs them.

use firmware::estimator::{Estimator, Network, Portable, step_instructions};
use firmware::parity::{RandomNetwork, estimator_digest, network_digest, shapes};
use host_tool::network::{Activation, Mode};
use model_export::blob;
use rig_tests::emulator::{Task, Work};
use rig_tests::figures::{configurations, costs, imported, tick_costs, worst_tick};
use rig_tests::models::{exported, model, network, physics_front_end};
use rig_tests::snapshot;

#[test]
#[ignore = "needs QEMU and the image; `cargo xtask test` runs it"]
fn networks_of_every_shape_give_the_same_bits_as_on_the_desktop() {
    let (seed, steps) = (3, 3);
    let lines = Work { task: Task::Sweep, steps, seed, blobs: &[] }.run();
    let mut random = RandomNetwork::new();
    random.fill_pool(seed);
    let mut count = 0;
    for (index, (inputs, units)) in (0..).zip(shapes()) {
        random.draw(index, inputs, &units);
        let network = Network::new(&random.wire(), inputs).unwrap();
        let expected = format!("{index} {:08x}", network_digest(&network, &Portable, index, 3));
        assert_eq!(lines.get(count), Some(&expected), "{inputs} features, {units:?} units");
        count += 1;
    }
    assert_eq!((count, lines.len()), (4544, 4544));
}

#[test]
#[ignore = "needs QEMU and the image; `cargo xtask test` runs it"]
fn imported_layers_take_the_instructions_that_inspect_says() {
    let configurations = imported();
    for (configuration, cost) in configurations.iter().zip(costs(&configurations)) {
        let estimate = step_instructions(&blob::decode(&exported(&configuration.model, 7)).unwrap().model) as f64;
        println!("{}: {:?} instructions, {estimate} estimated, {} with the portable kernel", cost.name, cost.packed, cost.portable);
        let ratio = estimate / f64::from(cost.packed[1]);
        assert!((0.97..=1.03).contains(&ratio), "{}: {estimate} estimated, {cost:?}", cost.name);
    }
}

#[test]
#[ignore = "needs QEMU and the image; `cargo xtask test` runs it"]
fn golden_vectors_and_ten_thousand_random_steps_give_the_same_bits_as_on_the_desktop() {
    let (seed, steps) = (11, 10_000u32);
    // Windows come below: those of the configurations run fifty steps for each sample.
    let configurations = configurations().into_iter().filter(|configuration| configuration.model.mode == Mode::Streaming);
    let mut blobs: Vec<Vec<u8>> = configurations.map(|configuration| exported(&configuration.model, seed)).collect();
    for (index, activation) in (0..).zip([Activation::Tanh, Activation::Relu, Activation::Hard]) {
        let front_end = physics_front_end(100 + index, 5 + 3 * u8::try_from(index).unwrap(), 2);
        let network = network(200 + index, front_end.features.len(), &[13, 22], activation, 1.5);
        blobs.push(exported(&model(front_end.clone(), Some(network.clone()), Mode::Streaming), seed));
        blobs.push(exported(&model(front_end, Some(network), Mode::Window { length: 5 }), seed));
    }
    blobs.extend(imported().iter().map(|configuration| exported(&configuration.model, seed)));
    let lines = Work { task: Task::Golden, steps, seed, blobs: &blobs }.run();
    assert_eq!(lines.len(), blobs.len());
    for (index, (bytes, line)) in blobs.iter().zip(&lines).enumerate() {
        let model = blob::decode(bytes).unwrap().model;
        let estimator = Estimator::new(&model).unwrap();
        let digest = estimator_digest(&estimator, [model.input.minimum, model.input.maximum], seed, steps as usize);
        let samples = model.golden.input.len() / 4;
        assert_eq!(*line, format!("{samples} true {digest:08x}"), "blob {index}");
    }
}

#[test]
#[ignore = "needs QEMU and the image; `cargo xtask test` runs it"]
fn steps_and_ticks_take_the_recorded_instructions_and_keep_their_targets() {
    let configurations = configurations();
    let (costs, ticks) = (costs(&configurations), tick_costs("hybrid"));
    let text = std::fs::read_to_string(snapshot::path()).unwrap();
    let differences = snapshot::differences(&serde_json::from_str(&text).unwrap(), &snapshot::record(&costs, &ticks));
    assert!(differences.is_empty(), "{differences:#?}\nif that is meant, renew the record with `cargo xtask bench firmware --bless`");

    let most = |name| costs.iter().find(|cost| cost.name == name).unwrap().packed[1];
    for (name, target) in [("2x64-tanh", 54_600), ("2x64-relu", 54_600), ("1x32-relu", 9_000)] {
        assert!(most(name) <= target, "{name}: {} instructions, {target} allowed", most(name));
    }
    // 60 % of the cycles of a millisecond at 168 MHz.
    assert!(worst_tick(&ticks) < 100_800, "{ticks:?}");
    let largest = tick_costs("largest");
    assert!(worst_tick(&largest) < 100_800, "{largest:?}");

    // What `catheter inspect` says before anything is flashed.
    for (configuration, cost) in configurations.iter().zip(&costs) {
        let bytes = exported(&configuration.model, 7);
        let estimate = step_instructions(&blob::decode(&bytes).unwrap().model) as f64;
        let ratio = estimate / f64::from(cost.packed[1]);
        assert!((0.97..=1.03).contains(&ratio), "{}: {estimate} estimated, {cost:?}", cost.name);
    }
}

#[test]
#[ignore = "needs QEMU and the image; `cargo xtask test` runs it"]
fn the_networks_cost_does_not_depend_on_data() {
    // Only the front end has branches: on the sample itself, on which side of its play an operator is, and at the bends of further stages, which
    // are left out here.
    let configurations: Vec<_> = configurations().into_iter().filter(|one| one.model.front_end.stages.is_none()).collect();
    for cost in costs(&configurations) {
        let [least, most] = cost.packed;
        let allowed = if cost.name.contains("window") { 50 * 50 } else { 200 };
        assert!(most - least <= allowed, "{cost:?}");
    }
}
