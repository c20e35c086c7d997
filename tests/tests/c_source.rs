//! Models as C source: whatever a C compiler makes of them gives the bits of the firmware's estimator.
//!
//! Terms. *Build*: one compiler with one set of options. *Script*: the samples that a program runs, some after a reset.

mod c_source {
    pub mod program;
    pub mod random;
    pub mod script;
}

use c_source::program::{Build, builds};
use c_source::random::RandomModel;
use c_source::script::{Script, expected};
use host_tool::export::c::{Name, generate};
use model_export::blob::{self, Blob};
use rig_tests::figures::{configurations, imported};
use rig_tests::models::exported;

/// Samples that every model runs when optimised.
const SAMPLES: usize = 24_000;
/// Random models.
const RANDOM_MODELS: u32 = 24;

/// Runs a model in every build and expects the estimator's bits.
fn meets_the_estimator(what: &str, blob: &Blob<'_>, builds: &[Build], script: &Script) {
    let name = Name::from_stem("model").expect("a plain name");
    let source = generate(blob, &name).unwrap_or_else(|error| panic!("{what}: {error}"));
    let expected = expected(&blob.model, script);
    let folder = tempfile::tempdir().expect("a temporary folder");
    std::fs::write(folder.path().join("model.h"), &source.header).expect("the header");
    std::fs::write(folder.path().join("model.c"), &source.source).expect("the source");
    for build in builds {
        // Slow builds look at the beginning only, which has every kind of sample in it.
        let length = if build.is_slow() { script.len() / 6 } else { script.len() };
        let found = build.run(folder.path(), &script.bytes()[..8 * length]);
        for (sample, (found, expected)) in found.iter().zip(&expected[..length]).enumerate() {
            assert_eq!(found, expected, "{what}, {build}: (held samples, output bits) of sample {sample}");
        }
        assert_eq!(found.len(), length, "{what}, {build}");
    }
    println!("{what}: {} samples, {} builds", script.len(), builds.len());
}

#[test]
fn every_kind_of_model_gives_the_estimators_bits() {
    let Some(builds) = builds() else { return };
    for (seed, configuration) in configurations().iter().chain(&imported()).enumerate() {
        let seed = u32::try_from(seed).expect("a few configurations");
        let bytes = exported(&configuration.model, 40 + seed);
        let blob = blob::decode(&bytes).expect("a blob just made");
        let script = Script::new(&blob.model.input, seed, SAMPLES);
        meets_the_estimator(configuration.name, &blob, &builds, &script);
    }
}

#[test]
fn whatever_a_blob_may_hold_gives_the_estimators_bits() {
    let Some(builds) = builds() else { return };
    let mut random = RandomModel::default();
    for seed in 0..RANDOM_MODELS {
        random.with(seed, |model| {
            let bytes = blob::encode(model).unwrap_or_else(|error| panic!("seed {seed}: {error}"));
            let blob = blob::decode(&bytes).expect("a blob just made");
            // Every other one with the build that is most likely to differ.
            let builds = if seed % 2 == 0 { &builds[..] } else { &builds[..1] };
            meets_the_estimator(&format!("seed {seed}"), &blob, builds, &Script::new(&blob.model.input, seed, SAMPLES / 4));
        });
    }
}

#[test]
fn a_build_that_could_not_keep_the_bits_is_refused_by_the_source() {
    let Some(builds) = builds() else { return };
    let bytes = exported(&configurations().pop().expect("a physics model").model, 3);
    let source = generate(&blob::decode(&bytes).expect("a blob just made"), &Name::from_stem("model").expect("a plain name"));
    let source = source.expect("a model that meets its golden vectors");
    let folder = tempfile::tempdir().expect("a temporary folder");
    std::fs::write(folder.path().join("model.h"), &source.header).expect("the header");
    std::fs::write(folder.path().join("model.c"), &source.source).expect("the source");
    let said = builds[0].refused_with(folder.path(), "-ffast-math");
    assert!(said.contains("-ffast-math and its parts"), "{said}");
}

#[test]
fn the_self_test_notices_a_weight_that_changed() {
    let Some(builds) = builds() else { return };
    let configuration = configurations().into_iter().find(|configuration| configuration.name == "1x32-relu").expect("that one");
    let bytes = exported(&configuration.model, 9);
    let blob = blob::decode(&bytes).expect("a blob just made");
    let source = generate(&blob, &Name::from_stem("model").expect("a plain name")).expect("a model that meets its golden vectors");
    let folder = tempfile::tempdir().expect("a temporary folder");
    std::fs::write(folder.path().join("model.h"), &source.header).expect("the header");
    let (before, after) = source.source.split_once("/* o 0 */\n    ").expect("the first row of the output gates");
    let (weight, rest) = after.split_once(',').expect("a row of weights");
    let changed = weight.parse::<i32>().expect("a weight").wrapping_neg() / 2 + 31;
    std::fs::write(folder.path().join("model.c"), format!("{before}/* o 0 */\n    {changed},{rest}")).expect("the source");
    assert!(builds[0].fails_its_self_test(folder.path()));
}

#[test]
fn a_model_that_does_not_meet_its_golden_vectors_is_not_written() {
    let bytes = exported(&configurations().pop().expect("a physics model").model, 5);
    let mut blob = blob::decode(&bytes).expect("a blob just made");
    blob.model.golden.digest ^= 1;
    let error = generate(&blob, &Name::from_stem("model").expect("a plain name")).expect_err("wrong bits");
    assert!(error.to_string().contains("golden vectors"), "{error}");
    blob.model.golden = model_export::schema::Golden::default();
    assert!(generate(&blob, &Name::from_stem("model").expect("a plain name")).is_err(), "nothing to test itself with");
}
